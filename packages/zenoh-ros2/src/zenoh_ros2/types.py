"""The message, service and action types of a distribution of ROS 2, by name.

Owns the files in ``interfaces`` (ROS's own definitions, reduced to fields, constants and default values), which
type a name means, and the classes of messages. Must not know what a message is used for, nor Zenoh.

    types = Types(Distribution.JAZZY)
    joint_state = types.message("sensor_msgs/msg/JointState")
    data = joint_state.serialize(joint_state(name=["J1"], position=[0.5]))
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterable, Mapping
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar, TypeVar

from .cdr import MOST_BYTES, MOST_PADDING, make_parser, make_serializer
from .definitions import (
    PRIMITIVES,
    ActionDefinition,
    Definition,
    Field,
    Kind,
    ServiceDefinition,
    Value,
    parse_action,
    parse_message,
    parse_service,
)
from .distributions import NO_TYPE_HASH, Distribution
from .errors import LocalProtocolError, RemoteProtocolError, UsageError
from .faults import find_fault
from .type_hash import IndividualDescription, describe, individual_of, type_hash

__all__ = ["ActionType", "Message", "MessageType", "ServiceType", "Types"]

_INTERFACES = Path(__file__).parent / "interfaces"
_NAME = re.compile(r"([a-z][a-z0-9_]*)/(msg|srv|action)/([A-Z][A-Za-z0-9]*)((?:_[A-Z][A-Za-z]*)*)")
_SEPARATOR = "=" * 80
_BAD_VALUES = (struct.error, ArithmeticError, AttributeError, LookupError, TypeError, ValueError)
_ENDIANNESS = (False, True)

_AnyDefinition = Definition | ServiceDefinition | ActionDefinition
_T = TypeVar("_T", bound="_Type")


class Message:
    """Base of all message classes: an object with the message's fields as attributes, and nothing else."""

    __slots__: tuple[str, ...] = ()
    _fields: ClassVar[tuple[str, ...]] = ()

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        return all(getattr(self, name) == getattr(other, name) for name in self._fields)

    __hash__ = None  # type: ignore[assignment]  # Messages are mutable.

    def __repr__(self) -> str:
        return f"{type(self).__name__}({', '.join(f'{name}={getattr(self, name)!r}' for name in self._fields)})"


class _Type:
    """What messages, services and actions have in common."""

    def __init__(self, types: Types, definition: _AnyDefinition) -> None:
        self._types = types
        self.name = definition.name
        package, kind, name = definition.name.split("/")
        self.dds_name = f"{package}::{kind}::dds_::{name}_"

    @cached_property
    def hash(self) -> str:
        """Its type hash, as in ``RIHS01_`` and 64 digits, or what stands for it in this distribution."""
        if not self._types.distribution.has_type_hashes:
            return NO_TYPE_HASH
        return type_hash(describe(self.name, self._types.individual))

    @property
    def description(self) -> Any:
        """A new ``type_description_interfaces/msg/TypeDescription`` of this type."""
        return self._types.description(self.name)

    @property
    def sources(self) -> list[Any]:
        """New ``type_description_interfaces/msg/TypeSource`` of this type and of those it contains."""
        return self._types.sources(self.name)

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.name}>"


