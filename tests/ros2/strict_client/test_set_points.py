"""Set-points: the pair for a controller manager elsewhere, and the forward position controller's topic.

What is followed, and when, is tested in simulated time: `tests/ros2/test_controller_manager.py`.
"""

from __future__ import annotations

from collections.abc import Callable

import pytest
from tests.ros2.strict_client.wire import Publisher
from tests.ros2.strict_client.world import JOINT_STATE, Arm
from tests.waits import until

pytestmark = pytest.mark.system

COMMANDS = "/robot_joint_commands"
ARRAY = "std_msgs/msg/Float64MultiArray"


def publisher(arm: Arm, topic: str, name: str) -> Publisher:
    made = arm.me.publisher(topic, name)
    made.wait_for_subscriber()
    return made


def follows(arm: Arm, publish: Callable[[list[float]], None]) -> None:
    """Whether the arm comes to set-points a little aside: a controller sends the same again and again."""
    wanted = arm.near({"J1": -0.08 if arm.positions()["J1"] > 0 else 0.08})

    def there() -> bool:
        publish(wanted)
        return arm.near() == pytest.approx(wanted, abs=0.04)

    until(there, f"the arm is at {wanted}")


def test_both_topics_have_the_types_of_the_plug_in(arm: Arm) -> None:
    for kind, topic in (("MP", "/robot_joint_states"), ("MS", COMMANDS)):
        assert arm.me.graph.one(kind=kind, topic=topic).type == "sensor_msgs::msg::dds_::JointState_", topic


def test_the_manager_gets_every_state_and_its_commands_are_followed(arm: Arm) -> None:
    first = arm.me.subscribe("/robot_joint_states", JOINT_STATE).take()
    same = arm.joint_states.wait(lambda message: message.header.stamp == first.message.header.stamp)
    assert same.raw == first.raw
    assert first.attachment.gid == arm.me.graph.one(kind="MP", topic="/robot_joint_states").gid
    to = publisher(arm, COMMANDS, JOINT_STATE)
    follows(arm, lambda wanted: to.publish(name=arm.names, position=wanted))


@pytest.mark.slow
def test_the_forward_position_controller(arm: Arm) -> None:
    before = arm.positions()
    to = publisher(arm, "/forward_position_controller/commands", ARRAY)
    to.publish(data=[0.0, 0.0])
    arm.rosout.wait(lambda message: message.level >= 30)
    assert arm.positions() == pytest.approx(before, abs=0.03)
    follows(arm, lambda wanted: to.publish(data=wanted))
