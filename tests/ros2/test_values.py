"""Goals from messages of ROS 2, as their bytes arrive."""

from __future__ import annotations

from typing import Any

import pytest

from hexwire.control.motion.goals import ComponentTolerance, Point, TrajectoryGoal
from hexwire.control.requests.client_goals import ClientRequest
from hexwire.ros2.values import request_of, trajectory_of
from zenoh_ros2.times import nanoseconds_of, seconds_of
from zenoh_ros2.types import Types

TYPES = Types()
NOW = 1_700_000_000_500_000_000


def make(name: str, **fields: Any) -> Any:
    """A message as a peer reads it."""
    kind = TYPES.message(name)
    return kind.parse(kind.serialize(kind(**fields)))


def time(nanoseconds: int, kind: str = "Time") -> Any:
    seconds, rest = divmod(nanoseconds, 10**9)
    return make(f"builtin_interfaces/msg/{kind}", sec=seconds, nanosec=rest)


def duration(nanoseconds: int) -> Any:
    return time(nanoseconds, "Duration")


def trajectory(stamp: int = 0) -> Any:
    point = TYPES.message("trajectory_msgs/msg/JointTrajectoryPoint")
    points = [
        point(positions=[0.1, 0.2], time_from_start=duration(500_000_000)),
        point(
            positions=[0.3, 0.4],
            velocities=[1.0, 2.0],
            accelerations=[3.0, 4.0],
            effort=[5.0, 6.0],
            time_from_start=duration(1_000_000_000),
        ),
    ]
    header = make("std_msgs/msg/Header", stamp=time(stamp))
    return make("trajectory_msgs/msg/JointTrajectory", header=header, joint_names=["J2", "J1"], points=points)


def expected(delay: float = 0.0, free: tuple[str, ...] = ()) -> TrajectoryGoal:
    last = Point(1.0, (0.3, 0.4), (1.0, 2.0), (3.0, 4.0), (5.0, 6.0))
    return TrajectoryGoal(("J2", "J1"), (Point(0.5, (0.1, 0.2)), last), delay, free)


@pytest.mark.parametrize("nanoseconds", [0, 1, -1, 999_999_999, -1_500_000_000, 2**31 * 10**9 - 1])
def test_times_are_exact_and_may_be_negative(nanoseconds: int) -> None:
    assert nanoseconds_of(duration(nanoseconds)) == nanoseconds
    assert seconds_of(duration(nanoseconds)) == nanoseconds / 1e9


def test_a_trajectory_is_read_as_it_is() -> None:
    assert trajectory_of(trajectory(), NOW) == expected()


@pytest.mark.parametrize("nanoseconds", [250_000_001, 1, -500_000_000])
def test_a_stamp_is_told_from_now_and_exactly(nanoseconds: int) -> None:
    assert trajectory_of(trajectory(NOW + nanoseconds), NOW) == expected(nanoseconds / 1e9)


@pytest.mark.parametrize(
    ("names", "points", "free"),
    [
        ([], 0, ()),
        (["base"], 0, ()),
        (["base", "ball"], 2, ("base", "ball")),
        ([], 1, ("joints without a name",)),
    ],
)
def test_joints_with_several_axes_count_if_they_are_to_move(
    names: list[str], points: int, free: tuple[str, ...]
) -> None:
    point = TYPES.message("trajectory_msgs/msg/MultiDOFJointTrajectoryPoint")
    multi = make(
        "trajectory_msgs/msg/MultiDOFJointTrajectory", joint_names=names, points=[point() for _ in range(points)]
    )
    assert trajectory_of(trajectory(), NOW, multi) == expected(free=free)


def test_a_goal_is_read_whole() -> None:
    tolerance = TYPES.message("control_msgs/msg/JointTolerance")
    component = TYPES.message("control_msgs/msg/JointComponentTolerance")
    point = TYPES.message("trajectory_msgs/msg/MultiDOFJointTrajectoryPoint")
    goal = make(
        "control_msgs/action/FollowJointTrajectory_Goal",
        trajectory=trajectory(NOW + 10**9),
        multi_dof_trajectory=make(
            "trajectory_msgs/msg/MultiDOFJointTrajectory", joint_names=["base"], points=[point()]
        ),
        path_tolerance=[tolerance(name="J1", position=0.1, velocity=-1.0, acceleration=0.5)],
        goal_tolerance=[tolerance(name="J2", position=0.2)],
        component_path_tolerance=[component(joint_name="J1", component=5, position=0.3)],
        component_goal_tolerance=[component(joint_name="J2", component=1, velocity=0.4, acceleration=0.6)],
        goal_time_tolerance=duration(-1_000_000_000),
    )
    assert request_of(goal, NOW) == ClientRequest(
        expected(1.0, ("base",)),
        [("J1", 0.1, -1.0, 0.5)],
        [("J2", 0.2, 0.0, 0.0)],
        -1.0,
        [ComponentTolerance("J1", 5, 0.3)],
        [ComponentTolerance("J2", 1, 0.0, 0.4, 0.6)],
        only_minus_one=True,
    )
