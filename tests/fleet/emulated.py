"""Emulated robots of every kind, each behind its own address, for a server or a program to open.

They run in threads of this process, to which a busy machine gives no processor for a while: this process waits for
their answers for longer than for those of real ones.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from queue import SimpleQueue

import pytest
from tests.defaults import default
from tests.drivers.puma_server import served_puma

from hexwire.bus import timing
from hexwire.emulator.board import EmulatedBoard, make_hex7bot_board
from hexwire.emulator.bus_device import make_servos
from hexwire.emulator.serve_pty import PtyServer, serve_bus
from hexwire.emulator.servo import EmulatedServo
from hexwire.session.policy import RetryPolicy
from hexwire.wire.registers import Series

KINDS = ("dialect 2", "dialect 1", "so101", "puma260")
"""A Hex7Bot with hexwire's firmware and one with the chapter's, an arm on a servo bus, and a PUMA 260."""
_PATIENCE = 1.0


@contextmanager
def patience() -> Iterator[None]:
    """Wait longer for each answer of a board or of servos, in this process. All of them must be there."""
    with pytest.MonkeyPatch.context() as patch:
        default(patch, RetryPolicy, window=_PATIENCE, dialect1_window=_PATIENCE)
        for allowance in ("_FIRST_ALLOWANCE", "_LEAST_ALLOWANCE", "_MOST_ALLOWANCE"):
            patch.setattr(timing, allowance, _PATIENCE)
        yield


@contextmanager
def emulated(kind: str) -> Iterator[dict[str, object]]:
    """Emulate a robot; gives the settings of an arm for a server: ``robot`` and ``port``."""
    if kind == "puma260":
        with served_puma() as puma:
            yield {"robot": kind, "port": puma.tcp}
    elif kind == "so101":
        servos = make_servos([Series.STS_SMS], range(1, 7), baud=[0], start=time.monotonic())
        with patience(), served_bus(servos) as path:
            yield {"robot": kind, "port": path}
    else:
        board = make_hex7bot_board(dialect=int(kind[-1]), baud=0, start=time.monotonic())
        with patience(), served_board(board) as path:
            yield {"robot": "hex7bot", "port": path}


@contextmanager
def served_bus(servos: list[EmulatedServo]) -> Iterator[str]:
    """Servos on a terminal; gives its path."""
    paths: SimpleQueue[str] = SimpleQueue()
    with _thread(lambda ended: serve_bus(servos, baud=0, stop=ended, announce=paths.put)):
        yield paths.get(timeout=30)


@contextmanager
def served_board(board: EmulatedBoard) -> Iterator[str]:
    """A board on a terminal; gives its path."""
    server = PtyServer(board)
    path = server.open()

    def run(ended: Callable[[], bool]) -> None:
        while not ended():
            server.run_once(0.02)

    try:
        with _thread(run):
            yield path
    finally:
        server.close()


@contextmanager
def _thread(run: Callable[[Callable[[], bool]], object]) -> Iterator[None]:
    end = threading.Event()
    thread = threading.Thread(target=run, args=(end.is_set,))
    thread.start()
    try:
        yield
    finally:
        end.set()
        thread.join(30)
