"""Time-optimal motion from pose to pose under limits of speed and acceleration, and of jerk if wanted.

Owns the trapezoid, and the use of ruckig for a start in motion. Must not know robots: limits come in as numbers.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from hexwire.errors import UsageError

from .through import Through
from .waypoints import Sample, Trajectory

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


class _Ruckig(Trajectory):
    """A trajectory of the library ruckig."""

    def __init__(self, names: tuple[str, ...], goal: tuple[float, ...], trajectory: Any) -> None:
        self.names = names
        self.duration = float(trajectory.duration)
        self._goal = goal
        self._trajectory = trajectory

    def at(self, t: float) -> Sample:
        position, velocity, acceleration = self._trajectory.at_time(t)
        return Sample(self._goal if t >= self.duration else tuple(position), tuple(velocity), tuple(acceleration))


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

    A start in motion needs ruckig.

    Args:
        names: Joint names.
        start: Radians.
        goal: Radians.
        max_speed: Radians per second, above 0.
        max_acceleration: Radians per second squared, above 0.
        max_jerk: Radians per second cubed, or None for no limit.
        velocity: At the start, radians per second; at rest if None.

    Raises:
        UsageError: The numbers are invalid, or the start is in motion and ruckig is not installed.
    """
    _check(tuple(names), start, goal, max_speed, max_acceleration)
    if velocity is None or not any(velocity):
        if max_jerk is None:
            return Trapezoid(names, start, goal, max_speed, max_acceleration)
        return Through(names, (start, goal), max_speed, max_acceleration, max_jerk)
    ruckig = ruckig_or_none()
    if ruckig is None:
        raise UsageError("a start in motion needs ruckig: pip install 'hexwire[motion]'")
    request = ruckig.InputParameter(len(names))
    request.current_position, request.target_position = list(start), list(goal)
    request.max_velocity, request.max_acceleration = list(max_speed), list(max_acceleration)
    request.max_jerk = list(max_jerk) if max_jerk is not None else [math.inf] * len(names)
    request.current_velocity = list(velocity)
    trajectory = ruckig.Trajectory(len(names))
    result = ruckig.Ruckig(len(names)).calculate(request, trajectory)
    if int(result) < 0:
        raise UsageError(f"ruckig finds no motion to the goal: {result}")
    return _Ruckig(tuple(names), tuple(goal), trajectory)


def ruckig_or_none() -> Any:
    """The ruckig module if it is installed, otherwise None."""
    try:
        import ruckig
    except ImportError:
        return None
    return ruckig


def _check(names: Sequence[str], *columns: Sequence[float]) -> None:
    for column in columns:
        if len(column) != len(names):
            raise UsageError(f"{len(column)} values for {len(names)} joints")
        if not all(map(math.isfinite, column)):
            raise UsageError("a value is not a number")
    if not names or min(*columns[2], *columns[3]) <= 0:
        raise UsageError("limits of speed and acceleration must be above 0")
