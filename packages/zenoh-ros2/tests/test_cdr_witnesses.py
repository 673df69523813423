"""Bytes of messages, compared with two implementations of other authors: rosbags, and Foxglove's in JavaScript."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from hypothesis import given, note, settings
from hypothesis import strategies as st
from zenoh_ros2_tests.foxglove import Foxglove
from zenoh_ros2_tests.messages import ASCII, NAMES, Rosbags, messages, messages_of

from zenoh_ros2.types import MessageType, Types

TYPES = Types()
ROSBAGS = Rosbags(TYPES)
# Those of topics: Foxglove's definitions cannot name messages of services and actions.
SHOWN = [
    "sensor_msgs/msg/JointState",
    "trajectory_msgs/msg/JointTrajectory",
    "control_msgs/msg/JointTrajectoryControllerState",
    "control_msgs/msg/DynamicJointState",
    "diagnostic_msgs/msg/DiagnosticArray",
    "tf2_msgs/msg/TFMessage",
    "rcl_interfaces/msg/Log",
    "rcl_interfaces/msg/ParameterEvent",
    "action_msgs/msg/GoalStatusArray",
    "sensor_msgs/msg/Imu",
    "std_msgs/msg/String",
]


def _check_rosbags(type_: MessageType, message: Any) -> None:
    data = type_.serialize(message)
    assert ROSBAGS.serialize(type_.name, message) == data
    assert ROSBAGS.parse(type_.name, data) == message
    assert type_.parse(ROSBAGS.serialize(type_.name, message, little=False)) == message


@settings(max_examples=5)
@given(data=st.data())
def _check_type(name: str, data: st.DataObject) -> None:
    note(name)
    for type_ in messages_of(TYPES, name):
        _check_rosbags(type_, data.draw(messages(TYPES, type_)))


@pytest.mark.slow
def test_rosbags_has_the_same_bytes_for_every_type() -> None:
    for name in NAMES:
        _check_type(name)


@given(messages(TYPES, TYPES.message("sensor_msgs/msg/JointState")))
def test_rosbags_has_the_same_bytes_for_joint_states(message: Any) -> None:
    _check_rosbags(TYPES.message("sensor_msgs/msg/JointState"), message)


@pytest.fixture(scope="module")
def foxglove() -> Iterator[Foxglove]:
    with Foxglove() as running:
        yield running


@pytest.mark.slow
@pytest.mark.parametrize("name", SHOWN)
@given(data=st.data())
def test_foxglove_has_the_same_bytes(foxglove: Foxglove, name: str, data: st.DataObject) -> None:
    type_ = TYPES.message(name)
    # It computes the size of other text wrongly when it serializes.
    expected = type_.serialize(data.draw(messages(TYPES, type_, ASCII)))
    _, again = foxglove.parse(type_.text, expected)
    assert again == expected


def test_foxglove_reads_the_values(foxglove: Foxglove) -> None:
    type_ = TYPES.message("sensor_msgs/msg/JointState")
    message = type_(name=["J1", "Schulter-ä"], position=[0.25, -1.5], effort=[2.0])
    message.header.stamp.sec = 3
    message.header.frame_id = "base_link"
    found, _ = foxglove.parse(type_.text, type_.serialize(message))
    assert found == {
        "header": {"stamp": {"sec": 3, "nanosec": 0}, "frame_id": "base_link"},
        "name": ["J1", "Schulter-ä"],
        "position": [0.25, -1.5],
        "velocity": [],
        "effort": [2.0],
    }
