"""What the messages of ROS say, as plain values: trajectories, tolerances, set-points; what was said of them.

Owns the reading of messages, whose classes it does not need. Must not know rospy, nor what a right order is.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

from hexwire.wire.robot_bodies import COMMAND_ARRAYS

from .goals import Point, TrajectoryOrder

__all__ = ["Sparing", "order_of", "set_points_of", "tolerances_of"]

_MEMORY = 60.0


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


class Sparing:
    """Decides whether to say something again: what comes fifty times a second must not fill the log."""

    def __init__(self) -> None:
        self._said: dict[str, float] = {}

    def due(self, text: str, now: float, period: float = _MEMORY) -> bool:
        """Whether to say `text` now; the answer True counts as said.

        Args:
            text: What is to be said.
            now: Seconds.
            period: Between two times, at most a minute.
        """
        if now - self._said.get(text, -math.inf) < period:
            return False
        # Texts hold numbers that a sender makes up; they must not fill the memory either.
        self._said = {old: when for old, when in self._said.items() if now - when < _MEMORY}
        self._said[text] = now
        return True
