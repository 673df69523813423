"""How the chapter's printed sketch takes frames off the line, hazards and all.

Owns the receive loop of the sketch: frames end at the first 0D 0A after the sync word, in a buffer that keeps
the bytes of earlier frames, and bytes that arrive while a command runs have 63 bytes of room. Tests use it to show
that a host never sends what such a board would misread. Knows nothing of what the frames mean.
"""

from __future__ import annotations

from typing import NamedTuple

from hexwire.wire.command_frame import Command

__all__ = ["SketchFrame", "SketchReceiver"]

_BUFFER = 254
_RING = 63


class SketchFrame(NamedTuple):
    """What the sketch takes for a frame.

    Attributes:
        data: The whole buffer, stale bytes included.
        length: Number of bytes of it that arrived this time.
    """

    data: bytes
    length: int

    @property
    def short(self) -> bool:
        """Too short for a command, by the sketch's own test."""
        return self.length <= 40

    @property
    def hangs(self) -> bool:
        """Whether the sketch waits forever for room for this packet."""
        return not self.short and self.cmd in (Command.PING, Command.READ) and self.data[36] > _RING

    @property
    def cmd(self) -> int:
        """Command code, perhaps of an earlier frame."""
        return self.data[38]

    @property
    def body(self) -> bytes:
        """The body by the low byte of its length field, perhaps with bytes of an earlier frame."""
        return self.data[40 : 40 + self.data[36]]


class SketchReceiver:
    """The sketch's `loop()`, a byte at a time, behind the ring of the Arduino core.

    Attributes:
        hung: 254 bytes came after a sync word without 0D 0A: the sketch takes no more until reset.
        lost: Bytes that the ring had no room for.
    """

    def __init__(self) -> None:
        self.hung = False
        self.lost = 0
        self._ring = bytearray()
        self._buffer = bytearray(_BUFFER)
        self._head = 0
        self._window = 0

    @property
    def waiting(self) -> int:
        """Bytes in the ring."""
        return len(self._ring)

    def put(self, data: bytes, *, busy: bool) -> None:
        """Take bytes off the line. While the sketch is busy with a command, what the ring cannot hold is lost."""
        self._ring += data
        if busy and len(self._ring) > _RING:
            self.lost += len(self._ring) - _RING
            del self._ring[_RING:]

    def next_frame(self) -> SketchFrame | None:
        """Read bytes to the end of what the sketch takes for a frame; None if there is no end yet."""
        while self._ring and not self.hung:
            byte = self._ring.pop(0)
            if not self._head:
                self._window = (self._window << 8 | byte) & 0xFFFFFFFF
                if self._window == 0x5AFAFA5A:
                    self._buffer[:4] = b"\x5a\xfa\xfa\x5a"
                    self._head = 4
                continue
            last = self._buffer[self._head - 1]
            self._buffer[self._head] = byte
            self._head += 1
            if last == 0x0D and byte == 0x0A:
                frame = SketchFrame(bytes(self._buffer), self._head)
                self._head = self._window = 0
                if len(self._ring) > _RING:
                    # It is busy from here on.
                    self.lost += len(self._ring) - _RING
                    del self._ring[_RING:]
                return frame
            if self._head >= _BUFFER:
                self.hung = True
        if self.hung:
            self._ring.clear()
        return None
