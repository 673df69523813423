"""Messages about an arm, field by field, for each distribution."""

from __future__ import annotations

import math

import pytest

from hexwire.control.loop.known_state import KnownState
from hexwire.control.loop.outcomes import Progress
from hexwire.control.requests.diagnostics import Row, RowLevel
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.motion.teach import Taught
from hexwire.motion.trajectory import Sample
from hexwire.ros2.reports import CONTROLLER_STATE, DIAGNOSTICS, JOINT_STATE, TRAJECTORY, Reports
from zenoh_ros2.distributions import Distribution
from zenoh_ros2.types import Types

WALL = 1_700_000_000.25
NEW = {Distribution.KILTED, Distribution.LYRICAL, Distribution.ROLLING}
PROGRESS = Progress(("J1", "J2"), Sample((1.0, 2.0), (0.5, 0.0), (0.1, 0.2)), (0.75, 2.5), (0.25, math.nan), 5.0)


@pytest.fixture(params=list(Distribution), ids=lambda each: each.value)
def types(request: pytest.FixtureRequest) -> Types:
    return Types(request.param)


@pytest.fixture
def reports(types: Types) -> Reports:
    return Reports(types)


def test_a_stamp_is_never_beyond_its_second(reports: Reports) -> None:
    stamp = reports.stamp(WALL)
    assert (stamp.sec, stamp.nanosec) == (1_700_000_000, 250_000_000)
    stamp = reports.stamp(math.nextafter(7.0, 0.0))
    assert (stamp.sec, stamp.nanosec) == (6, 999_999_999)
    stamp = reports.stamp(-0.5)
    assert (stamp.sec, stamp.nanosec) == (-1, 500_000_000)


def test_a_joint_state_has_no_effort(types: Types, reports: Reports) -> None:
    type_ = types.message(JOINT_STATE)
    for names, frame in ((("J1",), ""), (("J1", "J2"), "base_link"), (("J1", "J2", "gripper"), "base")):
        # Of the same joints, and of others: one is made of the bytes of the one before.
        for k in range(3):
            position, velocity = (tuple(sign * k + i for i in range(len(names))) for sign in (0.5, -0.25))
            data = reports.joint_state(KnownState(names, position, velocity, 0.01), WALL + k, frame)
            again = type_.parse(data)
            assert (again.name, again.effort, again.header.frame_id) == (list(names), [], frame)
            assert (again.position, again.velocity) == (list(position), list(velocity))
            assert again.header.stamp == reports.stamp(WALL + k)
            assert type_.serialize(again) == data, f"{k} of {names}"


def test_the_state_of_a_controller_has_the_names_of_its_distribution(types: Types, reports: Reports) -> None:
    type_ = types.message(CONTROLLER_STATE)
    message = type_.parse(type_.serialize(reports.controller_state(PROGRESS, WALL, 2.5)))
    for point in (message.reference, message.feedback):
        assert (point.time_from_start.sec, point.time_from_start.nanosec) == (2, 500_000_000)
    assert message.joint_names == ["J1", "J2"]
    assert (message.reference.positions, message.reference.velocities) == ([1.0, 2.0], [0.5, 0.0])
    assert message.reference.accelerations == [0.1, 0.2]
    assert message.feedback.positions == [0.75, 2.5]
    assert message.error.positions == [0.25, -0.5]
    assert message.error.velocities[0] == 0.25
    assert math.isnan(message.error.velocities[1])
    assert message.output.positions == [1.0, 2.0]
    if types.distribution is Distribution.HUMBLE:
        assert (message.desired, message.actual.positions) == (message.reference, message.feedback.positions)
    else:
        assert message.speed_scaling_factor == 1.0


@pytest.mark.parametrize("elapsed", [-math.inf, -1.0, 0.0])
def test_no_time_has_passed_before_a_goal_begins(reports: Reports, elapsed: float) -> None:
    message = reports.controller_state(PROGRESS, WALL, elapsed)
    assert (message.reference.time_from_start.sec, message.reference.time_from_start.nanosec) == (0, 0)


def test_feedback_names_the_point_under_way_where_it_can(types: Types, reports: Reports) -> None:
    action = types.action("control_msgs/action/FollowJointTrajectory")
    point = types.message("trajectory_msgs/msg/JointTrajectoryPoint")
    duration = types.message("builtin_interfaces/msg/Duration")
    goal = action.goal()
    goal.trajectory.points = [point(time_from_start=duration(sec=second)) for second in (1, 2)]
    without, type_ = action.goal(), action.feedback_content
    for elapsed, index in ((-1.0, 0), (0.0, 0), (1.0, 1), (1.5, 1), (2.0, 1), (9.0, 1)):
        message = type_.parse(type_.serialize(reports.feedback(PROGRESS, WALL, goal, elapsed)))
        assert message.joint_names == ["J1", "J2"]
        assert (message.desired.positions, message.actual.positions) == ([1.0, 2.0], [0.75, 2.5])
        assert message.error.positions == [0.25, -0.5]
        seconds = message.desired.time_from_start.sec, message.actual.time_from_start.sec
        assert seconds == (max(0, int(elapsed)),) * 2, f"after {elapsed} s"
        assert hasattr(message, "index") == (types.distribution in NEW)
        if types.distribution in NEW:
            assert message.index == index, f"after {elapsed} s"
        assert getattr(reports.feedback(PROGRESS, WALL, without, elapsed), "index", 0) == 0, f"after {elapsed} s"


def test_diagnostics_have_the_levels_of_ros(types: Types, reports: Reports) -> None:
    rows = [Row(level, f"part {level}", level.name, (("key (s)", "0.1"),)) for level in RowLevel]
    type_ = types.message(DIAGNOSTICS)
    message = type_.parse(type_.serialize(reports.diagnostics(rows, WALL, "arm", "arm-7")))
    status = types.message("diagnostic_msgs/msg/DiagnosticStatus")
    wanted = [status.constants[name] for name in ("OK", "WARN", "ERROR", "STALE")]
    assert [each.level for each in message.status] == wanted
    assert [each.name for each in message.status] == [f"arm: part {level}" for level in RowLevel]
    assert {each.hardware_id for each in message.status} == {"arm-7"}
    assert [(value.key, value.value) for value in message.status[0].values] == [("key (s)", "0.1")]


def test_a_taught_motion_is_a_trajectory(types: Types, reports: Reports) -> None:
    taught = Taught(("J1", "J2"), (0.0, 1.25), ((0.0, 0.5), (1.0, 0.5)))
    type_ = types.message(TRAJECTORY)
    message = type_.parse(type_.serialize(reports.taught(taught, HEX7BOT)))
    assert message.joint_names == ["J1", "J2"]
    assert [point.positions for point in message.points] == [[0.0, 0.5], [1.0, 0.5]]
    last = message.points[-1].time_from_start
    assert (last.sec, last.nanosec) == (1, 250_000_000)


def test_a_taught_motion_is_as_exact_as_the_counts_of_its_servos(reports: Reports) -> None:
    coarse = HEX7BOT.joints[0].scale
    taught = Taught(("J1",), (0.0, 1.0, 2.0), ((0.0,), (1.1 * coarse,), (0.0,)))
    assert len(reports.taught(taught, HEX7BOT).points) == 2, "a count more or less is no motion"
