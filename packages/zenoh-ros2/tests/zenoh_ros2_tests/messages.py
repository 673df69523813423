"""Random messages of a type, and the same messages for rosbags, a second implementation of CDR."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

import zenoh_ros2
from zenoh_ros2.definitions import PRIMITIVES, Field, FieldType, Kind, parse_message
from zenoh_ros2.types import MessageType, Types

_INTERFACES = Path(zenoh_ros2.__file__).parent / "interfaces"
NAMES = sorted(
    "/".join((*path.relative_to(_INTERFACES).parts[:2], path.stem))
    for path in _INTERFACES.rglob("*.*")
    if "variants" not in path.parts
)
"""Names of all types that the package has."""
TEXT = st.text(st.characters(exclude_categories=["Cs"]), max_size=8)
ASCII = st.text(st.characters(codec="ascii"), max_size=8)
_DTYPES = {"?": np.bool_} | {code: np.dtype(code) for code, _ in PRIMITIVES.values() if code != "?"}


def with_type(name: str, text: str) -> Types:
    """The types of a distribution, and one more message with all of these fields."""
    types = Types()
    types._definitions[name] = parse_message(name, text)
    return types


@cache
def messages(types: Types, type_: MessageType, strings: st.SearchStrategy[str] = TEXT) -> st.SearchStrategy[Any]:
    """Any message of a type."""
    definition, _ = types.lookup(type_.name)
    fields = {field.name: _values(types, field.type, strings) for field in definition.fields}
    return st.fixed_dictionaries(fields).map(lambda values: type_(**values))


def _values(types: Types, type_: FieldType, strings: st.SearchStrategy[str]) -> st.SearchStrategy[Any]:
    if type_.kind is Kind.ONE:
        return _one(types, type_, strings)
    least = type_.size if type_.kind is Kind.ARRAY else 0
    most = {Kind.ARRAY: type_.size, Kind.BOUNDED: type_.size}.get(type_.kind, 3)
    if type_.is_octets:
        return st.binary(min_size=least, max_size=most)
    return st.lists(_one(types, FieldType(type_.base, bound=type_.bound), strings), min_size=least, max_size=most)


def _one(types: Types, type_: FieldType, strings: st.SearchStrategy[str]) -> st.SearchStrategy[Any]:
    if type_.is_message:
        return messages(types, types.message(type_.base), strings)
    if type_.base == "string":
        return strings.filter(lambda text: len(text.encode()) <= type_.bound) if type_.bound else strings
    if type_.base == "bool":
        return st.booleans()
    code, size = PRIMITIVES[type_.base]
    if code in "fd":
        # rosbags' messages are compared with ==, so a NaN has tests of its own.
        return st.floats(width=8 * size, allow_nan=False)
    if type_.base == "byte":
        # rosbags takes it for signed.
        return st.integers(0, 127)
    signed = code.islower()
    return st.integers(-(1 << 8 * size - 1) if signed else 0, (1 << 8 * size - (1 if signed else 0)) - 1)


def messages_of(types: Types, name: str) -> list[Any]:
    """The message types of a message, service or action."""
    if "/msg/" in name:
        return [types.message(name)]
    if "/srv/" in name:
        service = types.service(name)
        return [service.request, service.response, service.event]
    action = types.action(name)
    services = [action.send_goal, action.get_result]
    return [action.goal, action.result, action.feedback, *(each.event for each in services)]


class Rosbags:
    """Serializes and parses with rosbags; its own definitions where it has them, else those of the package."""

    def __init__(self, types: Types) -> None:
        self._types = types
        self._store = get_typestore(Stores.ROS2_JAZZY)

    def _name(self, name: str) -> str:
        """The name that rosbags has for a message. It knows no messages of services and actions."""
        package, kind, stem = name.split("/")
        known = name if kind == "msg" else f"{package}_{kind}/msg/{stem}"
        if known not in self._store.fielddefs:
            text = "".join(f"{self._line(field)}\n" for field in self._types.lookup(name)[0].fields)
            self._store.register(get_types_from_msg(text, known))
        return known

    def _line(self, field: Field) -> str:
        type_ = field.type
        base = self._name(type_.base) if type_.is_message else type_.base
        bound = f"<={type_.bound}" if type_.bound else ""
        size = {
            Kind.ONE: "",
            Kind.ARRAY: f"[{type_.size}]",
            Kind.BOUNDED: f"[<={type_.size}]",
            Kind.SEQUENCE: "[]",
        }[type_.kind]
        return f"{base}{bound}{size} {field.name}"

    def make(self, name: str, message: Any) -> Any:
        """The same message as an object of rosbags."""
        definition, _ = self._types.lookup(name)
        cls = self._store.types[self._name(name)]
        values = {field.name: self._make(field.type, getattr(message, field.name)) for field in definition.fields}
        return cls(**(values or {"structure_needs_at_least_one_member": 0}))

    def _make(self, type_: FieldType, value: Any) -> Any:
        if type_.is_message:
            return (
                self.make(type_.base, value)
                if type_.kind is Kind.ONE
                else [self.make(type_.base, each) for each in value]
            )
        if type_.kind is Kind.ONE or type_.base == "string":
            return value
        dtype = _DTYPES[PRIMITIVES[type_.base][0]]
        return np.frombuffer(value, np.uint8) if type_.is_octets else np.array(value, dtype)

    def serialize(self, name: str, message: Any, *, little: bool = True) -> bytes:
        known = self._name(name)
        return bytes(self._store.serialize_cdr(self.make(name, message), known, little_endian=little))

    def parse(self, name: str, data: bytes) -> Any:
        """Parse bytes with rosbags, and give the message as one of the package."""
        return self._back(name, self._store.deserialize_cdr(data, self._name(name)))

    def _back(self, name: str, found: Any) -> Any:
        definition, _ = self._types.lookup(name)
        type_ = self._types.message(name)
        return type_(
            **{field.name: self._value(field.type, getattr(found, field.name)) for field in definition.fields}
        )

    def _value(self, type_: FieldType, value: Any) -> Any:
        if type_.is_message:
            return (
                self._back(type_.base, value)
                if type_.kind is Kind.ONE
                else [self._back(type_.base, each) for each in value]
            )
        if type_.is_octets:
            return bytes(value)
        return value.tolist() if isinstance(value, np.ndarray) else value
