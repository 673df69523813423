"""Time-optimal motion from pose to pose under limits of speed and acceleration, and of jerk if wanted.

Owns the trapezoid, and which profile suits a motion. Must not know robots: limits come in as numbers.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from hexwire.errors import UsageError

from .moving import reach
from .speed_profile import JointLimits
from .through import Through
from .trajectory import Sample, Trajectory

__all__ = ["Trapezoid", "time_optimal"]


class Trapezoid(Trajectory):
    """From rest to rest: each joint accelerates, moves at constant speed and decelerates; all arrive together.

    The slowest joint sets the time; the others move at the lowest speed that keeps up with it.

    Args:
        names: Joint names.
        start: Radians.
        goal: Radians.
        max_speed: Radians per second, above 0, one per joint.
        max_acceleration: Radians per second squared, above 0, one per joint.
        duration: Minimum duration in seconds.
    """

    def __init__(
        self,
        names: Sequence[str],
        start: Sequence[float],
        goal: Sequence[float],
        max_speed: Sequence[float],
        max_acceleration: Sequence[float],
        *,
        duration: float = 0.0,
    ) -> None:
        self.names = tuple(names)
        _check(self.names, start, goal, max_speed, max_acceleration)
        self._start, self._goal = tuple(start), tuple(goal)
        distances = [b - a for a, b in zip(start, goal, strict=True)]
        self.duration = max(
            duration,
            *(
                shortest_time(abs(distance), speed, acceleration)
                for distance, speed, acceleration in zip(distances, max_speed, max_acceleration, strict=True)
            ),
        )
        # Per joint: signed speed of the constant part, signed acceleration, duration of the acceleration.
        self._rows = [
            _row(distance, acceleration, self.duration)
            for distance, acceleration in zip(distances, max_acceleration, strict=True)
        ]

    def at(self, t: float) -> Sample:
        if t >= self.duration:
            rest = (0.0,) * len(self.names)
            return Sample(self._goal, rest, rest)
        columns = []
        for a, b, (speed, acceleration, ramp) in zip(self._start, self._goal, self._rows, strict=True):
            left = self.duration - t
            if t < ramp:
                columns.append((a + 0.5 * acceleration * t * t, acceleration * t, acceleration))
            elif left > ramp:
                columns.append((a + speed * (t - 0.5 * ramp), speed, 0.0))
            else:
                columns.append((b - 0.5 * acceleration * left * left, acceleration * left, -acceleration))
        return Sample(tuple(c[0] for c in columns), tuple(c[1] for c in columns), tuple(c[2] for c in columns))


def shortest_time(distance: float, speed: float, acceleration: float) -> float:
    """Seconds from rest to rest over a non-negative distance under both limits."""
    if distance <= speed * speed / acceleration:
        return 2 * math.sqrt(distance / acceleration)
    return distance / speed + speed / acceleration


def _row(distance: float, acceleration: float, duration: float) -> tuple[float, float, float]:
    if distance == 0 or duration == 0:
        return 0.0, 0.0, 0.0
    # distance = v (T - v / a), the smaller v.
    speed = 0.5 * (
        acceleration * duration
        - math.sqrt(max(0.0, (acceleration * duration) ** 2 - 4 * acceleration * abs(distance)))
    )
    sign = math.copysign(1.0, distance)
    return sign * speed, sign * acceleration, speed / acceleration


def time_optimal(
    names: Sequence[str],
    start: Sequence[float],
    goal: Sequence[float],
    max_speed: Sequence[float],
    max_acceleration: Sequence[float],
    *,
    max_jerk: Sequence[float] | None = None,
    velocity: Sequence[float] | None = None,
) -> Trajectory:
    """The fastest motion to a goal, ending at rest.

    From rest it is the shortest; one that begins in motion may be a few percent longer than that.

    Args:
        names: Joint names.
        start: Radians.
        goal: Radians.
        max_speed: Radians per second, above 0.
        max_acceleration: Radians per second squared, above 0.
        max_jerk: Radians per second cubed, above 0, or None for no limit.
        velocity: At the start, radians per second; at rest if None. Needs `max_jerk`.

    Raises:
        UsageError: The numbers are invalid, or a start in motion has no `max_jerk`.
    """
    _check(tuple(names), start, goal, max_speed, max_acceleration)
    if velocity is None or not any(velocity):
        if max_jerk is None:
            return Trapezoid(names, start, goal, max_speed, max_acceleration)
        return Through(names, (start, goal), max_speed, max_acceleration, max_jerk)
    if max_jerk is None:
        raise UsageError("a start in motion needs max_jerk")
    _check(tuple(names), start, velocity, max_speed, max_acceleration, max_jerk)
    limits = [JointLimits(*row) for row in zip(max_speed, max_acceleration, max_jerk, strict=True)]
    rest = (0.0,) * len(names)
    begin, end = Sample(tuple(start), tuple(velocity), rest), Sample(tuple(goal), rest, rest)
    way = reach(names, begin, end, limits, 0.0, longer=True)
    assert way is not None
    return way


def _check(names: Sequence[str], *columns: Sequence[float]) -> None:
    """Two columns of the motion, then those of limits."""
    for column in columns:
        if len(column) != len(names):
            raise UsageError(f"{len(column)} values for {len(names)} joints")
        if not all(map(math.isfinite, column)):
            raise UsageError("a value is not a number")
    if not names or min(min(column) for column in columns[2:]) <= 0:
        raise UsageError("limits of speed, acceleration and jerk must be above 0")
