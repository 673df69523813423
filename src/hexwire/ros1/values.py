"""Converts ROS messages to plain values: trajectories.

Owns reading the messages, without needing their classes. Must not import rospy, nor know which values are valid.
"""

from __future__ import annotations

from typing import Any

from hexwire.control.motion.goal_fields import trajectory_goal
from hexwire.control.motion.goals import TrajectoryGoal

__all__ = ["trajectory_of"]


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
