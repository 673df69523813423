"""Point-to-point motion: joint positions as a function of time, pure.

Owns the shape of the motion between two poses. Must not know clocks, limits or its users.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from hexwire.errors import UsageError

__all__ = ["PEAK_ACCELERATION", "PEAK_JERK", "PEAK_SPEED", "Quintic", "quintic_share"]

PEAK_SPEED = 15 / 8
"""Highest speed of a quintic over its mean speed: the derivative of 10u^3 - 15u^4 + 6u^5 at u = 1/2."""

PEAK_ACCELERATION = 10 / math.sqrt(3.0)
"""Its highest acceleration over distance and time squared: the second derivative at u = 1/2 - sqrt(3)/6."""
PEAK_JERK = 60.0
"""Its highest jerk over distance and time cubed: the third derivative at both ends."""


def quintic_share(u: float) -> float:
    """Share of the distance that is covered after a share of the time, both 0 to 1."""
    u = min(1.0, max(0.0, u))
    return u * u * u * (10.0 + u * (6.0 * u - 15.0))


@dataclass(frozen=True, slots=True)
class Quintic:
    """From one pose to another, starting and ending at rest: speed and acceleration are zero at both ends.

    The polynomial is the textbook's minimum-jerk one, 10u^3 - 15u^4 + 6u^5 with u from 0 to 1. All joints start
    and arrive together.

    Attributes:
        start: Pose at time 0, one value per joint; any unit.
        goal: Pose at the end, in the same order.
        duration: Seconds; 0 is a step.
    """

    start: tuple[float, ...]
    goal: tuple[float, ...]
    duration: float

    def __post_init__(self) -> None:
        if len(self.start) != len(self.goal):
            raise UsageError(f"a trajectory cannot go from {len(self.start)} joints to {len(self.goal)}")
        if not 0 <= self.duration < math.inf:
            raise UsageError(f"the duration of a trajectory must be finite and not negative, not {self.duration} s")

    def position(self, t: float) -> tuple[float, ...]:
        """Pose at `t` seconds: the start before 0, exactly the goal from the end on."""
        if t >= self.duration:
            return self.goal
        if t <= 0:
            return self.start
        share = quintic_share(t / self.duration)
        return tuple([a + share * (b - a) for a, b in zip(self.start, self.goal, strict=True)])

    @staticmethod
    def shortest_duration(start: Sequence[float], goal: Sequence[float], max_speed: Sequence[float]) -> float:
        """Seconds in which no joint exceeds its speed limit (unit of the pose per second, above 0)."""
        rows = zip(start, goal, max_speed, strict=True)
        return max((PEAK_SPEED * abs(b - a) / speed for a, b, speed in rows), default=0.0)
