"""Any bytes in one line that a person understands: frames of both dialects, servo packets, good or bad.

Owns the wording. Never raises, whatever the bytes: it is what logs and traces call. Knows nothing of streams;
`session.decoder` cuts them.
"""

from __future__ import annotations

from hexwire.errors import HexwireError

from . import tables
from .command_frame import Command, Frame, command_name, examine, status_name
from .commands import (
    FRAGMENT_HEAD_SIZE,
    FragmentHead,
    Identity,
    JointReport,
    LimitTable,
    MaintenanceReply,
    MoveReply,
    MoveRequest,
    Stats,
    TransactRequest,
    parse_missing,
    parse_stop_reply,
)
from .modules import module_name
from .registers import Series
from .servo_packet import (
    BROADCAST_ID,
    Instruction,
    ServoPacket,
    StatusPacket,
    board_error_name,
    parse_packet,
    parse_status,
    parse_sync_write,
)
from .tables import MAX_NETWORK_FRAME, PROTO_CHAPTER, SYNC_BYTES

__all__ = ["describe", "describe_body", "describe_frame", "describe_servo", "describe_status"]

_BOARD_ERRORS = {
    "frame_short": "frame too short",
    "command_unknown": "unknown command",
    "ping_silent": "ping not answered",
    "read_silent": "read not answered",
}
_STOP_MODES = ("hold", "torque off")
_SWITCH = ("off", "on")
_SAMPLE = 24
_INSTRUCTIONS = {member.value: member for member in Instruction}


def describe(data: bytes) -> str:
    """One line for any bytes.

    Args:
        data: A frame, a servo packet, or anything else.

    Returns:
        What it is and says; for bad bytes, what is wrong with them.
    """
    try:
        if data.startswith(SYNC_BYTES):
            return _describe_session(data)
        if data[:2] in (tables.SERVO_HEADER, tables.LEGACY_HEADER):
            return describe_servo(data)
        return f"{len(data)} bytes, no frame: {_hex(data)}" if data else "no bytes"
    except (HexwireError, ValueError, IndexError) as error:
        return f"{len(data)} bytes that cannot be explained ({error}): {_hex(data)}"


def describe_servo(data: bytes, series: Series | None = None, *, reply: bool | None = None) -> str:
    """One line for a servo packet.

    Args:
        data: The whole packet.
        series: Series of the servo, if known: register names are then its own.
        reply: Whether it is a status packet; guessed if None. An answer and a request can be the same bytes.

    Returns:
        What it says, or what is wrong with it. Never raises.
    """
    problems = []
    if reply is False or (reply is None and data[:2] == tables.SERVO_HEADER):
        try:
            packet = parse_packet(data)
            if reply is False or packet.instruction in _INSTRUCTIONS:
                return _describe_request(packet, series)
        except HexwireError as error:
            problems.append(str(error))
    if reply is not False:
        try:
            return describe_status(parse_status(data), series)
        except HexwireError as error:
            problems.append(str(error))
    return f"bad servo packet, {problems[0] if problems else 'unknown instruction'}: {_hex(data)}"


def describe_status(status: StatusPacket, series: Series | None = None, address: int | None = None) -> str:
    """One line for a status packet.

    Args:
        status: The packet.
        series: Series of the servo, if known.
        address: Where the data was read from, if the request is known.
    """
    named = board_error_name(status)
    if named is not None:
        return f"board error: {_BOARD_ERRORS[named]}" + (
            "" if status.servo_id == 0xFF else f" (servo {status.servo_id})"
        )
    who = f"servo {status.servo_id}" + (" (legacy)" if status.legacy else "")
    faults = [word for word, bit in tables.STATUS_BITS.items() if status.error & bit]
    condition = f"error {', '.join(faults) or f'0x{status.error:02X}'}" if status.error else "ok"
    text = f"{who} {condition}"
    if status.params:
        text += ": " + _values(status.params, series, address)
    return text


