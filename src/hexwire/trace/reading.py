# SPDX-License-Identifier: Apache-2.0 OR GPL-2.0-or-later
"""Describes the bytes on a line in words: command frames with their servo packets, or a servo bus.

Owns finding frames in a stream, matching answers with requests, and the wording, which ``vectors/readings.jsonl``
specifies. `make analyzers` copies this file into the analysers for sigrok and Logic 2, which run inside GPL
programs. So it has both licences, and needs only the standard library of Python 3.8 and the tables that are passed
to it (`reading_tables`). It is one file because it is copied. Never raises, for any bytes.
"""

from __future__ import annotations

import re
from binascii import crc_hqx
from collections.abc import Iterator, Mapping
from itertools import accumulate
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from typing import Literal

    Order = Literal["little", "big"]

__all__ = [
    "CEILING",
    "COOKED",
    "HEAD_SIZE",
    "TAIL",
    "Field",
    "FrameReading",
    "Inner",
    "Reader",
    "RegisterAccess",
    "has_ceiling_hazard",
    "packet_problem",
    "to_hex",
    "u16",
]

SYNC = b"\x5a\xfa\xfa\x5a"
TAIL = b"\r\n"
COOKED = b"\n\n"
HEAD_SIZE = 40
OVERHEAD = 44
MIN_PACKET, MAX_PACKET = 6, 250
MOST_ASKED = 1024  # requests that wait for an answer: whoever sends, sets their number
SAMPLE = 24  # most bytes shown of an undecoded body
SIZES = {"u8": 1, "i8": 1, "u16": 2, "i16": 2, "u32": 4, "i32": 4}
READ, REG_WRITE, WRITE, SYNC_READ, SYNC_WRITE = 2, 4, 3, 0x82, 0x83
CMD_SYNC_WRITE, CMD_TRANSACT = 3, 0x1A
CEILING = "run time in the current ceiling of an HLS servo"
MARKER = " ! 0D 0A inside, a board of the chapter cuts the frame there"
MISFIT = " ! the body does not fit the command"
ICRNL = " ! tail 0A 0A, the port was left with ICRNL"
_FROM_BOARD = ("from_board", "through")
_READ_AT, _WRITTEN_AT = range(2, 3), range(1, 2)
# In a run of FF, only the last two can be a header: no servo has the id 255.
HEADER = re.compile(rb"\xff(?:\xff(?!\xff)|\xf5)")


class FrameReading(NamedTuple):
    """One frame, packet, or bytes that are neither.

    Attributes:
        kind: frame, packet, bad or garbage.
        way: Name of the stream; there is one for each direction.
        start: Offset of its first byte in that stream.
        end: Offset after its last byte.
        text: Description.
        data: Its bytes.
        time: Time of its last byte.
        said: Where `words` are in the text: of thousands that are kept, none has them twice.
        problem: Why it is bad; empty if it is not.
        answer: Whether it is an answer: a frame from the board, or a status packet.
        answers: The request that it answers, or None.
        line: How it was read: host or bus.
    """

    kind: str
    way: Any
    start: int
    end: int
    text: str
    data: bytes
    time: float = 0.0
    said: tuple[int, int] = (0, 0)
    problem: str = ""
    answer: bool = False
    answers: FrameReading | None = None
    line: str = "host"

    @property
    def words(self) -> str:
        """The part of the text for a frame's body or for a packet, with its hazard."""
        begin, end = self.said
        return self.text[begin:end]


class Field(NamedTuple):
    """A value among bytes.

    Attributes:
        name: Its name.
        start: Offset of its first byte in the bytes that were passed.
        end: Offset after its last byte.
        value: The number; None for bytes.
        words: Name and value.
    """

    name: str
    start: int
    end: int
    value: int | None
    words: str


class Inner(NamedTuple):
    """A servo packet in a frame's body.

    Attributes:
        packet: Its bytes; they need not be a valid packet.
        start: Their offset in the body.
        where: to_board, from_board, or through (see `Reader.servo_place`).
        order: Byte order of written values if it is not that of the series.
    """

    packet: bytes
    start: int
    where: str
    order: Order | None


