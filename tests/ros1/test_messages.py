from __future__ import annotations

import importlib
import sys
import tempfile
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from hexwire.control.motion.goal_fields import ErrorCode
from hexwire.errors import HexwireError, UsageError
from hexwire.ros1 import messages
from hexwire.ros1.messages import control_msgs, control_srvs, osrf_msgs
from hexwire.ros1.path import find_ros

# As ROS's own packages have them.
CHECKSUMS = {
    "FollowJointTrajectoryAction": "bc4f9b743838566551c0390c65f1a248",
    "FollowJointTrajectoryActionGoal": "cff5c1d533bf2f82dd0138d57f4304bb",
    "FollowJointTrajectoryActionResult": "c4fb3b000dc9da4fd99699380efcc5d9",
    "FollowJointTrajectoryActionFeedback": "d8920dc4eae9fc107e00999cce4be641",
    "FollowJointTrajectoryGoal": "69636787b6ecbde4d61d711979bc7ecb",
    "FollowJointTrajectoryResult": "493383b18409bfb604b4e26c676401d2",
    "FollowJointTrajectoryFeedback": "10817c60c2486ef6b33e97dcd87f4474",
    "JointTolerance": "f544fe9c16cf04547e135dd6063ff5be",
    "JointTrajectoryControllerState": "10817c60c2486ef6b33e97dcd87f4474",
}


@pytest.fixture(autouse=True)
def _ros(monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """ROS for these tests only: other tests must not find Debian's packages."""
    monkeypatch.setattr(sys, "path", list(sys.path))
    # genpy clears up at exit, which a test process does not always come to.
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path_factory.getbasetemp()))
    assert find_ros()
    yield
    monkeypatch.undo()
    importlib.invalidate_caches()


def there_and_back(message: Any) -> Any:
    buffer = BytesIO()
    message.serialize(buffer)
    return type(message)().deserialize(buffer.getvalue())


def make_goal(msgs: SimpleNamespace) -> Any:
    import genpy
    from trajectory_msgs.msg import JointTrajectoryPoint

    goal = msgs.FollowJointTrajectoryGoal()
    goal.trajectory.header.stamp = genpy.Time(12, 345)
    goal.trajectory.joint_names = ["J1", "J2"]
    for i in range(3):
        point = JointTrajectoryPoint(positions=[0.1 * i, -0.1], velocities=[0.5, 0.25 * i])
        point.time_from_start = genpy.Duration(i, 500)
        goal.trajectory.points.append(point)
    goal.path_tolerance = [msgs.JointTolerance("J2", 0.1, -1.0, 0.0)]
    goal.goal_time_tolerance = genpy.Duration(2)
    return goal


@pytest.mark.parametrize("name", CHECKSUMS)
def test_checksums_of_control_msgs(name: str) -> None:
    made = getattr(control_msgs(), name)
    assert made._md5sum == CHECKSUMS[name]
    assert made._type == f"control_msgs/{name}"


def test_checksum_of_the_service_is_that_of_its_fields() -> None:
    import genmsg

    service = control_srvs().QueryTrajectoryState
    context = genmsg.MsgContext.create_default()
    fields = [service._request_class._full_text, service._response_class._full_text]
    spec = genmsg.msg_loader.load_srv_from_string(
        context, "---\n".join(fields), "control_msgs/QueryTrajectoryState"
    )
    assert genmsg.compute_md5(context, spec) == service._md5sum == "ec93cdecbd8062d761aa52b7c90cd44b"
    answer = service._response_class(name=["J1"], position=[0.5], velocity=[0.0], acceleration=[0.0])
    assert there_and_back(answer) == answer


def test_nothing_else_is_made() -> None:
    assert vars(control_msgs()).keys() == CHECKSUMS.keys()
    assert vars(osrf_msgs()).keys() == {"JointCommands"}


def test_checksum_and_fields_of_joint_commands() -> None:
    made = osrf_msgs().JointCommands
    assert made._md5sum == "f298c98f3e9c7aae9376ac19f73bfba3"
    assert made._type == "osrf_msgs/JointCommands"
    sent = made(name=["J1", "J7"], position=[0.5, -0.25], kp_position=[1.0, 2.0])
    sent.header.frame_id = "base"
    got = there_and_back(sent)
    assert got == sent
    assert (got.name, got.position, got.velocity) == (["J1", "J7"], (0.5, -0.25), ())


def test_the_same_classes_at_every_call() -> None:
    assert control_msgs().JointTolerance is control_msgs().JointTolerance
    assert osrf_msgs() is osrf_msgs()


def test_the_codes_of_a_result_are_those_of_goals() -> None:
    result = control_msgs().FollowJointTrajectoryResult
    assert {code.name: getattr(result, code.name) for code in ErrorCode} == {c.name: c.value for c in ErrorCode}


