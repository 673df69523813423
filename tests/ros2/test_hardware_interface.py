"""The node as others meet it: a router, a client of its own session, an emulated arm."""

from __future__ import annotations

import math
import sys
import threading
import time
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from tests.ros2.node_fixtures import PAUSE, arm, shared_arm, world
from tests.ros2.node_world import CONTROLLER, JOINTS, Arm, near, still, until

from hexwire.ros2.keys import data_key
from hexwire.ros2.qos import DEFAULT, LATCHED
from hexwire.ros2.zenoh_session import ZenohSettings

__all__ = ["arm", "shared_arm", "world"]

ROOT = Path(__file__).resolve().parent.parent.parent
pytestmark = pytest.mark.system
STATE, STRING = "sensor_msgs/msg/JointState", "std_msgs/msg/String"


def aside(arm: Arm, angle: float = 0.2) -> float:
    """A place for J1 so far away, towards its middle."""
    here = arm.position()["J1"]
    return here - math.copysign(angle, here)


def test_the_example_moves_the_arm(arm: Arm) -> None:
    before = arm.position()["J1"]
    program = arm.world.start(sys.executable, str(ROOT / "examples" / "ros2_client.py"))
    assert program.wait() == 0, program.report()
    first, last = (float(line.split()[3]) for line in program.out.splitlines())
    assert (first, last) == (pytest.approx(before, abs=0.02), pytest.approx(before + 0.2, abs=0.03))
    until(lambda: near({"J1": before + 0.2}, arm.board.positions), "it is there", arm.node.report)


