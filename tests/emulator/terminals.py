"""An emulated device on a terminal, served by a thread."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from hexwire.emulator.serve_pty import PtyServer


@contextmanager
def serving(server: PtyServer) -> Iterator[str]:
    path = server.open()
    ended = threading.Event()

    def run() -> None:
        while not ended.is_set():
            server.run_once(0.02)

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield path
    finally:
        ended.set()
        thread.join(30)
        server.close()
