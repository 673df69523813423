"""XCDR1, little-endian, as Fast CDR writes a ROS message: a header of four bytes, then each field, aligned.

It parses strictly: a bool of 2, a string without its zero, padding that is not zero, or a byte too many is an
error.
"""

from __future__ import annotations

import struct
from types import SimpleNamespace
from typing import Any

from tests.ros2.strict_client.definitions import Definitions

HEADER = b"\x00\x01\x00\x00"
_NUMBERS = {
    "bool": "?", "byte": "B", "char": "B", "int8": "b", "uint8": "B", "int16": "h", "uint16": "H", "int32": "i",
    "uint32": "I", "int64": "q", "uint64": "Q", "float32": "f", "float64": "d",
}  # fmt: skip


class WrongBytesError(Exception):
    """The bytes are not what ROS writes."""


def split_type(kind: str) -> tuple[str, str | None]:
    """`uint8[16]` is (`uint8`, `16`), a sequence (.., ``), a single value (.., None)."""
    base, bracket, bound = kind.partition("[")
    return base, bound[:-1] if bracket else None


class Cdr:
    def __init__(self, definitions: Definitions) -> None:
        self.definitions = definitions

    def serialize(self, name: str, message: Any) -> bytes:
        out = bytearray()
        self._write(out, name, message)
        # A structure in CDR needs a member: an empty one holds a byte.
        return HEADER + (bytes(out) if self.definitions.fields[name] else b"\x00")

    def _write(self, out: bytearray, name: str, message: Any) -> None:
        values = vars(message) if isinstance(message, SimpleNamespace) else (message or {})
        fields = self.definitions.fields[name]
        unknown = set(values) - {field for _, field in fields}
        assert not unknown, f"{name} has no {unknown}"
        for kind, field in fields:
            base, bound = split_type(kind)
            value = values.get(field)
            if bound is None:
                self._write_one(out, base, value)
                continue
            items = [] if value is None else list(value)
            if bound.isdecimal():
                items = items or [0] * int(bound)
                assert len(items) == int(bound)
            else:
                _align(out, 4)
                out += struct.pack("<I", len(items))
            for item in items:
                self._write_one(out, base, item)

    def _write_one(self, out: bytearray, base: str, value: Any) -> None:
        if base.startswith("string"):
            data = (value or "").encode() + b"\x00"
            _align(out, 4)
            out += struct.pack("<I", len(data)) + data
        elif code := _NUMBERS.get(base):
            _align(out, struct.calcsize(code))
            out += struct.pack("<" + code, value or 0)
        else:
            self._write(out, base, value)

    def parse(self, name: str, data: bytes) -> SimpleNamespace:
        if data[:4] != HEADER:
            raise WrongBytesError(f"header {data[:4].hex()}")
        if not self.definitions.fields[name]:
            if len(data) != 5:
                raise WrongBytesError(f"an empty {name} has one byte, not {data[4:].hex()}")
            return SimpleNamespace()
        reader = _Reader(data[4:])
        message = self._read(reader, name)
        # Fast CDR reserves the size rounded up to four, but cuts the message at its end.
        if reader.at != len(reader.data):
            raise WrongBytesError(f"{len(reader.data) - reader.at} bytes too many after {name}")
        return message

    def _read(self, reader: _Reader, name: str) -> SimpleNamespace:
        message = SimpleNamespace()
        for kind, field in self.definitions.fields[name]:
            base, bound = split_type(kind)
            if bound is None:
                setattr(message, field, self._read_one(reader, base))
                continue
            count = int(bound) if bound.isdecimal() else reader.number("I")
            if count > len(reader.data) or (bound.startswith("<=") and count > int(bound[2:])):
                raise WrongBytesError(f"{field} of {name} has {count} items")
            items = [self._read_one(reader, base) for _ in range(count)]
            setattr(message, field, bytes(items) if base in ("uint8", "byte") else items)
        return message

    def _read_one(self, reader: _Reader, base: str) -> Any:
        if base.startswith("string"):
            return reader.string()
        if code := _NUMBERS.get(base):
            return reader.number(code)
        return self._read(reader, base)


def _align(out: bytearray, size: int) -> None:
    out += b"\x00" * (-len(out) % size)


class _Reader:
    def __init__(self, data: bytes) -> None:
        self.data = data
        self.at = 0

    def take(self, size: int) -> bytes:
        piece = self.data[self.at : self.at + size]
        if len(piece) != size:
            raise WrongBytesError(f"{size} bytes at {self.at}, but the message has {len(self.data)}")
        self.at += size
        return piece

    def number(self, code: str) -> Any:
        size = struct.calcsize(code)
        if any(self.take(-self.at % size)):
            raise WrongBytesError(f"padding before {self.at} is not zero")
        piece = self.take(size)
        if code == "?" and piece not in (b"\x00", b"\x01"):
            raise WrongBytesError(f"a bool of {piece.hex()}")
        return struct.unpack("<" + code, piece)[0]

    def string(self) -> str:
        data = self.take(self.number("I"))
        if data[-1:] != b"\x00" or b"\x00" in data[:-1]:
            raise WrongBytesError(f"a string needs one zero, at its end: {data!r}")
        return data[:-1].decode()
