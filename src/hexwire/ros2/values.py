"""Makes plain values of ROS 2 messages: trajectories and goals.

Owns which field is which value. Must not know which values are valid.
"""

from __future__ import annotations

from typing import Any

from hexwire.control.loop.outcomes import Reason
from hexwire.control.motion.goal_fields import component_rows, tolerance_rows, trajectory_goal
from hexwire.control.motion.goals import TrajectoryGoal
from hexwire.control.requests.client_goals import ClientRequest
from hexwire.errors import GoalError
from zenoh_ros2 import nanoseconds_of, seconds_of

__all__ = ["delay_of", "request_of", "trajectory_of"]


def delay_of(time: Any, now: int) -> float:
    """Seconds until a builtin_interfaces Time; 0 for a time of 0, which means now.

    Args:
        time: The message.
        now: Current ROS time, nanoseconds; 0 if a simulation has not told it yet.

    Raises:
        GoalError: There is no current time.
    """
    stamp = nanoseconds_of(time)
    if stamp and not now:
        text = "it has a time, but use_sim_time is set and nothing has come on /clock"
        raise GoalError(text, reason=Reason.NOT_READY)
    # Subtract times, not floats, which have a resolution of a microsecond at best.
    return (stamp - now) / 1e9 if stamp else 0.0


def trajectory_of(message: Any, now: int, multi_dof: Any = None) -> TrajectoryGoal:
    """The goal in a trajectory_msgs/msg/JointTrajectory.

    Args:
        message: The message.
        now: As in `delay_of`.
        multi_dof: A trajectory_msgs/msg/MultiDOFJointTrajectory that comes with it.

    Raises:
        GoalError: As `delay_of`.
    """
    delay, free = delay_of(message.header.stamp, now), ()
    if multi_dof is not None and multi_dof.points:
        free = tuple(multi_dof.joint_names) or ("joints without a name",)
    return trajectory_goal(message, delay, seconds_of, free)


def request_of(goal: Any, now: int) -> ClientRequest:
    """The contents of a FollowJointTrajectory_Goal.

    Args:
        goal: The message.
        now: As in `delay_of`.

    Raises:
        GoalError: As `delay_of`.
    """
    return ClientRequest(
        trajectory_of(goal.trajectory, now, goal.multi_dof_trajectory),
        tolerance_rows(goal.path_tolerance),
        tolerance_rows(goal.goal_tolerance),
        seconds_of(goal.goal_time_tolerance),
        component_rows(goal.component_path_tolerance),
        component_rows(goal.component_goal_tolerance),
        only_minus_one=True,
    )
