"""The last ten minutes of an arm: positions, goals, velocities, loads, rates, for plots and files.

Owns the samples, in blocks of memory: another one is taken when the last is full, and one that is too old goes.
Pure: states come in as arguments, with their times. Must not know files or sockets.

One thread adds samples; any thread may read. Neither waits for the other: no row is ever overwritten.
"""

from __future__ import annotations

import math
import struct
from array import array
from bisect import bisect_left, bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from hexwire.model.state import JointFlag, JointState

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

__all__ = ["ARM_SIGNALS", "BLOCK", "JOINT_SIGNALS", "History", "KeptSignal", "Rows"]

_FAULTS = sum(int(flag.faults) for flag in JointFlag)
BLOCK = 512
"""Rows of a block, which are copied at once."""


@dataclass(frozen=True, slots=True)
class KeptSignal:
    """A quantity that is kept.

    Attributes:
        name: Its name in files, as in `JointState`.
        unit: Its SI unit; empty for a plain number.
        words: Its name for people.
    """

    name: str
    unit: str
    words: str


JOINT_SIGNALS = (
    KeptSignal("position", "rad", "position"),
    KeptSignal("goal", "rad", "goal"),
    KeptSignal("velocity", "rad/s", "velocity"),
    KeptSignal("load", "", "load"),
    KeptSignal("current", "A", "current"),
    KeptSignal("voltage", "V", "voltage"),
    KeptSignal("temperature", "°C", "temperature"),
)
"""What is kept of each joint, in this order; a goal is the last position that was sent."""
ARM_SIGNALS = (
    KeptSignal("rate", "Hz", "state rate"),
    KeptSignal("round_trip", "s", "round trip"),
    KeptSignal("faults", "", "joints with faults"),
)
"""What is kept of the whole arm."""


@dataclass(frozen=True, slots=True)
class Rows:
    """Samples, oldest first.

    Attributes:
        times: Seconds of the host's clock, rising.
        blocks: Little-endian floats of 32 bits, `width` for each time; NaN where unknown. Each has at most `BLOCK`
            rows, so that nobody copies more at once: other threads wait meanwhile.
        width: Values in a row.
    """

    times: array[float]
    blocks: tuple[bytes, ...]
    width: int

    def __len__(self) -> int:
        return len(self.times)

    def __iter__(self) -> Iterator[tuple[float, tuple[float, ...]]]:
        """Pairs of time and values."""
        row = struct.Struct(f"<{self.width}f")
        values = (found for block in self.blocks for found in row.iter_unpack(block))
        return zip(self.times, values, strict=True)

    def between(self, begin: float, end: float) -> Rows:
        """Only the rows of these times, both included."""
        low, high = bisect_left(self.times, begin), bisect_right(self.times, end)
        return Rows(self.times[low:high], _cut(self.blocks, low, high, 4 * self.width), self.width)


def _cut(blocks: Iterable[bytes], low: int, high: int, size: int) -> tuple[bytes, ...]:
    """The rows from `low` to before `high`, of `size` bytes each."""
    found, at = [], 0
    for block in blocks:
        count = len(block) // size
        if part := block[max(0, low - at) * size : max(0, high - at) * size]:
            found.append(part)
        at += count
    return tuple(found)


class _Block:
    """Rows in the order of their times, of which the first `count` are there."""

    __slots__ = ("count", "size", "times", "values")

    def __init__(self, size: int) -> None:
        self.size, self.count = size, 0
        self.times, self.values = array("d", bytes(8 * BLOCK)), bytearray(size * BLOCK)

    def later(self, after: float) -> tuple[int, int]:
        """Places of the first row that is later than a time, and after the last one."""
        count = self.count
        return bisect_right(self.times, after, 0, count), count


class History:
    """Keeps samples of one arm.

    A row has `JOINT_SIGNALS` of the first joint, then those of the second, and so on; then `ARM_SIGNALS`.

    Args:
        names: Joint names.
        seconds: How long samples are kept.
        rate: Most samples per second; of more frequent ones, some are left out.
    """

    def __init__(self, names: Sequence[str], *, seconds: float = 600.0, rate: float = 100.0) -> None:
        self.names = tuple(names)
        self.width = len(JOINT_SIGNALS) * len(self.names) + len(ARM_SIGNALS)
        self._period = 1.0 / rate
        self._seconds = seconds
        self._row = struct.Struct(f"<{self.width}f")
        # Another one for each change, so that readers need no lock.
        self._blocks: tuple[_Block, ...] = ()
        self._due = self._last = -math.inf

    @property
    def columns(self) -> list[tuple[str, KeptSignal]]:
        """Pairs of joint and signal, in the order of a row; the joint is empty for the whole arm."""
        return [(name, signal) for name in self.names for signal in JOINT_SIGNALS] + [
            ("", signal) for signal in ARM_SIGNALS
        ]

    def append(
        self,
        state: JointState,
        goals: Mapping[str, float],
        *,
        rate: float = math.nan,
        round_trip: float = math.nan,
    ) -> bool:
        """Add a state, unless it comes too soon after the last one or is not newer.

        Args:
            state: The state; joints that it lacks are unknown.
            goals: Positions that were sent last, by joint, radians.
            rate: States per second.
            round_trip: Seconds.

        Returns:
            Whether it was added.
        """
        now = state.stamp
        if not now > self._last:
            return False
        # Samples come early and late; after a delay of more than a period, the due times start from now.
        if now < self._due - 0.5 * self._period:
            return False
        self._due = (self._due if now < self._due + self._period else now) + self._period
        self._last = now
        unknown = math.nan
        row: list[float] = []
        places = {name: i for i, name in enumerate(state.names)} if state.names != self.names else None
        faults = 0
        for k, name in enumerate(self.names):
            i = k if places is None else places.get(name, -1)
            if i < 0:
                row += (unknown, goals.get(name, unknown), *(unknown,) * (len(JOINT_SIGNALS) - 2))
                continue
            row += (
                state.position[i],
                goals.get(name, unknown),
                state.velocity[i],
                state.load[i],
                state.current[i],
                state.voltage[i],
                state.temperature[i],
            )
            faults += bool(state.flags[i] & _FAULTS)
        block = self._blocks[-1] if self._blocks else None
        if block is None or block.count == BLOCK:
            oldest = now - self._seconds
            kept = (each for each in self._blocks if each.times[-1] > oldest)
            block = _Block(self._row.size)
            self._blocks = (*kept, block)
        at = block.count
        block.times[at] = now
        self._row.pack_into(block.values, at * block.size, *row, rate, round_trip, faults)
        # Last, so that a reader never sees a row that is not complete.
        block.count += 1
        return True

    def _later(self, after: float) -> Iterator[tuple[_Block, int, int]]:
        """The blocks with samples of the last ten minutes that are later than a time, and their places there."""
        after = max(after, self._last - self._seconds)
        for block in self._blocks:
            low, high = block.later(after)
            if low < high:
                yield block, low, high

    def count_after(self, after: float = -math.inf) -> int:
        """How many samples `rows` has."""
        return sum(high - low for _, low, high in self._later(after))

    def rows(self, after: float = -math.inf) -> Rows:
        """The samples of the last ten minutes that are later than a time."""
        times, blocks = array("d"), list[bytes]()
        for block, low, high in self._later(after):
            times += block.times[low:high]
            blocks.append(bytes(memoryview(block.values)[low * block.size : high * block.size]))
        return Rows(times, tuple(blocks), self.width)
