"""Emulated servos on a pseudo-terminal: a bus adapter that other programs can open.

Owns the loop, which keeps the line's timing more finely than `serve` needs to, and the rate that the host has set
on the terminal: servos set to another rate do not understand it. Must not know who is on the other side.
"""

from __future__ import annotations

import sys

if sys.platform != "linux":
    raise ImportError("pseudo-terminals for emulated servos are for Linux; give the emulator --tcp HOST:PORT")

import time
from collections.abc import Callable, Sequence
from pathlib import Path

from hexwire.link.serial import terminal_rate
from hexwire.model.arm import ArmModel

from .bus_device import BusDevice
from .faults import FaultPlan
from .hand import Hands
from .serve_pty import PtyServer
from .servo import EmulatedServo

__all__ = ["serve_bus"]

_IDLE = 0.02


def serve_bus(
    servos: Sequence[EmulatedServo],
    *,
    baud: int,
    stop: Callable[[], bool],
    announce: Callable[[str], None],
    link: str | Path | None = None,
    faults: FaultPlan | None = None,
    echo: bool = False,
    arm: ArmModel | None = None,
) -> None:
    """Serve a bus until told to stop.

    Args:
        servos: The servos on it.
        baud: Rate of the servos, of the first if they differ; with 0, bytes take no time and every servo hears any
            rate.
        stop: Called at least every 20 ms; True ends it.
        announce: Called with the path once the terminal is open.
        link: Path of a symbolic link to make to the terminal.
        faults: Scripted faults.
        echo: The adapter hears itself.
        arm: Names of the joints, for hands; None if it is no arm.
    """
    server: PtyServer | None = None

    def host_baud() -> int:
        return (None if server is None else terminal_rate(server.fileno())) or baud

    device = BusDevice(servos, paced=bool(baud), faults=faults, echo=echo, host_baud=host_baud)
    server = PtyServer(device, link=link, hands=Hands(servos, arm))
    path = server.open()
    try:
        announce(path)
        while not stop():
            due = device.answer_due
            if due is None:
                server.run_once(_IDLE)
            else:
                time.sleep(max(0.0, due - time.monotonic()))
                server.run_once(0.0)
    finally:
        server.close()
