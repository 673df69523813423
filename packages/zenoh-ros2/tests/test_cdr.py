"""Bytes of messages."""

from __future__ import annotations

import struct
import tracemalloc
from array import array
from contextlib import suppress

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from zenoh_ros2_tests.messages import Rosbags, messages, with_type

from zenoh_ros2.cdr import MOST_BYTES
from zenoh_ros2.errors import LocalProtocolError, RemoteProtocolError
from zenoh_ros2.types import Types

TYPES = Types()
JOINT_STATE = TYPES.message("sensor_msgs/msg/JointState")


def test_a_joint_state_has_known_bytes() -> None:
    message = JOINT_STATE(name=["J1", "J10"], position=[0.5, -1.0])
    message.header.stamp.sec = 1
    message.header.stamp.nanosec = 2
    message.header.frame_id = "base"
    expected = (
        b"\x00\x01\x00\x00"
        + struct.pack("<iiI", 1, 2, 5)
        + b"base\0\0\0\0"
        + struct.pack("<II", 2, 3)
        + b"J1\0\0"
        + struct.pack("<I", 4)
        + b"J10\0"
        # The length is at offset 40, the first value at the next multiple of eight.
        + struct.pack("<I4xdd", 2, 0.5, -1.0)
        + struct.pack("<II", 0, 0)
    )
    assert JOINT_STATE.serialize(message) == expected
    assert JOINT_STATE.parse(expected) == message


@given(st.integers(0, 9), st.integers(0, 70))
def test_numbers_are_aligned_from_the_end_of_the_header(letters: int, count: int) -> None:
    message = JOINT_STATE(name=["x" * letters], position=[float(i) for i in range(count)])
    data = JOINT_STATE.serialize(message)
    if count > 1:
        assert (data.index(struct.pack("<d", 1.0)) - 4) % 8 == 0
    assert JOINT_STATE.parse(data) == message


def test_any_sequence_of_numbers_is_serialized() -> None:
    values = [0.25, 1.5]
    expected = JOINT_STATE.serialize(JOINT_STATE(position=values))
    for form in (tuple(values), array("d", values)):
        assert JOINT_STATE.serialize(JOINT_STATE(position=form)) == expected


def test_the_bytes_of_a_peer_may_be_big_endian() -> None:
    duration = TYPES.message("builtin_interfaces/msg/Duration")
    assert duration.parse(b"\x00\x00\x00\x00" + struct.pack(">iI", -3, 4)) == duration(sec=-3, nanosec=4)


def test_a_message_without_fields_is_one_byte() -> None:
    request = TYPES.service("std_srvs/srv/Trigger").request
    assert request.serialize(request()) == b"\x00\x01\x00\x00\x00"
    assert request.parse(b"\x00\x01\x00\x00\x00") == request.parse(b"\x00\x01\x00\x00") == request()


EVERY_KIND = "test_msgs/msg/EveryKind"
EVERYTHING = with_type(
    EVERY_KIND,
    """
    byte one
    float64 number
    string<=3 short
    bool[] flags
    int8[] counts
    char[4] octets
    uint8[<=3] some_octets
    float32[2] pair
    uint64[] large
    float64[<=3] few_floats
    int16[3] odd
    string[2] texts
    string<=3[<=2] few_names
    std_msgs/Header[2] headers
    geometry_msgs/Pose[<=2] poses
    std_msgs/Empty[] nothings
    int64 last
    """,
)
ROSBAGS = Rosbags(EVERYTHING)
# Types with several kinds of fields; a peer sends most of them to a node.
RECEIVED = [
    "sensor_msgs/msg/JointState",
    "trajectory_msgs/msg/JointTrajectory",
    "control_msgs/action/FollowJointTrajectory_SendGoal_Request",
    "control_msgs/action/FollowJointTrajectory_FeedbackMessage",
    "action_msgs/srv/CancelGoal_Request",
    "rcl_interfaces/srv/SetParameters_Request",
    "rcl_interfaces/srv/DescribeParameters_Response",
    "type_description_interfaces/msg/TypeDescription",
    "diagnostic_msgs/msg/DiagnosticArray",
    "sensor_msgs/msg/Imu",
]


# All types share the examples, which are as many as three types would have.
MANY = settings(max_examples=3 * settings().max_examples)
NAMES = st.sampled_from(RECEIVED)


