"""What a peer sees of the node in the graph: `ros2 node info`, `ros2 topic info -v`, `ros2 service list -t`."""

from __future__ import annotations

import pytest
from tests.ros2.strict_client.definitions import HASHES, dds_name
from tests.ros2.strict_client.wire import (
    DEFAULT,
    LATCHED,
    PARAMETERS,
    ROSOUT,
    SERVICES,
    STATUS,
    Participant,
    Token,
    until,
)
from tests.ros2.strict_client.world import ACTION, CONTROLLER, NODE, Arm

pytestmark = pytest.mark.system

FOLLOW = "control_msgs/action/FollowJointTrajectory"
TRIGGER = "std_srvs/srv/Trigger"
# kind, name, type, QoS; None where ROS leaves it to the node: reliable and volatile, any depth.
ENDPOINTS = [
    ("MP", "/rosout", "rcl_interfaces/msg/Log", ROSOUT),
    ("MP", "/parameter_events", "rcl_interfaces/msg/ParameterEvent", PARAMETERS),
    ("MP", "/joint_states", "sensor_msgs/msg/JointState", None),
    ("MP", "/robot_description", "std_msgs/msg/String", LATCHED),
    ("MP", "/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", None),
    ("MP", f"{CONTROLLER}/controller_state", "control_msgs/msg/JointTrajectoryControllerState", None),
    ("MP", f"{NODE}/transition_event", "lifecycle_msgs/msg/TransitionEvent", None),
    ("MP", f"{ACTION}/_action/feedback", f"{FOLLOW}_FeedbackMessage", DEFAULT),
    ("MP", f"{ACTION}/_action/status", "action_msgs/msg/GoalStatusArray", STATUS),
    ("MS", f"{CONTROLLER}/joint_trajectory", "trajectory_msgs/msg/JointTrajectory", None),
    ("SS", f"{ACTION}/_action/send_goal", f"{FOLLOW}_SendGoal", SERVICES),
    ("SS", f"{ACTION}/_action/get_result", f"{FOLLOW}_GetResult", SERVICES),
    ("SS", f"{ACTION}/_action/cancel_goal", "action_msgs/srv/CancelGoal", SERVICES),
    ("SS", f"{NODE}/get_parameters", "rcl_interfaces/srv/GetParameters", PARAMETERS),
    ("SS", f"{NODE}/get_parameter_types", "rcl_interfaces/srv/GetParameterTypes", PARAMETERS),
    ("SS", f"{NODE}/set_parameters", "rcl_interfaces/srv/SetParameters", PARAMETERS),
    ("SS", f"{NODE}/set_parameters_atomically", "rcl_interfaces/srv/SetParametersAtomically", PARAMETERS),
    ("SS", f"{NODE}/describe_parameters", "rcl_interfaces/srv/DescribeParameters", PARAMETERS),
    ("SS", f"{NODE}/list_parameters", "rcl_interfaces/srv/ListParameters", PARAMETERS),
    ("SS", f"{NODE}/get_type_description", "type_description_interfaces/srv/GetTypeDescription", SERVICES),
    ("SS", f"{NODE}/get_state", "lifecycle_msgs/srv/GetState", SERVICES),
    ("SS", f"{NODE}/get_available_states", "lifecycle_msgs/srv/GetAvailableStates", SERVICES),
    ("SS", f"{NODE}/get_available_transitions", "lifecycle_msgs/srv/GetAvailableTransitions", SERVICES),
    ("SS", f"{NODE}/get_transition_graph", "lifecycle_msgs/srv/GetAvailableTransitions", SERVICES),
    ("SS", f"{NODE}/change_state", "lifecycle_msgs/srv/ChangeState", SERVICES),
    ("SS", f"{NODE}/stop", TRIGGER, SERVICES),
    ("SS", f"{NODE}/reset", TRIGGER, SERVICES),
    ("SS", f"{NODE}/enable", "std_srvs/srv/SetBool", SERVICES),
    ("SS", f"{NODE}/go_to/home", TRIGGER, SERVICES),
    ("SS", f"{NODE}/teach/start", TRIGGER, SERVICES),
    ("SS", f"{NODE}/teach/stop", TRIGGER, SERVICES),
    ("SS", f"{NODE}/teach/play", TRIGGER, SERVICES),
    ("SS", f"{CONTROLLER}/query_state", "control_msgs/srv/QueryTrajectoryState", SERVICES),
]


