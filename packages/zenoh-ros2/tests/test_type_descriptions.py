from __future__ import annotations

from zenoh_ros2.type_descriptions import TYPE, make_answer
from zenoh_ros2.types import Types

TYPES = Types()
SERVICE = TYPES.service(TYPE)
STATE = TYPES.message("sensor_msgs/msg/JointState")
answer = make_answer(SERVICE.response, lambda: {STATE.hash: STATE})


def test_a_type_in_use_is_described() -> None:
    response = answer(SERVICE.request(type_name=STATE.name, type_hash=STATE.hash, include_type_sources=True))
    assert (response.successful, response.failure_reason) == (True, "")
    described = response.type_description
    assert described.type_description.type_name == "sensor_msgs/msg/JointState"
    assert {part.type_name for part in described.referenced_type_descriptions} == {
        "builtin_interfaces/msg/Time",
        "std_msgs/msg/Header",
    }
    assert response.type_sources[0].type_name == "sensor_msgs/msg/JointState"
    assert SERVICE.response.parse(SERVICE.response.serialize(response)) == response


def test_sources_can_be_left_out() -> None:
    response = answer(SERVICE.request(type_name=STATE.name, type_hash=STATE.hash, include_type_sources=False))
    assert (response.successful, response.type_sources) == (True, [])


def test_another_type_is_refused_with_the_words_of_rcl() -> None:
    unused = TYPES.message("std_msgs/msg/String")
    response = answer(SERVICE.request(type_name=unused.name, type_hash=unused.hash))
    assert (response.successful, response.failure_reason) == (False, "Type not currently in use by this node")
    response = answer(SERVICE.request(type_name=unused.name, type_hash="x"))
    assert (response.successful, response.failure_reason) == (False, "Failed to parse type hash")