def test_a_goal_with_points_goes_there_and_back() -> None:
    msgs = control_msgs()
    action_goal = msgs.FollowJointTrajectoryActionGoal(goal=make_goal(msgs))
    action_goal.goal_id.id = "client-1"
    got = there_and_back(action_goal)
    assert got.goal_id.id == "client-1"
    trajectory = got.goal.trajectory
    assert trajectory.header.stamp.to_nsec() == 12_000_000_345
    assert trajectory.joint_names == ["J1", "J2"]
    assert [point.positions for point in trajectory.points] == [(0.0, -0.1), (0.1, -0.1), (0.2, -0.1)]
    assert [point.velocities[1] for point in trajectory.points] == [0.0, 0.25, 0.5]
    assert [point.time_from_start.to_nsec() for point in trajectory.points] == [500, 1_000_000_500, 2_000_000_500]
    tolerance = got.goal.path_tolerance[0]
    assert (tolerance.name, tolerance.position, tolerance.velocity) == ("J2", 0.1, -1.0)
    assert got.goal.goal_tolerance == []
    assert got.goal.goal_time_tolerance.to_sec() == 2.0


def test_result_and_feedback_go_there_and_back() -> None:
    msgs = control_msgs()
    result = msgs.FollowJointTrajectoryActionResult()
    result.status.status = 4
    result.result.error_code = result.result.PATH_TOLERANCE_VIOLATED
    result.result.error_string = "J2 is 0.12 rad off its path"
    assert there_and_back(result) == result
    state = msgs.JointTrajectoryControllerState(joint_names=["J1"])
    state.desired.positions, state.actual.positions, state.error.positions = [1.0], [0.75], [0.25]
    got = there_and_back(state)
    assert (got.desired.positions, got.actual.positions, got.error.positions) == ((1.0,), (0.75,), (0.25,))
    feedback = msgs.FollowJointTrajectoryActionFeedback()
    feedback.feedback.actual.velocities = [0.5]
    assert there_and_back(feedback).feedback.actual.velocities == (0.5,)


def test_what_is_sent_is_what_a_packaged_message_reads() -> None:
    from trajectory_msgs.msg import JointTrajectory

    msgs = control_msgs()
    buffer = BytesIO()
    make_goal(msgs).trajectory.serialize(buffer)
    got = JointTrajectory().deserialize(buffer.getvalue())
    assert got.joint_names == ["J1", "J2"]
    assert got.points[2].positions == (0.2, -0.1)


def test_no_folder_is_left_on_the_path() -> None:
    before = list(sys.path)
    assert messages._generate("osrf_msgs", messages._OSRF, messages._HEADER).JointCommands is not None
    assert sys.path == before


def test_without_a_folder_for_temporary_files(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "gone"))
    with pytest.raises(
        HexwireError, match=r"cannot generate the message classes of osrf_msgs: .*; set TMPDIR"
    ) as told:
        osrf_msgs.__wrapped__()
    assert "\n" not in str(told.value)


def test_without_ros_the_line_to_install_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "genpy.dynamic", None)
    with pytest.raises(UsageError, match="ROS 1 is not installed: sudo apt-get install"):
        control_msgs.__wrapped__()


def install(monkeypatch: pytest.MonkeyPatch, checksums: dict[str, str]) -> dict[str, type]:
    """An installed control_msgs whose classes have these checksums."""
    module = ModuleType("control_msgs.msg")
    classes = {name: type(name, (), {"_md5sum": checksum}) for name, checksum in checksums.items()}
    vars(module).update(classes)
    monkeypatch.setitem(sys.modules, "control_msgs", ModuleType("control_msgs"))
    monkeypatch.setitem(sys.modules, "control_msgs.msg", module)
    return classes


def test_an_installed_package_is_used(monkeypatch: pytest.MonkeyPatch) -> None:
    classes = install(monkeypatch, CHECKSUMS)
    assert vars(control_msgs.__wrapped__()) == classes


@pytest.mark.parametrize("other", [{"JointTolerance": "0" * 32}, None])
def test_an_installed_package_of_another_kind_is_not(
    monkeypatch: pytest.MonkeyPatch, other: dict[str, str] | None
) -> None:
    # ROS 2's package has the same name, and no checksums.
    classes = install(monkeypatch, CHECKSUMS | other if other else {})
    made = control_msgs.__wrapped__()
    assert made.JointTolerance is not classes.get("JointTolerance")
    assert made.JointTolerance._md5sum == CHECKSUMS["JointTolerance"]


def test_an_installed_service_has_the_same_names(monkeypatch: pytest.MonkeyPatch) -> None:
    made = control_srvs.__wrapped__()
    module = ModuleType("control_msgs.srv")
    service = type("QueryTrajectoryState", (made.QueryTrajectoryState,), {})
    vars(module).update(QueryTrajectoryState=service)
    monkeypatch.setitem(sys.modules, "control_msgs", ModuleType("control_msgs"))
    monkeypatch.setitem(sys.modules, "control_msgs.srv", module)
    installed = control_srvs.__wrapped__()
    assert installed.QueryTrajectoryState is service
    assert vars(installed) == {**vars(made), "QueryTrajectoryState": service}
