"""What the node publishes: joint states, description, diagnostics, controller state, logs; and joint_trajectory."""

from __future__ import annotations

import itertools
import xml.etree.ElementTree as ET

import pytest
from tests.ros2.strict_client.action import goal, point
from tests.ros2.strict_client.wire import Participant, Received, Subscription
from tests.ros2.strict_client.world import CONTROLLER, JOINT_STATE, NODE, Arm, latched
from tests.waits import until

pytestmark = pytest.mark.system

STATE = "control_msgs/msg/JointTrajectoryControllerState"
DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"
TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
STRING = "std_msgs/msg/String"


def seconds(stamp: object) -> float:
    return stamp.sec + stamp.nanosec * 1e-9  # type: ignore[attr-defined]


def some(subscription: Subscription, count: int) -> list[Received]:
    subscription.take_all()
    return [subscription.take() for _ in range(count)]


# --- joint states ---


def test_joint_states_have_every_joint_and_the_time_of_the_sample(arm: Arm) -> None:
    taken = some(arm.joint_states, 20)
    assert len(set(arm.names)) == len(arm.names) == 7
    for received in taken:
        message = received.message
        assert message.name == arm.names
        assert len(message.position) == len(message.velocity) == 7
        assert message.effort == [], "no servo of this arm measures Nm"
        assert message.header.frame_id == ""
        assert all(abs(position) < 3.2 for position in message.position), "radians"
        assert any(position != 0 for position in message.position)
        assert 0 <= message.header.stamp.nanosec < 10**9
    stamps = [seconds(received.message.header.stamp) for received in taken]
    assert all(a < b for a, b in itertools.pairwise(stamps))
    ages = [received.at - stamp for received, stamp in zip(taken, stamps, strict=True)]
    # Before it came, by less than a stalled machine needs; at most a millisecond of clock error.
    assert all(age > -0.001 for age in ages), ages
    assert min(ages) < 0.5


@pytest.mark.slow
def test_the_rate_is_what_the_line_allows(arm: Arm) -> None:
    """By the stamps of the samples: 115200 baud allow about 75 Hz, and 100 are asked for."""
    stamps = [seconds(received.message.header.stamp) for received in some(arm.joint_states, 60)]
    steps = sorted(b - a for a, b in itertools.pairwise(stamps))
    # A busy machine makes gaps, never a shorter period: those that it leaves alone are the short ones.
    assert 0.005 < steps[len(steps) // 4] < 0.04


def test_what_is_beside_a_message_belongs_to_its_token(arm: Arm) -> None:
    token = arm.me.graph.one(kind="MP", topic="/joint_states")
    taken = some(arm.joint_states, 20)
    numbers = [received.attachment.sequence for received in taken]
    assert numbers == list(range(numbers[0], numbers[0] + 20))
    for received in taken:
        assert received.attachment.gid == token.gid
        assert received.key == token.key
        published = received.attachment.stamp * 1e-9
        assert -0.001 < received.at - published < 30
        assert published >= seconds(received.message.header.stamp) - 0.001


def test_two_subscribers_hear_the_same(arm: Arm) -> None:
    with Participant(arm.port, "second") as other:
        theirs = other.subscribe("/joint_states", JOINT_STATE)
        first = theirs.take()
        same = arm.joint_states.wait(lambda message: message.header.stamp == first.message.header.stamp)
        assert same.raw == first.raw
        assert same.attachment == first.attachment


# --- robot_description ---


def test_each_late_joiner_gets_the_description(arm: Arm) -> None:
    token, texts = arm.me.graph.one(kind="MP", topic="/robot_description"), set()
    for _ in range(2):
        with Participant(arm.port, "late") as late:
            received = latched(late, "/robot_description", STRING).take()
            assert (received.attachment.sequence, received.attachment.gid) == (1, token.gid)
            texts.add(received.message.data)
    (text,) = texts
    robot = ET.fromstring(text)
    joints = {joint.get("name") for joint in robot.iter("joint") if joint.get("type") != "fixed"}
    assert robot.tag == "robot"
    assert set(arm.names) <= joints


@pytest.mark.slow
def test_the_description_comes_once_and_not_to_who_wants_no_history(arm: Arm) -> None:
    with Participant(arm.port, "volatile") as other:
        subscription = latched(other, "/robot_description", STRING)
        subscription.take()
        volatile = other.subscribe("/robot_description", STRING)
        assert volatile.listen(0.5) == subscription.take_all() == []


# --- diagnostics and controller state ---


def test_diagnostics_name_node_and_component(arm: Arm) -> None:
    subscription = arm.me.subscribe("/diagnostics", DIAGNOSTICS)
    message = subscription.wait(lambda message: all(status.level <= 1 for status in message.status)).message
    assert message.status
    for status in message.status:
        assert status.name.startswith("hardware_interface: ")
        assert status.message
        assert all(pair.key for pair in status.values)
    assert len({status.name for status in message.status}) == len(message.status)


def test_the_controller_state_has_every_joint(arm: Arm) -> None:
    received = arm.me.subscribe(f"{CONTROLLER}/controller_state", STATE).take()
    message = received.message
    assert (message.joint_names, message.multi_dof_joint_names) == (arm.names, [])
    off = [w - p for w, p in zip(message.reference.positions, message.feedback.positions, strict=True)]
    assert message.error.positions == pytest.approx(off, abs=1e-9)
    assert len(off) == 7
    assert message.speed_scaling_factor == 1.0
    assert -0.001 < received.at - seconds(message.header.stamp) < 30


# --- rosout ---


def test_a_late_joiner_gets_the_log_of_this_node(arm: Arm) -> None:
    with Participant(arm.port, "late") as late:
        message = late.subscribe("/rosout", "rcl_interfaces/msg/Log", arm.rosout.token.qos).take().message
    assert message.name == "hardware_interface"
    assert message.level in (10, 20, 30, 40, 50)
    assert message.msg
    assert seconds(message.stamp) > 1.6e9
    arm.send(goal(["nobody"], [point([0.0], 1.0)])).reply.message()
    received = arm.rosout.take()
    assert received.attachment.gid == arm.me.graph.one(kind="MP", topic="/rosout", full_node=NODE).gid


# --- joint_trajectory ---


def test_a_trajectory_on_the_topic_moves_the_arm_and_a_wrong_one_is_logged(arm: Arm) -> None:
    publisher = arm.me.publisher(f"{CONTROLLER}/joint_trajectory", TRAJECTORY)
    publisher.wait_for_subscriber()
    before = arm.positions()
    publisher.publish(joint_names=["nobody"], points=[point([0.3], 0.2)])
    arm.rosout.wait(lambda message: message.level >= 30 and "nobody" in message.msg)
    assert arm.positions()["J1"] == pytest.approx(before["J1"], abs=0.03)
    by = -0.1 if before["J1"] > 0 else 0.1
    publisher.publish(joint_names=arm.names, points=[point(arm.near({"J1": by}), 0.5)])
    until(lambda: abs(arm.positions()["J1"] - before["J1"] - by) < 0.03, "J1 has moved")
