"""Goals and tolerances from messages with the fields of the usual joint trajectory messages.

Owns which field becomes which number, and the code of each reason why a goal ends. Needs no class of a message; the
caller says what a duration is. Must not know which values are valid.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from enum import IntEnum
from typing import Any

from ..loop.outcomes import Reason
from .goals import ComponentTolerance, Point, TrajectoryGoal

__all__ = ["CODES", "ErrorCode", "component_rows", "tolerance_rows", "trajectory_goal"]


class ErrorCode(IntEnum):
    """Error codes of the results of such goals, with the names that their messages give them."""

    SUCCESSFUL = 0
    INVALID_GOAL = -1
    INVALID_JOINTS = -2
    OLD_HEADER_TIMESTAMP = -3
    PATH_TOLERANCE_VIOLATED = -4
    GOAL_TOLERANCE_VIOLATED = -5


CODES: Mapping[Reason, ErrorCode] = {
    Reason.REACHED: ErrorCode.SUCCESSFUL,
    Reason.REPLACED: ErrorCode.SUCCESSFUL,
    Reason.CANCELLED: ErrorCode.SUCCESSFUL,
    Reason.MALFORMED: ErrorCode.INVALID_GOAL,
    Reason.WRONG_JOINTS: ErrorCode.INVALID_JOINTS,
    Reason.TOO_LATE: ErrorCode.OLD_HEADER_TIMESTAMP,
    Reason.NOT_READY: ErrorCode.INVALID_GOAL,
    Reason.PATH_NOT_ALLOWED: ErrorCode.INVALID_GOAL,
    Reason.PATH_TOLERANCE: ErrorCode.PATH_TOLERANCE_VIOLATED,
    Reason.GOAL_TOLERANCE: ErrorCode.GOAL_TOLERANCE_VIOLATED,
    Reason.STOPPED: ErrorCode.INVALID_GOAL,
    Reason.FAILED: ErrorCode.INVALID_GOAL,
}
"""The error code of each reason."""


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
