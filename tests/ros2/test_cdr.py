"""Bytes of messages."""

from __future__ import annotations

import struct
from array import array

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexwire.errors import LocalProtocolError, RemoteProtocolError
from hexwire.ros2.types import Types

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


@given(st.data())
def test_a_cut_message_is_refused(data: st.DataObject) -> None:
    whole = JOINT_STATE.serialize(JOINT_STATE(name=["a", "bc"], position=[1.0, 2.0], effort=[3.0]))
    end = data.draw(st.integers(0, len(whole) - 1))
    with pytest.raises(RemoteProtocolError):
        JOINT_STATE.parse(whole[:end])


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
