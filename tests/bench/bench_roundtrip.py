"""Host cost of one JOINT_STATE round trip over an unpaced pseudo-terminal, beside the bare lower bound.

The bare loop writes, polls and reads the same bytes and looks at none of them. Both talk to the same responder
in another process, in turns, so that a stall of the machine hits both. The figure that counts is CPU time of this
process; wall time carries the responder and the scheduler.
"""

from __future__ import annotations

import os
import select
import signal
import statistics
import time
import tty

from tests.frames import frame_bytes

from hexwire.drivers.hex7bot import Hex7BotDriver
from hexwire.ipc.handle import IpcHandle
from hexwire.ipc.session import Session
from hexwire.session.connection import Connection, Role
from hexwire.session.events import Request
from hexwire.wire import tables
from hexwire.wire.command_frame import Command
from hexwire.wire.commands import ALL_FIELDS, Identity, JointReport, JointRow

_ROUNDS = 12
_PER_ROUND = 400


def _responder(master: int) -> None:
    """Answer IDENTIFY and JOINT_STATE for ever, from a table."""
    connection = Connection(Role.BOARD, local=8, remote=7, type=8)
    identity = Identity(2, (2, 0, 0), 1, 0, 253, 0, tuple(JointRow(i, 1 if i < 4 else 4, True) for i in range(7)))
    seven = tuple(range(2047, 2054))
    report = JointReport(1000, 0, seven, (64,) * 7, *([(1,) * 7] * 6))
    bodies = {Command.IDENTIFY: identity.serialize(), Command.JOINT_STATE: report.serialize()}
    while True:
        connection.receive(os.read(master, 4096), 0.0)
        while (event := connection.next_event()) is not None:
            if isinstance(event, Request):
                connection.reply(event, 0, bodies[Command(event.frame.cmd)], 0.0)
        for data in connection.data_to_send():
            os.write(master, data)


def run() -> list[str]:
    """Measure; returns the lines to print."""
    master, slave = os.openpty()
    tty.setraw(slave)
    path = os.ttyname(slave)
    child = os.fork()
    if child == 0:
        try:
            _responder(master)
        finally:
            os._exit(0)
    try:
        return _measure(path)
    finally:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        os.close(master)
        os.close(slave)


def _measure(path: str) -> list[str]:
    request = frame_bytes(Command.JOINT_STATE, bytes((ALL_FIELDS,)), seq=0)
    driver = Hex7BotDriver(Session(IpcHandle.from_url(f"serial://{path}")))
    with driver:
        size = len(driver.read().names)
        fd = driver.session.ipc.link.fileno()  # type: ignore[attr-defined]  # a serial link has one
        poll = select.poll()
        poll.register(fd, select.POLLIN)
        bare: list[tuple[float, float]] = []
        full: list[tuple[float, float]] = []
        for round_ in range(_ROUNDS + 1):
            measured_bare = _time(lambda: _bare(fd, poll, request))
            measured_full = _time(driver.read)
            if round_:
                bare.append(measured_bare)
                full.append(measured_full)
        reply = tables.FRAME_OVERHEAD + 8 + 13 * size
    cpu_bare, cpu_full = (statistics.median(c for c, _ in rows) for rows in (bare, full))
    wall_bare, wall_full = (statistics.median(w for _, w in rows) for rows in (bare, full))
    ratio = statistics.median(f / b for (f, _), (b, _) in zip(full, bare, strict=True))
    return [
        f"JOINT_STATE round trip over an unpaced pty, {len(request)} bytes out, {reply} in, seven joints:",
        f"  CPU bare write, poll, read {cpu_bare:.1f} us, hexwire {cpu_full:.1f} us: ratio {ratio:.2f}, aim 4",
        f"  wall bare {wall_bare:.1f} us, hexwire {wall_full:.1f} us",
    ]


def _bare(fd: int, poll: select.poll, request: bytes) -> None:
    os.write(fd, request)
    poll.poll(1000)
    os.read(fd, 4096)


def _time(call: object) -> tuple[float, float]:
    cpu, wall = time.process_time(), time.perf_counter()
    for _ in range(_PER_ROUND):
        call()  # type: ignore[operator]  # a callable
    return (time.process_time() - cpu) / _PER_ROUND * 1e6, (time.perf_counter() - wall) / _PER_ROUND * 1e6


if __name__ == "__main__":
    print("\n".join(run()))
