"""The newest state of a robot, the velocities of its joints, and which of its states are published.

Owns these for one thread that writes states and others that read. Time comes in as an argument. Must not know where
states come from, nor who gets them.
"""

from __future__ import annotations

import math
import threading
from typing import TYPE_CHECKING

from .known_state import StateFilter
from .rate import Periodic, RateMeter

if TYPE_CHECKING:
    from hexwire.model.state import JointState

    from .known_state import KnownState

__all__ = ["LatestState"]


class LatestState:
    """The newest state of a robot.

    Args:
        rate: Most states published per second.

    Attributes:
        state: The newest state, or None.
        heard: When it arrived, seconds; minus infinity before the first.
    """

    def __init__(self, rate: float) -> None:
        self.state: JointState | None = None
        self.heard = -math.inf
        self._period = 1.0 / rate
        self._between = self._period
        self._when_known = -math.inf
        self._known: KnownState | None = None
        self._filter = StateFilter()
        self._periodic, self._meter = Periodic(), RateMeter()
        self._lock = threading.Lock()

    def begin(self, between: float, max_age: float) -> None:
        """Start again after a new connection.

        Args:
            between: Seconds between two states.
            max_age: As in `StateFilter`.
        """
        self._between = between
        self._filter.begin(max_age)

    def take(self, state: JointState, now: float) -> KnownState | None:
        """Take the next state; returns the part of it to publish, or None."""
        with self._lock:
            self.state, self.heard = state, now
            known = self._filter.take(state)
            if known is None:
                return None
            self._when_known = now
            self._known = known
            # States up to half a period early are due, to keep the average rate.
            if self._between < self._period and not self._periodic.due(now, self._period, 0.5 * self._between):
                return None
            self._meter.count(now)
            return known

    def speeds(self, names: tuple[str, ...]) -> list[float]:
        """Velocities of these joints, radians per second; NaN if unknown."""
        known = self._known
        if known is None:
            return [math.nan] * len(names)
        if known.names == names:
            return list(known.velocity)
        speeds = dict(zip(known.names, known.velocity, strict=True))
        return [speeds.get(name, math.nan) for name in names]

    def rate(self, now: float) -> float:
        """States published per second, over the last seconds."""
        with self._lock:
            return self._meter.rate(now)

    def age(self, now: float) -> float:
        """Seconds since the last state with a new sample; infinite before the first."""
        return now - self._when_known
