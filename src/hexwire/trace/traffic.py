"""The frames and packets of a line, in a list that is bounded: paired, timed, ready for filtering.

Owns numbering them, the times between request and answer, which servos each concerns, which bytes are only the rest
of a frame that began before, and the newest traffic of a link, kept while an arm is open. Keeping costs the link's
owner next to nothing: one append, and now and then 0.1 ms to pack them, without a lock that a reader could hold.
`reading` finds and pairs frames. Must not know links.
"""

from __future__ import annotations

from array import array
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import accumulate, islice
from typing import Any

from hexwire.link.tap import Direction, Passed
from hexwire.wire.tables import BROADCAST_ID, EXT_STATUS_MASK, PROTO_HEXWIRE

from .explain import doubt
from .line_reader import LineReader
from .reading import HEAD_SIZE, TAIL, FrameReading, Reader, packet_problem, u16

__all__ = ["Entry", "Traffic", "TrafficRing"]

_PACKED, _SHARE = 256, 8
"""Most transfers that are packed together, and the share of all bytes beyond which fewer are."""
_OVERHEAD = 16
"""Memory of a packed transfer beside its bytes, about."""


class _Packed:
    """Transfers in a tenth of the memory that objects take.

    Attributes:
        first: Number of the first one.
        memory: Bytes, about.
    """

    __slots__ = ("_data", "_ends", "_sources", "_times", "_whose", "first", "memory")

    def __init__(self, first: int, transfers: list[Passed]) -> None:
        self.first = first
        self._data = b"".join(passed.data for passed in transfers)
        self._ends = array("I", accumulate(len(passed.data) for passed in transfers))
        self._times = array("d", (passed.time for passed in transfers))
        sources = list(dict.fromkeys((passed.direction, passed.url) for passed in transfers))
        places = {source: i for i, source in enumerate(sources)}
        self._sources, self._whose = sources, bytes(places[each.direction, each.url] for each in transfers)
        self.memory = len(self._data) + len(transfers) * _OVERHEAD

    @property
    def newest(self) -> float:
        """Time of the last one."""
        return self._times[-1]

    def after(self, number: int) -> Iterator[tuple[int, Passed]]:
        """Those after a number."""
        for i in range(max(0, number + 1 - self.first), len(self._times)):
            direction, url = self._sources[self._whose[i]]
            data = self._data[self._ends[i - 1] if i else 0 : self._ends[i]]
            yield self.first + i, Passed(direction, data, self._times[i], url)


class TrafficRing:
    """The newest transfers. One thread at a time feeds it; any thread may read.

    Args:
        seconds: Age of the oldest transfer at most, counted from the newest.
        size: Bytes of memory, about.
    """

    def __init__(self, seconds: float = 120.0, size: int = 4 * 1024 * 1024) -> None:
        self._seconds, self._size = seconds, size
        # Others for each change, so that readers need no lock.
        self._packed: tuple[_Packed, ...] = ()
        self._open: tuple[int, list[Passed]] = (1, [])
        self._bytes = 0
        self._number = 0

    def feed(self, passed: Passed) -> None:
        """Keep a transfer; an observer for `TapLink`."""
        first, transfers = self._open
        transfers.append(passed)
        self._number += 1
        self._bytes += len(passed.data)
        if len(transfers) < _PACKED and self._bytes < self._size // _SHARE:
            return
        kept = [each for each in self._packed if each.newest >= passed.time - self._seconds]
        kept.append(_Packed(first, transfers))
        left = sum(each.memory for each in kept)
        while len(kept) > 1 and left > self._size:
            left -= kept.pop(0).memory
        # In this order: a reader that comes between the two sees them packed and not packed, but misses none.
        self._packed = tuple(kept)
        self._open, self._bytes = (self._number + 1, []), 0

    @property
    def newest(self) -> int:
        """Number of the newest transfer; they are counted from 1."""
        return self._number

    def since(self, number: int) -> list[tuple[int, Passed]]:
        """The transfers after a number, oldest first, as far as they are still kept."""
        first, transfers = self._open
        newest = [(i, passed) for i, passed in enumerate(transfers[:], first) if i > number]
        older = (row for each in self._packed if each.first < first for row in each.after(number))
        found = [*older, *newest]
        oldest = found[-1][1].time - self._seconds if found else 0.0
        return [row for row in found if row[1].time >= oldest]


_MOST = 10_000
_SIZE = 8 * 1024 * 1024
_LONGEST_REST = 4096
"""Bytes before the first frame that may be the rest of one."""
_SHOWN = 240
"""Longest text in a row."""


