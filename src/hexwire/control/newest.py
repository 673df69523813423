"""The newest state of a robot, how fast its joints are, and which of its states are published.

Owns these while one thread brings states and others look. Time comes in as an argument. Must not know where states
come from, nor who is told.
"""

from __future__ import annotations

import math
import threading
from typing import TYPE_CHECKING

from .published import StateFilter
from .rate import Raster, RateMeter

if TYPE_CHECKING:
    from hexwire.model.state import JointState

    from .published import PublishedState

__all__ = ["LatestState"]


class LatestState:
    """What was heard of a robot last.

    Args:
        rate: States a second that are published; all that come if they are fewer.

    Attributes:
        state: The newest state, or None.
        heard: When it came, seconds; minus infinity before that.
    """

    def __init__(self, rate: float) -> None:
        self.state: JointState | None = None
        self.heard = -math.inf
        self._period = 1.0 / rate
        self._between = self._period
        self._known = -math.inf
        self._speeds: dict[str, float] = {}
        self._filter = StateFilter()
        self._raster, self._meter = Raster(), RateMeter()
        self._lock = threading.Lock()

    def begin(self, between: float, max_age: float) -> None:
        """What comes now has nothing to do with what came before.

        Args:
            between: Seconds between two states.
            max_age: As in `StateFilter`.
        """
        self._between = between
        self._filter.begin(max_age)

    def take(self, state: JointState, now: float) -> PublishedState | None:
        """The next state; what is to be published of it, if anything."""
        with self._lock:
            self.state, self.heard = state, now
            published = self._filter.take(state)
            if published is None:
                return None
            self._known = now
            self._speeds = dict(zip(published.names, published.velocity, strict=True))
            # Half a state early is nearer than half a state late.
            if self._between < self._period and not self._raster.due(now, self._period, 0.5 * self._between):
                return None
            self._meter.count(now)
            return published

    def speeds(self, names: tuple[str, ...]) -> list[float]:
        """Of these joints, radians per second; NaN where it is not known."""
        speeds = self._speeds
        return [speeds.get(name, math.nan) for name in names]

    def rate(self, now: float) -> float:
        """States a second that were published over the last while."""
        with self._lock:
            return self._meter.rate(now)

    def age(self, now: float) -> float:
        """Seconds since a state came that had something new to publish; infinite before the first."""
        return now - self._known
