"""Sessions that ask a studio for as much as they can, in a process of their own: downloads, uploads, plans.

    python -m tests.studio.crowd URL OPERATE_TOKEN WATCH_TOKEN COUNT RECORDING

Prints a line when each kind of request has been answered, and goes on until its input ends; then it prints how
often each was.
"""

from __future__ import annotations

import http.client
import json
import os
import re
import sys
import threading
import time
from collections import Counter
from urllib.parse import quote, urlsplit

from websockets.exceptions import WebSocketException
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin

_PATIENCE = 60.0
_LOG = b"0000: FF FF 01 02 01 FB\n" * 20_000
_PATHS = {
    "history": "/data/history",
    "csv": "/data/history.csv?columns=J1.position",
    "mcap": "/data/history.mcap?from={}",
}
_ROLES = (*_PATHS, "plan", "upload")


def main() -> None:
    """Run the crowd."""
    url, operate, watch, count, recording = sys.argv[1:]
    # Browsers are on other machines: the crowd takes what time of this one the studio leaves.
    os.nice(19)
    ended = threading.Event()
    begun = threading.Barrier(int(count) + 1)
    done: Counter[str] = Counter()

    def visit(number: int) -> None:
        role = _ROLES[number % len(_ROLES)]
        line = http.client.HTTPConnection(urlsplit(url).netloc, timeout=_PATIENCE)
        headers = {"Origin": url}
        tab: str | None = None

        def ask(path: str, body: bytes | None = None) -> bytes:
            line.request("GET" if body is None else "POST", path, body, headers)
            answer = line.getresponse()
            if cookie := answer.getheader("set-cookie"):
                headers["Cookie"] = cookie.partition(";")[0]
            data = answer.read()
            if tab is not None:
                done[f"{role} {answer.status}"] += 1
            return data

        def call(socket: ClientConnection, order: str) -> None:
            socket.send(order)
            while '"answer"' not in (told := str(socket.recv(timeout=_PATIENCE))):
                pass
            done[role + (" 200" if '"value"' in told else told)] += 1

        ask(f"/?token={operate if role in ('plan', 'upload') else watch}")
        socket: ClientConnection | None = None
        if role in ("plan", "upload"):
            found = re.search(rb'name="hexwire-tab" content="([^"]+)"', ask("/"))
            assert found is not None
            tab = found[1].decode()
        tab = tab or ""
        if role == "plan":
            address = url.replace("http", "ws", 1) + f"/live?tab={tab}"
            cookie = {"Cookie": headers["Cookie"]}
            socket = connect(address, origin=Origin(url), additional_headers=cookie, compression=None)
        begun.wait(_PATIENCE)
        args = {"motion": {"what": "play", "recording": recording}}
        order = json.dumps({"do": "call", "id": 1, "name": "arm.preview", "args": args})
        while not ended.is_set():
            try:
                if socket is not None:
                    call(socket, order)
                elif role == "upload":
                    ask(f"/wire/open?tab={quote(tab)}&name=log", _LOG)
                else:
                    ask(_PATHS[role].format(time.monotonic() - 60.0))
            except (OSError, http.client.HTTPException, WebSocketException):
                done[f"{role} lost"] += 1
                line.close()

    threads = [threading.Thread(target=visit, args=(i,), daemon=True) for i in range(int(count))]
    for thread in threads:
        thread.start()
    begun.wait(_PATIENCE)
    deadline = time.monotonic() + _PATIENCE
    while not all(done[f"{role} 200"] for role in _ROLES) and time.monotonic() < deadline:
        time.sleep(0.05)
    print("begun", flush=True)
    sys.stdin.read()
    ended.set()
    print(json.dumps(done), flush=True)


if __name__ == "__main__":
    main()
