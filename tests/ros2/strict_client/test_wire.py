"""The strict client itself: what it takes and what it refuses, against bytes and texts of others."""

from __future__ import annotations

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore
from tests.ros2.strict_client.cdr import HEADER, Cdr, WrongBytesError
from tests.ros2.strict_client.definitions import HASHES, NEW_HASHES, Definitions, dds_name
from tests.ros2.strict_client.wire import Attachment, Token, WrongTokenError, canonical_qos
from zenoh import ext

CDR = Cdr(Definitions("jazzy"))
STORE = get_typestore(Stores.ROS2_JAZZY)
# The example of the design document, with today's id and QoS forms.
TOKEN = (
    "@ros2_lv/0/aac3178e146ba6f1fc6e6a4085e77f21/0/10/MP/%/%/talker/%chatter/"
    "std_msgs::msg::dds_::String_/RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18/::,7:,:,:,,"
)


def test_a_token_is_its_text_again() -> None:
    token = Token.parse(TOKEN)
    assert token.text == TOKEN
    assert (token.topic, token.enclave, token.full_node, token.id) == ("/chatter", "/", "/talker", 10)


def test_a_key_has_no_slash_at_its_start() -> None:
    assert Token.parse(TOKEN).key.startswith("0/chatter/std_msgs::msg::dds_::String_/RIHS01_df66")


@pytest.mark.parametrize(
    "wrong",
    [
        TOKEN.replace("@ros2_lv", "@ros2"),
        TOKEN.replace("/MP/", "/NN/"),
        TOKEN.replace("/MP/", "/XX/"),
        TOKEN.replace("::,7:", "1::,7:"),
        TOKEN.replace("::,7:", ":2:,7:"),
        TOKEN.replace("::,7:", "::1,7:"),
        TOKEN.replace("::,7:", "::,42:"),
        TOKEN.replace("::,7:,:,:,,", "::,7:,:,:,"),
        TOKEN.replace("::,7:", "::,07:"),
        TOKEN.replace("/%/%/", "/%//"),
        TOKEN.rpartition("/")[0],
    ],
)
def test_a_token_that_a_peer_would_write_otherwise_is_refused(wrong: str) -> None:
    with pytest.raises((WrongTokenError, ValueError)):
        Token.parse(wrong)


def test_a_default_of_the_qos_is_left_empty() -> None:
    lifespan, lease = "9223372036,854775807", "1,9223372036,854775807"
    assert canonical_qos(f"1:2:1,42:{lifespan}:{lifespan}:{lease}") == "::,:,:,:,,"
    assert canonical_qos("2:1:2,5:1,2:3,0:2,4,5") == "2:1:2,5:1,2:3,0:2,4,5"


def test_an_attachment_is_what_zenoh_serializes() -> None:
    made = Attachment(7, 1234, bytes(range(16)))
    zenohs = bytes(ext.z_serialize((ext.Int64(7), ext.Int64(1234), bytes(range(16)))))
    assert made.serialize() == zenohs
    assert Attachment.of(zenohs) == made


@pytest.mark.parametrize("wrong", [None, b"", bytes(32), bytes(33), bytes(34)])
def test_another_attachment_is_refused(wrong: bytes | None) -> None:
    with pytest.raises(AssertionError):
        Attachment.of(wrong)


@pytest.mark.parametrize("name", sorted(name for name in HASHES if name in STORE.types))
def test_the_hash_of_a_message_is_that_of_rosbags(name: str) -> None:
    assert STORE.hash_rihs01(name) == HASHES[name]


def test_new_hashes_differ() -> None:
    assert all(HASHES[name] != made for name, made in NEW_HASHES.items())
    assert len(set(HASHES.values())) == len(HASHES)


def test_humble_has_no_hash() -> None:
    assert Definitions("humble").hash("std_msgs/msg/String") == "TypeHashNotSupported"


def test_names_are_those_of_dds() -> None:
    assert dds_name("control_msgs/action/FollowJointTrajectory_SendGoal") == (
        "control_msgs::action::dds_::FollowJointTrajectory_SendGoal_"
    )


def test_bytes_are_those_of_rosbags() -> None:
    types = STORE.types
    state = types["sensor_msgs/msg/JointState"](
        header=types["std_msgs/msg/Header"](stamp=types["builtin_interfaces/msg/Time"](5, 6), frame_id="odd"),
        name=["a", "long"],
        position=np.array([1.0, -2.5]),
        velocity=np.array([]),
        effort=np.array([3.0]),
    )
    fields = {
        "header": {"stamp": {"sec": 5, "nanosec": 6}, "frame_id": "odd"},
        "name": ["a", "long"],
        "position": [1.0, -2.5],
        "effort": [3.0],
    }
    theirs = bytes(STORE.serialize_cdr(state, "sensor_msgs/msg/JointState"))
    ours = CDR.serialize("sensor_msgs/msg/JointState", fields)
    # rosbags fills up to four bytes; Fast CDR cuts at the end of the last field.
    assert ours == theirs[: len(ours)]
    read = CDR.parse("sensor_msgs/msg/JointState", ours)
    assert (read.name, read.position, read.velocity, read.header.frame_id) == (
        ["a", "long"],
        [1.0, -2.5],
        [],
        "odd",
    )


def test_an_empty_request_has_one_byte() -> None:
    assert CDR.serialize("std_srvs/srv/Trigger_Request", {}) == HEADER + b"\0"
    assert vars(CDR.parse("std_srvs/srv/Trigger_Request", HEADER + b"\0")) == {}


@pytest.mark.parametrize(
    "wrong",
    [
        b"",
        HEADER,
        b"\0\0\0\0\2\0\0\0a\0",  # big-endian header
        HEADER + b"\2\0\0\0ab",  # no zero at the end
        HEADER + b"\2\0\0\0a\0\0",  # a byte too many
        HEADER + b"\xff\xff\xff\xffa\0",  # longer than the message
        HEADER + b"\0\0\0\0",  # a string without even its zero
    ],
)
def test_other_bytes_are_refused(wrong: bytes) -> None:
    with pytest.raises(WrongBytesError):
        CDR.parse("std_msgs/msg/String", wrong)


def test_a_bool_is_0_or_1() -> None:
    with pytest.raises(WrongBytesError):
        CDR.parse("std_srvs/srv/SetBool_Request", HEADER + b"\2")
