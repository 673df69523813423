"""Goals and tolerances from messages with the fields of the usual joint trajectory messages.

Owns which field becomes which number. Needs no class of a message; the caller says what a duration is. Must not
know which values are valid.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from .goals import ComponentTolerance, Point, TrajectoryGoal

__all__ = ["component_rows", "tolerance_rows", "trajectory_goal"]


def trajectory_goal(
    message: Any, delay: float, seconds: Callable[[Any], float], free: Iterable[str] = ()
) -> TrajectoryGoal:
    """The goal in a message.

    Args:
        message: Has `joint_names` and `points`.
        delay: See `TrajectoryGoal.delay`.
        seconds: Returns the seconds of a point's `time_from_start`.
        free: See `TrajectoryGoal.free`.
    """
    points = tuple(
        Point(
            seconds(point.time_from_start),
            tuple(point.positions),
            tuple(point.velocities),
            tuple(point.accelerations),
            tuple(point.effort),
        )
        for point in message.points
    )
    return TrajectoryGoal(tuple(message.joint_names), points, delay, tuple(free))


def tolerance_rows(rows: Iterable[Any]) -> list[tuple[str, float, float, float]]:
    """Name, position, velocity and acceleration of each tolerance, for `Tolerances.overridden`."""
    return [(row.name, row.position, row.velocity, row.acceleration) for row in rows]


def component_rows(rows: Iterable[Any]) -> list[ComponentTolerance]:
    """The tolerances of components, for `Tolerances.overridden`."""
    return [
        ComponentTolerance(row.joint_name, row.component, row.position, row.velocity, row.acceleration)
        for row in rows
    ]
