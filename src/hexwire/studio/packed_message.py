"""Binary messages of a WebSocket that are packed once for all who get them.

Owns their bytes, and where an application finds how they are written: `connections.PackingProtocol`. Pure. Must not
know what messages mean.
"""

from __future__ import annotations

import struct

__all__ = ["WRITE", "pack_message"]

WRITE = "hexwire.write"
"""Key of the scope of a socket: `connections.PackingProtocol.write`."""
_BINARY = 0x82
"""A whole message, in one frame, of bytes."""
_SHORT, _LONG = 126, 127
"""In place of a length that follows, in two or in eight bytes; a shorter one is in its place."""


def pack_message(payload: bytes) -> bytes:
    """The bytes of a message from a server, which are the same on every connection without compression."""
    size = len(payload)
    if size < _SHORT:
        head = struct.pack("!BB", _BINARY, size)
    elif size < 1 << 16:
        head = struct.pack("!BBH", _BINARY, _SHORT, size)
    else:
        head = struct.pack("!BBQ", _BINARY, _LONG, size)
    return head + payload
