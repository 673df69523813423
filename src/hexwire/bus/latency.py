"""A stress test of a bus: reads as fast as possible, how long each took, and which values are missing.

Owns the loop, its counts and the histogram, in bounded memory whatever its length. Nothing moves. Must not know
terminals or pages.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field

from .servo_bus import ServoBus

__all__ = ["Bins", "LatencyCounts", "StressTest"]

_RESOLUTION = 1e-6
_SHARES = 10
"""Bins up to the 99th percentile; one more holds what took longer."""


@dataclass(frozen=True, slots=True)
class Bins:
    """A histogram.

    Attributes:
        edges: Lower end of each bin, seconds; the last bin has no upper end.
        counts: Number of durations in each.
        p50: Median, seconds.
        p99: 99th percentile, seconds.
        longest: Seconds.
    """

    edges: tuple[float, ...]
    counts: tuple[int, ...]
    p50: float
    p99: float
    longest: float


class LatencyCounts:
    """Durations, counted by the microsecond, so that millions of them take little memory.

    Attributes:
        total: Number of durations.
        longest: Seconds.
    """

    def __init__(self) -> None:
        self.total, self.longest = 0, 0.0
        self._counts: dict[int, int] = {}

    def add(self, seconds: float) -> None:
        """Count a duration. From a millisecond on, three digits are kept."""
        self.total += 1
        self.longest = max(self.longest, seconds)
        steps = max(0, round(seconds / _RESOLUTION))
        if steps >= 1000:
            digits = 10 ** (int(math.log10(steps)) - 2)
            steps = steps // digits * digits
        self._counts[steps] = self._counts.get(steps, 0) + 1

    def percentile(self, share: float) -> float:
        """The duration that this fraction does not exceed, seconds; NaN without any."""
        place = min(self.total - 1, int(self.total * share))
        for steps in sorted(self._counts):
            place -= self._counts[steps]
            if place < 0:
                return steps * _RESOLUTION
        return math.nan

    def bins(self) -> Bins:
        """Make a histogram: ten bins up to the 99th percentile, and one for the rest; no bins without durations."""
        if not self._counts:
            return Bins((), (), math.nan, math.nan, math.nan)
        low, p99 = min(self._counts) * _RESOLUTION, self.percentile(0.99)
        step = max((p99 - low) / _SHARES, _RESOLUTION)
        filled = [0] * (_SHARES + 1)
        for steps, count in self._counts.items():
            # A duration on an edge belongs above it, also where floating point puts it a hair below.
            filled[min(int((steps * _RESOLUTION - low) / step + 1e-9), _SHARES)] += count
        edges = tuple(low + i * step for i in range(_SHARES + 1))
        return Bins(edges, tuple(filled), self.percentile(0.5), p99, self.longest)


@dataclass
class StressTest:
    """One test and what it found so far; `run` may be called again to go on.

    Attributes:
        ids: The servos.
        name: The register that is read.
        took: Durations of the reads.
        missing: Number of missing values by servo.
        seconds: Duration of the test.
    """

    ids: tuple[int, ...]
    name: str = "present_position"
    took: LatencyCounts = field(default_factory=LatencyCounts)
    missing: dict[int, int] = field(default_factory=dict)
    seconds: float = 0.0

    def __post_init__(self) -> None:
        self.missing = dict.fromkeys(self.ids, 0)

    def run(
        self,
        bus: ServoBus,
        count: int,
        *,
        go_on: Callable[[], bool] = lambda: True,
        clock: Callable[[], float] = time.perf_counter,
        each: Callable[[float], object] = lambda seconds: None,
    ) -> None:
        """Read `count` times, or until `go_on` returns False.

        Args:
            bus: The bus, which knows the series of the servos.
            count: Number of reads.
            go_on: Asked before each read.
            clock: Seconds.
            each: Called with each duration.

        Raises:
            LinkError: The line has a fault; what was found so far is kept.
        """
        first = clock()
        try:
            for _ in range(count):
                if not go_on():
                    return
                begin = clock()
                readings = bus.sync_read(self.name, self.ids)
                took = clock() - begin
                self.took.add(took)
                each(took)
                for servo_id in readings.missing:
                    self.missing[servo_id] += 1
        finally:
            self.seconds += clock() - first

    @property
    def reads(self) -> int:
        """Number of reads."""
        return self.took.total

    @property
    def values(self) -> int:
        """Number of values asked for."""
        return self.took.total * len(self.ids)

    @property
    def lost(self) -> int:
        """Number of values that are missing."""
        return sum(self.missing.values())

    @property
    def worst(self) -> int:
        """The servo of which most values are missing."""
        return max(self.ids, key=lambda servo_id: self.missing[servo_id])