class RegisterAccess(NamedTuple):
    """What a request on the servo bus reads or writes.

    Attributes:
        address: The first register.
        size: Bytes for each servo, if the packet says it.
        servos: Their ids.
        starts: Offset in the parameters of what each gets; in a request to several, its id is right before that.
        length: Bytes that each gets; 0 if it is asked.
        fits: It has as many parameters as its instruction takes.
    """

    address: int
    size: int | None
    servos: bytes
    starts: range
    length: int
    fits: bool


class Piece(NamedTuple):
    """A part of the received bytes: frame, cooked, packet, bad or garbage."""

    kind: str
    start: int
    end: int
    problem: str


def to_hex(data: bytes, limit: int | None = None) -> str:
    """Bytes as hex, at most `limit` of them."""
    if limit is not None and len(data) > limit:
        return to_hex(data[:limit]) + " ..."
    return " ".join(f"{byte:02X}" for byte in data)


def u16(data: bytes, at: int) -> int:
    """Read a little-endian 16-bit number."""
    return data[at] | data[at + 1] << 8


def frame_check(data: bytes) -> int:
    """CRC-16/IBM-3740; FFFF is sent as 0000."""
    crc = crc_hqx(data, 0xFFFF)
    return 0 if crc == 0xFFFF else crc


def servo_sum(data: bytes) -> int:
    """Checksum of a servo packet, from its id to its last parameter."""
    return ~sum(data) & 0xFF