# -- what is published ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("topic", ["joint_states", "robot_joint_states"])
def test_joint_states_have_the_stamps_of_their_samples(arm: Arm, topic: str) -> None:
    messages = arm.peer.collect(f"/{topic}", STATE, 150)
    assert all(tuple(message.name) == JOINTS for message in messages)
    assert all(len(m.position) == len(m.velocity) == len(JOINTS) and not m.effort for m in messages)
    stamps = [message.header.stamp.sec + message.header.stamp.nanosec * 1e-9 for message in messages]
    assert stamps == sorted(set(stamps))
    assert abs(stamps[-1] - time.time()) < 20.0
    # A busy machine makes gaps, never a shorter period: those that it leaves alone are the short ones.
    steps = sorted(later - earlier for earlier, later in pairwise(stamps))
    assert 1 / 140 < steps[len(steps) // 4] < 1 / 60
    assert near(arm.position(), arm.board.positions)


def test_the_state_of_the_controller_says_what_is_wanted_and_what_is(arm: Arm) -> None:
    (message,) = arm.peer.collect(
        f"/{CONTROLLER}/controller_state", "control_msgs/msg/JointTrajectoryControllerState"
    )
    assert tuple(message.joint_names) == JOINTS
    actual = dict(zip(JOINTS, message.feedback.positions, strict=True))
    assert near(actual, arm.board.positions)
    assert near(dict(zip(JOINTS, message.reference.positions, strict=True)), actual)


@pytest.mark.parametrize(
    ("topic", "kind"),
    [
        ("joint_states", STATE),
        (f"{CONTROLLER}/controller_state", "control_msgs/msg/JointTrajectoryControllerState"),
        ("tf", "tf2_msgs/msg/TFMessage"),
    ],
)
def test_a_program_without_a_token_gets_what_is_published(arm: Arm, topic: str, kind: str) -> None:
    message = arm.peer.types.message(kind)
    received: list[bytes] = []
    session = ZenohSettings(connect=(arm.world.endpoint,)).open()
    try:
        key = data_key(0, topic, message.dds_name, message.hash)
        session.subscribe(key, DEFAULT, lambda payload, _: received.append(payload))
        until(lambda: bool(received), f"a message of {topic}", arm.node.report)
    finally:
        session.close()
    message.parse(received[0])


def test_whoever_comes_late_gets_the_description(arm: Arm) -> None:
    (message,) = arm.peer.collect("/robot_description", STRING, qos=LATCHED)
    assert message.data.startswith("<?xml")
    assert all(f'<joint name="{joint}"' in message.data for joint in JOINTS)


def test_every_frame_has_a_transform(arm: Arm) -> None:
    (fixed,) = arm.peer.collect("/tf_static", "tf2_msgs/msg/TFMessage", qos=LATCHED)
    (moving,) = arm.peer.collect("/tf", "tf2_msgs/msg/TFMessage")
    (description,) = arm.peer.collect("/robot_description", STRING, qos=LATCHED)
    frames = {each.child_frame_id for each in [*fixed.transforms, *moving.transforms]}
    assert len(frames) == description.data.count("<joint name=")


def test_diagnostics_name_the_node_and_the_arm(arm: Arm) -> None:
    row = arm.diagnosed("link", 0, "ok")
    assert row.hardware_id == "arm-7"
    assert arm.diagnosed("J1 (servo 0)", 0).hardware_id == "arm-7"
    arm.trigger("stop")
    arm.diagnosed("board", 1, "stopped")


# -- commands ----------------------------------------------------------------------------------------------------


def test_a_trajectory_moves_the_arm_and_an_empty_one_holds_it(arm: Arm) -> None:
    target, start = {"J1": aside(arm, 0.6)}, arm.board.positions
    arm.send((4.0, target))
    until(lambda: not near(start, arm.board.positions), "it moves", arm.node.report)
    arm.send()
    stood = still(lambda: arm.board.positions)
    assert not near(target, stood)
    arm.send((1.0, {"J1": start["J1"]}))
    until(lambda: near({"J1": start["J1"]}, arm.board.positions), "it is back", arm.node.report)


WRONG: dict[str, tuple[dict[str, float], str]] = {
    "unknown joint": ({"elbow": 0.0}, "elbow"),
    "not a number": ({"J1": math.nan}, "nan"),
    "outside limits": ({"J1": 9.0}, "limits"),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_wrong_trajectory_is_logged_and_moves_nothing(arm: Arm, case: str) -> None:
    angles, text = WRONG[case]
    before, said = arm.board.positions, len(arm.node.err)
    arm.send((2.0, angles))
    until(lambda: "joint_trajectory refused" in arm.node.err[said:], "it is logged", arm.node.report)
    assert text in arm.node.err[said:]
    assert near(before, arm.board.positions, 0.002)


def test_query_state_says_where_the_arm_is_meant_to_be(arm: Arm) -> None:
    query: dict[str, Any] = {
        "service": f"/{CONTROLLER}/query_state",
        "type_name": "control_msgs/srv/QueryTrajectoryState",
    }
    at_rest = arm.peer.call(**query)
    assert at_rest.success
    assert tuple(at_rest.name) == JOINTS
    assert near(dict(zip(JOINTS, at_rest.position, strict=True)), arm.board.positions)
    assert set(at_rest.velocity) == {0.0}
    long_ago = arm.peer.types.message("builtin_interfaces/msg/Time")(sec=1)  # type: ignore[operator]
    refused = arm.peer.call(**query, time=long_ago)
    assert not refused.success
    assert "is not available" in refused.message
    arm.trigger("stop")
    assert "stopped" in arm.peer.call(**query).message


def test_set_points_of_a_forward_command_controller_are_followed(arm: Arm) -> None:
    # A stream before a stop has paused.
    time.sleep(PAUSE)
    target = {**arm.position(), "J1": aside(arm)}
    values = [target[joint] for joint in JOINTS]
    arm.stream("/forward_position_controller/commands", "std_msgs/msg/Float64MultiArray", 1.5, data=values)
    until(lambda: near(target, arm.board.positions), "it is there", arm.node.report)


def test_set_points_that_go_on_through_a_stop_move_nothing_after_the_reset(arm: Arm) -> None:
    target = {**arm.position(), "J1": aside(arm, 0.8)}
    topic, kind = "/forward_position_controller/commands", "std_msgs/msg/Float64MultiArray"
    values = [target[joint] for joint in JOINTS]
    ending = threading.Event()

    def play() -> None:
        while not ending.wait(0.02):
            arm.peer.publish(topic, kind, data=values)

    # A stream of the test before has paused.
    time.sleep(PAUSE)
    start, program = arm.board.positions, threading.Thread(target=play)
    program.start()
    try:
        until(lambda: not near(start, arm.board.positions, 0.05), "it moves", arm.node.report)
        arm.trigger("stop")
        stood, said = still(lambda: arm.board.positions), len(arm.node.err)
        arm.trigger("reset")
        until(lambda: "commands refused: they have come since before" in arm.node.err[said:], "it is logged")
        time.sleep(0.5)
        assert near(stood, arm.board.positions, 0.01)
        assert not near(stood, target, 0.1)
    finally:
        ending.set()
        program.join()


# -- services ----------------------------------------------------------------------------------------------------


def test_a_stop_is_latched_until_a_reset_that_moves_nothing(arm: Arm) -> None:
    target = {"J1": aside(arm, 0.6)}
    start = arm.board.positions
    arm.send((6.0, target))
    until(lambda: not near(start, arm.board.positions, 0.02), "it moves", arm.node.report)
    assert arm.trigger("stop").endswith("; all joints confirmed it")
    stood = still(lambda: arm.board.positions)
    said = len(arm.node.err)
    arm.send((2.0, target))
    until(lambda: "refused: the arm is stopped" in arm.node.err[said:], "it is refused", arm.node.report)
    assert "stopped" in arm.refused("go_to/home")
    arm.trigger("reset")
    assert near(stood, still(lambda: arm.board.positions), 0.01)


def long_trajectories(arm: Arm, count: int, points: int) -> None:
    """All at once; each moves J1 far."""
    target = aside(arm, 0.8)
    rows = [(1.0 + i / points, {"J1": target}) for i in range(points)]
    message = arm.trajectory(*rows)
    topic, kind = f"/{CONTROLLER}/joint_trajectory", "trajectory_msgs/msg/JointTrajectory"
    publisher = arm.peer.node.publisher(topic, kind)
    until(lambda: publisher.subscriber_count() and publisher.has_readers, "somebody subscribes", arm.node.report)
    payload = publisher.type.serialize(message)
    for _ in range(count):
        publisher.publish_serialized(payload)


def test_a_stop_does_not_wait_until_long_messages_are_read(arm: Arm) -> None:
    query = f"/{CONTROLLER}/query_state", "control_msgs/srv/QueryTrajectoryState"
    arm.peer.call(*query)
    arm.trigger("stop")
    long_trajectories(arm, 8, 100_000)
    answers: list[Any] = []
    behind = threading.Thread(target=lambda: answers.append(arm.peer.call(*query)))
    behind.start()
    arm.trigger("stop")
    assert not answers, "what comes after the trajectories is not yet answered"
    behind.join()
    assert answers


def test_a_stop_voids_what_was_sent_before_it_and_is_read_after_it(arm: Arm) -> None:
    said = len(arm.node.err)
    long_trajectories(arm, 8, 9_000)
    arm.trigger("stop")
    # Before the stop it may have begun.
    stood = arm.board.positions
    arm.trigger("reset")
    # Its turn comes after theirs.
    arm.send((1.0, {"elbow": 0.0}))
    until(lambda: "elbow" in arm.node.err[said:], "all of them are checked", arm.node.report)
    assert near(stood, still(lambda: arm.board.positions), 0.1)


def test_a_pose_is_answered_on_arrival(arm: Arm) -> None:
    arm.send((1.0, {"J1": aside(arm, 0.3)}))
    still(lambda: arm.board.positions)
    assert arm.trigger("go_to/home") == "at home"
    assert near({"J1": -0.087, "J2": 0.96}, arm.board.positions)


def test_torque_is_switched_by_service(arm: Arm) -> None:
    arm.enable(False)
    assert not any(servo.torque_on for servo in arm.board.board.wire.servos)
    arm.enable()
    assert all(servo.torque_on for servo in arm.board.board.wire.servos)


def test_a_taught_motion_is_latched_saved_and_played(arm: Arm) -> None:
    arm.trigger("teach/start")
    arm.board.lead("J1", 0.3, 1.0)
    assert "taught" in arm.trigger("teach/stop")
    (message,) = arm.peer.collect("/hardware_interface/taught", "trajectory_msgs/msg/JointTrajectory", qos=LATCHED)
    assert tuple(message.joint_names) == JOINTS
    assert list((arm.world.folder / "taught").glob("*.json"))
    assert arm.trigger("teach/play").startswith("played")
    assert "is not in teach mode" in arm.refused("teach/stop")


# -- parameters and life cycle -------------------------------------------------------------------------------------


def parameter(arm: Arm, name: str, service: str = "hardware_interface") -> Any:
    """The value of a parameter, as its message has it."""
    answer = arm.peer.call(f"/{service}/get_parameters", "rcl_interfaces/srv/GetParameters", names=[name])
    (value,) = answer.values
    return value


def set_parameter(arm: Arm, name: str, value: float | str) -> str:
    """Set a parameter; returns why that was refused."""
    make = arm.peer.types.message
    kind = {"type": 3, "double_value": value} if isinstance(value, float) else {"type": 4, "string_value": value}
    row = make("rcl_interfaces/msg/Parameter")(  # type: ignore[operator]
        name=name,
        value=make("rcl_interfaces/msg/ParameterValue")(**kind),  # type: ignore[operator]
    )
    answer = arm.peer.call(
        "/hardware_interface/set_parameters", "rcl_interfaces/srv/SetParameters", parameters=[row]
    )
    (result,) = answer.results
    assert result.successful == (not result.reason)
    return str(result.reason)


def test_every_parameter_is_listed_with_its_value_and_what_it_is_for(arm: Arm) -> None:
    listed = arm.peer.call("/hardware_interface/list_parameters", "rcl_interfaces/srv/ListParameters").result
    wanted = {"port", "use_sim_time", "poses.home.J1", "constraints.goal_time", "constraints.J1.goal", "joints"}
    assert wanted <= set(listed.names)
    assert parameter(arm, "port").string_value.endswith("/ipc_msg.conf")
    assert parameter(arm, "constraints.goal_time").double_value == 3.0
    assert parameter(arm, "joints").string_array_value == list(JOINTS)
    described = arm.peer.call(
        "/hardware_interface/describe_parameters",
        "rcl_interfaces/srv/DescribeParameters",
        names=["watchdog", "diagnostics_rate"],
    )
    watchdog, rate = described.descriptors
    assert (watchdog.read_only, rate.read_only) == (True, False)
    assert "silence after which the board stops the arm" in watchdog.description


def test_a_parameter_takes_effect_and_a_wrong_value_is_refused_with_the_reason(arm: Arm) -> None:
    assert set_parameter(arm, "frame_id", "base_link") == ""
    frames = {message.header.frame_id for message in arm.peer.collect("/joint_states", STATE, 100)}
    assert frames in ({"base_link"}, {"", "base_link"})
    assert set_parameter(arm, "constraints.J1.goal", 0.25) == ""
    assert parameter(arm, "constraints.J1.goal").double_value == 0.25
    assert "must be above 0" in set_parameter(arm, "pose_speed", -1.0)
    assert "read-only" in set_parameter(arm, "port", "/dev/null")
    assert "type" in set_parameter(arm, "pose_speed", "fast")
    assert parameter(arm, "pose_speed").double_value == 1.0
    assert set_parameter(arm, "frame_id", "") == ""


def test_the_life_cycle_says_whether_the_arm_can_move(arm: Arm) -> None:
    def label() -> str:
        answer = arm.peer.call("/hardware_interface/get_state", "lifecycle_msgs/srv/GetState")
        return str(answer.current_state.label)

    def change(number: int) -> bool:
        transition = arm.peer.types.message("lifecycle_msgs/msg/Transition")(id=number)  # type: ignore[operator]
        answer = arm.peer.call(
            "/hardware_interface/change_state", "lifecycle_msgs/srv/ChangeState", transition=transition
        )
        return bool(answer.success)

    until(lambda: label() == "active", "it is active", arm.node.report)
    assert change(4)
    until(lambda: label() == "inactive", "it is inactive", arm.node.report)
    assert change(3), "it ends the stop of deactivate"
    until(lambda: label() == "active", "it is active again", arm.node.report)
    arm.trigger("stop")
    until(lambda: label() == "inactive", "it is stopped", arm.node.report)
    assert not change(3), "it does not end another stop"
    arm.trigger("reset")
    until(lambda: label() == "active", "it is active once more", arm.node.report)
    arm.enable(False)
    until(lambda: label() == "inactive", "it has no torque", arm.node.report)
    assert change(3)
    assert all(servo.torque_on for servo in arm.board.board.wire.servos)
