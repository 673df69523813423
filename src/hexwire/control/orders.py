"""What the messages of ROS say, as plain values: trajectories, tolerances, set-points; what was said of them.

Owns the reading of messages, whose classes it does not need. Must not know rospy, nor what a right order is.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from typing import Any

from hexwire.wire.robot_bodies import COMMAND_ARRAYS

from .goals import Point, TrajectoryOrder

__all__ = ["Sparing", "order_of", "set_points_of", "tolerances_of"]

_NUMBER = re.compile(r"[+-]?\d[\d.e+-]*")
_KINDS = 100
"""Texts that are remembered."""


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
    """Decides whether to say something again: what comes fifty times a second must not fill the log.

    Texts that differ in their numbers alone are one: a sender who streams what is refused sends others each time.
    """

    def __init__(self) -> None:
        self._said: dict[str, float] = {}

    def due(self, text: str, now: float, period: float = 1.0) -> bool:
        """Whether to say `text` now; the answer True counts as said.

        Args:
            text: What is to be said.
            now: Seconds.
            period: Between two times, seconds.
        """
        kind = _NUMBER.sub("#", text)
        if now - self._said.get(kind, -math.inf) < period:
            return False
        # The newest last, and the oldest forgotten: names in a text may be made up, too.
        self._said.pop(kind, None)
        self._said[kind] = now
        while len(self._said) > _KINDS:
            del self._said[next(iter(self._said))]
        return True
