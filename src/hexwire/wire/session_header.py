"""The 32 bytes in front of every frame: who, to whom, when, how long.

Owns the header's layout. Does not know what follows it, nor whose clock the time is.
"""

from __future__ import annotations

import struct
from typing import NamedTuple

from hexwire.errors import RemoteProtocolError
from hexwire.units import NSEC

from .tables import HEADER_SIZE, SYNC

__all__ = ["HEADER", "SYNC_BYTES", "SessionHeader"]

HEADER = struct.Struct("<IIIIiiiI")
SYNC_BYTES = struct.pack("<I", SYNC)


class SessionHeader(NamedTuple):
    """A session header without its sync word.

    Attributes:
        time_sec: Whole seconds of the sender's clock.
        time_nsec: Nanoseconds; the chapter's board sends 1,000,000,000 now and then, which is meant.
        sn: The sender's own frame counter.
        src: Module id of the sender.
        dst: Module id it is meant for.
        type: 3 from a host on a serial line, 8 from a board.
        size: Bytes of the whole frame, this header included.
    """

    time_sec: int
    time_nsec: int
    sn: int
    src: int
    dst: int
    type: int
    size: int

    @property
    def time(self) -> float:
        """The sender's clock in seconds, whatever the split between the two fields."""
        return self.time_sec + self.time_nsec / NSEC

    def serialize(self) -> bytes:
        """The header as 32 bytes."""
        return HEADER.pack(SYNC, *self)

    @classmethod
    def parse(cls, data: bytes) -> SessionHeader:
        """Read a header from the first 32 bytes.

        Raises:
            RemoteProtocolError: Too few bytes, or they do not start with the sync word.
        """
        if len(data) < HEADER_SIZE:
            raise RemoteProtocolError(f"a session header has {HEADER_SIZE} bytes, here are {len(data)}")
        sync, *rest = HEADER.unpack_from(data)
        if sync != SYNC:
            raise RemoteProtocolError(f"no sync word: {data[:4].hex(' ').upper()}")
        return cls(*rest)
