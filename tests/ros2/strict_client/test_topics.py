"""What the node publishes: joint states, description, diagnostics, controller state, logs; and joint_trajectory."""

from __future__ import annotations

import itertools
import time
import xml.etree.ElementTree as ET

import pytest
from tests.ros2.strict_client.action import goal, point
from tests.ros2.strict_client.wire import Participant, Received, Subscription, until
from tests.ros2.strict_client.world import CONTROLLER, JOINT_STATE, NODE, Arm, latched

pytestmark = pytest.mark.system

STATE = "control_msgs/msg/JointTrajectoryControllerState"
DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"
TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"


def seconds(stamp: object) -> float:
    return stamp.sec + stamp.nanosec * 1e-9  # type: ignore[attr-defined]


def some(subscription: Subscription, count: int) -> list[Received]:
    subscription.take_all()
    return [subscription.take() for _ in range(count)]


# --- joint states ---


def test_all_joints_are_named_once(arm: Arm) -> None:
    for received in some(arm.joint_states, 3):
        assert received.message.name == arm.names
    assert len(set(arm.names)) == len(arm.names) == 7


def test_arrays_are_as_long_as_the_names_or_empty(arm: Arm) -> None:
    message = arm.joint_states.take().message
    assert len(message.position) == len(message.velocity) == 7
    assert message.effort == [], "no servo of this arm measures Nm"


def test_positions_are_radians(arm: Arm) -> None:
    message = arm.joint_states.take().message
    assert all(abs(position) < 3.2 for position in message.position)
    assert any(position != 0 for position in message.position)


def test_stamps_rise(arm: Arm) -> None:
    stamps = [seconds(received.message.header.stamp) for received in some(arm.joint_states, 20)]
    assert all(a < b for a, b in itertools.pairwise(stamps))


def test_stamps_are_the_time_of_the_sample(arm: Arm) -> None:
    ages = [received.at - seconds(received.message.header.stamp) for received in some(arm.joint_states, 20)]
    # Before it came, by less than a stalled machine needs; at most a millisecond of clock error.
    assert all(age > -0.001 for age in ages), ages
    assert min(ages) < 0.5


def test_nanoseconds_are_below_a_second(arm: Arm) -> None:
    assert all(0 <= received.message.header.stamp.nanosec < 10**9 for received in some(arm.joint_states, 20))


