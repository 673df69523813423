"""Services: how they answer, what each does, and type descriptions.

What they do with the arm is decided and tested in `control`.
"""

from __future__ import annotations

import time

import pytest
from tests.ros2.strict_client.action import ABORTED, SUCCEEDED
from tests.ros2.strict_client.cdr import HEADER
from tests.ros2.strict_client.definitions import HASHES
from tests.ros2.strict_client.wire import Participant
from tests.ros2.strict_client.world import CONTROLLER, NODE, Arm

pytestmark = pytest.mark.system

TRIGGER = "std_srvs/srv/Trigger"
DESCRIBE = "type_description_interfaces/srv/GetTypeDescription"
QUERY = "control_msgs/srv/QueryTrajectoryState"
STATE = "sensor_msgs/msg/JointState"


# --- the wire of a service ---


def test_each_request_has_one_answer_with_its_number_its_gid_and_a_time_of_its_own(arm: Arm) -> None:
    client = arm.me.client(f"{NODE}/reset", TRIGGER)
    client.wait()
    before = time.time_ns()
    # `received` looks at number and gid; equal requests at once are several.
    for reply in [client.send() for _ in range(10)]:
        stamp = reply.received().attachment.stamp
        assert before - 1_000_000 <= stamp <= time.time_ns() + 1_000_000
    client.sequence = 2**62
    client.send().received()
    assert client.put(HEADER + b"\0").message().success, "a request without fields is one byte"


def test_the_same_sequence_of_two_clients_is_no_conflict(arm: Arm) -> None:
    with Participant(arm.port, "a") as a, Participant(arm.port, "b") as b:
        clients = [p.client(f"{NODE}/get_state", "lifecycle_msgs/srv/GetState") for p in (a, b)]
        for client in clients:
            client.wait()
        replies = [client.send() for client in clients]
        assert [reply.sequence for reply in replies] == [1, 1]
        for reply in replies:
            reply.received()


# --- the arm ---


def test_a_stop_is_latched_until_the_reset_and_refusals_have_a_reason(arm: Arm) -> None:
    answer = arm.trigger("stop")
    assert answer.success, answer.message
    assert not arm.send(arm.short_goal()).accepted
    for refused in (arm.enable(True), arm.trigger("go_to/home")):
        assert not refused.success
        assert refused.message
    assert arm.trigger("reset").success
    assert arm.enable().success
    sent = arm.send(arm.short_goal())
    assert sent.accepted
    assert sent.result().status == SUCCEEDED


def test_enable_and_disable(arm: Arm) -> None:
    off = arm.enable(False)
    assert off.success, off.message
    sent = arm.send(arm.short_goal())
    assert not sent.accepted or sent.result().status == ABORTED
    assert arm.enable(True).success


def test_the_state_now_is_where_the_arm_holds(arm: Arm) -> None:
    answer = arm.service(f"{CONTROLLER}/query_state", QUERY).call()
    assert answer.success, answer.message
    assert answer.name == arm.names
    assert answer.position == pytest.approx(arm.near(), abs=0.1)
    assert len(answer.velocity) == len(answer.acceleration) == 7


# --- type descriptions ---


def test_types_are_described(arm: Arm) -> None:
    client = arm.service(f"{NODE}/get_type_description", DESCRIBE)
    for name in (STATE, "rcl_interfaces/msg/Log", "rcl_interfaces/msg/ParameterEvent"):
        answer = client.call(type_name=name, type_hash=HASHES[name], include_type_sources=True)
        assert answer.successful, f"{name}: {answer.failure_reason}"
        described = answer.type_description.type_description
        assert described.type_name == name
        wanted = [field for _, field in arm.me.definitions.fields[name]]
        assert [field.name for field in described.fields] == wanted, name


def test_a_description_has_every_type_that_it_needs_the_ids_of_rep_2016_and_sources_on_demand(arm: Arm) -> None:
    client = arm.service(f"{NODE}/get_type_description", DESCRIBE)
    without = client.call(type_name=STATE, type_hash=HASHES[STATE], include_type_sources=False)
    assert without.type_sources == []
    others = [other.type_name for other in without.type_description.referenced_type_descriptions]
    assert others == ["builtin_interfaces/msg/Time", "std_msgs/msg/Header"]
    kinds = {field.name: field.type for field in without.type_description.type_description.fields}
    assert (kinds["header"].type_id, kinds["header"].nested_type_name) == (1, "std_msgs/msg/Header")
    assert (kinds["name"].type_id, kinds["position"].type_id) == (161, 155)
    with_them = client.call(type_name=STATE, type_hash=HASHES[STATE], include_type_sources=True)
    sources = {source.type_name: source for source in with_them.type_sources}
    assert set(sources) == {STATE, *others}
    assert "float64[] position" in sources[STATE].raw_file_contents
    assert sources[STATE].encoding == "msg"


def test_a_type_is_found_by_its_hash(arm: Arm) -> None:
    """rcl looks for the hash, whatever the name (rcl_node_type_description_service_handle_request)."""
    client = arm.service(f"{NODE}/get_type_description", DESCRIBE)
    answer = client.call(type_name=STATE, type_hash=HASHES["rcl_interfaces/msg/Log"])
    assert not answer.successful or answer.type_description.type_description.type_name == "rcl_interfaces/msg/Log"
    for wrong in ("RIHS01_" + "0" * 64, "RIHS01_12", "RIHS02_" + "0" * 64, "", "x" * 5000):
        answer = client.call(type_name=STATE, type_hash=wrong)
        assert not answer.successful, wrong
        assert answer.failure_reason
        assert answer.type_description.type_description.type_name == ""