@MANY
@given(st.data())
def test_every_message_comes_back_and_a_cut_or_changed_one_is_refused_or_a_message(data: st.DataObject) -> None:
    type_ = TYPES.message(data.draw(NAMES))
    message = data.draw(messages(TYPES, type_))
    whole = type_.serialize(message)
    assert type_.parse(whole) == message
    end = data.draw(st.integers(0, len(whole) - 1))
    with pytest.raises(RemoteProtocolError):
        type_.parse(whole[:end])
    changed = bytearray(whole)
    for _ in range(data.draw(st.integers(1, 4))):
        start = data.draw(st.integers(0, len(changed) - 1))
        changed[start : start + 4] = data.draw(st.sampled_from([b"\xff" * 4, b"\0\0\0\x7f", b"\1\0\0\0", b"\0"]))
    with suppress(RemoteProtocolError):
        type_.parse(bytes(changed))


@MANY
@given(NAMES, st.binary(max_size=400), st.sampled_from([b"", b"\0\0\0\0", b"\0\1\0\0"]))
def test_noise_is_a_message_or_a_protocol_error(name: str, noise: bytes, header: bytes) -> None:
    with suppress(RemoteProtocolError):
        TYPES.message(name).parse(header + noise)


def test_no_length_costs_more_memory_than_the_message_has_bytes() -> None:
    zeros = bytes(400)
    for name in RECEIVED:
        type_ = TYPES.message(name)
        type_.message_class()
        with suppress(RemoteProtocolError):
            type_.parse(b"\0\1\0\0" + zeros)
        for length in (0xFFFFFFFF, 0x7FFFFFFF, 0x00FFFFFF):
            tracemalloc.start()
            try:
                for start in range(0, 400, 4):
                    data = bytearray(b"\0\1\0\0" + zeros)
                    data[4 + start : 8 + start] = struct.pack("<I", length)
                    with suppress(RemoteProtocolError):
                        type_.parse(bytes(data))
                most = tracemalloc.get_traced_memory()[1]
            finally:
                tracemalloc.stop()
            assert most < 200_000, f"{name} takes {most} bytes for a length of {length:#x}"


def test_a_message_that_is_too_large_is_refused() -> None:
    with pytest.raises(RemoteProtocolError, match="at most"):
        TYPES.message("std_msgs/msg/String").parse(bytes(MOST_BYTES + 1))


@pytest.mark.parametrize("header", [b"\0\2\0\0", b"\0\7\0\1", b"\1\1\0\0"])
def test_another_encoding_is_refused(header: bytes) -> None:
    with pytest.raises(RemoteProtocolError, match="is not the header of CDR"):
        JOINT_STATE.parse(header + bytes(40))


def test_bytes_after_a_message_are_padding_or_refused() -> None:
    data = JOINT_STATE.serialize(JOINT_STATE())
    assert JOINT_STATE.parse(data + bytes(3)) == JOINT_STATE()
    with pytest.raises(RemoteProtocolError, match="4 bytes after the end"):
        JOINT_STATE.parse(data + bytes(4))


@pytest.mark.parametrize(
    ("name", "before", "what"),
    [
        ("std_msgs/msg/UInt8MultiArray", 8, "data: 9 values"),
        ("std_msgs/msg/Int16MultiArray", 8, "data: 9 values"),
        ("std_msgs/msg/Float64MultiArray", 8, "data: 9 values"),
        ("rcl_interfaces/msg/ListParametersResult", 4, "prefixes: 9 strings"),
        ("action_msgs/msg/GoalStatusArray", 0, "status_list: 9 values"),
    ],
)
def test_a_sequence_that_does_not_fit_is_named(name: str, before: int, what: str) -> None:
    data = b"\0\1\0\0" + bytes(before) + struct.pack("<I", 9) + b"\1" * 8
    with pytest.raises(RemoteProtocolError, match=f"{what} do not fit"):
        TYPES.message(name).parse(data)


@pytest.mark.parametrize("little", [True, False])
@given(data=st.data())
def test_every_kind_of_field_comes_back_as_rosbags_has_it(little: bool, data: st.DataObject) -> None:
    type_ = EVERYTHING.message(EVERY_KIND)
    message = data.draw(messages(EVERYTHING, type_))
    expected = ROSBAGS.serialize(EVERY_KIND, message, little=little)
    assert type_.parse(expected) == message
    if little:
        assert type_.serialize(message) == expected


@given(st.data())
def test_noise_in_every_kind_of_field_is_a_message_or_a_protocol_error(data: st.DataObject) -> None:
    type_ = EVERYTHING.message(EVERY_KIND)
    changed = bytearray(type_.serialize(data.draw(messages(EVERYTHING, type_))))
    start = data.draw(st.integers(0, len(changed) - 1))
    changed[start : start + 4] = data.draw(st.binary(min_size=4, max_size=4))
    with suppress(RemoteProtocolError):
        type_.parse(bytes(changed))


