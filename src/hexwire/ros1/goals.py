"""What a joint trajectory of ROS must be, how it becomes a spline, and how far the arm may be off it.

Owns the rules of ROS's joint trajectory controller. Values come in as plain numbers and time as seconds from now;
must not know messages, clocks or robots.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum

from hexwire.motion.waypoints import Sample, Spline

__all__ = [
    "MAX_POINTS",
    "ErrorCode",
    "Point",
    "Tolerance",
    "Tolerances",
    "TrajectoryOrder",
    "check_order",
    "make_trajectory",
]

MAX_POINTS = 100_000
"""Points that a trajectory may have: hours of motion, and a bound on the work."""


class ErrorCode(IntEnum):
    """Codes of ROS's FollowJointTrajectoryResult."""

    SUCCESSFUL = 0
    INVALID_GOAL = -1
    INVALID_JOINTS = -2
    OLD_HEADER_TIMESTAMP = -3
    PATH_TOLERANCE_VIOLATED = -4
    GOAL_TOLERANCE_VIOLATED = -5


@dataclass(frozen=True, slots=True)
class Point:
    """One point, in the order of the names that come with it; whatever is empty is not given.

    Attributes:
        time: Seconds from the order's stamp (`time_from_start`).
        positions: Radians.
        velocities: Radians per second.
        accelerations: Radians per second squared; only with velocities.
        effort: Feed-forward, newton metres; only zeros, since no arm here takes it.
    """

    time: float
    positions: tuple[float, ...]
    velocities: tuple[float, ...] = ()
    accelerations: tuple[float, ...] = ()
    effort: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True)
class TrajectoryOrder:
    """A trajectory as it was sent.

    Attributes:
        names: Joint names, in any order.
        points: Values in the order of the names.
        delay: Seconds from now to the order's stamp; 0 for no stamp, negative if it has passed.
    """

    names: tuple[str, ...]
    points: tuple[Point, ...]
    delay: float = 0.0


@dataclass(frozen=True, slots=True)
class Tolerance:
    """How far one joint may be off; 0 is not checked.

    Attributes:
        position: Radians.
        velocity: Radians per second.
        acceleration: Radians per second squared; kept, but never judged, since no arm here measures it.
    """

    position: float = 0.0
    velocity: float = 0.0
    acceleration: float = 0.0


@dataclass(frozen=True, slots=True)
class Tolerances:
    """How far the arm may be off its path and its goal.

    Attributes:
        path: By joint, while it moves; every joint of the controller has a row.
        goal: By joint, at the end; likewise. The velocity is what ROS calls `stopped_velocity_tolerance`.
        goal_time: Seconds after the end in which the goal must be reached; 0 is to wait for ever.
    """

    path: Mapping[str, Tolerance]
    goal: Mapping[str, Tolerance]
    goal_time: float = 0.0

    def overridden(
        self,
        path: Sequence[tuple[str, float, float, float]],
        goal: Sequence[tuple[str, float, float, float]],
        goal_time: float,
    ) -> Tolerances:
        """With what a goal asks for: 0 keeps what is here, a negative number switches the check off."""
        raise NotImplementedError

    def path_violation(
        self,
        names: Sequence[str],
        desired: Sample,
        actual_position: Sequence[float],
        actual_velocity: Sequence[float],
    ) -> str:
        """What is off the path, worst first; empty if nothing is."""
        raise NotImplementedError

    def goal_violation(
        self,
        names: Sequence[str],
        desired: Sample,
        actual_position: Sequence[float],
        actual_velocity: Sequence[float],
    ) -> str:
        """What is off the goal, worst first; empty if nothing is."""
        raise NotImplementedError


def check_order(order: TrajectoryOrder, joints: tuple[str, ...], *, allow_partial: bool) -> None:
    """Refuse an order that the rules forbid."""
    raise NotImplementedError


def make_trajectory(order: TrajectoryOrder, joints: tuple[str, ...], start: Sample) -> tuple[Spline, float]:
    """Spline over all `joints` through what is left of an order, and seconds from now at which it begins."""
    raise NotImplementedError
