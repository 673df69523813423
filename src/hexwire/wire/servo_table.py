"""Bodies of SERVO_TABLE: registers of one servo, many at once (PROTOCOL.md section 6.10).

Owns their packing; `schema/commands.toml` is the source, and a test compares the two. Knows nothing of what a
register means.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from hexwire.errors import RemoteProtocolError

__all__ = ["TABLE_HEAD_SIZE", "TABLE_REGISTERS", "ServoTable"]

TABLE_REGISTERS = 256
"""Registers of a servo."""

_HEAD = struct.Struct("<BBH")
TABLE_HEAD_SIZE = _HEAD.size


@dataclass(frozen=True, slots=True)
class ServoTable:
    """Body of a request or a reply.

    Attributes:
        servo_id: Id of the servo.
        first: The first register.
        count: How many.
        data: Their values, raw; empty in a request that reads and in the reply to one that writes.
    """

    servo_id: int
    first: int
    count: int
    data: bytes = b""

    def serialize(self) -> bytes:
        """Serialize the body."""
        return _HEAD.pack(self.servo_id, self.first, self.count) + self.data

    @classmethod
    def parse(cls, body: bytes) -> ServoTable:
        """Parse the body; whether the data has the length `count` is for the receiver to check."""
        if len(body) < TABLE_HEAD_SIZE:
            raise RemoteProtocolError(f"SERVO_TABLE: {len(body)} bytes, at least {TABLE_HEAD_SIZE} are needed")
        servo_id, first, count = _HEAD.unpack_from(body)
        return cls(servo_id, first, count, bytes(body[TABLE_HEAD_SIZE:]))
