# SPDX-License-Identifier: GPL-2.0-or-later
# ruff: noqa: UP031  (the formats stand as in hexwire.lua, which must come to the same words)
"""Bytes of a hexwire line, put into words: command frames with their servo packets, or a bare servo bus.

Owns finding frames in a stream and wording them. Knows nothing of the program it runs in, and needs nothing but
the table that is given to it: analysers load a folder of their own. Never raises, whatever the bytes.
"""

from __future__ import annotations

from collections import namedtuple

SYNC = b"\x5a\xfa\xfa\x5a"
TAIL = b"\r\n"
COOKED = b"\n\n"
HEAD_SIZE = 40
OVERHEAD = 44
MAX_PACKET = 250
SAMPLE = 24  # bytes shown of a body that is only bytes
SIZES = {"u8": 1, "i8": 1, "u16": 2, "i16": 2, "u32": 4, "i32": 4}
READ, REG_WRITE, WRITE, SYNC_READ, SYNC_WRITE = 2, 4, 3, 0x82, 0x83
CMD_SYNC_WRITE, CMD_TRANSACT = 3, 0x1A
CEILING = " ! run time in the current ceiling of an HLS servo"
MARKER = " ! 0D 0A inside, a board of the chapter cuts the frame there"
MISFIT = " ! the body does not fit the command"
ICRNL = " ! tail 0A 0A, the port was left with ICRNL"

Reading = namedtuple("Reading", "kind way start end text data answers")
Reading.__doc__ = """One frame, packet, or bytes that are none.

kind: frame, packet, bad or garbage. way: the stream's name. start, end: where in that stream, in bytes. text: in
words. data: its bytes. answers: the Reading it answers, or None.
"""


def to_hex(data, limit=None):
    """Bytes as hex, at most `limit` of them."""
    if limit is not None and len(data) > limit:
        return to_hex(data[:limit]) + " ..."
    return " ".join("%02X" % byte for byte in data)


def u16(data, at):
    return data[at] | data[at + 1] << 8