class Reader:
    """Reads one line.

    Args:
        tables: See `reading_tables`.
        line: host (frames) or bus (servo packets); it may be changed between calls.
        series: Series of all servos, or board: the series of each Hex7Bot servo, by id.
    """

    def __init__(self, tables: Mapping[str, Any], line: str = "host", series: str = "board") -> None:
        self.tables = tables
        self.line = line
        self.series = series
        self._rest: dict[Any, bytes] = {}  # stream -> bytes of an incomplete frame
        self._at: dict[Any, int] = {}  # stream -> their offset in it
        self._asked: dict[Any, tuple[FrameReading, bytes]] = {}  # slot -> request, its servo packet

    def feed(self, data: bytes, way: Any = "", time: float = 0.0) -> list[FrameReading]:
        """Take bytes of one stream; returns the Readings that they complete."""
        return self._read(bytes(data), way, time, False)

    def silence(self, way: Any = "", time: float = 0.0) -> list[FrameReading]:
        """Give up an incomplete frame after a long pause, or at the end."""
        return self._read(b"", way, time, True)

    def unfinished(self, way: Any = "") -> bytes:
        """The bytes of an incomplete frame or packet."""
        return self._rest.get(way, b"")

    def series_of(self, servo: int) -> str | None:
        """Name of a servo's series; None if unknown."""
        return self.tables["joints"].get(servo) if self.series == "board" else self.series

    def _read(self, fresh: bytes, way: Any, time: float, final: bool) -> list[FrameReading]:
        data, base = self._rest.get(way, b"") + fresh, self._at.get(way, 0)
        pieces = list(self._cut_frames(data, final) if self.line == "host" else self._cut_packets(data, final))
        rest = pieces[-1].end if pieces else 0
        self._rest[way], self._at[way] = data[rest:], base + rest
        return [self._word(piece, data[piece.start : piece.end], way, base, time) for piece in pieces]

    def _word(self, piece: Piece, data: bytes, way: Any, base: int, time: float) -> FrameReading:
        place = way, base + piece.start, base + piece.end
        if piece.kind == "garbage":
            return FrameReading("garbage", *place, f"garbage: {len(data)} bytes", data, time, line=self.line)
        if piece.kind == "bad":
            name = "frame" if self.line == "host" else "packet"
            text = f"bad {name}: {piece.problem}"
            return FrameReading("bad", *place, text, data, time, (0, 0), piece.problem, line=self.line)
        if piece.kind == "packet":
            return self._packet(place, data, time)
        return self._frame(place, data, time, piece.kind == "cooked")

    # -- finding ------------------------------------------------------------------------------------

    def _examine(self, data: bytes, at: int) -> tuple[str, int, str]:
        """Kind (head, more, frame, cooked, bad), number of bytes needed or used, and the problem."""
        available = len(data) - at
        if available < HEAD_SIZE:
            return "more", HEAD_SIZE, ""
        size = u16(data, at + 28) | u16(data, at + 30) << 16
        dialect, pad, length = data[at + 33], data[at + 35], u16(data, at + 36)
        if size > self.tables["max_frame"] or data[at + 32] != 0x82 or dialect not in (1, 2):
            return "head", 0, ""
        if size != OVERHEAD + length + pad or pad != -length % 4:
            return "head", 0, ""
        if available < size:
            return "more", size, ""
        tail = data[at + size - 2 : at + size]
        if tail not in (TAIL, COOKED):
            return "bad", size, f"tail is {to_hex(tail)}, not 0D 0A"
        check = u16(data, at + HEAD_SIZE + length)
        wanted = frame_check(data[at : at + HEAD_SIZE + length]) if dialect == 2 else check
        if check != wanted:
            cooked = tail == COOKED
            return "bad", size, "tail is 0A 0A, not 0D 0A" if cooked else f"check is {check:04X}, not {wanted:04X}"
        return ("cooked" if tail == COOKED else "frame"), size, ""

    def _cut_frames(self, data: bytes, final: bool) -> Iterator[Piece]:
        done = at = 0
        while True:
            start = data.find(SYNC, at)
            if start < 0:
                keep = 0 if final else next((n for n in (3, 2, 1) if data.endswith(SYNC[:n])), 0)
                yield from _garbage(done, len(data) - keep)
                return
            kind, size, problem = self._examine(data, start)
            if kind == "head":
                at = start + 1
                continue
            yield from _garbage(done, start)
            if kind == "more" and not final:
                return
            end = start + size
            if kind in ("more", "bad"):
                problem = problem or f"cut short, {len(data) - start} of {size} bytes"
                # Bad bytes end where the next frame may begin.
                following = data.find(SYNC, start + 1, end)
                kind, end = "bad", min(end, len(data)) if following < 0 else following
            yield Piece(kind, start, end, problem)
            done = at = end

    def _cut_packets(self, data: bytes, final: bool) -> Iterator[Piece]:
        done = at = 0
        # Running sums, since adding up each of many overlapping packets would take long.
        totals: Iterator[int] = accumulate(data, _add, initial=0)
        sums = bytes(totals)
        while True:
            start = _header(data, at)
            if start < 0:
                yield from _garbage(done, len(data) - (1 if not final and data.endswith(b"\xff") else 0))
                return
            head = data[start : start + MIN_PACKET]
            length = head[3] if len(head) > 3 else 2
            if not 2 <= length <= MAX_PACKET - 4:
                at = start + 1
                continue
            # The length byte of a legacy servo's answer to a ping, and of most board errors, is 6, the full size.
            quirk = len(head) == 6 and head[1] == 0xF5 and length == 6 and head[5] == servo_sum(head[2:5])
            size = MIN_PACKET if quirk else 4 + length
            kind, end, problem = "packet", start + size, ""
            yield from _garbage(done, start)
            if len(data) < end:
                if not final:
                    return
                kind, end, problem = "bad", len(data), f"cut short, {len(data) - start} of {size} bytes"
            else:
                wanted = ~(sums[end - 1] - sums[start + 2]) & 0xFF
                if data[end - 1] != wanted:
                    kind, problem = "bad", f"checksum {data[end - 1]:02X}, not {wanted:02X}"
            if kind == "bad":
                following = _header(data, start + 2)
                end = following if 0 < following < end else end
            yield Piece(kind, start, end, problem)
            done = at = end

    # -- matching answers with requests -------------------------------------------------------------

    def _frame(self, place: tuple[Any, int, int], data: bytes, time: float, cooked: bool) -> FrameReading:
        dialect, seq, cmd, ext = data[33], data[34], data[38], data[39]
        reply, report = dialect == 2 and ext & 0x80, dialect == 2 and ext & 0x40
        src, dst = _i32(data, 16), _i32(data, 20)
        from_board = bool(reply or (dialect == 1 and src == self.tables["board_module"]))
        body = data[HEAD_SIZE : HEAD_SIZE + u16(data, 36)]
        slot = "chapter" if dialect == 1 else (dst if from_board else src, seq, cmd)
        asked = self._asked.pop(slot, None) if from_board else None
        head = self._head_words(data)
        words, hazard = self._inner_words(data, body, asked[1] if asked else None, from_board)
        text = head + (f": {words}" if body else "") + hazard
        said = len(head) + 2 * bool(body), len(text)
        if dialect == 1 and 0 <= data.find(TAIL, 4) < len(data) - 2:
            text += MARKER
        text += ICRNL if cooked else ""
        before = asked[0] if asked else None
        found = FrameReading("frame", *place, text, data, time, said, "", from_board, before)
        if not from_board and (reply or not report) and not (dialect == 1 and cmd == CMD_SYNC_WRITE):
            self._asked[slot] = (found, body[2:] if cmd == CMD_TRANSACT else body)
            if len(self._asked) > MOST_ASKED:
                del self._asked[next(iter(self._asked))]
        return found

    def _packet(self, place: tuple[Any, int, int], data: bytes, time: float) -> FrameReading:
        asked = self._asked.get("bus")
        words, answer, hazard = self._servo_words(data, asked[1] if asked else None, "bus", None)
        text, before = words + hazard, asked[0] if answer and asked else None
        found = FrameReading("packet", *place, text, data, time, (0, len(text)), "", answer, before, "bus")
        if not answer:
            self._asked["bus"] = (found, data)
        elif asked and asked[1][4] != SYNC_READ:
            del self._asked["bus"]
        return found

    # -- words --------------------------------------------------------------------------------------

    def _head_words(self, data: bytes) -> str:
        dialect, seq, cmd, ext = data[33], data[34], data[38], data[39]
        row = self.tables["commands"].get(cmd)
        text = f"{dialect} {row['name'] if row else f'command 0x{cmd:02X}'}"
        if dialect == 2 and ext & 0x80:
            status = ext & 0x3F
            text += f" reply {self.tables['statuses'].get(status, f'status {status}')}"
        elif dialect == 2:
            text += " report" if ext & 0x40 else " request"
        return f"{text} seq {seq}"

    def _inner_words(self, data: bytes, body: bytes, asked: bytes | None, from_board: bool) -> tuple[str, str]:
        """Description of a body, and its hazard."""
        if not body:
            return "", ""
        inner = self.inner_packet(data, body, from_board)
        if inner is None:
            layout = self.layout(data)
            parts = self.body_items(body, layout) if layout else None
            if parts is None:
                return to_hex(body, SAMPLE), MISFIT if layout else ""
            head, *rows = (", ".join(item.words for item in part) for part in parts)
            return " ".join(part for part in (head, *(f"({each})" for each in rows)) if part), ""
        before = f"reply_length {body[0]}, timeout_ms {body[1]}; " if inner.start else ""
        problem = packet_problem(inner.packet)
        if problem:
            return f"{before}bad packet, {problem}: {to_hex(inner.packet, SAMPLE)}", ""
        words, _, hazard = self._servo_words(inner.packet, asked, inner.where, inner.order)
        return before + words, hazard

    def inner_packet(self, data: bytes, body: bytes, from_board: bool) -> Inner | None:
        """The servo packet in a frame with this body; None if the command has none."""
        cmd = data[38]
        if not body or (cmd > CMD_SYNC_WRITE and cmd != CMD_TRANSACT):
            return None
        start = 0 if cmd != CMD_TRANSACT or (data[33] == 2 and data[39] & 0x80) else min(2, len(body))
        where = "to_board" if not from_board else "through" if cmd == CMD_TRANSACT else "from_board"
        return Inner(body[start:], start if start == 2 else 0, where, "little" if cmd == CMD_SYNC_WRITE else None)

    def layout(self, data: bytes) -> Mapping[str, Any] | None:
        """The layout of a frame's body; None if its command is unknown."""
        row = self.tables["commands"].get(data[38])
        return row["reply" if data[33] == 2 and data[39] & 0xC0 else "request"] if row else None

    def body_items(self, data: bytes, layout: Mapping[str, Any]) -> list[list[Field]] | None:
        """The fields of a body by the layout of its command, then those of each row; None if it does not fit."""
        known: dict[str, int] = {}
        first, at = self._row_items(data, 0, layout["fields"], known, 0)
        if first is None:
            return None
        number = known.get(layout["count"])
        rows = [first]
        while layout["rows"] and at < len(data) and (number is None or len(rows) <= number):
            row, end = self._row_items(data, at, layout["rows"], {}, known.get("fields", 0))
            if row is None or end == at:
                return None
            rows.append(row)
            at = end
        if at != len(data) or (layout["rows"] and number is not None and len(rows) - 1 != number):
            return None
        return rows

    def _row_items(
        self, data: bytes, at: int, row: tuple[tuple[str, str, str], ...], known: dict[str, int], mask: int
    ) -> tuple[list[Field] | None, int]:
        items = []
        for name, kind, wanted in row:
            if wanted and not mask & self.tables["state_fields"][wanted]:
                continue
            end = len(data) if kind == "bytes" else at + SIZES[kind]
            if end > len(data):
                return None, at
            if kind == "bytes":
                items.append(Field(name, at, end, None, f"{name} {to_hex(data[at:], SAMPLE)}"))
            else:
                known[name] = value = int.from_bytes(data[at:end], "little", signed=kind[0] == "i")
                items.append(Field(name, at, end, value, f"{name} {value}"))
            at = end
        return items, at

    def _servo_words(
        self, data: bytes, asked: bytes | None, where: str, order: Order | None
    ) -> tuple[str, bool, str]:
        """Description of a valid packet, whether it is an answer, and its hazard.

        Args:
            data: The packet.
            asked: The servo packet of the request, if known.
            where: bus, to_board, from_board, or through: from a board that passed it on unchanged.
            order: Byte order of values if it is not that of the series.
        """
        if data[1] == 0xF5 or where in _FROM_BOARD or (where == "bus" and self._is_status(data, asked)):
            return self._status_words(data, asked, where), True, ""
        words, hazard = self._request_words(data, order)
        return words, False, f" ! {CEILING}" if hazard else ""

    def _is_status(self, data: bytes, asked: bytes | None) -> bool:
        """Whether a packet with FF FF on a bus is an answer, from the last request and what a request can be."""
        inst = data[4]
        if inst not in self.tables["instructions"] or (inst in self.tables["bare"] and len(data) > 6):
            return True
        # A repeated request is not an answer.
        if asked is None or data == asked or self.tables["replies"].get(asked[4]) == "never":
            return False
        reads = asked[4] in (READ, SYNC_READ) and len(asked) > 7
        same = asked[2] == data[2] or (asked[4] == SYNC_READ and data[2] in asked[7:-1])
        return same and len(data) == (asked[6] + 6 if reads else 6)

    def _status_words(self, data: bytes, asked: bytes | None, where: str) -> str:
        legacy, servo, error, params = data[1] == 0xF5, data[2], data[4], data[5:-1]
        named = self.tables["board_errors"].get(error)
        if where in _FROM_BOARD and legacy and named:
            silent = error == 1 and len(data) == 8 and params == b"\0\0"
            if silent or (error != 1 and not params and (servo == 0xFF or named == "ping silent")):
                return f"board error {named}" + ("" if servo == 0xFF else f", servo {servo}")
        text = f"status {servo}" + (" legacy" if legacy else "")
        if error:
            bits = [name for bit, name in sorted(self.tables["status_bits"].items()) if error & bit]
            text += f" error {', '.join(bits) or f'0x{error:02X}'}"
        if not params:
            return text
        items = self.answer_items(data, asked, where)
        return f"{text}: {to_hex(params) if items is None else _listed(items)}"

    def answer_items(self, data: bytes, asked: bytes | None, where: str) -> list[Field] | None:
        """The registers in the parameters of a status packet; None if they are unknown."""
        legacy, servo, params = data[1] == 0xF5, data[2], data[5:-1]
        series = self.series_of(servo) or ("seven_bot" if legacy else None)
        if not (asked and len(asked) > 6 and asked[4] in (READ, SYNC_READ) and series):
            return None
        # The board swaps the two bytes of a legacy servo's answer.
        swapped = where == "from_board" and series == "seven_bot" and len(params) == 2
        return self.register_items(series, asked[5], params, "little" if swapped else None)

    def _request_words(self, data: bytes, order: Order | None) -> tuple[str, bool]:
        servo, inst, params = data[2], data[4], data[5:-1]
        name = self.tables["instructions"].get(inst, f"instruction 0x{inst:02X}")
        who = "all" if servo == 0xFE else str(servo)
        access = self.access(data)
        if access is None or not access.fits:
            return f"{name} {who}" + (f": {to_hex(params)}" if params else ""), False
        if inst in (READ, SYNC_READ):
            asked = who if inst == READ else " ".join(map(str, access.servos))
            register = self._register(self.series_of(access.servos[0]), access.address)
            return f"{name} {asked}: {register}, {access.size} bytes", False
        if inst != SYNC_WRITE:
            series, values = self.series_of(servo), params[1:]
            hazard = has_ceiling_hazard(series, access.address, values)
            return f"{name} {who}: {self._placed(series, access.address, values, None)}", hazard
        hazard, rows = False, []
        for start in access.starts:
            servo, values = params[start - 1], params[start : start + access.length]
            series = self.series_of(servo)
            hazard = hazard or has_ceiling_hazard(series, access.address, values)
            rows.append(f"{servo} {self._placed(series, access.address, values, order)}")
        return f"{name}: " + "; ".join(rows), hazard

    def access(self, data: bytes) -> RegisterAccess | None:
        """What a request reads or writes; None if it does neither, or not as its instruction wants."""
        inst, params = data[4], data[5:-1]
        count = len(params)
        if not count:
            return None
        size = params[1] if count > 1 else None
        if inst == READ:
            return RegisterAccess(params[0], size, data[2:3], _READ_AT, 0, count == 2)
        if inst in (WRITE, REG_WRITE):
            return RegisterAccess(params[0], None, data[2:3], _WRITTEN_AT, count - 1, count > 1)
        if inst == SYNC_READ:
            return RegisterAccess(params[0], size, params[2:], range(3, count + 1), 0, count > 2)
        step = 1 + (size or 0)
        if inst != SYNC_WRITE or count < 3 or (count - 2) % step:
            return None
        return RegisterAccess(params[0], size, params[2::step], range(3, count + 1, step), step - 1, True)

    def _register(self, series: str | None, address: int) -> str:
        row = self.tables["series"][series]["registers"].get(address) if series else None
        return row[0] if row else f"0x{address:02X}"

    def _placed(self, series: str | None, address: int, data: bytes, order: Order | None) -> str:
        if not series:
            return f"0x{address:02X} {to_hex(data)}"
        return _listed(self.register_items(series, address, data, order))

    def register_items(self, series: str, address: int, data: bytes, order: Order | None) -> list[Field]:
        """The registers of a series in bytes from an address.

        Args:
            series: Its name in the tables.
            address: Of the first byte.
            data: The bytes.
            order: Byte order if it is not that of the series.
        """
        rows = self.tables["series"][series]
        items, at = [], 0
        while at < len(data):
            row = rows["registers"].get(address + at)
            if row is None or at + row[1] > len(data):
                name = f"0x{address + at:02X}"
                items.append(Field(name, at, at + 1, data[at], f"{name} {data[at]}"))
                at += 1
                continue
            name, size, sign, unit, scale = row
            raw = int.from_bytes(data[at : at + size], order or rows["byte_order"])
            if sign >= 0 and raw >> sign & 1:
                raw = -(raw & ((1 << sign) - 1))
            text = f"{name} {raw}"
            if scale:
                text += f" = {raw * scale:.6g} {'deg' if unit == 'count' else unit}"
            items.append(Field(name, at, at + size, raw, text))
            at += size
        return items