@dataclass(slots=True)
class Entry:
    """One frame or packet, or bytes that are neither.

    Attributes:
        number: Counted from 1.
        reading: What was found.
        problem: What is wrong or doubtful about it; empty if nothing is.
        servos: Ids of the servos that it names.
        name: Command of a frame, instruction of a packet; in lower case, with underscores.
        answers: Number of the request that it answers, or None.
        answered: Number of the newest answer to it, or None.
        took: Seconds from the request to this answer, or to the answer of this request; None without times.
    """

    number: int
    reading: FrameReading
    problem: str
    servos: tuple[int, ...]
    name: str
    answers: int | None = None
    answered: int | None = None
    took: float | None = None

    @property
    def sent(self) -> bool:
        """Whether the host sent it."""
        return self.reading.way is Direction.SENT

    @property
    def bad(self) -> bool:
        """Whether it is no valid frame or packet."""
        return self.reading.kind in ("bad", "garbage")

    def as_row(self) -> list[Any]:
        """Plain values for a table: number, time, sent, kind, size, text, problem, bad, request, milliseconds."""
        reading = self.reading
        took = None if self.took is None or self.answers is None else round(1000 * self.took, 3)
        return [
            self.number,
            round(reading.time, 6),
            int(self.sent),
            reading.kind,
            len(reading.data),
            reading.text[:_SHOWN],
            self.problem[:_SHOWN],
            int(self.bad),
            self.answers,
            took,
        ]


class Traffic:
    """The newest frames of a line.

    Args:
        series: Name of the series of all servos, or board: the series of each Hex7Bot servo, by id.
        bus: Whether the line is a servo bus without a board. If None, it is if it begins with a servo packet.
        most: Entries to keep.
        size: Bytes of their data to keep.

    Attributes:
        lost: Entries that were dropped since they were too many.
    """

    def __init__(
        self, series: str = "board", *, bus: bool | None = None, most: int = _MOST, size: int = _SIZE
    ) -> None:
        self.series, self._bus = series, bus
        self._lines = LineReader(series, bus=bus)
        self._most, self._size = most, size
        self._entries: deque[Entry] = deque()
        self._places: dict[tuple[Any, int], Entry] = {}
        self._bytes = 0
        self._number = 0
        self._heard: dict[Direction, float] = {}
        # Until the first valid frame of a direction: the bytes before it.
        self._before: dict[Direction, list[FrameReading]] = {way: [] for way in Direction}
        self.lost = 0

    def __len__(self) -> int:
        return len(self._entries)

    def __iter__(self) -> Iterator[Entry]:
        return iter(self._entries)

    @property
    def newest(self) -> int:
        """Number of the newest entry."""
        return self._number

    def feed(self, passed: Passed) -> None:
        """Take a transfer. One without bytes ends what is incomplete: the reader of the line waited in vain.

        How far apart bytes come ends nothing: a decoder that was kept waiting gets them together.
        """
        way = passed.direction
        if not passed.data:
            for reading in self._lines.silence(way, self._heard.get(way, passed.time)):
                self._take(reading)
            if not _ends_frame(self._before.get(way, [])):
                self._begin(way, rest=False)
            return
        self._heard[way] = passed.time
        for reading in self._lines.feed(passed):
            self._take(reading)

    def skip(self) -> None:
        """Transfers are missing here: the next ones complete no frame and answer no request from before."""
        self._lines = LineReader(self.series, bus=self._bus)
        self._places.clear()
        self._heard.clear()
        self._before = {way: [] for way in Direction}

    def finish(self) -> None:
        """Give up what is incomplete, at the end of a file."""
        for reading in self._lines.finish():
            self._take(reading)
        for way in Direction:
            self._begin(way, rest=False)

    def _take(self, reading: FrameReading) -> None:
        """Add a reading, but for the rest of a frame that began before the traffic: nothing is wrong with it."""
        before = self._before.get(reading.way)
        if before is not None:
            good = reading.kind in ("frame", "packet")
            if not good:
                before.append(reading)
            longer = sum(len(each.data) for each in before) >= _LONGEST_REST
            if not good and not longer:
                return
            # A frame ends with its tail; nothing marks the end of a packet. What is damaged has begun here.
            ends = reading.kind == "packet" or _ends_frame(before)
            ends = ends and not (before and before[0].kind == "bad" and before[0].start == 0)
            self._begin(reading.way, rest=ends and not longer)
            if not good:
                return
        self._add(reading)

    def _begin(self, way: Direction, *, rest: bool) -> None:
        """The direction has begun; what came before is the rest of a frame, or is shown as what it is."""
        before = self._before.pop(way, [])
        for reading in () if rest else before:
            self._add(reading)

    def get(self, number: int) -> Entry | None:
        """An entry by its number; None if it is not kept."""
        at = number - self._number + len(self._entries) - 1
        return self._entries[at] if 0 <= at < len(self._entries) else None

    def since(self, number: int, most: int | None = None) -> list[Entry]:
        """The entries after a number, oldest first; only the newest `most` of them."""
        wanted = max(0, min(self._number - number, len(self._entries)))
        found = list(islice(reversed(self._entries), wanted if most is None else min(wanted, most)))
        found.reverse()
        return found

    def _add(self, reading: FrameReading) -> None:
        self._number += 1
        reader = self._lines.reader
        problem = doubt(reading) or _reported(reading, reader)
        entry = Entry(self._number, reading, problem, _servos(reading, reader), _name(reading))
        asked = reading.answers
        request = None if asked is None else self._places.get((asked.way, asked.start))
        if request is not None:
            entry.answers, request.answered = request.number, entry.number
            if reading.time and request.reading.time:
                entry.took = request.took = reading.time - request.reading.time
        self._entries.append(entry)
        if not reading.answer:
            self._places[reading.way, reading.start] = entry
        self._bytes += len(reading.data)
        while len(self._entries) > self._most or (self._bytes > self._size and len(self._entries) > 1):
            gone = self._entries.popleft()
            place = gone.reading.way, gone.reading.start
            if self._places.get(place) is gone:
                del self._places[place]
            self._bytes -= len(gone.reading.data)
            self.lost += 1


