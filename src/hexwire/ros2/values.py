"""Makes plain values of ROS 2 messages: trajectories, goals, and set-points of controllers.

Owns which field is which value. Must not know which values are valid.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from hexwire.control.loop.outcomes import Reason
from hexwire.control.motion.goal_fields import component_rows, tolerance_rows, trajectory_goal
from hexwire.control.motion.goals import TrajectoryGoal
from hexwire.control.requests.client_goals import ClientRequest
from hexwire.errors import GoalError, UsageError
from zenoh_ros2 import nanoseconds_of, seconds_of

__all__ = ["ARRAY", "delay_of", "of_array", "of_joint_state", "request_of", "trajectory_of"]

ARRAY = "std_msgs/msg/Float64MultiArray"
"""Type of the commands of a forward command controller."""


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


def of_array(message: Any, joints: Sequence[str]) -> dict[str, float]:
    """The set-points in a std_msgs/msg/Float64MultiArray: one for each joint.

    Args:
        message: The message; its layout is ignored, as usual.
        joints: The joints, in the order of the values.

    Returns:
        Radians by joint.

    Raises:
        UsageError: There are more or fewer values, or one is not a finite number.
    """
    if len(message.data) != len(joints):
        raise UsageError(f"data has {len(message.data)} values for the {len(joints)} joints {', '.join(joints)}")
    for joint, value in zip(joints, message.data, strict=True):
        if not math.isfinite(value):
            raise UsageError(f"the value of {joint} is {value}, not a number")
    return dict(zip(joints, message.data, strict=True))


def of_joint_state(message: Any) -> dict[str, float]:
    """The set-points in a sensor_msgs/msg/JointState, as `joint_state_topic_hardware_interface` sends it.

    NaN means no command for that joint, as long as no controller has claimed it. Velocities and efforts are
    ignored: they come beside the positions of a controller, and the servos take positions only.

    Returns:
        Radians by joint; empty if there is no command.

    Raises:
        UsageError: A joint is named twice, the positions are not as many as the names, or one is infinite.
    """
    names, positions = message.name, message.position
    if len(set(names)) != len(names):
        raise UsageError(f"a joint is named twice: {', '.join(names)}")
    if len(positions) != len(names):
        raise UsageError(
            f"position has {len(positions)} values for {len(names)} names; give each joint of the ros2_control tag "
            "the command interface position, and no other joint"
        )
    found = {joint: value for joint, value in zip(names, positions, strict=True) if not math.isnan(value)}
    for joint, value in found.items():
        if math.isinf(value):
            raise UsageError(f"the position of {joint} is {value}, not a number")
    return found
