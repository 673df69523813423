"""Definitions of ROS 2 messages, services and actions, as in .msg, .srv and .action files.

Owns the syntax of such a file, and the messages that ROS derives from a service or an action (``_Request``,
``_SendGoal_Response``, ``_FeedbackMessage`` and so on). Must not know how a message becomes bytes, nor where the
files are.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import Enum
from keyword import iskeyword

from .errors import UsageError

__all__ = [
    "EMPTY",
    "PRIMITIVES",
    "ActionDefinition",
    "Constant",
    "Definition",
    "Field",
    "FieldType",
    "Kind",
    "ServiceDefinition",
    "Value",
    "parse_action",
    "parse_message",
    "parse_service",
]

Value = bool | int | float | str
"""A value of a constant or of a scalar field."""

# Type -> code of `struct`, size in bytes.
PRIMITIVES: dict[str, tuple[str, int]] = {
    "bool": ("?", 1),
    "byte": ("B", 1),
    "char": ("B", 1),
    "int8": ("b", 1),
    "uint8": ("B", 1),
    "int16": ("h", 2),
    "uint16": ("H", 2),
    "int32": ("i", 4),
    "uint32": ("I", 4),
    "int64": ("q", 8),
    "uint64": ("Q", 8),
    "float32": ("f", 4),
    "float64": ("d", 8),
}
"""Types of fixed size: code of `struct`, size in bytes."""

EMPTY = "structure_needs_at_least_one_member"
"""Name of the uint8 that ROS gives a message without fields."""

_LINE = re.compile(r"(?P<type>[\w/]+(?:<=\d+)?(?:\[(?:<=)?\d*\])?)\s+(?P<name>\w+)\s*(?P<rest>.*)")
_TYPE = re.compile(r"(?P<base>[\w/]+?)(?:<=(?P<bound>\d+))?(?:\[(?P<most><=)?(?P<size>\d*)\])?")
_FIELD_NAME = re.compile(r"[a-z](?:_?[a-z0-9])*")
_CONSTANT_NAME = re.compile(r"[A-Z](?:_?[A-Z0-9])*")
_MESSAGE = re.compile(r"[a-z][a-z0-9_]*/(?:msg|srv|action)/[A-Z]\w*")
_LARGEST_BOUND = 2**31


class Kind(Enum):
    """How many values a field has."""

    ONE = "one"
    ARRAY = "array"
    BOUNDED = "bounded sequence"
    SEQUENCE = "sequence"


@dataclass(frozen=True, slots=True)
class FieldType:
    """Type of a field.

    Attributes:
        base: A name in `PRIMITIVES`, ``string``, or a message as in ``std_msgs/msg/Header``.
        kind: How many values the field has.
        size: Values of an array; the most of a bounded sequence; otherwise 0.
        bound: The most bytes of a bounded string; 0 without a bound.
    """

    base: str
    kind: Kind = Kind.ONE
    size: int = 0
    bound: int = 0

    @property
    def is_message(self) -> bool:
        return "/" in self.base

    @property
    def is_octets(self) -> bool:
        """Whether its value is `bytes`: several uint8, byte or char."""
        return self.kind is not Kind.ONE and PRIMITIVES.get(self.base, ("", 0))[0] == "B"


@dataclass(frozen=True, slots=True)
class Field:
    """A field of a message; ``default`` is None where the file names no default value."""

    name: str
    type: FieldType
    default: Value | tuple[Value, ...] | None = None


@dataclass(frozen=True, slots=True)
class Constant:
    """A constant of a message."""

    name: str
    type: str
    value: Value


@dataclass(frozen=True, slots=True)
class Definition:
    """A message: its full name, as in ``sensor_msgs/msg/JointState``, its fields in order, its constants.

    Attributes:
        text: What defines it; empty for a message that is derived from a service or an action.
    """

    name: str
    fields: tuple[Field, ...]
    constants: tuple[Constant, ...] = ()
    text: str = ""


@dataclass(frozen=True, slots=True)
class ServiceDefinition:
    """A service: its full name and its three messages."""

    name: str
    request: Definition
    response: Definition
    event: Definition
    text: str = ""


@dataclass(frozen=True, slots=True)
class ActionDefinition:
    """An action: its full name, its messages, and what ROS derives from them."""

    name: str
    goal: Definition
    result: Definition
    feedback: Definition
    send_goal: ServiceDefinition
    get_result: ServiceDefinition
    feedback_message: Definition
    text: str = ""


def parse_message(name: str, text: str) -> Definition:
    """Parse a message.

    Args:
        name: Its full name, as in ``sensor_msgs/msg/JointState``.
        text: Contents of the .msg file.

    Raises:
        UsageError: A line is wrong; the text says which.
    """
    if not _MESSAGE.fullmatch(name):
        raise UsageError(f"{name!r} is not the name of a ROS 2 message, as in sensor_msgs/msg/JointState")
    package = name.partition("/")[0]
    fields: list[Field] = []
    constants: list[Constant] = []
    for number, line in enumerate(text.splitlines(), 1):
        stripped = _without_comment(line).strip()
        if not stripped:
            continue
        try:
            item = _parse_line(stripped, package)
        except ValueError as error:
            raise UsageError(f"{name}, line {number}: {error}") from None
        if item.name in {other.name for other in fields} | {other.name for other in constants}:
            raise UsageError(f"{name}, line {number}: {item.name} exists already")
        if isinstance(item, Field):
            fields.append(item)
        else:
            constants.append(item)
    return Definition(name, tuple(fields), tuple(constants), text)


def parse_service(name: str, text: str) -> ServiceDefinition:
    """Parse a service, as ``std_srvs/srv/Trigger``; the arguments and errors are those of `parse_message`."""
    request, response = _parts(name, text, 2)
    return _service(
        name,
        parse_message(f"{name}_Request", request),
        parse_message(f"{name}_Response", response),
        text,
    )


def parse_action(name: str, text: str) -> ActionDefinition:
    """Parse an action; the arguments and errors are those of `parse_message`."""
    parts = _parts(name, text, 3)
    goal, result, feedback = (
        parse_message(f"{name}_{part}", lines)
        for part, lines in zip(("Goal", "Result", "Feedback"), parts, strict=True)
    )
    goal_id = Field("goal_id", FieldType("unique_identifier_msgs/msg/UUID"))
    stamp = Field("stamp", FieldType("builtin_interfaces/msg/Time"))
    sends, gets = f"{name}_SendGoal", f"{name}_GetResult"
    return ActionDefinition(
        name=name,
        goal=goal,
        result=result,
        feedback=feedback,
        send_goal=_service(
            sends,
            Definition(f"{sends}_Request", (goal_id, Field("goal", FieldType(goal.name)))),
            Definition(f"{sends}_Response", (Field("accepted", FieldType("bool")), stamp)),
        ),
        get_result=_service(
            gets,
            Definition(f"{gets}_Request", (goal_id,)),
            Definition(
                f"{gets}_Response", (Field("status", FieldType("int8")), Field("result", FieldType(result.name)))
            ),
        ),
        feedback_message=Definition(
            f"{name}_FeedbackMessage", (goal_id, Field("feedback", FieldType(feedback.name)))
        ),
        text=text,
    )


def _service(name: str, request: Definition, response: Definition, text: str = "") -> ServiceDefinition:
    event = Definition(
        f"{name}_Event",
        (
            Field("info", FieldType("service_msgs/msg/ServiceEventInfo")),
            Field("request", FieldType(request.name, Kind.BOUNDED, 1)),
            Field("response", FieldType(response.name, Kind.BOUNDED, 1)),
        ),
    )
    return ServiceDefinition(name, request, response, event, text)


def _parts(name: str, text: str, count: int) -> list[str]:
    parts: list[list[str]] = [[]]
    for line in text.splitlines():
        if line.strip() == "---":
            parts.append([])
        else:
            parts[-1].append(line)
    if len(parts) != count:
        raise UsageError(f"{name}: {len(parts)} parts separated by '---', but there must be {count}")
    return ["\n".join(part) for part in parts]


def _without_comment(line: str) -> str:
    quote = ""
    for i, character in enumerate(line):
        if quote:
            if character == quote and line[i - 1] != "\\":
                quote = ""
        elif character in "\"'":
            quote = character
        elif character == "#":
            return line[:i]
    return line


def _parse_line(line: str, package: str) -> Field | Constant:
    found = _LINE.fullmatch(line)
    if found is None:
        raise ValueError(f"{line[:80]!r} is neither a field nor a constant")
    type_, name, rest = _parse_type(found["type"], package), found["name"], found["rest"]
    if rest.startswith("="):
        if not _CONSTANT_NAME.fullmatch(name):
            raise ValueError(f"{name!r} is not the name of a constant, as in MOST_JOINTS")
        if type_.kind is not Kind.ONE or type_.is_message:
            raise ValueError(f"a constant cannot be a {found['type']}")
        return Constant(name, type_.base, _parse_value(rest[1:].strip(), type_))
    if not _FIELD_NAME.fullmatch(name):
        raise ValueError(f"{name!r} is not the name of a field, as in joint_names")
    if iskeyword(name):
        raise ValueError(f"{name!r} has a meaning in Python and cannot be the name of a field")
    return Field(name, type_, _parse_default(rest, type_) if rest else None)


def _parse_type(text: str, package: str) -> FieldType:
    found = _TYPE.fullmatch(text)
    if found is None:
        raise ValueError(f"{text!r} is not a type")
    base, bound, size = found["base"], int(found["bound"] or 0), int(found["size"] or 0)
    if max(bound, size) > _LARGEST_BOUND or "0" in (found["bound"], found["size"]):
        raise ValueError(f"the size in {text!r} must be from 1 to {_LARGEST_BOUND}")
    if base == "wstring":
        raise ValueError("wstring is not supported")
    if found["bound"] and base != "string":
        raise ValueError(f"only a string has a bound, unlike {text!r}")
    if base not in PRIMITIVES and base != "string":
        parts = base.split("/")
        if len(parts) == 1:
            parts.insert(0, package)
        if len(parts) == 2:
            parts.insert(1, "msg")
        base = "/".join(parts)
        if not _MESSAGE.fullmatch(base):
            raise ValueError(f"{text!r} is not a type")
    if found["most"]:
        if not size:
            raise ValueError(f"{text!r} lacks its greatest size")
        kind = Kind.BOUNDED
    elif found["size"] is None:
        kind = Kind.ONE
    else:
        kind = Kind.ARRAY if size else Kind.SEQUENCE
    return FieldType(base, kind, size, bound)


def _parse_default(text: str, type_: FieldType) -> Value | tuple[Value, ...]:
    if type_.is_message:
        raise ValueError("a message as a field has no default value")
    if type_.kind is Kind.ONE:
        return _parse_value(text, type_)
    if not (text.startswith("[") and text.endswith("]")):
        raise ValueError(f"{text[:80]!r} is not a list in brackets")
    inner = text[1:-1].strip()
    # A string in quotes may contain a comma.
    items = re.findall(r"\s*(\"(?:\\.|[^\"\\])*\"|'(?:\\.|[^'\\])*'|[^,]+)\s*(?:,|$)", inner) if inner else []
    values = tuple(_parse_value(item.strip(), type_) for item in items)
    if type_.kind is Kind.ARRAY and len(values) != type_.size:
        raise ValueError(f"{len(values)} default values, but there must be {type_.size}")
    if type_.kind is Kind.BOUNDED and len(values) > type_.size:
        raise ValueError(f"{len(values)} default values, but there may be {type_.size}")
    return values


def _parse_value(text: str, type_: FieldType) -> Value:
    base = type_.base
    if base == "string":
        if len(text) > 1 and text[0] in "\"'" and text[-1] == text[0]:
            text = text[1:-1].replace("\\" + text[0], text[0])
        if type_.bound and len(text.encode()) > type_.bound:
            raise ValueError(f"the default value is longer than {type_.bound} bytes")
        return text
    if base == "bool":
        if text.lower() not in ("true", "false", "0", "1"):
            raise ValueError(f"{text[:80]!r} is neither true nor false")
        return text.lower() in ("true", "1")
    if base.startswith("float"):
        return float(text)
    number = int(text, 0) if re.fullmatch(r"[+-]?0[xXbBoO][0-9a-fA-F]+", text) else int(text)
    bits = 8 * PRIMITIVES[base][1]
    least, most = (-(1 << bits - 1), (1 << bits - 1) - 1) if base.startswith("int") else (0, (1 << bits) - 1)
    if not least <= number <= most:
        raise ValueError(f"{number} is not a {base}")
    return number
