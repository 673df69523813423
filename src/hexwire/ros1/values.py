"""What ROS's messages say, as plain values: trajectories, tolerances, set-points.

Owns the reading of messages, whose classes it does not need. Must not know rospy, nor which values are right.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from hexwire.control.goals import Point, TrajectoryOrder
from hexwire.wire.robot_bodies import COMMAND_ARRAYS

__all__ = ["order_of", "set_points_of", "tolerances_of"]


def order_of(message: Any, now: Any) -> TrajectoryOrder:
    """The order in a trajectory_msgs/JointTrajectory.

    Args:
        message: The message.
        now: ROS's time, of the class that the message's stamp has.
    """
    stamp = message.header.stamp
    # The difference of two times, and not of two floats, which are good to a microsecond at most.
    delay = 0.0 if stamp.is_zero() else (stamp - now).to_sec()
    points = tuple(
        Point(
            point.time_from_start.to_sec(),
            tuple(point.positions),
            tuple(point.velocities),
            tuple(point.accelerations),
            tuple(point.effort),
        )
        for point in message.points
    )
    return TrajectoryOrder(tuple(message.joint_names), points, delay)


def tolerances_of(rows: Iterable[Any]) -> list[tuple[str, float, float, float]]:
    """Name, position, velocity and acceleration of each control_msgs/JointTolerance."""
    return [(row.name, row.position, row.velocity, row.acceleration) for row in rows]


def set_points_of(message: Any) -> dict[str, tuple[float, ...]]:
    """Values a joint of an osrf_msgs/JointCommands, by field."""
    return {field: tuple(getattr(message, field)) for field in COMMAND_ARRAYS}
