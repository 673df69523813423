"""Converts ROS messages to plain values: trajectories and set-points.

Owns reading the messages, without needing their classes. Must not import rospy, nor know which values are valid.
"""

from __future__ import annotations

import math
from typing import Any

from hexwire.control.goal_fields import trajectory_goal
from hexwire.control.goals import TrajectoryGoal
from hexwire.errors import UsageError
from hexwire.wire.robot_bodies import COMMAND_ARRAYS

__all__ = ["set_points_of", "trajectory_of"]


def trajectory_of(message: Any, now: Any) -> TrajectoryGoal:
    """The goal in a trajectory_msgs/JointTrajectory.

    Args:
        message: The message.
        now: The current ROS time, of the same class as the message's stamp.
    """
    stamp = message.header.stamp
    # Subtract times, not floats, which have a resolution of a microsecond at best.
    delay = 0.0 if stamp.is_zero() else (stamp - now).to_sec()
    return trajectory_goal(message, delay, lambda duration: duration.to_sec())


def set_points_of(message: Any) -> tuple[dict[str, float], tuple[str, ...]]:
    """The set-points in an osrf_msgs/JointCommands.

    Returns:
        Positions by joint, radians, and the names of other fields that are not zero.

    Raises:
        UsageError: A joint is named twice, a field has the wrong length, or a value is not a finite number.
    """
    names = tuple(message.name)
    if len(set(names)) != len(names):
        raise UsageError(f"a joint is named twice: {', '.join(names)}")
    for field in COMMAND_ARRAYS:
        values = getattr(message, field)
        if len(values) not in {0, len(names)}:
            raise UsageError(f"{field} has {len(values)} values for {len(names)} names")
        for joint, value in zip(names, values, strict=False):
            if not math.isfinite(value):
                raise UsageError(f"the {field} of {joint} is {value}, not a number")
    others = tuple(field for field in COMMAND_ARRAYS if field != "position" and any(getattr(message, field)))
    return dict(zip(names, message.position, strict=False)), others