def describe_frame(frame: Frame) -> str:
    """One line for a good frame: who to whom, what, and what the body says."""
    head = f"{module_name(frame.src)} -> {module_name(frame.dst)} #{frame.sn}"
    if frame.proto == PROTO_CHAPTER:
        return f"{head} dialect 1 {command_name(frame.cmd)} seq {frame.seq}: {_dialect1_body(frame)}"
    if frame.is_reply:
        kind = f"reply, {status_name(frame.status)}"
    elif frame.is_unsolicited:
        kind = "unsolicited"
    else:
        kind = "request"
    body = describe_body(frame)
    return f"{head} dialect 2 {command_name(frame.cmd)} {kind}, seq {frame.seq}" + (f": {body}" if body else "")


def _describe_session(data: bytes) -> str:
    result = examine(data, 0, MAX_NETWORK_FRAME)
    if isinstance(result, int):
        return f"frame cut short, {len(data)} of {result} bytes: {_hex(data)}"
    if isinstance(result, str):
        return f"bad frame, {result.removeprefix('head: ')}: {_hex(data)}"
    extra = len(data) - result.size
    return describe_frame(result) + (f" (+ {extra} bytes after it)" if extra else "")


def _dialect1_body(frame: Frame) -> str:
    body = frame.body
    if not body:
        return "empty"
    # What a board sends is a status packet, what a host sends is a request; the bytes alone do not say.
    from_board = frame.src == tables.MODULES["ARM_7BOT_ARDUINO_TRX"]
    return describe_servo(body, reply=from_board)


def describe_body(frame: Frame) -> str:
    """What the body of a dialect-2 frame says, in words; empty for an empty one. Never raises."""
    body = frame.body
    if not body:
        return ""
    try:
        return _known_body(frame, body)
    except HexwireError as error:
        return f"{error}: {_hex(body)}"


def _known_body(frame: Frame, body: bytes) -> str:
    cmd, reply = frame.cmd, frame.is_reply
    if cmd in (Command.PING, Command.READ, Command.SYNC_WRITE):
        return describe_servo(body, reply=reply)
    if cmd == Command.IDENTIFY and reply:
        who = Identity.parse(body)
        present = sum(row.present for row in who.joints)
        version = ".".join(map(str, who.firmware))
        return f"firmware {version}, boot {who.boot_id}, {present} of {len(who.joints)} servos present"
    if cmd == Command.JOINT_STATE and (reply or frame.is_unsolicited):
        report = JointReport.parse(body)
        flags = _flags(report.board_flags)
        return f"positions {', '.join(map(str, report.position))}" + (f" [{flags}]" if flags else "")
    if cmd == Command.JOINT_MOVE and not reply:
        move = MoveRequest.parse(body)
        rows = ", ".join(f"{'all' if i == BROADCAST_ID else i} to {p}" for i, p in move.rows)
        return f"{rows} in {move.duration_ms} ms"
    if cmd == Command.JOINT_MOVE:
        sent = MoveReply.parse(body)
        rows = ", ".join(f"{i} to {p}{' (clamped)' if c else ''}" for i, p, c in sent.rows)
        return f"sent {rows or 'nothing'} in {sent.duration_ms} ms"
    if cmd == Command.TORQUE or (cmd == Command.STOP and reply):
        mode, mask = parse_stop_reply(body)
        words = _SWITCH if cmd == Command.TORQUE else _STOP_MODES
        return f"{words[min(mode, 1)]}, joints {mask:07b}"
    if cmd == Command.STOP and len(body) == 1:
        return _STOP_MODES[min(body[0], 1)]
    if cmd in (Command.REPORT, Command.WATCHDOG) and len(body) == 3:
        every, last = int.from_bytes(body[:2], "little"), body[2]
        if not every:
            return "off"
        words = (
            (f"every {every} ms", f"fields {last:02X}")
            if cmd == Command.REPORT
            else (f"after {every} ms", _STOP_MODES[min(last, 1)])
        )
        return ", ".join(words)
    if cmd == Command.MAINTENANCE and not reply and len(body) == 1:
        return _SWITCH[min(body[0], 1)]
    if cmd == Command.MAINTENANCE and reply:
        maintenance = MaintenanceReply.parse(body)
        flags = _flags(maintenance.board_flags)
        return _SWITCH[maintenance.on] + (f" [{flags}]" if flags else "")
    if cmd == Command.LIMITS and reply:
        return ", ".join(f"{lo}..{hi}" for lo, hi, _ in LimitTable.parse(body).rows)
    if cmd == Command.TRANSACT and not reply:
        transact = TransactRequest.parse(body)
        return f"{describe_servo(transact.packet, reply=False)}, {transact.reply_length} bytes expected"
    if cmd == Command.TRANSACT:
        return describe_servo(body, reply=True)
    if cmd == Command.STATS and reply:
        counters = Stats.parse(body).counters
        return ", ".join(f"{name} {value}" for name, value in counters.items() if value)
    if cmd == Command.FRAGMENT:
        head = FragmentHead.parse(body)
        inner = command_name(head.cmd)
        return f"chunk {head.number + 1} of {head.chunks}, {len(body) - FRAGMENT_HEAD_SIZE} bytes of {inner}"
    if cmd == Command.FRAGMENT_MISSING:
        message, indexes = parse_missing(body)
        return f"message {message}: " + (
            f"chunks {', '.join(map(str, indexes))} missing" if indexes else "complete"
        )
    return _hex(body)