def _ends_frame(before: list[FrameReading]) -> bool:
    """Whether the bytes are what the end of a frame may be."""
    data = b"".join(each.data for each in before)
    return data.endswith(TAIL) or TAIL.endswith(data)


def _name(reading: FrameReading) -> str:
    """Command or instruction; empty if it has none."""
    reader = _READER
    if reading.kind == "frame":
        row = reader.tables["commands"].get(reading.data[38])
        return str(row["name"]).lower() if row else ""
    if reading.kind == "packet" and not reading.answer and reading.data[1] == 0xFF:
        return str(reader.tables["instructions"].get(reading.data[4], "")).replace(" ", "_")
    return "status" if reading.kind == "packet" else ""


_NAMING = {("servo_id", "u8"), ("mask", "u16")}
"""Fields that name servos: one, or the joints of a board."""


def _reported(reading: FrameReading, reader: Reader) -> str:
    """What an answer says went wrong, in general words; empty if nothing did. Its text has the error."""
    if not reading.answer:
        return ""
    data, packet = reading.data, reading.data if reading.kind == "packet" else b""
    if reading.kind == "frame":
        if data[33] == PROTO_HEXWIRE and data[39] & EXT_STATUS_MASK:
            return "the board reports an error"
        inner = reader.inner_packet(data, data[HEAD_SIZE : HEAD_SIZE + u16(data, 36)], from_board=True)
        packet = b"" if inner is None else inner.packet
    return "" if not packet or packet_problem(packet) or not packet[4] else "the servo reports an error"


def _servos(reading: FrameReading, reader: Reader) -> tuple[int, ...]:
    if reading.kind == "packet":
        return _packet_servos(reading.data, reading.answer, reader)
    if reading.kind != "frame":
        return ()
    data = reading.data
    body = data[HEAD_SIZE : HEAD_SIZE + u16(data, 36)]
    inner = reader.inner_packet(data, body, reading.answer)
    if inner is not None:
        return () if packet_problem(inner.packet) else _packet_servos(inner.packet, reading.answer, reader)
    layout = reader.layout(data)
    if not body or layout is None:
        return ()
    if not any((name, kind) in _NAMING for name, kind, _ in (*layout["fields"], *layout["rows"])):
        return ()
    joints = tuple(reader.tables["joints"]) if reader.series == "board" else ()
    found: list[int] = []
    for item in (item for each in reader.body_items(body, layout) or () for item in each):
        if item.name == "servo_id" and item.value is not None:
            found += joints if item.value == BROADCAST_ID else (item.value,)
        elif item.name == "mask" and item.value is not None:
            found += (servo for i, servo in enumerate(joints) if item.value >> i & 1)
    return tuple(found)


def _packet_servos(packet: bytes, answer: bool, reader: Reader) -> tuple[int, ...]:
    access = None if answer or packet[1] == 0xF5 else reader.access(packet)
    return tuple(access.servos) if access is not None and access.servos else (packet[2],)


_READER = LineReader().reader
"""For its tables."""
