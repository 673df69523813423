"""How early and how densely a path is sent to a robot that keeps the time, by how long an exchange takes.

Owns these numbers. Pure. Must not know robots, nor what is sent.
"""

from __future__ import annotations

import math

__all__ = ["PathPace"]

_AHEAD = 0.12
"""Seconds by which the robot must know of a change: the point towards which its joints move cannot be replaced, and
requests take time, perhaps one more that is under way."""
_CLOSEST, _FURTHEST = 0.02, 0.03
"""Seconds between two points; further apart where turns are rare."""
_TURNS = 2.0
"""Turns for which the points on the robot must last at least."""
_NEXT = 6
"""Points that are sent in one turn, or more."""
_TRANSIT, _USUAL = 0.015, 0.025
"""Seconds that a request with points takes to the robot, and an exchange at most, on a serial line."""
_FADES = 0.9
"""Part of what was measured of a slower line that counts after another exchange."""


class PathPace:
    """The pace of a path.

    Attributes:
        period: Seconds between two turns in which something is sent.
    """

    def __init__(self) -> None:
        self.period = 0.0
        # Seconds that an exchange takes longer than usual, as over a network.
        self._slow = 0.0

    def measure(self, seconds: float) -> None:
        """Take in how long an exchange took."""
        self._slow = max(seconds - _USUAL, _FADES * self._slow, 0.0)

    @property
    def ahead(self) -> float:
        """Seconds by which the robot must know of a change."""
        return _AHEAD + 2.0 * self._slow

    @property
    def transit(self) -> float:
        """Seconds until the robot has received points that are sent now."""
        return _TRANSIT + self._slow

    def apart(self, capacity: int) -> tuple[float, float]:
        """Least and most seconds between two points, so that those on the robot last for some turns.

        Args:
            capacity: Points that the robot can hold.
        """
        least = max(_CLOSEST, _TURNS * self._turn / capacity)
        return least, max(least, _FURTHEST)

    def most(self, capacity: int) -> int:
        """Most points that are sent in one turn."""
        return max(_NEXT, math.ceil(_TURNS * self._turn / self.apart(capacity)[0]))

    @property
    def pause(self) -> float:
        """Least seconds from one turn to the next: states must not wait behind them."""
        return 2.0 * self._slow

    @property
    def _turn(self) -> float:
        """Seconds from one turn to the next; each may ask and send."""
        return self.period + 2.0 * self._slow + self.pause