class MessageType(_Type):
    """A message type; calling it makes a message.

    Attributes:
        name: As in ``sensor_msgs/msg/JointState``.
        dds_name: As in ``sensor_msgs::msg::dds_::JointState_``.
        constants: Its constants by name; each is an attribute of the messages, too.
        fields: Names of its fields, in order.
        message_class: Class of its messages.
    """

    def __init__(self, types: Types, definition: Definition) -> None:
        super().__init__(types, definition)
        self._definition = definition
        self.constants: Mapping[str, Value] = MappingProxyType(
            {each.name: each.value for each in definition.constants}
        )
        self.fields = tuple(field.name for field in definition.fields)
        self.message_class = _make_class(definition, types)

    def __call__(self, **fields: Any) -> Any:
        """Make a message. Fields that are not named have their default value, or are zero or empty.

        Raises:
            TypeError: There is no such field.
        """
        return self.message_class(**fields)

    @cached_property
    def _serializer(self) -> Any:
        return make_serializer(self._definition, self._types.lookup)

    @cached_property
    def _parsers(self) -> Any:
        # The byte order is the second byte of the header: 0 for big-endian.
        return tuple(
            make_parser(self._definition, self._types.lookup, self.message_class, little=little)
            for little in _ENDIANNESS
        )

    def serialize(self, message: Any) -> bytes:
        """Turn a message into bytes, with the header of the encoding.

        Args:
            message: An object with the fields of the type. Numbers may be in any sequence; several uint8, byte or
                char in `bytes` or a sequence.

        Raises:
            LocalProtocolError: A field has an unsuitable value; the text names it.
        """
        try:
            data: bytes = self._serializer(message)
        except _BAD_VALUES as error:
            fault = find_fault(self._definition, message, self._types.lookup) or f": {error}"
            raise LocalProtocolError(f"cannot send {self.name}{fault}") from None
        return data

    def parse(self, data: bytes | bytearray | memoryview) -> Any:
        """Turn bytes into a message. Several numbers are a list; several uint8, byte or char are `bytes`.

        Bytes of a string that are not UTF-8 become replacement characters. Memory and time are in proportion to
        the bytes, whatever the lengths in them say.

        Raises:
            RemoteProtocolError: The bytes are not such a message.
        """
        data = bytes(data)
        if len(data) > MOST_BYTES:
            raise RemoteProtocolError(f"{self.name}: {len(data)} bytes, at most {MOST_BYTES}")
        if len(data) < 4 or data[0] or data[1] > 1:
            raise RemoteProtocolError(f"{self.name}: {data[:4].hex(' ') or 'nothing'} is not the header of CDR")
        if len(data) == 4 and not self.fields:
            return self.message_class()
        try:
            message, end = self._parsers[data[1]](data)
        except (struct.error, IndexError):
            raise RemoteProtocolError(f"{self.name}: the message ends after {len(data)} bytes, too early") from None
        if len(data) - end > MOST_PADDING:
            raise RemoteProtocolError(f"{self.name}: {len(data) - end} bytes after the end of the message")
        return message

    @cached_property
    def text(self) -> str:
        """The definition with those of all messages that it contains, as recordings store it (``ros2msg``)."""
        parts = [self._types.message_text(self.name)]
        for part in describe(self.name, self._types.individual).referenced:
            package, _, name = part.name.split("/")
            parts.append(f"{_SEPARATOR}\nMSG: {package}/{name}\n{self._types.message_text(part.name)}")
        return "\n".join(parts)


class ServiceType(_Type):
    """A service type; ``request``, ``response`` and ``event`` are its messages."""

    def __init__(self, types: Types, definition: ServiceDefinition) -> None:
        super().__init__(types, definition)
        self.request = types.message(definition.request.name)
        self.response = types.message(definition.response.name)
        self._event = definition.event.name

    @cached_property
    def event(self) -> MessageType:
        return self._types.message(self._event)


class ActionType(_Type):
    """An action type.

    Attributes:
        goal: What a goal says, and likewise ``result``.
        feedback: The message on the topic ``feedback``: goal id and feedback.
        feedback_content: The feedback in it.
        status: The message on the topic ``status``.
        send_goal: The service that takes goals, and likewise ``get_result`` and ``cancel_goal``.
    """

    def __init__(self, types: Types, definition: ActionDefinition) -> None:
        super().__init__(types, definition)
        self.goal = types.message(definition.goal.name)
        self.result = types.message(definition.result.name)
        self.feedback_content = types.message(definition.feedback.name)
        self.feedback = types.message(definition.feedback_message.name)
        self.status = types.message("action_msgs/msg/GoalStatusArray")
        self.send_goal = types.service(definition.send_goal.name)
        self.get_result = types.service(definition.get_result.name)
        self.cancel_goal = types.service("action_msgs/srv/CancelGoal")


