"""How the chapter's printed sketch takes frames off the line, hazards and all.

Owns the receive loop of the sketch: frames end at the first 0D 0A after the sync word, in a buffer that keeps
the bytes of earlier frames. For tests that a host never sends what such a board would misread. Knows nothing of
what the frames mean.
"""

from __future__ import annotations

from typing import NamedTuple

__all__ = ["SketchFrame", "SketchReceiver"]

_BUFFER = 254


class SketchFrame(NamedTuple):
    """What the sketch believes to be a frame.

    Attributes:
        data: The whole buffer, stale bytes included.
        length: How much of it arrived this time.
    """

    data: bytes
    length: int

    @property
    def short(self) -> bool:
        """Too short for a command, by the sketch's own test."""
        return self.length <= 40

    @property
    def cmd(self) -> int:
        """Command code, perhaps of an earlier frame."""
        return self.data[38]

    @property
    def body(self) -> bytes:
        """The body by the low byte of its length, perhaps with bytes of an earlier frame."""
        return self.data[40 : 40 + self.data[36]]


class SketchReceiver:
    """The sketch's `loop()`, a byte at a time.

    Attributes:
        hung: 254 bytes came after a sync word without 0D 0A: the sketch takes no more until reset.
    """

    def __init__(self) -> None:
        self.hung = False
        self._buffer = bytearray(_BUFFER)
        self._head = 0
        self._window = 0

    def receive(self, data: bytes) -> list[SketchFrame]:
        """Take bytes; returns the frames that the sketch would execute."""
        frames = []
        for byte in data:
            if self.hung:
                break
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
                frames.append(SketchFrame(bytes(self._buffer), self._head))
                self._head = self._window = 0
            elif self._head >= _BUFFER:
                self.hung = True
        return frames
