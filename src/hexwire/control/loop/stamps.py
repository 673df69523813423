"""Converts monotonic times to wall-clock times, for message stamps.

Owns the offset between the two clocks, and keeps stamps in order. The clocks come in as arguments.
"""

from __future__ import annotations

import math
from collections.abc import Callable

__all__ = ["StampClock"]

_SET = 0.25
"""Seconds by which the wall clock must differ from the expected time to count as set, not as adjusted."""
_SLEW = 0.005
"""Seconds per second by which the offset is corrected: far more than any clock drifts."""


class StampClock:
    """Makes stamps for monotonic times. For one thread only.

    Reading the wall clock for every stamp and subtracting the age of the data would let stamps go backwards: if the
    thread is suspended between reading the two clocks, the stamp is too early by that time. This class stores the
    offset between the clocks instead. When the wall clock is adjusted, the offset is corrected so slowly that
    stamps still increase; when the wall clock is set, the offset follows at once, as all other programs do.

    Args:
        wall: Returns wall-clock time, seconds.
        clock: Returns monotonic time, seconds.
    """

    def __init__(self, wall: Callable[[], float], clock: Callable[[], float]) -> None:
        self._wall, self._clock = wall, clock
        self._offset = math.nan
        self._latest = -math.inf

    def stamp(self, moment: float) -> float:
        """Convert a monotonic time to wall-clock time.

        Args:
            moment: Monotonic time, seconds; about now. Later times get later stamps, unless the wall clock was set
                back in between.
        """
        before = self._clock()
        wall = self._wall()
        after = self._clock()
        # The wall clock was read at some time between the two readings.
        low, high = wall - after, wall - before
        if not low - _SET <= self._offset <= high + _SET:
            self._offset = (low + high) / 2
        most = _SLEW * max(0.0, moment - self._latest)
        self._latest = max(self._latest, moment)
        wanted = min(max(self._offset, low), high)
        self._offset += min(max(wanted - self._offset, -most), most)
        return moment + self._offset
