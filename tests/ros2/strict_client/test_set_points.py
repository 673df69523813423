"""Set-points: the pair for a controller manager elsewhere, and the forward position controller's topic."""

from __future__ import annotations

import math
import time

import pytest
from tests.ros2.strict_client.action import CANCELED, SUCCEEDED
from tests.ros2.strict_client.wire import Publisher, until
from tests.ros2.strict_client.world import JOINT_STATE, Arm

pytestmark = pytest.mark.system

COMMANDS = "/robot_joint_commands"
ARRAY = "std_msgs/msg/Float64MultiArray"


def publisher(arm: Arm, topic: str = COMMANDS, name: str = JOINT_STATE) -> Publisher:
    made = arm.me.publisher(topic, name)
    made.wait_for_subscriber()
    return made


def step(arm: Arm, size: float) -> float:
    return -size if arm.positions()["J1"] > 0 else size


@pytest.mark.slow
def test_every_state_goes_to_the_manager_too(arm: Arm) -> None:
    pair = arm.me.subscribe("/robot_joint_states", JOINT_STATE)
    first = pair.take()
    same = arm.joint_states.wait(lambda message: message.header.stamp == first.message.header.stamp)
    assert same.raw == first.raw
    assert first.attachment.gid == arm.me.graph.one(kind="MP", topic="/robot_joint_states").gid


def test_both_topics_have_the_types_of_the_plug_in(arm: Arm) -> None:
    for kind, topic in (("MP", "/robot_joint_states"), ("MS", COMMANDS)):
        token = arm.me.graph.one(kind=kind, topic=topic)
        assert token.type == "sensor_msgs::msg::dds_::JointState_"


def stream(arm: Arm, to: Publisher, positions: list[float], names: list[str] | None = None) -> None:
    """Until the arm is there: a controller manager sends the same again and again."""
    names = names or arm.names
    wanted = dict(zip(names, positions, strict=True))

    def there() -> bool:
        to.publish(name=names, position=positions)
        at = arm.positions()
        return all(abs(at[name] - position) < 0.04 for name, position in wanted.items() if not math.isnan(position))

    until(there, f"the arm is at {wanted}")


def test_commands_are_followed(arm: Arm) -> None:
    stream(arm, publisher(arm), arm.near({"J1": step(arm, 0.08)}))


@pytest.mark.slow
def test_commands_are_ordered_by_name(arm: Arm) -> None:
    stream(arm, publisher(arm), arm.near({"J1": step(arm, 0.08)})[::-1], arm.names[::-1])


@pytest.mark.slow
def test_nan_commands_nothing(arm: Arm) -> None:
    before = arm.positions()
    to = publisher(arm)
    for _ in range(20):
        to.publish(name=arm.names, position=[math.nan] * 7)
        arm.joint_states.take()
    assert arm.positions() == pytest.approx(before, abs=0.03)


@pytest.mark.slow
def test_a_far_first_command_moves_nothing_and_is_logged(arm: Arm) -> None:
    # The stream of an earlier test ends after `command_timeout`, 0.5 s; before, this were not the first.
    time.sleep(1.0)
    before = arm.positions()
    to = publisher(arm)
    to.publish(name=arm.names, position=arm.near({"J1": step(arm, 0.6)}))
    arm.rosout.wait(lambda message: message.level >= 30 and "away from the arm" in message.msg)
    assert arm.positions() == pytest.approx(before, abs=0.03)


@pytest.mark.slow
@pytest.mark.parametrize(
    "wrong",
    [
        {"name": ["nobody"], "position": [0.0]},
        {"name": ["J1"], "position": []},
        {"name": ["J1", "J1"], "position": [0.0, 0.0]},
        {"name": [], "position": [0.0]},
    ],
)
def test_wrong_commands_move_nothing(arm: Arm, wrong: dict[str, list[object]]) -> None:
    before = arm.positions()
    to = publisher(arm)
    for _ in range(5):
        to.publish(**wrong)
        arm.joint_states.take()
    arm.node.check()
    assert arm.positions() == pytest.approx(before, abs=0.03)


@pytest.mark.slow
def test_a_command_ends_a_goal(arm: Arm) -> None:
    made = arm.send(arm.long_goal())
    assert made.accepted
    to = publisher(arm)

    def ended() -> bool:
        to.publish(name=arm.names, position=arm.near())
        return made.ended

    until(ended, "the goal has ended")
    assert made.result().status == CANCELED


@pytest.mark.slow
def test_a_goal_ends_a_stream(arm: Arm) -> None:
    stream(arm, publisher(arm), arm.near({"J1": step(arm, 0.05)}))
    assert arm.send(arm.short_goal()).result().status == SUCCEEDED


@pytest.mark.slow
def test_the_forward_position_controller(arm: Arm) -> None:
    to = publisher(arm, "/forward_position_controller/commands", ARRAY)
    wanted = arm.near({"J1": step(arm, 0.08)})

    def there() -> bool:
        to.publish(data=wanted)
        return abs(arm.positions()["J1"] - wanted[0]) < 0.04

    until(there, "J1 is there")


@pytest.mark.slow
def test_an_array_of_the_wrong_length_moves_nothing(arm: Arm) -> None:
    before = arm.positions()
    publisher(arm, "/forward_position_controller/commands", ARRAY).publish(data=[0.0, 0.0])
    arm.rosout.wait(lambda message: message.level >= 30)
    assert arm.positions() == pytest.approx(before, abs=0.03)


@pytest.mark.slow
def test_a_stopped_arm_follows_nothing(arm: Arm) -> None:
    arm.trigger("stop")
    before = arm.positions()
    to = publisher(arm)
    for _ in range(20):
        to.publish(name=arm.names, position=[position + 0.05 for position in before.values()])
        arm.joint_states.take()
    assert arm.positions() == pytest.approx(before, abs=0.03)
