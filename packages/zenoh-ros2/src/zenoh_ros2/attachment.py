"""What travels beside each ROS 2 message on Zenoh: sequence number, time and id of the sender.

Owns its bytes. Pure. Must not know messages nor sessions.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from .errors import RemoteProtocolError

__all__ = ["GID", "Attachment", "pack_attachment"]

GID = 16
"""Bytes of the id of an endpoint."""

# Zenoh's serialization of (int64, int64, bytes): little-endian, and the length of the bytes as a varint.
_FORM = struct.Struct("<qqB16s")


@dataclass(frozen=True, slots=True)
class Attachment:
    """Beside a message.

    Attributes:
        sequence: Of the sender's messages, from 1; in a reply that of the request.
        stamp: When it was sent, nanoseconds of Unix time.
        gid: Id of the sender; in a reply that of the client.
    """

    sequence: int
    stamp: int
    gid: bytes

    def serialize(self) -> bytes:
        """Its 33 bytes."""
        return pack_attachment(self.sequence, self.stamp, self.gid)

    @classmethod
    def parse(cls, data: bytes | None) -> Attachment:
        """Read it.

        Raises:
            RemoteProtocolError: It is missing or malformed. `rmw_zenoh` drops such messages, too.
        """
        if not data:
            raise RemoteProtocolError("no attachment; is its sender older than April 2025?")
        if len(data) != _FORM.size or data[16] != GID:
            raise RemoteProtocolError(f"an attachment of {len(data)} bytes in another form")
        sequence, stamp, _, gid = _FORM.unpack(data)
        if sequence < 0 or stamp < 0:
            raise RemoteProtocolError("an attachment with a negative sequence number or time")
        return cls(sequence, stamp, gid)


def pack_attachment(sequence: int, stamp: int, gid: bytes) -> bytes:
    """The 33 bytes of an `Attachment`, without the value itself."""
    return _FORM.pack(sequence, stamp, GID, gid)
