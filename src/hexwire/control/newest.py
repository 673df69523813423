"""The newest state of a robot, how fast its joints are, and which of its states are passed on.

Owns these while one thread brings states and others look. Time comes in as an argument. Must not know where states
come from, nor who is told.
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
    """What was heard of a robot last.

    Args:
        rate: States a second that are passed on; all that come if they are fewer.

    Attributes:
        state: The newest state, or None.
        heard: When it came, seconds; minus infinity before that.
    """

    def __init__(self, rate: float) -> None:
        self.state: JointState | None = None
        self.heard = -math.inf
        self._period = 1.0 / rate
        self._between = self._period
        self._when_known = -math.inf
        self._speeds: dict[str, float] = {}
        self._filter = StateFilter()
        self._periodic, self._meter = Periodic(), RateMeter()
        self._lock = threading.Lock()

    def begin(self, between: float, max_age: float) -> None:
        """What comes now has nothing to do with what came before.

        Args:
            between: Seconds between two states.
            max_age: As in `StateFilter`.
        """
        self._between = between
        self._filter.begin(max_age)

    def take(self, state: JointState, now: float) -> KnownState | None:
        """The next state; what of it is to be passed on, if anything."""
        with self._lock:
            self.state, self.heard = state, now
            known = self._filter.take(state)
            if known is None:
                return None
            self._when_known = now
            self._speeds = dict(zip(known.names, known.velocity, strict=True))
            # Half a state early is nearer than half a state late.
            if self._between < self._period and not self._periodic.due(now, self._period, 0.5 * self._between):
                return None
            self._meter.count(now)
            return known

    def speeds(self, names: tuple[str, ...]) -> list[float]:
        """Of these joints, radians per second; NaN where it is not known."""
        speeds = self._speeds
        return [speeds.get(name, math.nan) for name in names]

    def rate(self, now: float) -> float:
        """States a second that were passed on over the last while."""
        with self._lock:
            return self._meter.rate(now)

    def age(self, now: float) -> float:
        """Seconds since a state came that had something new; infinite before the first."""
        return now - self._when_known
