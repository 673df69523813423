"""Frames from a stream of bytes: finds them, checks them, counts the bytes it discards.

Owns the receive buffer. Bad bytes give a `BadFrame` or `Garbage` event and a counter; no input raises. Time comes
in as `now`. Knows nothing of requests and replies.

PROTOCOL.md section 3 says why the size of a frame, and never its tail, marks its end.
"""

from __future__ import annotations

from dataclasses import dataclass

from hexwire.wire import tables
from hexwire.wire.command_frame import Frame, examine
from hexwire.wire.tables import FRAME_OVERHEAD, SYNC_BYTES

from .events import BadFrame, Garbage

__all__ = ["DecoderCounters", "FrameDecoder"]

_SAMPLE = 64
_SYNC_TAILS = tuple(SYNC_BYTES[:n] for n in (3, 2, 1))


@dataclass(slots=True)
class DecoderCounters:
    """Frames and bytes that a decoder has processed since it was made."""

    bytes_received: int = 0
    frames: int = 0
    bad_frames: int = 0
    bad_checks: int = 0
    resyncs: int = 0
    bytes_dropped: int = 0


class FrameDecoder:
    """A resynchronising decoder with a bounded buffer.

    Args:
        max_frame: Longest frame accepted, bytes.
        max_buffer: Most bytes kept between calls of `receive`; older bytes are dropped and counted. Only a caller
            that does not take its events reaches it.
    """

    def __init__(
        self,
        max_frame: int = tables.MAX_SERIAL_FRAME,
        *,
        max_buffer: int = 65536,
    ) -> None:
        self.max_frame = max_frame
        self.counters = DecoderCounters()
        self._max_buffer = max(max_buffer, max_frame)
        self._data = b""
        self._pos = 0
        self._skipped = 0
        self._sample = b""
        self._last_rx = 0.0
        self._waiting = False

    def receive(self, data: bytes, now: float) -> None:
        """Process bytes from the line; `next_event` returns the events."""
        if not data:
            # An empty read must not extend the time-out of an unfinished frame.
            return
        self.counters.bytes_received += len(data)
        self._last_rx = now
        self._waiting = False
        held = self._data
        if self._pos == len(held):
            self._data = bytes(data)
        else:
            self._skip_to(len(held) - self._max_buffer)
            self._data = held[self._pos :] + data
        self._pos = 0

    def next_event(self) -> Frame | BadFrame | Garbage | None:
        """Return the next event of the stream, or None if more bytes are needed."""
        data = self._data
        end = len(data)
        while self._pos < end:
            start = self._pos
            if not data.startswith(SYNC_BYTES, start):
                found = data.find(SYNC_BYTES, start)
                if found < 0:
                    self._skip_to(end - self._partial_sync(data, start))
                    break
                self._skip_to(found)
                start = found
            result = examine(data, start, self.max_frame)
            if result.__class__ is str and result.startswith("head:"):
                self._skip_to(start + 1)
                continue
            if self._skipped:
                return self._garbage()
            if isinstance(result, Frame):
                # As `Frame.size`, without the call: this runs for every frame.
                self._pos = start + FRAME_OVERHEAD + (len(result.body) + 3 & ~3)
                self.counters.frames += 1
                return result
            if isinstance(result, int):
                self._waiting = True
                return None
            return self._bad(result, start)
        if self._skipped:
            return self._garbage()
        self._waiting = self._pos < end
        return None

    def next_timeout(self) -> float | None:
        """Time at which to call `handle_timeout`, or None."""
        return self._last_rx + tables.INTERBYTE_TIMEOUT if self._waiting else None

    def handle_timeout(self, now: float) -> BadFrame | Garbage | None:
        """Discard an unfinished frame if the line has been silent long enough.

        The search continues at its second byte: call `next_event` afterwards, and then this again until it returns
        None.
        """
        if not self._waiting or now < self._last_rx + tables.INTERBYTE_TIMEOUT:
            return None
        return self.end_of_message("unfinished")

    def end_of_message(self, reason: str = "cut short") -> BadFrame | Garbage | None:
        """Treat unfinished bytes as bad, because the message ends. For links that keep message boundaries.

        As with `handle_timeout`, call `next_event` afterwards, and then this again until it returns None.
        """
        start = self._pos
        if start >= len(self._data):
            return None
        self._waiting = False
        if not self._data.startswith(SYNC_BYTES, start):
            self._skip_to(len(self._data))
            return self._garbage()
        return self._bad(reason, start)

    def reset(self) -> int:
        """Discard the buffer; returns the number of bytes discarded."""
        held = len(self._data) - self._pos
        self.counters.bytes_dropped += held
        self._data = self._sample = b""
        self._pos = self._skipped = 0
        self._waiting = False
        return held

    def _bad(self, reason: str, start: int) -> BadFrame:
        # The search continues at the second byte; this event reports the first, so it is not garbage.
        self._pos = start + 1
        self.counters.bytes_dropped += 1
        self.counters.bad_frames += 1
        if reason.startswith("check"):
            self.counters.bad_checks += 1
        return BadFrame(reason, self._data[start : start + _SAMPLE])

    def _skip_to(self, position: int) -> None:
        skipped = position - self._pos
        if skipped <= 0:
            return
        if self._skipped < _SAMPLE:
            self._sample += self._data[self._pos : min(position, self._pos + _SAMPLE - self._skipped)]
        self._skipped += skipped
        self.counters.bytes_dropped += skipped
        self._pos = position

    def _garbage(self) -> Garbage:
        event = Garbage(self._skipped, self._sample)
        self._skipped = 0
        self._sample = b""
        self.counters.resyncs += 1
        return event

    @staticmethod
    def _partial_sync(data: bytes, start: int) -> int:
        for tail in _SYNC_TAILS:
            if data.endswith(tail) and len(data) - start >= len(tail):
                return len(tail)
        return 0
