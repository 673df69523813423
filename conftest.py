"""Fixtures for code blocks in documents: in a fence ``python fixture:emulated_arm`` an arm is plugged in."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator

import pytest

from hexwire.emulator.board import make_hex7bot_board
from hexwire.emulator.serve_pty import PtyServer


@pytest.fixture
def emulated_arm(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """An emulated Hex7Bot on a serial port that HEXWIRE_PORT names; gives its path."""
    server = PtyServer(make_hex7bot_board(start=time.monotonic()))
    path = server.open()
    stop = threading.Event()

    def serve() -> None:
        while not stop.is_set():
            server.run_once(0.05)

    thread = threading.Thread(target=serve)
    thread.start()
    monkeypatch.setenv("HEXWIRE_PORT", path)
    try:
        yield path
    finally:
        stop.set()
        thread.join()
        server.close()
