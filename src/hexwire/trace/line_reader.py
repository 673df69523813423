"""Reads the transfers of one link as frames or servo packets: decides by itself whether a board or a bus is there.

Owns that decision and the order of transfers; `reading` finds frames and matches answers with requests. Never
raises.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator

from hexwire.link.tap import Direction, Passed
from hexwire.wire import tables

from .reading import FrameReading, Reader
from .reading_tables import TABLES

__all__ = ["LineReader"]

_PIECE = 1 << 16
"""Bytes that are read at a time, since all frames found in them are kept in memory."""


class LineReader:
    """Reads the traffic of one link, transfer by transfer.

    Args:
        series: Name of the series of all servos, or board: the series of each Hex7Bot servo, by id.
        bus: Whether the line is a servo bus without a board. If None, it is if it begins with a servo packet.

    Attributes:
        reader: Finds the frames.
    """

    def __init__(self, series: str = "board", *, bus: bool | None = None) -> None:
        self.reader = Reader(TABLES, series=series)
        self._bus = bus
        self._lines = dict.fromkeys(Direction, "host")
        self._framed: set[Direction] = set()
        # If the caller stops iterating early, the rest comes with the next transfer.
        self._left: deque[Passed] = deque()
        self._found: deque[FrameReading] = deque()

    def feed(self, passed: Passed) -> Iterator[FrameReading]:
        """Read the frames that this transfer completes."""
        for at in range(0, len(passed.data), _PIECE):
            self._left.append(passed._replace(data=passed.data[at : at + _PIECE]))
        while self._found or self._left:
            if self._found:
                yield self._found.popleft()
                continue
            way, data, time, _ = self._left.popleft()
            self.reader.line = self._lines[way] = self._line(way, data)
            self._found += self.reader.feed(data, way, time)

    def silence(self, way: Direction, time: float = 0.0) -> list[FrameReading]:
        """Give up an incomplete frame of one direction after a long pause."""
        self.reader.line = self._lines[way]
        return self.reader.silence(way, time)

    def finish(self) -> Iterator[FrameReading]:
        """Give up the incomplete bytes at the end."""
        for way in Direction:
            yield from self.silence(way)

    def waits(self, way: Direction) -> bool:
        """Whether bytes of that direction wait for the rest of their frame."""
        return bool(self.reader.unfinished(way))

    def _line(self, way: Direction, data: bytes) -> str:
        """How to read these bytes, host or bus: once a frame was found, the line is not a bus."""
        if self._bus is not None:
            return "bus" if self._bus else "host"
        data = self.reader.unfinished(way) + data
        if tables.SYNC_BYTES in data:
            self._framed.add(way)
        if way in self._framed:
            return "host"
        # An answer may come byte by byte: its first one says nothing, but the request did.
        begins = data.startswith((tables.SERVO_HEADER, tables.LEGACY_HEADER))
        return (
            "bus" if begins or any(self._lines[other] == "bus" for other in Direction if other != way) else "host"
        )
