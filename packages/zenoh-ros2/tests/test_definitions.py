"""Definitions of messages, services and actions."""

from __future__ import annotations

from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from zenoh_ros2.definitions import (
    Constant,
    Field,
    FieldType,
    Kind,
    parse_action,
    parse_message,
    parse_service,
)
from zenoh_ros2.errors import UsageError

NAME = "robot_msgs/msg/Arm"


def _field(line: str) -> Field:
    (field,) = parse_message(NAME, line).fields
    return field


@pytest.mark.parametrize(
    ("line", "type_"),
    [
        ("float64 x", FieldType("float64")),
        ("float64[] x", FieldType("float64", Kind.SEQUENCE)),
        ("uint8[16] x", FieldType("uint8", Kind.ARRAY, 16)),
        ("int32[<=5] x", FieldType("int32", Kind.BOUNDED, 5)),
        ("string<=255 x", FieldType("string", bound=255)),
        ("string<=10[<=3] x", FieldType("string", Kind.BOUNDED, 3, 10)),
        ("std_msgs/Header x", FieldType("std_msgs/msg/Header")),
        ("std_msgs/msg/Header x", FieldType("std_msgs/msg/Header")),
        ("Tolerance[] x", FieldType("robot_msgs/msg/Tolerance", Kind.SEQUENCE)),
    ],
)
def test_a_type_is_parsed(line: str, type_: FieldType) -> None:
    assert _field(line) == Field("x", type_)


@pytest.mark.parametrize(
    ("line", "value"),
    [
        ("float64 w 1", 1.0),
        ("bool on true", True),
        ("bool on 0", False),
        ("int8 x -128", -128),
        ("uint8 x 0x10", 16),
        ('string s "a # b"', "a # b"),
        ("string s 'it\\'s'", "it's"),
        ("int32[] x [1, 2,-3]", (1, 2, -3)),
        ("int32[<=2] x []", ()),
        ('string[] s ["a, b", c]', ("a, b", "c")),
    ],
)
def test_a_default_value_is_parsed(line: str, value: object) -> None:
    default = _field(line).default
    assert (default, type(default)) == (value, type(value))


def test_constants_and_comments_are_told_from_fields() -> None:
    text = "# about\nint32 INVALID_JOINTS = -2 # why\nstring NAME='a = b'\nint32 error_code\n\n"
    found = parse_message(NAME, text)
    assert found.constants == (Constant("INVALID_JOINTS", "int32", -2), Constant("NAME", "string", "a = b"))
    assert [field.name for field in found.fields] == ["error_code"]
    assert found.text == text


@pytest.mark.parametrize(
    ("line", "why"),
    [
        ("float64", "neither a field nor a constant"),
        ("float64 X", "not the name of a field"),
        ("float64 a__b", "not the name of a field"),
        ("float64 from", "has a meaning in Python"),
        ("int32 x=1", "not the name of a constant"),
        ("int32[] X=1", "a constant cannot be"),
        ("uint8 X=256", "256 is not a uint8"),
        ("int8 x -129", "-129 is not a int8"),
        ("bool x maybe", "neither true nor false"),
        ("float64 x one", "could not convert"),
        ("int32[2] x [1]", "there must be 2"),
        ("int32[<=1] x [1, 2]", "there may be 1"),
        ("int32[] x 1", "list in brackets"),
        ("int32[0] x", "from 1 to"),
        ("string<=0 x", "from 1 to"),
        ("string<=3 x 'abcd'", "longer than 3 bytes"),
        ("int32<=3 x", "only a string has a bound"),
        ("int32[<=] x", "lacks its greatest size"),
        ("wstring x", "wstring is not supported"),
        ("double x", "is not a type"),
        ("a/b/c/D x", "is not a type"),
        ("std_msgs/Header x 1", "has no default value"),
    ],
)
def test_a_wrong_line_is_named(line: str, why: str) -> None:
    with pytest.raises(UsageError, match=why) as caught:
        parse_message(NAME, f"int8 first\n{line}")
    assert "line 2" in str(caught.value)


def test_a_name_twice_is_refused() -> None:
    with pytest.raises(UsageError, match="line 2: x exists already"):
        parse_message(NAME, "int8 x\nint16 x")


def test_a_message_needs_a_full_name() -> None:
    with pytest.raises(UsageError, match="not the name of a ROS 2 message"):
        parse_message("Arm", "int8 x")


def test_a_service_has_request_response_and_event() -> None:
    service = parse_service("robot_msgs/srv/Go", "string pose\n---\nbool success\n")
    assert service.request.name == "robot_msgs/srv/Go_Request"
    assert [field.name for field in service.response.fields] == ["success"]
    info, request, response = service.event.fields
    assert info.type.base == "service_msgs/msg/ServiceEventInfo"
    assert request.type == FieldType("robot_msgs/srv/Go_Request", Kind.BOUNDED, 1)
    assert response.type == FieldType("robot_msgs/srv/Go_Response", Kind.BOUNDED, 1)


def test_an_action_has_what_ros_derives_from_it() -> None:
    action = parse_action("robot_msgs/action/Go", "int32 a\n---\nint32 b\n---\nint32 c\n")
    assert [(field.name, field.type.base) for field in action.send_goal.request.fields] == [
        ("goal_id", "unique_identifier_msgs/msg/UUID"),
        ("goal", "robot_msgs/action/Go_Goal"),
    ]
    assert [(field.name, field.type.base) for field in action.send_goal.response.fields] == [
        ("accepted", "bool"),
        ("stamp", "builtin_interfaces/msg/Time"),
    ]
    assert [field.name for field in action.get_result.request.fields] == ["goal_id"]
    assert [(field.name, field.type.base) for field in action.get_result.response.fields] == [
        ("status", "int8"),
        ("result", "robot_msgs/action/Go_Result"),
    ]
    assert action.feedback_message.name == "robot_msgs/action/Go_FeedbackMessage"
    assert [field.type.base for field in action.feedback_message.fields][1] == "robot_msgs/action/Go_Feedback"


@pytest.mark.parametrize("text", ["int8 x", "int8 x\n---\nint8 y\n---\nint8 z"])
def test_a_service_has_two_parts(text: str) -> None:
    with pytest.raises(UsageError, match="there must be 2"):
        parse_service("robot_msgs/srv/Go", text)


_LETTERS = st.sampled_from([*"aAzZ_019 \t\n#='\"\\[]<=/.-", "int32", "string", "float64", "[<=", "---\n"])


@given(st.lists(_LETTERS, max_size=60).map("".join))
def test_any_text_is_a_definition_or_a_usage_error(text: str) -> None:
    for parse, name in ((parse_message, NAME), (parse_service, "a/srv/B"), (parse_action, "a/action/B")):
        with suppress(UsageError):
            parse(name, text)