def mine(arm: Arm) -> list[Token]:
    return [token for token in arm.me.graph.tokens() if token.full_node == NODE]


def test_every_endpoint_is_there_with_its_type_and_quality(arm: Arm) -> None:
    for kind, name, type_name, qos in ENDPOINTS:
        token = arm.me.graph.one(kind=kind, topic=name, full_node=NODE)
        assert token.type == dds_name(type_name), (kind, name)
        assert token.hash == HASHES[type_name], (kind, name)
        if qos is None:
            assert token.qos.startswith("::,"), f"{kind} {name}: reliable and volatile"
            assert token.qos.endswith(":,:,:,,"), (kind, name)
        else:
            assert token.qos == qos, (kind, name)


def test_the_node_is_the_first_of_its_session_and_every_endpoint_belongs_to_it(arm: Arm) -> None:
    node = arm.me.graph.one(kind="NN", full_node=NODE)
    assert (node.domain, node.namespace, node.node, node.enclave) == (0, "/", "hardware_interface", "/")
    assert node.id == node.node_id == 0
    # They are canonical: others are not parsed.
    tokens = mine(arm)
    assert {(token.zid, token.node_id, token.enclave, token.namespace, token.domain) for token in tokens} == {
        (node.zid, 0, "/", "/", 0)
    }
    assert sorted(token.id for token in tokens) == list(range(len(tokens))), "one counter without gaps"
    assert len({token.gid for token in tokens}) == len(tokens)
    names = [(token.kind, token.topic, token.type) for token in tokens if token.kind != "NN"]
    assert sorted(set(names)) == sorted(names), "no endpoint is there twice"
    for _, topic, _ in names:
        assert topic.startswith("/")
        assert not topic.endswith("/")
        assert "//" not in topic
        assert "~" not in topic


def test_the_zid_is_that_of_the_session_of_the_node(arm: Arm) -> None:
    (zid,) = {token.zid for token in mine(arm)}
    # Zenoh's own form: hexadecimal, without leading zeros, at most 16 bytes.
    assert int(zid, 16) > 0
    assert zid == zid.lower().lstrip("0")
    assert len(zid) <= 32
    assert zid in {str(peer) for peer in arm.me.session.info.peers_zid()} | {
        str(r) for r in arm.me.session.info.routers_zid()
    }


def test_the_action_client_of_the_specification_finds_a_whole_server(arm: Arm) -> None:
    """`ros2 action list -t` takes an action's type from its feedback topic or its send_goal service."""
    ends = {(t.kind, t.topic.rpartition("/")[2]) for t in mine(arm) if t.topic.startswith(f"{ACTION}/_action/")}
    assert ends == {
        ("SS", "send_goal"),
        ("SS", "get_result"),
        ("SS", "cancel_goal"),
        ("MP", "feedback"),
        ("MP", "status"),
    }


def test_a_late_participant_sees_the_whole_graph_and_so_does_a_get(arm: Arm) -> None:
    texts = {token.text for token in mine(arm)}
    assert until(lambda: texts <= arm.me.graph.asked(), "a get of the tokens answers them all")
    with Participant(arm.port, "late") as late:
        until(lambda: texts <= set(late.graph.texts), "the graph is there")


def test_tokens_of_another_domain_are_not_here(arm: Arm) -> None:
    with Participant(arm.port, "elsewhere", domain=5) as elsewhere:

        def answered() -> set[str] | None:
            # Zenoh may lose a question.
            texts = elsewhere.graph.asked()
            return texts if elsewhere.node.text in texts else None

        texts = until(answered, "its own token is there")
        assert {Token.parse(text).full_node for text in texts} == {"/elsewhere"}


def test_nothing_comes_and_goes_while_nothing_happens(arm: Arm) -> None:
    arm.joint_states.take()
    # Not parsed: wrong tokens of other tests are gone, too.
    assert [text for text in arm.me.graph.gone if NODE[1:] in text] == []
