"""When something is due that may happen once a period, and how often something happened.

Owns a raster that never bursts, and the count behind a rate. Time comes in as an argument. Must not know what is
done, nor who waits for it.
"""

from __future__ import annotations

import math
from collections import deque

__all__ = ["Raster", "RateMeter"]


class Raster:
    """Says yes once a period. What comes too late is not made up for.

    One thread asks; any thread may `hurry`.
    """

    def __init__(self) -> None:
        self._due = -math.inf
        self._done = -math.inf
        self._hurried = False

    def hurry(self) -> None:
        """Do not wait for the next point of the raster, if nothing was done for a period."""
        self._hurried = True

    def due(self, now: float, period: float, early: float = 0.0) -> bool:
        """Whether it is time; the next time is later then.

        Args:
            now: Seconds.
            period: Seconds.
            early: So many seconds before its time it is time already; below half a period.
        """
        if now + early >= self._due:
            # A late cycle keeps the raster; one that is later than a period begins a new one.
            following = self._due + period if now < self._due + period else now + period
        elif self._hurried and now >= self._done + period:
            following = now + period
        else:
            return False
        # Before anything is looked at: who hurries from here on has something that was not seen.
        self._hurried = False
        self._due = following
        return True

    def done(self, now: float) -> None:
        """Something was really done at its time, not only looked at."""
        self._done = now


class RateMeter:
    """Events a second over the last while.

    Args:
        window: How long that is, seconds.
    """

    def __init__(self, window: float = 2.0) -> None:
        self._window = window
        self._times: deque[float] = deque()

    def count(self, now: float) -> None:
        """One more."""
        self._times.append(now)
        self._forget(now)

    def rate(self, now: float) -> float:
        """Events a second; 0 before there were two."""
        self._forget(now)
        times = self._times
        return (len(times) - 1) / max(times[-1] - times[0], 1e-9) if len(times) > 1 else 0.0

    def _forget(self, now: float) -> None:
        while self._times and self._times[0] < now - self._window:
            self._times.popleft()