def _describe_request(packet: ServoPacket, series: Series | None) -> str:
    who = "all servos" if packet.servo_id == BROADCAST_ID else f"servo {packet.servo_id}"
    known = _INSTRUCTIONS.get(packet.instruction)
    name = known.name.lower().replace("_", " ") if known else f"instruction 0x{packet.instruction:02X} to"
    params = packet.params
    if packet.instruction in (Instruction.READ, Instruction.SYNC_READ) and len(params) >= 2:
        what = f"{params[1]} bytes at {_register(params[0], series)}"
        ids = f" of {', '.join(map(str, params[2:]))}" if packet.instruction == Instruction.SYNC_READ else ""
        return f"{name} {what}{ids or f' of {who}'}"
    if packet.instruction in (Instruction.WRITE, Instruction.REG_WRITE) and params:
        return f"{name} {who} {_register(params[0], series)} = {_values(params[1:], series, params[0])}"
    if packet.instruction == Instruction.SYNC_WRITE:
        address, rows = parse_sync_write(packet)
        each = ", ".join(f"{i}: {data.hex(' ').upper()}" for i, data in rows)
        return f"{name} {_register(address, series)} {each}"
    return f"{name} {who}" + (f" {params.hex(' ').upper()}" if params else "")


def _register(address: int, series: Series | None) -> str:
    register = series.at(address) if series else None
    return f"{register.name} (0x{address:02X})" if register else f"0x{address:02X}"


def _values(data: bytes, series: Series | None, address: int | None) -> str:
    """Data as register values where the place is known, else as bytes, and a pair also as a number."""
    if series is None or address is None:
        if len(data) == 2:
            return f"{data.hex(' ').upper()} (little-endian {int.from_bytes(data, 'little')})"
        return data.hex(" ").upper()
    words, at = [], 0
    while at < len(data):
        register = series.at(address + at)
        if register is None or at + register.size > len(data):
            words.append(f"0x{data[at]:02X}")
            at += 1
            continue
        raw = register.decode(data[at : at + register.size])
        words.append(f"{register.name} {raw}")
        at += register.size
    return ", ".join(words)


def _flags(flags: int) -> str:
    return ", ".join(name.replace("_", " ") for name, bit in tables.BOARD_FLAGS.items() if flags & bit)


def _hex(data: bytes) -> str:
    text = data[:_SAMPLE].hex(" ").upper()
    return f"{text} ..." if len(data) > _SAMPLE else text
