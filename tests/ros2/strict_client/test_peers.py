"""Other participants as the node sees them: their QoS, their types, their tokens, and what is wrong with them."""

from __future__ import annotations

import pytest
from tests.ros2.strict_client.action import SUCCEEDED, ActionClient, goal, point
from tests.ros2.strict_client.wire import ADMIN, DEFAULT, LATCHED, Participant, until
from tests.ros2.strict_client.world import CONTROLLER, JOINT_STATE, NODE, Arm, running

pytestmark = pytest.mark.system

TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
BEST_EFFORT = "2::,5:,:,:,,"


def warning(arm: Arm, *words: str) -> str:
    message = arm.rosout.wait(lambda each: each.level == 30 and all(word in each.msg for word in words)).message
    return str(message.msg)


def test_a_best_effort_publisher_is_warned_about(arm: Arm) -> None:
    """As rclcpp logs it: the subscription asks for more than is offered."""
    arm.me.publisher(f"{CONTROLLER}/joint_trajectory", TRAJECTORY, BEST_EFFORT)
    said = warning(arm, "incompatible QoS")
    assert f"{CONTROLLER}/joint_trajectory" in said
    assert "RELIABILITY" in said


@pytest.mark.slow
def test_a_transient_local_subscriber_of_a_volatile_topic_is_warned_about(arm: Arm) -> None:
    arm.me.subscribe("/joint_states", JOINT_STATE, LATCHED)
    said = warning(arm, "incompatible QoS")
    assert "/joint_states" in said
    assert "DURABILITY" in said


@pytest.mark.slow
def test_a_best_effort_subscriber_is_compatible(arm: Arm) -> None:
    subscription = arm.me.subscribe("/joint_states", JOINT_STATE, BEST_EFFORT)
    subscription.take()
    assert [r for r in arm.rosout.take_all() if "incompatible" in r.message.msg] == []


@pytest.mark.slow
def test_a_compatible_publisher_is_not_warned_about(arm: Arm) -> None:
    arm.me.publisher(f"{CONTROLLER}/joint_trajectory", TRAJECTORY, DEFAULT).wait_for_subscriber()
    assert arm.trigger("reset").success
    assert [r for r in arm.rosout.take_all() if "incompatible" in r.message.msg] == []


WRONG_TOKENS = [
    f"{ADMIN}/0/zid/0/0/XX/%/%/node",
    f"{ADMIN}/0/zid/0/0/NN",
    f"{ADMIN}/0/zid/x/y/NN/%/%/node",
    f"{ADMIN}/0/zid/0/1/MP/%/%/node/%joint_states",
    f"{ADMIN}/0/zid/0/1/MP/%/%/node/%joint_states/sensor_msgs::msg::dds_::JointState_/RIHS01_0/9:9:9,x:,:,:,,",
    f"{ADMIN}/0/zid/0/1/MP/%/%/node/%joint_states/no_type/no_hash/::,10:,:,:,,",
    f"{ADMIN}/0/zid/0/1/MS/%/%/node/%joint_states/{'x' * 3000}/RIHS01_0/::,10:,:,:,,",
    f"{ADMIN}/0/zid/0/99999999999999999999999999/SS/%/%/node/%a/b/c/::,99999999999999999999:,:,:,,",
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
def test_a_token_with_backends_of_a_newer_peer_is_read(arm: Arm) -> None:
    """Rolling may add a part at the end; our strict graph must not see it as its own."""
    text = (
        f"{ADMIN}/0/zid/0/1/MS/%/%/node/%joint_states/sensor_msgs::msg::dds_::JointState_/RIHS01_0/::,10:,:,:,,/cpu"
    )
    reset = arm.service(f"{NODE}/reset", "std_srvs/srv/Trigger")
    with Participant(arm.port, "newer") as other:
        token = other.session.liveliness().declare_token(text)
        until(lambda: text in arm.me.graph.texts, "the token is there")
        # Without a look at the graph, in which our own strict parser would find it.
        assert reset.send().message().success
        token.undeclare()
    until(lambda: text not in arm.me.graph.texts, "the token is gone")


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


@pytest.mark.slow
def test_another_publisher_of_joint_states_is_allowed(arm: Arm) -> None:
    other = arm.me.publisher("/joint_states", JOINT_STATE)
    other.publish(name=["wheel"], position=[1.0])
    arm.joint_states.wait(lambda message: message.name == ["wheel"])
    assert arm.joint_states.wait(lambda message: message.name == arm.names)
    assert arm.trigger("reset").success


@pytest.mark.slow
def test_transforms_by_option(tmp_path_factory: pytest.TempPathFactory) -> None:
    folder = tmp_path_factory.mktemp("tf")
    with running(folder, "publish_tf:=true") as (port, node), Participant(port) as me:
        Arm(me, port, node)
        for topic in ("/tf", "/tf_static"):
            token = me.graph.one(kind="MP", topic=topic, full_node=NODE)
            assert token.qos == {"/tf": "::,100:,:,:,,", "/tf_static": LATCHED}[topic]
        moving = me.subscribe("/tf", "tf2_msgs/msg/TFMessage", "::,100:,:,:,,").take().message
        assert moving.transforms
        for each in moving.transforms:
            turn = each.transform.rotation
            assert turn.x**2 + turn.y**2 + turn.z**2 + turn.w**2 == pytest.approx(1.0, abs=1e-6)
            assert each.header.frame_id
            assert each.child_frame_id
        fixed = me.subscribe("/tf_static", "tf2_msgs/msg/TFMessage", LATCHED).take().message
        children = [each.child_frame_id for each in fixed.transforms + moving.transforms]
        assert len(set(children)) == len(children), "each frame has one parent"


@pytest.mark.slow
def test_several_controllers(tmp_path_factory: pytest.TempPathFactory) -> None:
    folder = tmp_path_factory.mktemp("controllers")
    names = (
        "controllers.arm_controller.joints:=[J1, J2, J3, J4, J5, J6]",
        "controllers.gripper_controller.joints:=[J7]",
        "enable_on_start:=true",
    )
    with running(folder, *names, constraints=()) as (port, _), Participant(port) as me:
        for name in ("/arm_controller", "/gripper_controller"):
            me.graph.one(kind="MP", topic=f"{name}/controller_state", patience=60)
        states = me.subscribe("/joint_states", JOINT_STATE)
        arm, gripper = (
            ActionClient(me, f"/{name}/follow_joint_trajectory")
            for name in ("arm_controller", "gripper_controller")
        )
        assert me.client(f"{NODE}/enable", "std_srvs/srv/SetBool").call(data=True).success
        message = states.take().message
        at = dict(zip(message.name, message.position, strict=True))
        first = arm.send(goal(message.name[:6], [point([at[f"J{i}"] for i in range(1, 7)], 1.0)]))
        second = gripper.send(goal(["J7"], [point([at["J7"]], 1.0)]))
        assert first.accepted
        assert second.accepted
        assert first.result().status == second.result().status == SUCCEEDED
