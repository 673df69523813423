"""Namespaces, remaps, domains, distributions, and the end of a node; each with a node of its own."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest
from tests.link.far_ends import free_port
from tests.ros2.strict_client.action import SUCCEEDED, goal, point
from tests.ros2.strict_client.definitions import NO_HASH, Definitions, dds_name
from tests.ros2.strict_client.wire import Participant, Token, router
from tests.ros2.strict_client.world import ACTION, CONTROLLER, JOINT_STATE, NODE, Arm, NodeProcess, running
from tests.waits import until

pytestmark = pytest.mark.system

FEEDBACK = "control_msgs/action/FollowJointTrajectory_FeedbackMessage"
STATE = "control_msgs/msg/JointTrajectoryControllerState"


@pytest.mark.slow
def test_a_namespace_a_domain_and_files_of_parameters_and_of_the_session(tmp_path: Path) -> None:
    """ZENOH_SESSION_CONFIG_URI, as rmw_zenoh_cpp has it; the other tests use ZENOH_CONFIG_OVERRIDE."""
    file = tmp_path / "arm.yaml"
    file.write_text("/**:\n  ros__parameters:\n    frame_id: base\n    constraints:\n      goal_time: 25.0\n")
    arguments = ("-r", "__ns:=/lab/left", "--params-file", str(file))
    env = {"ROS_DOMAIN_ID": "42"}
    with (
        running(
            tmp_path / "node",
            *("enable_on_start:=true", "allow_partial_joints_goal:=true"),
            arguments=arguments,
            env=env,
            by_file=True,
        ) as (port, node),
        Participant(port, domain=42) as me,
    ):
        arm = Arm(me, port, node, "/lab/left/hardware_interface", "/lab/left")
        own = me.graph.one(kind="NN", full_node="/lab/left/hardware_interface")
        assert own.text.endswith("/NN/%/%lab%left/hardware_interface")
        assert own.domain == 42
        assert arm.joint_states.token.key.startswith("42/lab/left/joint_states/")
        # Absolute names stay.
        for topic in ("/rosout", "/diagnostics", "/parameter_events"):
            assert me.graph.one(kind="MP", topic=topic, zid=own.zid).namespace == "/lab/left"
        for topic in ("/lab/left/robot_description", f"/lab/left{CONTROLLER}/controller_state"):
            me.graph.one(kind="MP", topic=topic)
        received = arm.joint_states.take()
        assert received.key.startswith("42/lab/left/joint_states/")
        assert received.message.header.frame_id == "base"
        assert arm.parameters.get("frame_id") == "base"
        # The file comes after the single values of the command line.
        assert arm.parameters.get("constraints.goal_time") == 25.0
        arm.rest()
        assert arm.send(arm.short_goal()).result().status == SUCCEEDED
        arm.send(goal(["nobody"], [point([0.0], 1.0)])).reply.message()
        assert arm.rosout.take().message.name == "lab.left.hardware_interface"
        with Participant(port, domain=0) as outside:
            assert outside.graph.tokens(full_node=own.full_node) == []


@pytest.mark.slow
@pytest.mark.parametrize("distribution", ["humble", "rolling"])
def test_a_distribution(tmp_path: Path, distribution: str) -> None:
    """Feedback has indices from control_msgs 6.3 on; Humble has no hashes."""
    wanted = Definitions(distribution)
    with (
        running(tmp_path, "enable_on_start:=true", f"distribution:={distribution}") as (port, node),
        Participant(port, distribution=distribution) as me,
    ):
        arm = Arm(me, port, node)
        feedback = me.graph.one(kind="MP", topic=f"{ACTION}/_action/feedback")
        assert (feedback.type, feedback.hash) == (dds_name(FEEDBACK), wanted.hash(FEEDBACK))
        arm.rest()
        made = arm.send(arm.short_goal(0.2, 1.0))
        assert made.result().status == SUCCEEDED
        message = arm.action.feedback.take().message.feedback
        assert hasattr(message, "index") == (distribution == "rolling")
        me.subscribe(f"{CONTROLLER}/controller_state", STATE).take()
        if distribution == "humble":
            assert {token.hash for token in me.graph.tokens(full_node=NODE) if token.kind != "NN"} == {NO_HASH}


@pytest.mark.slow
def test_all_tokens_go_with_the_node(tmp_path: Path) -> None:
    """With the node process itself; the router and the others stay."""
    port = free_port()
    with router(port):
        node = NodeProcess(port, tmp_path, "port:=sim://hex7bot")
        try:
            with Participant(port) as me:
                Arm(me, port, node)
                own = [token.text for token in me.graph.tokens(full_node=NODE)]
                status = node.end(signal.SIGINT)
                until(lambda: not set(own) & set(me.graph.texts), "all its tokens are gone")
                # Endpoints before their node: who hears the node go need not look for its endpoints.
                gone = [Token.parse(text) for text in me.graph.gone if text in own]
                assert gone[-1].kind == "NN"
            assert status == 0, node.said
            assert "Traceback" not in node.said
        finally:
            node.kill()


@pytest.mark.slow
def test_remaps_of_topics_services_and_actions(tmp_path: Path) -> None:
    """rcl_action resolves the name of an action as that of a topic, and adds `/_action/...` after that."""
    rules = ("joint_states:=js", "~/stop:=/halt", "__node:=arm7", f"{ACTION[1:]}:=arm/follow")
    remaps = tuple(word for rule in rules for word in ("-r", rule))
    with running(tmp_path, arguments=remaps) as (port, _), Participant(port) as me:
        me.graph.one(kind="NN", full_node="/arm7")
        for kind, topic in [
            ("MP", "/js"),
            ("SS", "/halt"),
            ("SS", "/arm7/list_parameters"),
            ("SS", "/arm7/reset"),
            ("MP", "/arm/follow/_action/status"),
            ("MP", "/arm/follow/_action/feedback"),
            ("SS", "/arm/follow/_action/send_goal"),
            ("SS", "/arm/follow/_action/get_result"),
        ]:
            me.graph.one(kind=kind, topic=topic)
        names = {token.topic for token in me.graph.tokens()}
        assert not names & {"/joint_states", "/arm7/stop"}
        me.subscribe("/js", JOINT_STATE).take()
        assert me.client("/halt", "std_srvs/srv/Trigger").call().success