@pytest.mark.slow
def test_the_rate_is_what_the_line_allows(arm: Arm) -> None:
    """By the stamps of the samples: 115200 baud allow about 75 Hz, and 100 are asked for."""
    stamps = [seconds(received.message.header.stamp) for received in some(arm.joint_states, 60)]
    steps = sorted(b - a for a, b in itertools.pairwise(stamps))
    # A busy machine makes gaps, never a shorter period: those that it leaves alone are the short ones.
    assert 0.005 < steps[len(steps) // 4] < 0.04


def test_sequence_numbers_count(arm: Arm) -> None:
    numbers = [received.attachment.sequence for received in some(arm.joint_states, 20)]
    assert numbers == list(range(numbers[0], numbers[0] + 20))


def test_the_attachment_has_the_gid_of_the_token(arm: Arm) -> None:
    token = arm.me.graph.one(kind="MP", topic="/joint_states")
    assert {received.attachment.gid for received in some(arm.joint_states, 3)} == {token.gid}


def test_the_source_time_is_when_it_was_published(arm: Arm) -> None:
    for received in some(arm.joint_states, 5):
        assert -0.001 < received.at - received.attachment.stamp * 1e-9 < 30
        assert received.attachment.stamp * 1e-9 >= seconds(received.message.header.stamp) - 0.001


def test_messages_come_on_the_key_of_the_token(arm: Arm) -> None:
    token = arm.me.graph.one(kind="MP", topic="/joint_states")
    assert arm.joint_states.take().key == token.key


def test_the_frame_is_empty_by_default(arm: Arm) -> None:
    assert arm.joint_states.take().message.header.frame_id == ""


# --- robot_description ---


def test_a_late_joiner_gets_the_description(arm: Arm) -> None:
    with Participant(arm.port, "late") as late:
        text = latched(late, "/robot_description", "std_msgs/msg/String").take().message.data
    robot = ET.fromstring(text)
    joints = {joint.get("name") for joint in robot.iter("joint") if joint.get("type") != "fixed"}
    assert robot.tag == "robot"
    assert set(arm.names) <= joints


@pytest.mark.slow
def test_the_description_comes_once(arm: Arm) -> None:
    with Participant(arm.port, "late") as late:
        subscription = latched(late, "/robot_description", "std_msgs/msg/String")
        first = subscription.take()
        assert first.attachment.sequence == 1
        assert subscription.listen(0.5) == []


@pytest.mark.slow
def test_each_late_joiner_gets_the_same(arm: Arm) -> None:
    texts = set()
    for _ in range(3):
        with Participant(arm.port, "late") as late:
            texts.add(latched(late, "/robot_description", "std_msgs/msg/String").take().message.data)
    assert len(texts) == 1


@pytest.mark.slow
def test_a_volatile_subscriber_gets_no_history(arm: Arm) -> None:
    with Participant(arm.port, "volatile") as other:
        latched(other, "/robot_description", "std_msgs/msg/String").take()
        volatile = other.subscribe("/robot_description", "std_msgs/msg/String")
        assert volatile.listen(0.5) == []


def test_the_gid_of_the_description_is_that_of_its_token(arm: Arm) -> None:
    with Participant(arm.port, "late") as late:
        received = latched(late, "/robot_description", "std_msgs/msg/String").take()
    assert received.attachment.gid == arm.me.graph.one(kind="MP", topic="/robot_description").gid


# --- diagnostics ---


@pytest.mark.slow
def test_diagnostics_come_once_a_second(arm: Arm) -> None:
    subscription = arm.me.subscribe("/diagnostics", DIAGNOSTICS)
    stamps = [seconds(subscription.take().message.header.stamp) for _ in range(3)]
    # Changes are published at once, so they may come earlier.
    assert all(b - a < 3.0 for a, b in itertools.pairwise(stamps))


def test_diagnostics_name_node_and_component(arm: Arm) -> None:
    message = arm.me.subscribe("/diagnostics", DIAGNOSTICS).take().message
    assert message.status
    for status in message.status:
        assert status.name.startswith("hardware_interface: ")
        assert status.level in (0, 1, 2, 3)
        assert status.message
        assert all(pair.key for pair in status.values)
    assert len({status.name for status in message.status}) == len(message.status)


def test_diagnostics_are_well_when_all_is_well(arm: Arm) -> None:
    subscription = arm.me.subscribe("/diagnostics", DIAGNOSTICS)
    subscription.wait(lambda message: all(status.level <= 1 for status in message.status))


@pytest.mark.slow
def test_a_stop_is_in_the_diagnostics(arm: Arm) -> None:
    subscription = arm.me.subscribe("/diagnostics", DIAGNOSTICS)
    assert arm.trigger("stop").success
    subscription.wait(lambda message: any(status.level in (1, 2) for status in message.status))


# --- controller state ---


def test_the_controller_state_has_every_joint(arm: Arm) -> None:
    message = arm.me.subscribe(f"{CONTROLLER}/controller_state", STATE).take().message
    assert message.joint_names == arm.names
    assert len(message.feedback.positions) == len(message.reference.positions) == len(message.error.positions) == 7
    assert message.multi_dof_joint_names == []


def test_the_error_is_reference_minus_feedback(arm: Arm) -> None:
    message = arm.me.subscribe(f"{CONTROLLER}/controller_state", STATE).take().message
    for error, wanted, seen in zip(
        message.error.positions, message.reference.positions, message.feedback.positions, strict=True
    ):
        assert error == pytest.approx(wanted - seen, abs=1e-9)


def test_the_speed_is_not_scaled(arm: Arm) -> None:
    assert arm.me.subscribe(f"{CONTROLLER}/controller_state", STATE).take().message.speed_scaling_factor == 1.0


def test_the_controller_state_is_stamped(arm: Arm) -> None:
    received = arm.me.subscribe(f"{CONTROLLER}/controller_state", STATE).take()
    assert -0.001 < received.at - seconds(received.message.header.stamp) < 30


# --- rosout ---


def test_a_late_joiner_gets_the_log(arm: Arm) -> None:
    with Participant(arm.port, "late") as late:
        log = late.subscribe("/rosout", "rcl_interfaces/msg/Log", arm.rosout.token.qos)
        message = log.take().message
    assert message.name == "hardware_interface"
    assert message.level in (10, 20, 30, 40, 50)
    assert message.msg
    assert seconds(message.stamp) > 1.6e9


def test_log_messages_are_this_nodes(arm: Arm) -> None:
    arm.send(goal(["nobody"], [point([0.0], 1.0)])).reply.message()
    received = arm.rosout.take()
    assert received.attachment.gid == arm.me.graph.one(kind="MP", topic="/rosout", full_node=NODE).gid


# --- joint_trajectory ---


def moved(arm: Arm, before: dict[str, float], by: float) -> None:
    until(lambda: abs(arm.positions()["J1"] - before["J1"] - by) < 0.03, "J1 has moved")


def trajectory(arm: Arm, by: float, duration: float = 0.5) -> dict[str, object]:
    return {"joint_names": arm.names, "points": [point(arm.near({"J1": by}), duration)]}


def test_a_trajectory_on_the_topic_moves_the_arm(arm: Arm) -> None:
    publisher = arm.me.publisher(f"{CONTROLLER}/joint_trajectory", TRAJECTORY)
    publisher.wait_for_subscriber()
    before = arm.positions()
    by = -0.1 if before["J1"] > 0 else 0.1
    publisher.publish(**trajectory(arm, by))
    moved(arm, before, by)


@pytest.mark.slow
def test_a_trajectory_is_ordered_by_name(arm: Arm) -> None:
    publisher = arm.me.publisher(f"{CONTROLLER}/joint_trajectory", TRAJECTORY)
    publisher.wait_for_subscriber()
    before = arm.positions()
    by = -0.1 if before["J1"] > 0 else 0.1
    positions = arm.near({"J1": by})
    publisher.publish(joint_names=arm.names[::-1], points=[point(positions[::-1], 0.5)])
    moved(arm, before, by)


def test_a_wrong_trajectory_moves_nothing_and_is_logged(arm: Arm) -> None:
    publisher = arm.me.publisher(f"{CONTROLLER}/joint_trajectory", TRAJECTORY)
    publisher.wait_for_subscriber()
    before = arm.positions()
    publisher.publish(joint_names=["nobody"], points=[point([0.3], 0.2)])
    arm.rosout.wait(lambda message: message.level >= 30 and "nobody" in message.msg)
    assert arm.positions()["J1"] == pytest.approx(before["J1"], abs=0.03)


@pytest.mark.slow
def test_the_newest_of_two_trajectories_wins(arm: Arm) -> None:
    publisher = arm.me.publisher(f"{CONTROLLER}/joint_trajectory", TRAJECTORY)
    publisher.wait_for_subscriber()
    before = arm.positions()
    sign = -1 if before["J1"] > 0 else 1
    publisher.publish(**trajectory(arm, sign * 0.3, 3.0))
    time.sleep(0.2)
    publisher.publish(joint_names=arm.names, points=[point([*before.values()], 0.5)])
    time.sleep(0.8)
    moved(arm, before, 0.0)


@pytest.mark.slow
def test_two_publishers_may_take_turns(arm: Arm) -> None:
    with Participant(arm.port, "second") as other:
        publishers = [p.publisher(f"{CONTROLLER}/joint_trajectory", TRAJECTORY) for p in (arm.me, other)]
        for publisher in publishers:
            publisher.wait_for_subscriber()
            before = arm.positions()
            by = -0.08 if before["J1"] > 0 else 0.08
            publisher.publish(**trajectory(arm, by))
            moved(arm, before, by)


def test_two_subscribers_hear_the_same(arm: Arm) -> None:
    with Participant(arm.port, "second") as other:
        theirs = other.subscribe("/joint_states", JOINT_STATE)
        first = theirs.take()
        same = arm.joint_states.wait(lambda message: message.header.stamp == first.message.header.stamp)
        assert same.raw == first.raw
        assert same.attachment == first.attachment
