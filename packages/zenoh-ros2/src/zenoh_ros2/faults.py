"""Finds the field of a message that cannot be sent, once serializing has failed.

Owns the wording. Serializing itself checks only as much as costs nothing; this looks again, slowly.
"""

from __future__ import annotations

import struct
from typing import Any

from .cdr import Lookup
from .definitions import PRIMITIVES, Definition, FieldType, Kind

__all__ = ["find_fault"]


def find_fault(definition: Definition, message: Any, lookup: Lookup) -> str:
    """Say which field of a message is unsuitable, and why; an empty text if none is."""
    for field in definition.fields:
        try:
            value = getattr(message, field.name)
        except AttributeError:
            return f".{field.name}: a {type(message).__name__} has no such field"
        fault = _field_fault(field.type, value, lookup)
        if fault:
            return f".{field.name}{fault}"
    return ""


def _field_fault(type_: FieldType, value: Any, lookup: Lookup) -> str:
    if type_.kind is Kind.ONE:
        return _value_fault(type_, value, lookup)
    if isinstance(value, str):
        return f": {_quoted(value)} is not a sequence"
    try:
        count = len(value)
        items = list(value)
    except TypeError:
        return f": {_quoted(value)} is not a sequence"
    if type_.kind is Kind.ARRAY and count != type_.size:
        return f": {count} values, but there must be {type_.size}"
    if type_.kind is Kind.BOUNDED and count > type_.size:
        return f": {count} values, but there may be {type_.size}"
    for i, item in enumerate(items):
        fault = _value_fault(FieldType(type_.base, bound=type_.bound), item, lookup)
        if fault:
            return f"[{i}]{fault}"
    return ""


def _value_fault(type_: FieldType, value: Any, lookup: Lookup) -> str:
    if type_.is_message:
        return find_fault(lookup(type_.base)[0], value, lookup)
    if type_.base == "string":
        if not isinstance(value, str):
            return f": {_quoted(value)} is not a string"
        try:
            data = value.encode()
        except UnicodeEncodeError:
            return f": {_quoted(value)} is not valid Unicode"
        return f": longer than {type_.bound} bytes" if type_.bound and len(data) > type_.bound else ""
    if type_.base == "bool":
        try:
            return "" if value in (False, True) else f": {_quoted(value)} is not a bool"
        except ValueError:
            return f": {_quoted(value)} is not a bool"
    try:
        struct.pack("<" + PRIMITIVES[type_.base][0], value)
    except (struct.error, OverflowError, TypeError, ValueError):
        return f": {_quoted(value)} is not a {type_.base}"
    return ""


def _quoted(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:40]}...{text[-15:]}"
