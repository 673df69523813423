"""Type descriptions and their hashes, RIHS01 (REP 2016).

Owns the form that is hashed. Must not know bytes of messages, nor where definitions come from. Verified with the
hashes that ROS publishes.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from hashlib import sha256

from .definitions import EMPTY, ActionDefinition, Definition, Field, FieldType, Kind, ServiceDefinition

__all__ = ["Description", "IndividualDescription", "describe", "individual_of", "type_hash"]

# As in type_description_interfaces/msg/FieldType.
_IDS = {
    "int8": 2,
    "uint8": 3,
    "int16": 4,
    "uint16": 5,
    "int32": 6,
    "uint32": 7,
    "int64": 8,
    "uint64": 9,
    "float32": 10,
    "float64": 11,
    # The IDL file that ROS makes of a .msg file has uint8 in place of char.
    "char": 3,
    "bool": 15,
    "byte": 16,
    "string": 17,
}
_NESTED, _BOUNDED_STRING = 1, 21
_OFFSETS = {Kind.ONE: 0, Kind.ARRAY: 48, Kind.BOUNDED: 96, Kind.SEQUENCE: 144}


@dataclass(frozen=True, slots=True)
class IndividualDescription:
    """A type without those of its fields: its name, and name, type and default value of each field.

    Attributes:
        name: Its full name.
        fields: Of each field its name, type id, capacity, capacity of a string, nested type, default value.
    """

    name: str
    fields: tuple[tuple[str, int, int, int, str, str], ...]


@dataclass(frozen=True, slots=True)
class Description:
    """A type and all types that it contains, sorted by name."""

    type: IndividualDescription
    referenced: tuple[IndividualDescription, ...]


def individual_of(definition: Definition | ServiceDefinition | ActionDefinition) -> IndividualDescription:
    """Describe a message, a service or an action without the types of its fields."""
    fields: Iterable[Field]
    if isinstance(definition, Definition):
        fields = definition.fields or (Field(EMPTY, FieldType("uint8")),)
    elif isinstance(definition, ServiceDefinition):
        fields = (
            Field(f"{part}_message", FieldType(getattr(definition, part).name))
            for part in ("request", "response", "event")
        )
    else:
        names = ("goal", "result", "feedback", "send_goal", "get_result", "feedback_message")
        fields = (
            Field(f"{name}_service" if name in ("send_goal", "get_result") else name, FieldType(part.name))
            for name, part in ((name, getattr(definition, name)) for name in names)
        )
    return IndividualDescription(definition.name, tuple(_field(field) for field in fields))


def _field(field: Field) -> tuple[str, int, int, int, str, str]:
    type_ = field.type
    if type_.is_message:
        number = _NESTED
    elif type_.bound:
        number = _BOUNDED_STRING
    else:
        number = _IDS[type_.base]
    nested = type_.base if type_.is_message else ""
    default = "" if field.default is None else str(field.default)
    return field.name, number + _OFFSETS[type_.kind], type_.size, type_.bound, nested, default


def describe(name: str, individual: Callable[[str], IndividualDescription]) -> Description:
    """Describe a type with all types that it contains.

    Args:
        name: Its full name.
        individual: Gives the description of a name, without the types of its fields.
    """
    own = individual(name)
    found: dict[str, IndividualDescription] = {}
    waiting = [own]
    while waiting:
        for _, _, _, _, nested, _ in waiting.pop().fields:
            if nested and nested not in found:
                found[nested] = individual(nested)
                waiting.append(found[nested])
    return Description(own, tuple(found[key] for key in sorted(found)))


def type_hash(description: Description) -> str:
    """Compute the hash of a type, as in ``RIHS01_`` and 64 hexadecimal digits."""
    text = json.dumps(
        {
            "type_description": _hashed(description.type),
            "referenced_type_descriptions": [_hashed(part) for part in description.referenced],
        }
    )
    return f"RIHS01_{sha256(text.encode()).hexdigest()}"


def _hashed(part: IndividualDescription) -> dict[str, object]:
    # Default values and constants are not hashed.
    return {
        "type_name": part.name,
        "fields": [
            {
                "name": name,
                "type": {
                    "type_id": number,
                    "capacity": capacity,
                    "string_capacity": string_capacity,
                    "nested_type_name": nested,
                },
            }
            for name, number, capacity, string_capacity, nested, _ in part.fields
        ],
    }
