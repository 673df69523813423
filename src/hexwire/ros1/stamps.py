"""Moments of the host's clock as times of a wall clock, which is what message stamps are.

Owns the difference of the two clocks, so that stamps rise as the moments do. The clocks come in as arguments; must
not know ROS, nor what is stamped.
"""

from __future__ import annotations

import math
from collections.abc import Callable

__all__ = ["StampClock"]

_SET = 0.25
"""Seconds by which the wall clock must differ from what was expected to count as set, not as adjusted."""
_SLEW = 0.005
"""Seconds a second that the difference of the clocks is corrected by: far more than any clock drifts."""


class StampClock:
    """Stamps for moments of a monotonic clock. One thread only.

    To take the wall clock's time at every stamp, less the age of what is stamped, would have stamps go back: a
    thread that is put aside between the two looks at clocks stamps too early by as long as it stood. Here the
    difference is kept. Where it turns out wrong, as when the wall clock is adjusted, it is corrected so slowly that
    stamps go on rising; a clock that was set is followed at once, since everybody else follows it as well.

    Args:
        wall: Seconds of the clock that stamps are of.
        clock: Monotonic seconds.
    """

    def __init__(self, wall: Callable[[], float], clock: Callable[[], float]) -> None:
        self._wall, self._clock = wall, clock
        self._offset = math.nan
        self._latest = -math.inf

    def stamp(self, moment: float) -> float:
        """The wall clock's time of a moment.

        Args:
            moment: Of the monotonic clock, seconds; about now. Later moments have later stamps, unless the wall
                clock was set back in between.
        """
        before = self._clock()
        wall = self._wall()
        after = self._clock()
        # The wall clock was looked at somewhere in between.
        low, high = wall - after, wall - before
        if not low - _SET <= self._offset <= high + _SET:
            self._offset = (low + high) / 2
        most = _SLEW * max(0.0, moment - self._latest)
        self._latest = max(self._latest, moment)
        wanted = min(max(self._offset, low), high)
        self._offset += min(max(wanted - self._offset, -most), most)
        return moment + self._offset