@pytest.mark.parametrize(
    ("field", "values"),
    [
        ("few_floats", [0.5] * 4),
        ("few_names", ["a"] * 3),
        ("few_names", ["abcd"]),
        ("short", "éé"),
        ("octets", b"12345"),
        ("some_octets", b"1234"),
        ("pair", [1.0]),
        ("texts", ["a", "b", "c"]),
        ("headers", []),
        ("flags", [True, 2]),
        ("counts", [1, 200]),
    ],
)
def test_more_than_a_bound_is_not_sent(field: str, values: object) -> None:
    type_ = EVERYTHING.message(EVERY_KIND)
    with pytest.raises(LocalProtocolError, match=rf"\.{field}"):
        type_.serialize(type_(**{field: values}))


def test_a_bounded_string_in_a_sequence_is_no_longer_than_its_bound() -> None:
    types = with_type("test_msgs/msg/Names", "string<=3[] names")
    type_ = types.message("test_msgs/msg/Names")
    assert type_.parse(type_.serialize(type_(names=["abc"]))).names == ["abc"]
    with pytest.raises(RemoteProtocolError, match="longer than 3 bytes"):
        type_.parse(b"\0\1\0\0" + struct.pack("<II", 1, 5) + b"abcd\0")


@pytest.mark.parametrize(("lists", "letters", "most"), [(100, 50_000, 1_000_000), (10_000, 8, 200_000)])
def test_neither_long_names_nor_many_lists_of_names_are_kept(lists: int, letters: int, most: int) -> None:
    message = JOINT_STATE(name=["x"])
    JOINT_STATE.serialize(message)
    tracemalloc.start()
    try:
        for i in range(lists):
            message.name = [f"{i}" * letters]
            JOINT_STATE.parse(JOINT_STATE.serialize(message))
        assert tracemalloc.get_traced_memory()[0] < most
    finally:
        tracemalloc.stop()


def test_bounds_are_kept() -> None:
    ranges = TYPES.message("rcl_interfaces/msg/ParameterDescriptor")
    data = bytearray(ranges.serialize(ranges(name="", type=0)))
    data[-4:] = struct.pack("<I", 2)
    with pytest.raises(RemoteProtocolError, match="integer_range: 2 values, at most 1"):
        ranges.parse(bytes(data) + bytes(48))
    field = TYPES.message("type_description_interfaces/msg/FieldType")
    with pytest.raises(RemoteProtocolError, match="longer than 255 bytes"):
        field.parse(b"\0\1\0\0" + bytes(24) + struct.pack("<I", 257) + b"x" * 256 + b"\0")
    longest = field(nested_type_name="x" * 255)
    assert field.parse(field.serialize(longest)) == longest


def test_a_string_needs_its_end_and_need_not_be_utf8() -> None:
    string = TYPES.message("std_msgs/msg/String")
    with pytest.raises(RemoteProtocolError, match="without its end"):
        string.parse(b"\0\1\0\0" + struct.pack("<I", 2) + b"ab")
    assert string.parse(b"\0\1\0\0" + struct.pack("<I", 2) + b"\xff\0").data == "\ufffd"
    # Some encoders send an empty string as no bytes at all.
    assert string.parse(b"\0\1\0\0" + bytes(4)).data == ""


def test_names_that_change_are_not_taken_from_the_message_before() -> None:
    for names in (["a", "bc"], ["a", "bd"], ["a"], [], ["a", "bc"], ["a" * 5000]):
        message = JOINT_STATE(name=names)
        first, second = (JOINT_STATE.parse(JOINT_STATE.serialize(message)) for _ in range(2))
        assert first.name == second.name == names
        first.name.append("x")
        second.name.append("y")
        assert JOINT_STATE.parse(JOINT_STATE.serialize(message)).name == names


@pytest.mark.parametrize(
    ("field", "value", "why"),
    [
        ("position", [1.0, "x"], r"\.position\[1\]: 'x' is not a float64"),
        ("name", "J1", r"\.name: 'J1' is not a sequence"),
        ("name", ["a", 1], r"\.name\[1\]: 1 is not a string"),
        ("header", 5, r"\.header\.stamp: a int has no such field"),
        ("effort", None, r"\.effort: None is not a sequence"),
    ],
)
def test_an_unsuitable_value_is_named(field: str, value: object, why: str) -> None:
    message = JOINT_STATE()
    setattr(message, field, value)
    with pytest.raises(LocalProtocolError, match=why):
        JOINT_STATE.serialize(message)
