"""What a job of an emulated board waits for, and the serial buffer it may read.

Owns the values that a job yields to the board's scheduler. A job is a generator; it is resumed with the answer when
the wait is over. Knows nothing of frames or the contents of packets.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from typing import NamedTuple

__all__ = ["BUS_TIMEOUT", "BusBuffer", "Clock", "Delay", "Job", "Pause", "Send", "Transaction", "Wait"]

BUS_TIMEOUT = 0.005
"""Seconds for a servo to begin its answer."""

Clock = Callable[[], float]
"""The board's time, seconds; it advances while a job waits."""


class Transaction(NamedTuple):
    """Empty the buffer and put a packet on the bus; the job is resumed with the bytes that come back.

    The wait ends with the whole answer, or `timeout` seconds after the time that packet and answer take.
    """

    packet: bytes
    reply_length: int
    timeout: float = BUS_TIMEOUT


class Send(NamedTuple):
    """Put a packet on the bus; the job is resumed when it is sent. What comes back stays in the buffer."""

    packet: bytes


class Delay(NamedTuple):
    """Time that the board's program takes; skipped if the bus is not paced. The job is resumed without data."""

    seconds: float


class Pause(NamedTuple):
    """Let this much time pass for the servos, paced or not. The job is resumed without data."""

    seconds: float


Wait = Transaction | Send | Delay | Pause
Job = Generator[Wait, bytes | None, None]


class BusBuffer:
    """The serial buffer of the servo bus: bytes that have arrived, and bytes still to come with their times."""

    def __init__(self) -> None:
        self._input: list[tuple[float, bytes]] = []

    def put(self, data: bytes, when: float) -> None:
        """Add bytes that can be read from the time `when` on."""
        self._input.append((when, data))

    def waiting(self, now: float) -> int:
        """Number of bytes that can be read."""
        return sum(len(data) for when, data in self._input if when <= now)

    def read(self, now: float) -> bytes:
        """Remove and return the bytes that have arrived."""
        if not self._input:
            return b""
        data = b"".join(data for when, data in self._input if when <= now)
        self._input = [(when, data) for when, data in self._input if when > now]
        return data
