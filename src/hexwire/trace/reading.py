"""One short line for a frame or servo packet: the words that all of the project's analysers use for it.

Owns that wording, which ``vectors/readings.jsonl`` states and the analysers for Wireshark, sigrok and Logic 2 keep
too. Knows nothing of streams and pairing; `explain` does those.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from itertools import accumulate

from hexwire.errors import HexwireError
from hexwire.wire import tables
from hexwire.wire.command_frame import Command, Frame, command_name, status_name
from hexwire.wire.registers import Series
from hexwire.wire.servo_packet import (
    Instruction,
    ServoPacket,
    StatusPacket,
    board_error_name,
    parse_packet,
    parse_status,
    parse_sync_write,
)
from hexwire.wire.tables import BROADCAST_ID, PROTO_CHAPTER, TAIL, Body

__all__ = ["CEILING", "answers", "cut_packets", "has_ceiling_hazard", "read_frame", "read_request", "read_status"]

CEILING = "run time in the current ceiling of an HLS servo"
_MARKER = "0D 0A inside, a board of the chapter cuts the frame there"
_MISFIT = "the body does not fit the command"
_ICRNL = "tail 0A 0A, the port was left with ICRNL"
_SAMPLE = 24
_MIN_PACKET, _MAX_LENGTH = 6, tables.MAX_SERVO_PACKET - 4
# Of a row of FF only the last two can be a header: no servo has the id 255.
_HEADER = re.compile(rb"\xff(?:\xff(?!\xff)|\xf5)")
_READS = (Instruction.READ, Instruction.SYNC_READ)
_BARE = frozenset(
    {
        Instruction.PING,
        Instruction.ACTION,
        Instruction.RESTORE,
        Instruction.REBOOT,
        Instruction.BACKUP,
        Instruction.RESET_STATE,
    }
)
_KNOWN = {member.value: member for member in Instruction}
_SIZES = {"u8": 1, "i8": 1, "u16": 2, "i16": 2, "u32": 4, "i32": 4}

SeriesById = Mapping[int, Series]


def cut_packets(data: bytes, *, final: bool = False) -> Iterator[tuple[str, int, int, str]]:
    """Find the servo packets in the bytes of one line.

    Takes a time that grows with the length, whatever the bytes are.

    Args:
        data: What came, from where the last call left off.
        final: Nothing more will come: what is unfinished is bad.

    Yields:
        Pieces (kind, start, end, reason), the kind being packet, bad or garbage, without gaps between them. An
        unfinished rest begins where the last one ends.
    """
    done = at = 0
    # Sums up to each byte: adding up anew for each of many overlapping packets would take long.
    totals: Iterator[int] = accumulate(data, _add, initial=0)
    sums = bytes(totals)
    while True:
        start = _header(data, at)
        if start < 0:
            rest = len(data) - (1 if not final and data.endswith(b"\xff") else 0)
            if rest > done:
                yield "garbage", done, rest, ""
            return
        head = data[start : start + _MIN_PACKET]
        length = head[3] if len(head) > 3 else 2
        if not 2 <= length <= _MAX_LENGTH:
            at = start + 1
            continue
        quirk = length == 6 and head[1] == 0xF5 and len(head) == 6 and sum(head[2:]) & 0xFF == 0xFF
        size = _MIN_PACKET if quirk else 4 + length
        kind, end, reason = "packet", start + size, ""
        if start > done:
            yield "garbage", done, start, ""
        if len(data) < end:
            if not final:
                return
            kind, end, reason = "bad", len(data), f"cut short, {len(data) - start} of {size} bytes"
        else:
            wanted = ~(sums[end - 1] - sums[start + 2]) & 0xFF
            if data[end - 1] != wanted:
                kind, reason = "bad", f"checksum {data[end - 1]:02X}, not {wanted:02X}"
        if kind == "bad":
            following = _header(data, start + 2)
            end = following if 0 < following < end else end
        yield kind, start, end, reason
        done = at = end


def _add(total: int, byte: int) -> int:
    return (total + byte) & 0xFF


def _header(data: bytes, at: int) -> int:
    found = _HEADER.search(data, at)
    return -1 if found is None else found.start()


def answers(data: bytes, asked: ServoPacket | None) -> bool:
    """Whether a sound packet on a bus is an answer: by what was asked, else by whether it can be a request."""
    instruction = data[4]
    if data[:2] == tables.LEGACY_HEADER or instruction not in _KNOWN or (instruction in _BARE and len(data) > 6):
        return True
    if asked is None or data == asked.serialize() or asked.instruction not in _KNOWN:
        return False
    if tables.INSTRUCTION_REPLY[_KNOWN[asked.instruction].name] == "never":
        return False
    reads = asked.instruction in _READS and len(asked.params) > 1
    listed = asked.instruction == Instruction.SYNC_READ and data[2] in asked.params[2:]
    return (asked.servo_id == data[2] or listed) and len(data) == (asked.params[1] + 6 if reads else 6)


def read_request(data: bytes, series: SeriesById, *, little: bool = False) -> str:
    """Words for a sound request; `little`: values of a sync write are little-endian whatever the servo."""
    packet = parse_packet(data)
    servo, params = packet.servo_id, packet.params
    known = _KNOWN.get(packet.instruction)
    name = known.name.lower().replace("_", " ") if known else f"instruction 0x{packet.instruction:02X}"
    who = "all" if servo == BROADCAST_ID else str(servo)
    if known is Instruction.READ and len(params) == 2:
        return f"read {who}: {_register(series.get(servo), params[0])}, {params[1]} bytes"
    if known in (Instruction.WRITE, Instruction.REG_WRITE) and len(params) > 1:
        text = f"{name} {who}: {_placed(series.get(servo), params[0], params[1:])}"
        return text + (f" ! {CEILING}" if has_ceiling_hazard(series.get(servo), params[0], params[1:]) else "")
    if known is Instruction.SYNC_READ and len(params) > 2:
        register = _register(series.get(params[2]), params[0])
        return f"sync read {' '.join(map(str, params[2:]))}: {register}, {params[1]} bytes"
    if known is Instruction.SYNC_WRITE and len(params) > 2:
        try:
            address, rows = parse_sync_write(packet)
        except HexwireError:
            return f"{name} {who}: {_hex(params)}"
        words = [f"{each} {_placed(series.get(each), address, values, little=little)}" for each, values in rows]
        hazard = any(has_ceiling_hazard(series.get(each), address, values) for each, values in rows)
        return f"sync write: {'; '.join(words)}" + (f" ! {CEILING}" if hazard else "")
    return f"{name} {who}" + (f": {_hex(params)}" if params else "")


def read_status(
    status: StatusPacket,
    asked: ServoPacket | None,
    series: SeriesById,
    *,
    board: bool = False,
    swapped: bool = False,
) -> str:
    """Words for an answer.

    Args:
        status: The answer.
        asked: The request it answers, if that is known.
        series: Series of the servos by id.
        board: It came through a board, which may report errors of its own.
        swapped: The board has swapped the two bytes of a legacy servo's value.
    """
    named = board_error_name(status) if board else None
    servo = status.servo_id
    if named:
        return f"board error {named.replace('_', ' ')}" + ("" if servo == 0xFF else f", servo {servo}")
    text = f"status {servo}" + (" legacy" if status.legacy else "")
    if status.error:
        bits = [name for name, bit in tables.STATUS_BITS.items() if status.error & bit]
        text += f" error {', '.join(bits) or f'0x{status.error:02X}'}"
    if not status.params:
        return text
    its = series.get(servo) or (Series.SEVEN_BOT if status.legacy else None)
    if asked is None or asked.instruction not in _READS or len(asked.params) < 1 or its is None:
        return f"{text}: {_hex(status.params)}"
    little = swapped and its is Series.SEVEN_BOT and len(status.params) == 2
    return f"{text}: {_values(its, asked.params[0], status.params, little=little)}"


def read_frame(
    frame: Frame, raw: bytes, asked: ServoPacket | None, series: SeriesById, *, cooked: bool = False
) -> str:
    """Words for a good frame.

    Args:
        frame: The frame.
        raw: Its bytes as they were on the line.
        asked: The servo packet of the request it answers, if that is known.
        series: Series of the servos by id.
        cooked: Its tail was 0A 0A.
    """
    text = f"{frame.proto} {command_name(frame.cmd)}"
    if frame.proto != PROTO_CHAPTER:
        kind = "report" if frame.is_unsolicited else "request"
        text += f" reply {status_name(frame.status)}" if frame.is_reply else f" {kind}"
    text += f" seq {frame.seq}"
    remarks = []
    if frame.body and (frame.cmd <= Command.SYNC_WRITE or frame.cmd == Command.TRANSACT):
        text += f": {_servo_body(frame, asked, series)}"
    elif frame.body:
        words = _body(frame)
        text += f": {_hex(frame.body, _SAMPLE) if words is None else words}"
        if words is None and command_name(frame.cmd) in tables.COMMAND_ROWS:
            remarks.append(_MISFIT)
    if frame.proto == PROTO_CHAPTER and TAIL in raw[4:-2]:
        remarks.append(_MARKER)
    if cooked:
        remarks.append(_ICRNL)
    return " ! ".join([text, *remarks])


def _servo_body(frame: Frame, asked: ServoPacket | None, series: SeriesById) -> str:
    from_board = frame.src == tables.MODULES["ARM_7BOT_ARDUINO_TRX"]
    if frame.proto != PROTO_CHAPTER:
        from_board = frame.is_reply
    data, prefix = frame.body, ""
    through = frame.cmd == Command.TRANSACT
    if through and not from_board:
        prefix = f"reply_length {data[0]}, timeout_ms {data[1]}; " if len(data) > 1 else ""
        data = data[2:]
    try:
        if from_board:
            return prefix + read_status(
                parse_status(data, as_it_is=True), asked, series, board=True, swapped=not through
            )
        return prefix + read_request(data, series, little=frame.cmd == Command.SYNC_WRITE)
    except HexwireError:
        return f"{prefix}bad packet, {_unsound(data)}: {_hex(data, _SAMPLE)}"


def _unsound(data: bytes) -> str:
    if len(data) < _MIN_PACKET or data[:2] not in (tables.SERVO_HEADER, tables.LEGACY_HEADER):
        return "no header"
    if data[3] != len(data) - 4:
        return f"length {data[3]}"
    return f"checksum {data[-1]:02X}, not {~sum(data[2:-1]) & 0xFF:02X}"


def _body(frame: Frame) -> str | None:
    """A body by the layout of its command; None if it does not fit, or nobody knows the command."""
    row = tables.COMMAND_ROWS.get(command_name(frame.cmd))
    if row is None:
        return None
    layout: Body = row.reply if frame.is_reply or frame.is_unsolicited else row.request
    known: dict[str, int] = {}
    first = _fields(frame.body, 0, layout.fields, known, 0)
    if first is None:
        return None
    text, at = first
    number = known.get(layout.count_field)
    rows: list[str] = []
    while layout.rows and at < len(frame.body) and (number is None or len(rows) < number):
        found = _fields(frame.body, at, layout.rows, {}, known.get("fields", 0))
        if found is None or found[1] == at:
            return None
        rows.append(f"({found[0]})")
        at = found[1]
    if at != len(frame.body) or (layout.rows and number is not None and len(rows) != number):
        return None
    return " ".join(part for part in (text, *rows) if part)


def _fields(
    data: bytes, at: int, layout: tuple[tuple[str, str, str], ...], known: dict[str, int], mask: int
) -> tuple[str, int] | None:
    words = []
    for name, kind, wanted in layout:
        if wanted and not mask & tables.STATE_FIELDS[wanted]:
            continue
        if kind == "bytes":
            words.append(f"{name} {_hex(data[at:], _SAMPLE)}")
            at = len(data)
            continue
        end = at + _SIZES[kind]
        if end > len(data):
            return None
        known[name] = int.from_bytes(data[at:end], "little", signed=kind[0] == "i")
        words.append(f"{name} {known[name]}")
        at = end
    return ", ".join(words), at


def has_ceiling_hazard(series: Series | None, address: int, data: bytes) -> bool:
    """Whether this is the chapter's 4-byte block on an HLS servo: its run time lands in the current ceiling."""
    return series is Series.HLS and address == Series.HLS.register("goal_position").address and len(data) == 4


def _register(series: Series | None, address: int) -> str:
    register = series.at(address) if series else None
    return register.name if register else f"0x{address:02X}"


def _placed(series: Series | None, address: int, data: bytes, *, little: bool = False) -> str:
    return _values(series, address, data, little=little) if series else f"0x{address:02X} {_hex(data)}"


def _values(series: Series, address: int, data: bytes, *, little: bool = False) -> str:
    words, at = [], 0
    while at < len(data):
        register = series.at(address + at)
        if register is None or at + register.size > len(data):
            words.append(f"0x{address + at:02X} {data[at]}")
            at += 1
            continue
        piece = data[at : at + register.size]
        raw = register.decode(piece[::-1] if little and register.byte_order == "big" else piece)
        unit = "deg" if register.unit == "count" else register.unit
        words.append(f"{register.name} {raw}" + (f" = {raw * register.scale:.6g} {unit}" if register.scale else ""))
        at += register.size
    return ", ".join(words)


def _hex(data: bytes, limit: int | None = None) -> str:
    if limit is not None and len(data) > limit:
        return f"{data[:limit].hex(' ').upper()} ..."
    return data.hex(" ").upper()