class Types:
    """The types of a distribution; each is made when it is first asked for, and kept.

    Args:
        distribution: Whose interfaces and hashes.
        folders: Folders of ROS packages with more interfaces, as ``my_msgs/msg/Load.msg``; they come first.
    """

    def __init__(self, distribution: Distribution = Distribution.JAZZY, folders: Iterable[str | Path] = ()) -> None:
        self.distribution = distribution
        self._folders = [Path(folder) for folder in folders]
        self._definitions: dict[str, _AnyDefinition] = {}
        self._types: dict[str, Any] = {}

    def message(self, name: str) -> MessageType:
        """A message type by its full name, as ``sensor_msgs/msg/JointState``.

        Messages of services and actions have ROS's names, as ``std_srvs/srv/Trigger_Request``.

        Raises:
            UsageError: There is no such message here.
        """
        return self._type(name, Definition, MessageType)

    def service(self, name: str) -> ServiceType:
        """A service type by its full name, as ``std_srvs/srv/Trigger``; raises as `message`."""
        return self._type(name, ServiceDefinition, ServiceType)

    def action(self, name: str) -> ActionType:
        """An action type by its full name, as ``example_interfaces/action/Fibonacci``; raises as `message`."""
        return self._type(name, ActionDefinition, ActionType)

    def _type(self, name: str, kind: type[_AnyDefinition], make: type[_T]) -> _T:
        found = self._types.get(name)
        if not isinstance(found, make):
            definition = self._definition(name)
            if not isinstance(definition, kind):
                what = {Definition: "message", ServiceDefinition: "service"}.get(kind, "action")
                raise UsageError(f"{name} is not a {what} type")
            # Two threads may both make it: what is kept is then one of them.
            found = self._types.setdefault(name, make(self, definition))
        return found

    def lookup(self, name: str) -> tuple[Definition, type]:
        """Definition and class of a message, by its full name."""
        found = self.message(name)
        return found._definition, found.message_class

    def individual(self, name: str) -> IndividualDescription:
        """The description of a type without those of its fields."""
        return individual_of(self._definition(name))

    def description(self, name: str) -> Any:
        """A new ``type_description_interfaces/msg/TypeDescription`` of a type, by its full name."""
        described = describe(name, self.individual)
        message = self.message("type_description_interfaces/msg/TypeDescription")
        return message(
            type_description=self._individual_message(described.type),
            referenced_type_descriptions=[self._individual_message(part) for part in described.referenced],
        )

    def _individual_message(self, part: IndividualDescription) -> Any:
        individual, field, field_type = (
            self.message(f"type_description_interfaces/msg/{name}")
            for name in ("IndividualTypeDescription", "Field", "FieldType")
        )
        return individual(
            type_name=part.name,
            fields=[
                field(
                    name=name,
                    type=field_type(
                        type_id=number, capacity=capacity, string_capacity=string_capacity, nested_type_name=nested
                    ),
                    default_value=default,
                )
                for name, number, capacity, string_capacity, nested, default in part.fields
            ],
        )

    def sources(self, name: str) -> list[Any]:
        """New ``type_description_interfaces/msg/TypeSource`` of a type and of those it contains, itself first."""
        described = describe(name, self.individual)
        source = self.message("type_description_interfaces/msg/TypeSource")
        found = []
        for part in (described.type, *described.referenced):
            text = self._definition(part.name).text
            # ROS says so of what it derives from a service or an action.
            encoding = part.name.split("/")[1] if "_" not in part.name.rpartition("/")[2] else "implicit"
            text = "" if encoding == "implicit" else text
            found.append(source(type_name=part.name, encoding=encoding, raw_file_contents=text))
        return found

    def message_text(self, name: str) -> str:
        """The definition of one message, without those that it contains."""
        definition = self._definition(name)
        assert isinstance(definition, Definition)
        if definition.text or not definition.fields:
            return definition.text
        return "".join(f"{_field_text(field)}\n" for field in definition.fields)

    def _definition(self, name: str) -> _AnyDefinition:
        found = self._definitions.get(name)
        if found is None:
            self._load(name)
            found = self._definitions.get(name)
            if found is None:
                raise UsageError(f"there is no ROS 2 type {name!r:.120} here")
        return found

    def _load(self, name: str) -> None:
        match = _NAME.fullmatch(name)
        if match is None:
            raise UsageError(f"{name!r:.120} is not the name of a ROS 2 type, as in sensor_msgs/msg/JointState")
        package, kind, stem = match[1], match[2], match[3]
        file = f"{kind}/{stem}.{kind}"
        folders = [folder / package for folder in self._folders] + [
            _INTERFACES / "variants" / variant
            for variant in self.distribution.variants
            if variant.rpartition("_")[0] == package
        ]
        path = next(
            (found for folder in folders if (found := folder / file).is_file()), _INTERFACES / package / file
        )
        if not path.is_file():
            raise UsageError(f"there is no ROS 2 type {name!r:.120} here")
        text = path.read_text(encoding="utf-8")
        base = f"{package}/{kind}/{stem}"
        parts: tuple[_AnyDefinition, ...]
        if kind == "msg":
            parts = (parse_message(base, text),)
        elif kind == "srv":
            parts = _service_parts(parse_service(base, text))
        else:
            action = parse_action(base, text)
            own = (action, action.goal, action.result, action.feedback, action.feedback_message)
            parts = (*own, *_service_parts(action.send_goal), *_service_parts(action.get_result))
        for part in parts:
            self._definitions.setdefault(part.name, part)


