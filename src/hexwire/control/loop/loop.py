"""A loop at a fixed rate, with absolute deadlines.

Owns the deadlines and the timing counters.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from hexwire.errors import UsageError
from hexwire.model.state import LONGEST

_FASTEST = 10_000.0
"""Greatest rate, hertz."""
_LEAST_WAIT = 0.0001
"""Seconds; a sleep is no more exact than this, so a cycle that is less late begins at once."""

__all__ = ["LoopCounters", "RateLoop", "check_rate"]


@dataclass(slots=True)
class LoopCounters:
    """Timing of a loop.

    Attributes:
        cycles: Cycles started.
        late: Cycles that started after their deadline by more than `RateLoop.tolerance`.
        skipped: Deadlines skipped because a cycle took longer than a period.
        worst: Longest delay after a deadline, seconds.
        late_by: Total delay of the late cycles, seconds.
    """

    cycles: int = 0
    late: int = 0
    skipped: int = 0
    worst: float = 0.0
    late_by: float = 0.0


def check_rate(rate: float) -> None:
    """Refuse a rate that no loop can keep, cycles per second.

    Raises:
        UsageError: It is not a number, too low or too high.
    """
    if not 1 / LONGEST <= rate <= _FASTEST:
        raise UsageError(f"a rate of {rate:g} Hz is not possible; give {1 / LONGEST:g} to {_FASTEST:g} Hz")


class RateLoop:
    """Start cycles at multiples of a period after the first; errors do not add up.

    A cycle that overruns its period is not made up for in a burst, which would send set-points faster than planned:
    the deadlines it missed are skipped and counted, and the following ones stay multiples of the period.

    Args:
        rate: Cycles per second.
        clock: Monotonic seconds.
        sleep: Waits for a number of seconds.
        tolerance: Seconds after its deadline from which a cycle counts as late; if None a tenth of the period, but
            at least 0.1 ms.

    Attributes:
        period: Seconds.
        counters: Updated while it runs.
        due: Seconds from the first cycle to the deadline of the last one that was started.
    """

    def __init__(
        self,
        rate: float,
        *,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], object] = time.sleep,
        tolerance: float | None = None,
    ) -> None:
        check_rate(rate)
        self.period = 1.0 / rate
        self.tolerance = max(0.1 * self.period, _LEAST_WAIT) if tolerance is None else tolerance
        self.counters = LoopCounters()
        self.due = 0.0
        self._clock = clock
        self._sleep = sleep
        self._started = math.nan
        self._last = math.nan

    def ticks(self, duration: float = math.inf) -> Iterator[float]:
        """Yield at every deadline the seconds from the first cycle to that deadline.

        The deadline is yielded, not the clock time: a trajectory sampled with it is as smooth as planned even if
        a cycle starts a little late.

        Args:
            duration: No cycle starts from this time on; the last one still has its full period.
        """
        counters = self.counters
        # Slightly less, so that 0.3 s with periods of 0.1 s are three cycles despite rounding, not four.
        cycles = duration / self.period - 1e-6
        self._started = start = self._clock()
        tick = 0
        while tick < cycles:
            self.due = due = tick * self.period
            delay = self._wait_until(start + due)
            self._last = start + due + delay
            counters.cycles += 1
            counters.worst = max(counters.worst, delay)
            if delay > self.tolerance:
                counters.late += 1
                counters.late_by += delay
            yield due
            # The next deadline in the future; one missed by less than the tolerance is kept, and is late.
            behind = self._clock() - start - self.tolerance
            following = max(tick + 1, math.ceil(behind / self.period))
            counters.skipped += following - tick - 1
            tick = following
        if math.isfinite(duration):
            self._wait_until(start + duration)

    @property
    def achieved(self) -> float:
        """Cycles per second between the starts of the first and the last; 0 if there were fewer than two."""
        elapsed = self._last - self._started
        return (self.counters.cycles - 1) / elapsed if elapsed > 0 else 0.0

    def _wait_until(self, deadline: float) -> float:
        """Sleep until a deadline; returns the delay after it, seconds."""
        while (left := deadline - self._clock()) > 0:
            self._sleep(left)
        return -left
