"""Services: stop, reset, enable, poses, teaching, query_state, type descriptions; several clients at once."""

from __future__ import annotations

import time

import pytest
from tests.ros2.strict_client.cdr import HEADER
from tests.ros2.strict_client.definitions import HASHES
from tests.ros2.strict_client.wire import Participant
from tests.ros2.strict_client.world import CONTROLLER, NODE, Arm

pytestmark = pytest.mark.system

TRIGGER = "std_srvs/srv/Trigger"
SETBOOL = "std_srvs/srv/SetBool"
DESCRIBE = "type_description_interfaces/srv/GetTypeDescription"
QUERY = "control_msgs/srv/QueryTrajectoryState"


# --- the wire of a service ---


def test_the_answer_echoes_sequence_and_gid(arm: Arm) -> None:
    client = arm.me.client(f"{NODE}/reset", TRIGGER)
    client.wait()
    for _ in range(3):
        client.send().received()  # checks both


def test_the_answer_has_a_time_of_its_own(arm: Arm) -> None:
    client = arm.me.client(f"{NODE}/reset", TRIGGER)
    client.wait()
    before = time.time_ns()
    received = client.send().received()
    assert before - 1_000_000 <= received.attachment.stamp <= time.time_ns() + 1_000_000


def test_any_sequence_number_comes_back(arm: Arm) -> None:
    client = arm.me.client(f"{NODE}/reset", TRIGGER)
    client.wait()
    client.sequence = 2**62
    client.send().received()


def test_two_equal_requests_get_two_answers(arm: Arm) -> None:
    client = arm.me.client(f"{NODE}/reset", TRIGGER)
    client.wait()
    for reply in [client.send() for _ in range(10)]:
        reply.received()


def test_an_empty_request_is_one_byte(arm: Arm) -> None:
    client = arm.me.client(f"{NODE}/reset", TRIGGER)
    client.wait()
    assert client.put(HEADER + b"\0").message().success


@pytest.mark.slow
def test_answers_are_never_crossed(arm: Arm) -> None:
    """Four participants with two clients each ask for different things at once; a service keeps 10 requests."""
    everyone = [Participant(arm.port, f"client{i}") for i in range(4)]
    try:
        asked = []
        for participant in everyone:
            for kind in ("sensor_msgs/msg/JointState", "rcl_interfaces/msg/Log"):
                client = participant.client(f"{NODE}/get_type_description", DESCRIBE)
                client.wait()
                asked.append((client, kind))
        replies = [
            (client.send(type_name=kind, type_hash=HASHES[kind], include_type_sources=False), kind)
            for client, kind in asked
        ]
        for reply, kind in replies:
            answer = reply.message()
            assert answer.successful, answer.failure_reason
            assert answer.type_description.type_description.type_name == kind
    finally:
        for participant in everyone:
            participant.close()


def test_the_same_sequence_of_two_clients_is_no_conflict(arm: Arm) -> None:
    with Participant(arm.port, "a") as a, Participant(arm.port, "b") as b:
        clients = [p.client(f"{NODE}/get_state", "lifecycle_msgs/srv/GetState") for p in (a, b)]
        for client in clients:
            client.wait()
        replies = [client.send() for client in clients]
        assert [reply.sequence for reply in replies] == [1, 1]
        for reply in replies:
            reply.received()


@pytest.mark.slow
def test_a_client_that_is_gone_disturbs_nobody(arm: Arm) -> None:
    gone = Participant(arm.port, "gone")
    client = gone.client(f"{NODE}/get_type_description", DESCRIBE)
    client.wait()
    for _ in range(5):
        client.send(type_name="sensor_msgs/msg/JointState", type_hash="", include_type_sources=True)
    gone.close()
    assert arm.trigger("reset").success


# --- stop, reset, enable ---


def test_stop_answers_success(arm: Arm) -> None:
    answer = arm.trigger("stop")
    assert answer.success, answer.message


@pytest.mark.slow
def test_stop_may_be_called_twice(arm: Arm) -> None:
    assert arm.trigger("stop").success
    assert arm.trigger("stop").success


def test_a_stop_is_latched(arm: Arm) -> None:
    arm.trigger("stop")
    sent = arm.send(arm.short_goal())
    if sent.accepted:
        assert sent.result().status == 6


def test_reset_ends_a_stop(arm: Arm) -> None:
    arm.trigger("stop")
    assert arm.trigger("reset").success
    assert arm.enable().success
    sent = arm.send(arm.short_goal())
    assert sent.accepted
    assert sent.result().status == 4


@pytest.mark.slow
def test_reset_without_a_stop_succeeds(arm: Arm) -> None:
    assert arm.trigger("reset").success


def test_enable_and_disable(arm: Arm) -> None:
    off = arm.enable(False)
    assert off.success, off.message
    sent = arm.send(arm.short_goal())
    assert not sent.accepted or sent.result().status == 6
    assert arm.enable(True).success


@pytest.mark.slow
def test_enabling_moves_nothing(arm: Arm) -> None:
    arm.enable(False)
    before = arm.positions()
    arm.enable(True)
    time.sleep(0.3)
    assert arm.positions() == pytest.approx(before, abs=0.03)