def _service_parts(service: ServiceDefinition) -> tuple[_AnyDefinition, ...]:
    return (service, service.request, service.response, service.event)


def _field_text(field: Field) -> str:
    base = field.type.base
    if field.type.is_message:
        package, _, name = base.split("/")
        base = f"{package}/{name}"
    count = {Kind.ONE: "", Kind.SEQUENCE: "[]"}.get(field.type.kind)
    if count is None:
        count = f"[{field.type.size}]" if field.type.kind is Kind.ARRAY else f"[<={field.type.size}]"
    return f"{base}{count} {field.name}"


def _make_class(definition: Definition, types: Types) -> type[Message]:
    """Make the class of a message; its constructor has the fields as keyword arguments."""
    fields = tuple(field.name for field in definition.fields)
    names: dict[str, Any] = {}
    arguments = ["*", *(f"{name}=None" for name in fields)] if fields else []
    lines = [f"def __init__({', '.join(['self', *arguments])}):"]
    for field in definition.fields:
        names[f"new_{field.name}"], value = _default(field, types)
        lines.append(f"    self.{field.name} = {value} if {field.name} is None else {field.name}")
    exec("\n".join([*lines, "    return"]), names)
    body: dict[str, Any] = {constant.name: constant.value for constant in definition.constants}
    body |= {
        "__slots__": fields,
        "_fields": fields,
        "__init__": names["__init__"],
        "__doc__": f"{definition.name}: {', '.join(fields) or 'no fields'}.",
        "__module__": __name__,
    }
    return type(definition.name.rpartition("/")[2], (Message,), body)


def _default(field: Field, types: Types) -> tuple[Any, str]:
    """A value or function of the name ``new_`` and the field's, and the expression that makes a default value."""
    type_, name = field.type, f"new_{field.name}"
    if type_.is_message:
        cls = types.message(type_.base).message_class
        if type_.kind is Kind.ARRAY:
            return cls, f"[{name}() for _ in range({type_.size})]"
        return cls, f"{name}()" if type_.kind is Kind.ONE else "[]"
    if field.default is not None:
        if type_.is_octets and isinstance(field.default, tuple):
            return bytes(int(value) for value in field.default), name
        return field.default, name if type_.kind is Kind.ONE else f"list({name})"
    zero: Value = (
        "" if type_.base == "string" else {"?": False, "f": 0.0, "d": 0.0}.get(PRIMITIVES[type_.base][0], 0)
    )
    if type_.kind is Kind.ONE:
        return zero, name
    size = type_.size if type_.kind is Kind.ARRAY else 0
    return (bytes(size), name) if type_.is_octets else (zero, f"[{name}] * {size}" if size else "[]")
