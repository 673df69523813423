"""Emulated boards and servos in processes of their own, for benchmarks; and what a process takes."""

from __future__ import annotations

import multiprocessing
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection
from pathlib import Path

from hexwire.emulator.board import make_hex7bot_board
from hexwire.emulator.bus_device import make_servos
from hexwire.emulator.serve_pty import PtyServer, serve_bus
from hexwire.wire.registers import Series

__all__ = ["board", "cpu", "cpu_ns", "memory", "servo_bus"]

_WRITES = (0x03, 0x83)
"""Instructions of a servo packet that move a servo: write and sync write."""
_TICKS = os.sysconf("SC_CLK_TCK")


@contextmanager
def board() -> Iterator[tuple[str, Connection]]:
    """An emulated board on an unpaced line, in a process of its own so that nothing here holds it up.

    Yields its terminal, and whom to ask when bytes went out that move a servo.
    """
    context = multiprocessing.get_context("fork")
    ours, theirs = context.Pipe()
    process = context.Process(target=_serve, args=(theirs,), daemon=True)
    process.start()
    try:
        yield ours.recv(), ours
    finally:
        process.terminate()
        process.join()


def _serve(parent: Connection) -> None:
    board = make_hex7bot_board(baud=0, start=time.monotonic())
    plain = board.wire.transact
    moved: list[float] = []

    def transact(packet: bytes, now: float) -> tuple[bytes, float]:
        if len(packet) > 4 and packet[4] in _WRITES:
            moved.append(time.monotonic())
        return plain(packet, now)

    board.wire.transact = transact  # type: ignore[method-assign]
    with PtyServer(board, baud=0) as server:
        parent.send(server.path)
        while True:
            server.run_once()
            # Not as they come: a pipe that is full would hold the board up.
            if parent.poll():
                parent.recv()
                parent.send(moved)


@contextmanager
def servo_bus(count: int = 7) -> Iterator[str]:
    """Servos on an unpaced line, in a process of its own; gives their terminal."""
    context = multiprocessing.get_context("fork")
    ours, theirs = context.Pipe()
    process = context.Process(target=_serve_servos, args=(theirs, count), daemon=True)
    process.start()
    try:
        yield ours.recv()
    finally:
        process.terminate()
        process.join()


def _serve_servos(parent: Connection, count: int) -> None:
    servos = make_servos([Series.STS_SMS], range(1, count + 1), baud=[0], start=time.monotonic())
    serve_bus(servos, baud=0, stop=lambda: False, announce=parent.send)


def cpu(pid: int) -> float:
    """Seconds of processor time that a process has had."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / _TICKS


def cpu_ns(pid: int) -> int:
    """Nanoseconds of processor time that the living threads of a process have had; `cpu` counts in hundredths."""
    total = 0
    for task in Path(f"/proc/{pid}/task").iterdir():
        # A thread may end meanwhile.
        with suppress(OSError):
            total += int((task / "schedstat").read_text().split()[0])
    return total


def memory(pid: int) -> float:
    """Resident memory, MB."""
    for line in Path(f"/proc/{pid}/status").read_text().splitlines():
        if line.startswith("VmRSS"):
            return int(line.split()[1]) / 1000
    return 0.0