def _listed(items: list[Field]) -> str:
    return ", ".join(item.words for item in items)


def _garbage(start: int, end: int) -> Iterator[Piece]:
    if end > start:
        yield Piece("garbage", start, end, "")


def _add(total: int, byte: int) -> int:
    return (total + byte) & 0xFF


def _header(data: bytes, at: int) -> int:
    found = HEADER.search(data, at)
    return -1 if found is None else found.start()


def packet_problem(data: bytes) -> str:
    """Why this is not a valid servo packet; empty if it is."""
    if len(data) < MIN_PACKET or data[:2] not in (b"\xff\xff", b"\xff\xf5"):
        return "no header"
    if data[3] != len(data) - 4 and not (data[1] == 0xF5 and len(data) == 6 == data[3]):
        return f"length {data[3]}"
    wanted = servo_sum(data[2:-1])
    return "" if data[-1] == wanted else f"checksum {data[-1]:02X}, not {wanted:02X}"


def has_ceiling_hazard(series: str | None, address: int, data: bytes) -> bool:
    """Whether this is the chapter's 4-byte block on an HLS servo: it writes a run time to the current limit."""
    return series == "hls" and address == 42 and len(data) == 4


def _i32(data: bytes, at: int) -> int:
    return int.from_bytes(data[at : at + 4], "little", signed=True)
