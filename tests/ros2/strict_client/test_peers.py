"""Other participants as the node sees them: their QoS, their types, their tokens, and what is wrong with them."""

from __future__ import annotations

import pytest
from tests.ros2.strict_client.wire import ADMIN, DEFAULT, Participant
from tests.ros2.strict_client.world import CONTROLLER, JOINT_STATE, NODE, Arm
from tests.waits import until

pytestmark = pytest.mark.system

TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
BEST_EFFORT = "2::,5:,:,:,,"


def test_an_incompatible_publisher_is_warned_about_and_no_compatible_peer(arm: Arm) -> None:
    """As rclcpp logs it: the subscription asks for more than is offered."""
    arm.me.publisher(f"{CONTROLLER}/joint_trajectory", TRAJECTORY, DEFAULT).wait_for_subscriber()
    arm.me.subscribe("/joint_states", JOINT_STATE, BEST_EFFORT).take()
    assert arm.trigger("reset").success
    assert [each for each in arm.rosout.take_all() if "incompatible" in each.message.msg] == []
    arm.me.publisher(f"{CONTROLLER}/joint_trajectory", TRAJECTORY, BEST_EFFORT)
    said = arm.rosout.wait(lambda each: each.level == 30 and "incompatible QoS" in each.msg).message.msg
    assert f"{CONTROLLER}/joint_trajectory" in said
    assert "RELIABILITY" in said


WRONG_TOKENS = [
    f"{ADMIN}/0/zid/0/0/XX/%/%/node",
    f"{ADMIN}/0/zid/0/0/NN",
    f"{ADMIN}/0/zid/x/y/NN/%/%/node",
    f"{ADMIN}/0/zid/0/1/MP/%/%/node/%joint_states",
    f"{ADMIN}/0/zid/0/1/MP/%/%/node/%joint_states/sensor_msgs::msg::dds_::JointState_/RIHS01_0/9:9:9,x:,:,:,,",
    f"{ADMIN}/0/zid/0/1/MP/%/%/node/%joint_states/no_type/no_hash/::,10:,:,:,,",
    f"{ADMIN}/0/zid/0/1/MS/%/%/node/%joint_states/{'x' * 3000}/RIHS01_0/::,10:,:,:,,",
    f"{ADMIN}/0/zid/0/99999999999999999999999999/SS/%/%/node/%a/b/c/::,99999999999999999999:,:,:,,",
    # Rolling may add a part at the end.
    f"{ADMIN}/0/zid/0/1/MS/%/%/node/%joint_states/sensor_msgs::msg::dds_::JointState_/RIHS01_0/::,10:,:,:,,/cpu",
    f"{ADMIN}/0/more/than/anybody/wants/to/read/a/b/c/d/e/f/g/h/i/j",
]


def test_wrong_tokens_do_no_harm(arm: Arm) -> None:
    reset = arm.service(f"{NODE}/reset", "std_srvs/srv/Trigger")
    for text in WRONG_TOKENS:
        with Participant(arm.port, "wrong") as other:
            token = other.session.liveliness().declare_token(text)
            until(lambda text=text: text in arm.me.graph.texts, f"{text} is there")  # type: ignore[misc]  # bound at once
            # Without a look at the graph, in which our own strict parser would find it.
            assert reset.send().message().success, text
            token.undeclare()
        until(lambda text=text: text not in arm.me.graph.texts, f"{text} is gone")  # type: ignore[misc]  # likewise
    arm.node.check()


@pytest.mark.slow
def test_many_participants_come_and_go(arm: Arm) -> None:
    for _ in range(5):
        others = [Participant(arm.port, f"guest{i}") for i in range(4)]
        for other in others:
            other.subscribe("/joint_states", JOINT_STATE)
        for other in others:
            other.close()
    assert arm.trigger("reset").success
    # Asked anew: a subscriber to tokens may miss that one goes when whole sessions end.
    until(lambda: not [text for text in arm.me.graph.asked() if "/guest" in text], "all guests are gone")
