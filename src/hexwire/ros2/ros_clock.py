"""The time of ROS: that of the system, or with `use_sim_time` what a simulation or a bag publishes on `/clock`.

Owns which time is which. The arm itself runs in real time, whatever it is called. Clocks come in as arguments.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable

from hexwire.control.loop.stamps import StampClock

__all__ = ["RosClock"]

_KEPT = 1.0
"""Seconds for which times of `/clock` are kept: states are stamped with the time of their samples."""


class RosClock:
    """Time of a node. Any thread may call its methods, except `stamp`, which is for one thread.

    Simulated time is as in `rclcpp`: it stands between two messages, and is 0 before the first.

    Args:
        wall: Returns the system's time, nanoseconds since 1970.
        clock: Returns monotonic time, seconds.
        simulated: Time comes from `/clock`.

    Attributes:
        simulated: Time comes from `/clock`.
    """

    def __init__(self, wall: Callable[[], int], clock: Callable[[], float], *, simulated: bool = False) -> None:
        self._wall, self._clock, self.simulated = wall, clock, simulated
        self._stamps = StampClock(lambda: wall() / 1e9, clock)
        self._lock = threading.Lock()
        # Monotonic time of arrival, and nanoseconds; the oldest first.
        self._taken: deque[tuple[float, int]] = deque()

    def take(self, nanoseconds: int) -> None:
        """Take a time from `/clock`; an earlier one than before begins a new run of the simulation."""
        with self._lock:
            taken, arrived = self._taken, self._clock()
            if taken and nanoseconds < taken[-1][1]:
                taken.clear()
            taken.append((arrived, nanoseconds))
            while arrived - taken[0][0] > _KEPT:
                taken.popleft()

    def now(self) -> int:
        """Nanoseconds."""
        if not self.simulated:
            return self._wall()
        with self._lock:
            return self._taken[-1][1] if self._taken else 0

    def stamp(self, moment: float) -> float:
        """The time of a recent moment of the monotonic clock, seconds."""
        if not self.simulated:
            return self._stamps.stamp(moment)
        with self._lock:
            first = self._taken[0][1] if self._taken else 0
            return next((told for arrived, told in reversed(self._taken) if arrived <= moment), first) / 1e9
