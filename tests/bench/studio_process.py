"""The process whose figures the studio's benchmark takes: an owner alone, or one with the studio around it.

    python tests/bench/studio_process.py owner  --port URL     the arm, opened as the studio opens it; no pages
    python tests/bench/studio_process.py studio --port URL     `hexwire studio`

A line on stdin asks how late the owner's cycles began since the last line; the answer is a line of JSON, seconds.
"""

from __future__ import annotations

import json
import sys
import threading

from hexwire.control.loop import loop
from hexwire.control.loop.shutdown import Shutdown

_SWITCH = 0.00002
"""As `hexwire studio` sets it."""


def main(words: list[str]) -> None:
    """Run until stdin ends."""
    delays: list[float] = []
    wait = loop.RateLoop._wait_until

    def noted(self: loop.RateLoop, deadline: float) -> float:
        delay = wait(self, deadline)
        delays.append(delay)
        return delay

    loop.RateLoop._wait_until = noted  # type: ignore[method-assign]  # eyes on the loop
    kind, *rest = words
    answer = threading.Thread(target=_answer, args=(delays,), daemon=True)
    if kind == "studio":
        from hexwire.cli.main import cli

        answer.start()
        cli(["studio", *rest])
        return
    from hexwire.studio.source import Source

    sys.setswitchinterval(_SWITCH)
    shutdown = Shutdown(12.0)
    shutdown.listen()
    source = Source()
    options = dict(zip(rest[::2], rest[1::2], strict=True))
    source.open(options["--port"], options.get("--robot"))
    print("operate: none", flush=True)
    answer.start()
    while not shutdown.wait(1.0):
        pass
    source.close()


def _answer(delays: list[float]) -> None:
    for _ in sys.stdin:
        rows, delays[:] = delays[:], []
        print(json.dumps(rows), flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