def frame_check(data):
    """CRC-16/IBM-3740; FFFF goes as 0000."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ 0x1021) & 0xFFFF if crc & 0x8000 else crc << 1
    return 0 if crc == 0xFFFF else crc


def servo_sum(data):
    """Checksum of a servo packet, from its id to its last parameter."""
    return ~sum(data) & 0xFF


class Reader:
    """Reads one line.

    Args:
        tables: The generated table.
        line: host (frames) or bus (servo packets).
        series: Series of all servos, or board: those of the Hex7Bot by id.
    """

    def __init__(self, tables, line="host", series="board"):
        self.tables = tables
        self.line = line
        self.series = series
        self._rest = {}  # way -> bytes of an unfinished frame
        self._at = {}  # way -> where in the stream they begin
        self._asked = {}  # slot -> (Reading, servo packet)

    def feed(self, data, way=""):
        """Take bytes of one way; the Readings that are whole now."""
        return self._read(bytes(data), way, False)

    def silence(self, way=""):
        """Nothing came for long: what is unfinished is given up."""
        return self._read(b"", way, True)

    def _read(self, fresh, way, final):
        data, base = self._rest.get(way, b"") + fresh, self._at.get(way, 0)
        cut = self._cut_frames if self.line == "host" else self._cut_packets
        items, rest = cut(data, final)
        self._rest[way], self._at[way] = data[rest:], base + rest
        return [self._word(kind, data[a:b], way, base + a, base + b, why) for kind, a, b, why in items]

    def _word(self, kind, data, way, start, end, why):
        if kind == "garbage":
            return Reading(kind, way, start, end, "garbage: %d bytes" % len(data), data, None)
        if kind == "bad":
            name = "frame" if self.line == "host" else "packet"
            return Reading(kind, way, start, end, "bad %s: %s" % (name, why), data, None)
        if kind == "packet":
            return self._packet(data, way, start, end)
        return self._frame(data, way, start, end, kind == "cooked")

    # -- finding ------------------------------------------------------------------------------------

    def _examine(self, data, at):
        """Kind and size (of what is wanted or taken), and a reason: head, more, frame, cooked, bad."""
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
            return "bad", size, "tail is %s, not 0D 0A" % to_hex(tail)
        check = u16(data, at + HEAD_SIZE + length)
        wanted = frame_check(data[at : at + HEAD_SIZE + length]) if dialect == 2 else check
        if check != wanted and tail == COOKED:
            return "bad", size, "tail is 0A 0A, not 0D 0A"
        if check != wanted:
            return "bad", size, "check is %04X, not %04X" % (check, wanted)
        return ("cooked" if tail == COOKED else "frame"), size, ""

    def _cut_frames(self, data, final):
        items, done, at = [], 0, 0
        while True:
            start = data.find(SYNC, at)
            if start < 0:
                keep = 0 if final else next((n for n in (3, 2, 1) if data.endswith(SYNC[:n])), 0)
                return _with_garbage(items, done, max(len(data) - keep, done))
            kind, size, why = self._examine(data, start)
            if kind == "head":
                at = start + 1
                continue
            if kind == "more" and not final:
                return _with_garbage(items, done, start)
            end = start + size
            if kind in ("more", "bad"):
                why = why or "cut short, %d of %d bytes" % (len(data) - start, size)
                following = data.find(SYNC, start + 1)
                end = min(end, len(data), following if following > 0 else len(data))
                kind = "bad"
            _with_garbage(items, done, start)
            items.append((kind, start, end, why))
            done = at = end

    def _cut_packets(self, data, final):
        items, done, at = [], 0, 0
        while True:
            start = _packet_start(data, at)
            if start < 0:
                keep = 1 if not final and data.endswith(b"\xff") else 0
                return _with_garbage(items, done, max(len(data) - keep, done))
            head = data[start : start + 6]
            length = head[3] if len(head) > 3 else 2
            # A ping's answer of a legacy servo, and most errors of the board, say 6 and have 6 bytes in all.
            quirk = len(head) == 6 and head[1] == 0xF5 and length == 6 and head[5] == servo_sum(head[2:5])
            size = 6 if quirk else 4 + length
            if head[1:3] == b"\xff\xff" or not 2 <= length <= MAX_PACKET - 4:
                at = start + 1
                continue
            kind, end, why = "packet", start + size, ""
            if len(data) < end:
                if not final:
                    return _with_garbage(items, done, start)
                kind, end, why = "bad", len(data), "cut short, %d of %d bytes" % (len(data) - start, size)
            elif data[end - 1] != servo_sum(data[start + 2 : end - 1]):
                kind, why = "bad", "checksum %02X, not %02X" % (data[end - 1], servo_sum(data[start + 2 : end - 1]))
            if kind == "bad":
                following = _packet_start(data, start + 2)
                end = following if 0 < following < end else end
            _with_garbage(items, done, start)
            items.append((kind, start, end, why))
            done = at = end

    # -- pairing ------------------------------------------------------------------------------------

    def _frame(self, data, way, start, end, cooked):
        dialect, seq, cmd, ext = data[33], data[34], data[38], data[39]
        reply, report = dialect == 2 and ext & 0x80, dialect == 2 and ext & 0x40
        src, dst = _i32(data, 16), _i32(data, 20)
        from_board = bool(reply or (dialect == 1 and src == self.tables["board_module"]))
        body = data[HEAD_SIZE : HEAD_SIZE + u16(data, 36)]
        slot = "chapter" if dialect == 1 else (dst if from_board else src, seq, cmd)
        asked = self._asked.pop(slot, None) if from_board else None
        text = self._frame_words(data, body, asked[1] if asked else None, from_board, cooked)
        found = Reading("frame", way, start, end, text, data, asked[0] if asked else None)
        if not from_board and (reply or not report) and not (dialect == 1 and cmd == CMD_SYNC_WRITE):
            self._asked[slot] = (found, body[2:] if cmd == CMD_TRANSACT else body)
        return found

    def _packet(self, data, way, start, end):
        asked = self._asked.get("bus")
        text, answer, hazard = self._servo_words(data, asked[1] if asked else None, "bus", None)
        found = Reading("packet", way, start, end, text + hazard, data, asked[0] if answer and asked else None)
        if not answer:
            self._asked["bus"] = (found, data)
        elif asked and asked[1][4] != SYNC_READ:
            del self._asked["bus"]
        return found

    # -- words --------------------------------------------------------------------------------------

    def _frame_words(self, data, body, asked, from_board, cooked):
        dialect, seq, cmd, ext = data[33], data[34], data[38], data[39]
        row = self.tables["commands"].get(cmd)
        text = "%d %s" % (dialect, row["name"] if row else "command 0x%02X" % cmd)
        reply, report = dialect == 2 and ext & 0x80, dialect == 2 and ext & 0x40
        if reply:
            text += " reply " + self.tables["statuses"].get(ext & 0x3F, "status %d" % (ext & 0x3F))
        elif dialect == 2:
            text += " report" if report else " request"
        text += " seq %d" % seq
        remarks = ""
        if body and (cmd <= 3 or cmd == CMD_TRANSACT):
            packet = body
            text += ": "
            if cmd == CMD_TRANSACT and not reply:
                packet = body[2:]
                text += "reply_length %d, timeout_ms %d; " % (body[0], body[1]) if len(body) > 1 else ""
            why = _unsound(packet)
            if why:
                text += "bad packet, %s: %s" % (why, to_hex(packet, SAMPLE))
            else:
                order = "little" if cmd == CMD_SYNC_WRITE else "bus" if cmd == CMD_TRANSACT and from_board else None
                words, _, remarks = self._servo_words(
                    packet, asked, "from_board" if from_board else "to_board", order
                )
                text += words
        elif body:
            words = self._body_words(body, row["reply" if reply or report else "request"]) if row else None
            text += ": " + (to_hex(body, SAMPLE) if words is None else words)
            remarks += MISFIT if row and words is None else ""
        marker = data.find(TAIL, 4)
        if dialect == 1 and 0 <= marker < len(data) - 2:
            remarks += MARKER
        return text + remarks + (ICRNL if cooked else "")

    def _body_words(self, data, layout):
        """A body by the layout of its command; None if it does not fit."""
        known = {}
        text, at = self._row_words(data, 0, layout["fields"], known, 0)
        if text is None:
            return None
        number, rows = known.get(layout["count"]), []
        while layout["rows"] and at < len(data) and (number is None or len(rows) < number):
            words, end = self._row_words(data, at, layout["rows"], {}, known.get("fields", 0))
            if words is None or end == at:
                return None
            rows.append("(%s)" % words)
            at = end
        if at != len(data) or (layout["rows"] and number is not None and len(rows) != number):
            return None
        return " ".join(part for part in (text, *rows) if part)

    def _row_words(self, data, at, row, known, mask):
        words = []
        for name, kind, wanted in row:
            if wanted and not mask & self.tables["state_fields"][wanted]:
                continue
            if kind == "bytes":
                words.append("%s %s" % (name, to_hex(data[at:], SAMPLE)))
                at = len(data)
            elif at + SIZES[kind] > len(data):
                return None, at
            else:
                raw = data[at : at + SIZES[kind]]
                known[name] = int.from_bytes(raw, "little", signed=kind[0] == "i")
                words.append("%s %d" % (name, known[name]))
                at += SIZES[kind]
        return ", ".join(words), at

    def _servo_words(self, data, asked, where, order):
        """Words, whether it is an answer, and a hazard, for a sound packet on the bus or to or from a board."""
        if data[1] == 0xF5 or where == "from_board" or (where == "bus" and self._is_status(data, asked)):
            return self._status_words(data, asked, where, order), True, ""
        return self._request_words(data, order)

    def _is_status(self, data, asked):
        """Whether FF FF ... on a bus is an answer: by what was asked, else by whether it can be a request."""
        inst = data[4]
        if inst not in self.tables["instructions"] or (inst in self.tables["bare"] and len(data) > 6):
            return True
        # A request that is said again is no answer.
        if asked is None or data == asked or self.tables["replies"].get(asked[4]) == "never":
            return False
        reads = asked[4] in (READ, SYNC_READ) and len(asked) > 7
        same = asked[2] == data[2] or (asked[4] == SYNC_READ and data[2] in asked[7:-1])
        return same and len(data) == (asked[6] + 6 if reads else 6)

    def _status_words(self, data, asked, where, order):
        legacy, servo, error, params = data[1] == 0xF5, data[2], data[4], data[5:-1]
        named = self.tables["board_errors"].get(error)
        if where == "from_board" and legacy and named:
            silent = error == 1 and len(data) == 8 and params == b"\0\0"
            if silent or (error != 1 and not params and (servo == 0xFF or named == "ping silent")):
                return "board error %s%s" % (named, "" if servo == 0xFF else ", servo %d" % servo)
        text = "status %d%s" % (servo, " legacy" if legacy else "")
        if error:
            bits = [name for bit, name in sorted(self.tables["status_bits"].items()) if error & bit]
            text += " error " + (", ".join(bits) or "0x%02X" % error)
        if not params:
            return text
        series = self._series(servo) or ("seven_bot" if legacy else None)
        if asked and len(asked) > 6 and asked[4] in (READ, SYNC_READ) and series:
            # The board swaps the two bytes of a legacy servo's answer.
            swapped = where == "from_board" and series == "seven_bot" and len(params) == 2 and order != "bus"
            return "%s: %s" % (text, self._values(series, asked[5], params, "little" if swapped else None))
        return "%s: %s" % (text, to_hex(params))

    def _request_words(self, data, order):
        servo, inst, params = data[2], data[4], data[5:-1]
        name = self.tables["instructions"].get(inst, "instruction 0x%02X" % inst)
        who = "all" if servo == 0xFE else str(servo)
        series = self._series(servo)
        if inst == READ and len(params) == 2:
            register = self._register(series, params[0])
            return "read %s: %s, %d bytes" % (who, register, params[1]), False, ""
        if inst in (WRITE, REG_WRITE) and len(params) > 1:
            words = self._placed(series, params[0], params[1:], None)
            hazard = CEILING if _ceiling(series, params[0], params[1:]) else ""
            return "%s %s: %s" % (name, who, words), False, hazard
        if inst == SYNC_READ and len(params) > 2:
            register = self._register(self._series(params[2]), params[0])
            ids = " ".join(map(str, params[2:]))
            return "sync read %s: %s, %d bytes" % (ids, register, params[1]), False, ""
        if inst == SYNC_WRITE and len(params) > 2 and (len(params) - 2) % (params[1] + 1) == 0:
            rows, hazard, step = [], "", params[1] + 1
            for i in range(2, len(params), step):
                series, values = self._series(params[i]), params[i + 1 : i + step]
                hazard = CEILING if _ceiling(series, params[0], values) else hazard
                rows.append("%d %s" % (params[i], self._placed(series, params[0], values, order)))
            return "sync write: " + "; ".join(rows), False, hazard
        return "%s %s%s" % (name, who, ": " + to_hex(params) if params else ""), False, ""

    def _series(self, servo):
        return self.tables["joints"].get(servo) if self.series == "board" else self.series

    def _register(self, series, address):
        row = self.tables["series"][series]["registers"].get(address) if series else None
        return row[0] if row else "0x%02X" % address

    def _placed(self, series, address, data, order):
        return self._values(series, address, data, order) if series else "0x%02X %s" % (address, to_hex(data))

    def _values(self, series, address, data, order):
        rows = self.tables["series"][series]
        words, at = [], 0
        while at < len(data):
            row = rows["registers"].get(address + at)
            if row is None or at + row[1] > len(data):
                words.append("0x%02X %d" % (address + at, data[at]))
                at += 1
                continue
            name, size, sign, unit, scale = row
            raw = int.from_bytes(data[at : at + size], order or rows["byte_order"])
            if sign >= 0 and raw >> sign & 1:
                raw = -(raw & ((1 << sign) - 1))
            text = "%s %d" % (name, raw)
            if scale:
                text += " = %.6g %s" % (raw * scale, "deg" if unit == "count" else unit)
            words.append(text)
            at += size
        return ", ".join(words)


def _with_garbage(items, done, until):
    if until > done:
        items.append(("garbage", done, until, ""))
    return items, until


def _packet_start(data, at):
    at = data.find(b"\xff", at)
    while 0 <= at < len(data) - 1:
        if data[at + 1] in (0xFF, 0xF5):
            return at
        at = data.find(b"\xff", at + 1)
    return -1


def _unsound(data):
    """Why this is no sound packet; empty if it is one."""
    if len(data) < 6 or data[:2] not in (b"\xff\xff", b"\xff\xf5"):
        return "no header"
    if data[3] != len(data) - 4 and not (data[1] == 0xF5 and len(data) == 6 == data[3]):
        return "length %d" % data[3]
    wanted = servo_sum(data[2:-1])
    return "" if data[-1] == wanted else "checksum %02X, not %02X" % (data[-1], wanted)


def _ceiling(series, address, data):
    """The chapter's 4-byte block on an HLS servo: its run time lands in the current ceiling."""
    return series == "hls" and address == 42 and len(data) == 4


def _i32(data, at):
    return int.from_bytes(data[at : at + 4], "little", signed=True)