@pytest.mark.slow
def test_enabling_a_stopped_arm_is_refused_with_a_reason(arm: Arm) -> None:
    arm.trigger("stop")
    answer = arm.enable(True)
    assert not answer.success
    assert answer.message


# --- poses, teaching ---


@pytest.mark.slow
def test_going_to_a_pose_answers_on_arrival(arm: Arm) -> None:
    answer = arm.trigger("go_to/home")
    assert answer.success, answer.message
    at = arm.positions()
    assert at["J1"] == pytest.approx(-0.087, abs=0.06)
    assert at["J2"] == pytest.approx(0.96, abs=0.06)


@pytest.mark.slow
def test_a_pose_is_refused_while_stopped(arm: Arm) -> None:
    arm.trigger("stop")
    answer = arm.trigger("go_to/home")
    assert not answer.success
    assert answer.message


@pytest.mark.slow
def test_playing_without_a_motion_is_refused_or_plays(arm: Arm) -> None:
    answer = arm.trigger("teach/play")
    assert answer.success or answer.message


@pytest.mark.slow
def test_teaching_takes_and_gives_back_torque(arm: Arm) -> None:
    start = arm.trigger("teach/start")
    assert start.success, start.message
    refused = arm.send(arm.short_goal())
    assert not refused.accepted or refused.result().status == 6
    stop = arm.trigger("teach/stop")
    assert stop.success or "recorded" in stop.message, "nobody moved the arm, so there may be nothing"
    arm.rest()
    sent = arm.send(arm.short_goal())
    assert sent.accepted
    assert sent.result().status == 4


# --- query_state ---


def test_the_state_now_is_where_the_arm_holds(arm: Arm) -> None:
    answer = arm.service(f"{CONTROLLER}/query_state", QUERY).call()
    assert answer.success, answer.message
    assert answer.name == arm.names
    assert answer.position == pytest.approx(arm.near(), abs=0.1)
    assert len(answer.velocity) == len(answer.acceleration) == 7


# --- type descriptions ---


@pytest.mark.parametrize(
    "name", ["sensor_msgs/msg/JointState", "rcl_interfaces/msg/Log", "rcl_interfaces/msg/ParameterEvent"]
)
def test_a_type_is_described(arm: Arm, name: str) -> None:
    answer = arm.service(f"{NODE}/get_type_description", DESCRIBE).call(
        type_name=name, type_hash=HASHES[name], include_type_sources=True
    )
    assert answer.successful, answer.failure_reason
    described = answer.type_description.type_description
    assert described.type_name == name
    assert [field.name for field in described.fields] == [field for _, field in arm.me.definitions.fields[name]]


def test_the_description_has_every_type_that_it_needs(arm: Arm) -> None:
    name = "sensor_msgs/msg/JointState"
    answer = arm.service(f"{NODE}/get_type_description", DESCRIBE).call(type_name=name, type_hash=HASHES[name])
    others = [other.type_name for other in answer.type_description.referenced_type_descriptions]
    assert others == ["builtin_interfaces/msg/Time", "std_msgs/msg/Header"]


def test_the_description_has_the_ids_of_rep_2016(arm: Arm) -> None:
    name = "sensor_msgs/msg/JointState"
    answer = arm.service(f"{NODE}/get_type_description", DESCRIBE).call(type_name=name, type_hash=HASHES[name])
    kinds = {field.name: field.type for field in answer.type_description.type_description.fields}
    assert (kinds["header"].type_id, kinds["header"].nested_type_name) == (1, "std_msgs/msg/Header")
    assert kinds["name"].type_id == 161
    assert kinds["position"].type_id == 155


def test_sources_come_when_they_are_asked_for(arm: Arm) -> None:
    name = "sensor_msgs/msg/JointState"
    client = arm.service(f"{NODE}/get_type_description", DESCRIBE)
    without = client.call(type_name=name, type_hash=HASHES[name], include_type_sources=False)
    assert without.type_sources == []
    with_them = client.call(type_name=name, type_hash=HASHES[name], include_type_sources=True)
    sources = {source.type_name: source for source in with_them.type_sources}
    assert set(sources) == {name, "std_msgs/msg/Header", "builtin_interfaces/msg/Time"}
    assert "float64[] position" in sources[name].raw_file_contents
    assert sources[name].encoding == "msg"


def test_a_type_is_found_by_its_hash(arm: Arm) -> None:
    """rcl looks for the hash, whatever the name (rcl_node_type_description_service_handle_request)."""
    answer = arm.service(f"{NODE}/get_type_description", DESCRIBE).call(
        type_name="sensor_msgs/msg/JointState", type_hash=HASHES["rcl_interfaces/msg/Log"]
    )
    assert not answer.successful or answer.type_description.type_description.type_name == "rcl_interfaces/msg/Log"


@pytest.mark.parametrize("wrong", ["RIHS01_" + "0" * 64, "RIHS01_12", "RIHS02_" + "0" * 64, "", "x" * 5000])
def test_an_unknown_hash_is_refused(arm: Arm, wrong: str) -> None:
    answer = arm.service(f"{NODE}/get_type_description", DESCRIBE).call(
        type_name="sensor_msgs/msg/JointState", type_hash=wrong
    )
    assert not answer.successful
    assert answer.failure_reason
    assert answer.type_description.type_description.type_name == ""
