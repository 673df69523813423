"""Fifty arms in one process: each an emulated board behind a driver of its own, polled at a steady rate.

Each arm is a `Hex7BotDriver` over a link in memory to an emulated board with seven servos. One thread does
everything: a cycle reads the joints, and every fifth writes a set-point as well.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable

from hexwire.drivers.hex7bot import Hex7BotDriver
from hexwire.emulator.board import EmulatedBoard, make_hex7bot_board
from hexwire.ipc.handle import IpcHandle
from hexwire.ipc.session import Session
from hexwire.link.base import Link, LinkKind
from hexwire.model.state import JointTarget

__all__ = ["Arm", "run_fleet"]

SET_POINTS = 5
"""Cycles from one set-point to the next."""


def _sleep(clock: Callable[[], float]) -> Callable[[float], object]:
    """What lets time pass: a clock of simulated time does it itself."""
    return getattr(clock, "sleep", time.sleep)


class HostedLink(Link):
    """A line to a board in this process: who writes hands over, who reads lets the board work."""

    kind = LinkKind.STREAM
    max_message = None

    def __init__(self, board: EmulatedBoard, number: int, clock: Callable[[], float]) -> None:
        self.board, self.clock = board, clock
        self.url = f"memory://arm{number}"
        self._open = False

    @property
    def is_open(self) -> bool:
        return self._open

    def open(self) -> None:
        self._open = True

    def close(self) -> None:
        self._open = False

    def read(self, deadline: float | None) -> bytes:
        while True:
            now = self.clock()
            self.board.step(now)
            data = self.board.data_to_send()
            if data or (deadline is not None and now >= deadline):
                return data
            due = [when for when in (deadline, self.board.next_event_time()) if when is not None]
            _sleep(self.clock)(max(0.0, min([0.001, *(when - now for when in due)])))

    def write(self, data: bytes, deadline: float | None = None) -> None:
        self.board.receive(data, self.clock())

    def flush_input(self) -> int:
        return len(self.board.data_to_send())

    def wake(self) -> None:
        """Nobody waits here for long."""


class Arm:
    """One arm of the fleet.

    Attributes:
        cycles: Cycles done.
        worst: Largest error of J1 against its set-point of a moment ago, radians.
    """

    def __init__(self, number: int, clock: Callable[[], float]) -> None:
        now = clock()
        # baud 0: a bus that costs no time, so that what is measured is the work of host and emulator.
        board = make_hex7bot_board(dialect=2, baud=0, faults=(), seed=number, start=now)
        self.link = HostedLink(board, number, clock)
        self.driver = Hex7BotDriver(Session(IpcHandle.from_link(self.link)))
        self.phase = 0.1 * number
        self.cycles = 0
        self.worst = 0.0
        self.wanted = 0.0
        self.driver.attach()
        self.driver.torque(True)
        self.centre = self.driver.read()["J1"].position

    def cycle(self, t: float, period: float) -> None:
        if self.cycles % SET_POINTS == 0:
            ahead = t + SET_POINTS * period
            self.wanted = self.centre + 0.2 * math.sin(ahead + self.phase) - 0.2 * math.sin(self.phase)
            self.driver.write(JointTarget.of({"J1": self.wanted}, SET_POINTS * period))
        here = self.driver.read()["J1"].position
        if t > 1.0:
            self.worst = max(self.worst, abs(here - self.wanted))
        self.cycles += 1


def run_fleet(
    count: int,
    seconds: float,
    *,
    rate: float = 50.0,
    tick: Callable[[float], None] = lambda _: None,
    clock: Callable[[], float] = time.monotonic,
) -> tuple[list[Arm], float, float]:
    """Run a fleet.

    Args:
        count: Arms.
        seconds: How long.
        rate: Cycles a second of each arm.
        tick: Called with the time at each cycle.
        clock: Seconds of all parts.

    Returns:
        The arms, CPU seconds of this process for the cycles alone, and the achieved rate in Hz.
    """
    arms = [Arm(number, clock) for number in range(count)]
    period = 1.0 / rate
    cycles = round(seconds * rate)
    try:
        cpu, began = time.process_time(), clock()
        for i in range(cycles):
            tick(i * period)
            for arm in arms:
                arm.cycle(i * period, period)
            left = began + (i + 1) * period - clock()
            if left > 0:
                _sleep(clock)(left)
        return arms, time.process_time() - cpu, cycles / (clock() - began)
    finally:
        for arm in arms:
            arm.driver.detach()
