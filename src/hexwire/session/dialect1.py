"""Dialect 1 on the host: frames that an old board can process, and answers matched by servo id and length.

Owns the rules of PROTOCOL.md section 5 that protect an old board. No I/O and no time.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field

from hexwire.errors import LocalProtocolError, RemoteProtocolError
from hexwire.wire.command_frame import BODY_OFFSET, Command, Frame, command_name, max_body, serialize_frame
from hexwire.wire.registers import Series
from hexwire.wire.servo_packet import (
    BROADCAST_ID,
    Instruction,
    ServoPacket,
    StatusPacket,
    make_board_error,
    make_legacy_ping_status,
    make_status,
    parse_packet,
    parse_sync_write,
)
from hexwire.wire.tables import (
    BOARD_ERRORS,
    HEADER_FIELDS,
    LEGACY_HEADER,
    MAX_SERIAL_FRAME,
    PROTO_CHAPTER,
    SERVO_HEADER,
    TAIL,
)

from .servo_answers import AnswerCollector
from .servo_matching import Expected, expected_answer

__all__ = [
    "MAX_PACKET",
    "SHORT_FRAME_PACKET",
    "UNKNOWN_COMMAND_PACKET",
    "Pending1",
    "clean_frame",
    "match_reply",
]

MAX_PACKET = 63
"""Longest servo packet of commands 01 and 02; a longer one hangs the chapter's sketch (63-byte ring buffer)."""

SHORT_FRAME_PACKET = bytes.fromhex("FFF5FF0604F6")
UNKNOWN_COMMAND_PACKET = bytes.fromhex("FFF5FF0607F3")
_TARGET = Series.SEVEN_BOT.register("target_position").address
_SYNC_WRITE_DATA = 4
_READ_ANSWER = 8
_EXCHANGED = 6
_OFFSETS = {name: offset for name, _, offset in HEADER_FIELDS}
_SEC, _NSEC, _SN, _SRC = (_OFFSETS[name] for name in ("time_sec", "time_nsec", "sn", "src"))
_ATTEMPTS = 256
"""Attempts to build a frame. The nanoseconds need at most 66 steps, every other field one."""


@dataclass(slots=True)
class Pending1:
    """A dialect-1 request that waits to be sent or answered.

    Raises:
        LocalProtocolError: Its body is not a servo packet, or is one that the chapter's board cannot process.
    """

    ticket: int
    cmd: int
    body: bytes
    window: float
    attempts: int
    sent: int = 0
    sent_at: float = 0.0
    deadline: float = 0.0
    instead: str = ""
    urgent: bool = False
    frame: bytes = b""
    murky: dict[tuple[bytes, int], StatusPacket | None] = field(default_factory=dict)
    packet: ServoPacket = field(init=False)
    expected: Expected = field(init=False)

    def __post_init__(self) -> None:
        try:
            self.packet = parse_packet(self.body)
        except RemoteProtocolError as error:
            raise LocalProtocolError(f"dialect 1 carries servo packets only: {error}") from None
        problem = _problem(self.cmd, self.packet, len(self.body))
        if problem:
            raise LocalProtocolError(problem)
        if TAIL in self.body:
            raise LocalProtocolError(
                f"the packet {self.body.hex(' ').upper()} has 0D 0A inside, where a dialect-1 board would cut it"
            )
        self.expected = expected_answer(self.packet)

    @property
    def answered(self) -> bool:
        """Whether the board answers it."""
        return self.cmd != Command.SYNC_WRITE

    @property
    def servo_id(self) -> int:
        """Id of the servo addressed."""
        return self.packet.servo_id


def _problem(cmd: int, packet: ServoPacket, size: int) -> str:
    """Return why the chapter's board would hang on a request or misinterpret it; empty if it would not."""
    instruction, params = packet.instruction, packet.params
    if cmd == Command.SYNC_WRITE:
        longest = max_body(MAX_SERIAL_FRAME)
        if size > longest:
            return f"a sync write of {size} bytes would hang a dialect-1 board; {longest} is the most"
        try:
            address, rows = parse_sync_write(packet)
        except RemoteProtocolError as error:
            return f"SYNC_WRITE carries a sync write only: {error}"
        if not rows or address != _TARGET or len(rows[0][1]) != _SYNC_WRITE_DATA:
            return (
                f"a dialect-1 board writes {_SYNC_WRITE_DATA} bytes at 0x{_TARGET:02X} per servo for any sync write"
            )
        return ""
    if cmd not in (Command.PING, Command.READ):
        return f"{command_name(cmd)} does not exist in dialect 1"
    if size > MAX_PACKET:
        return f"a packet of {size} bytes would hang a dialect-1 board; {MAX_PACKET} is the most"
    if packet.servo_id == BROADCAST_ID:
        return "a packet to all servos would overrun a dialect-1 board; only a sync write may go to all"
    if cmd == Command.PING and instruction != Instruction.PING:
        return "PING carries a ping only: any longer answer would overrun a dialect-1 board"
    if instruction == Instruction.READ and params[1:] != b"\x02":
        return "a read of other than 2 bytes would overrun a dialect-1 board"
    return ""


def match_reply(body: bytes, pending: Pending1, sent: Collection[bytes] = ()) -> bytes | None:
    """Find the status packet in a dialect-1 reply that answers `pending`.

    The payload is everything that the board received on its bus, with noise, echoes and late answers. For command
    02 and a legacy servo, the chapter's board has exchanged bytes 5 and 6 of it, whatever they are. So the payload
    is searched
    twice: with the exchange undone for a legacy servo's answer (FF F5), and unchanged for any other (FF FF).
        `servo_answers` decides what counts as an answer.

    Args:
        body: The payload.
        pending: The request. It keeps doubtful answers.
        sent: Packets sent before: the board returns a late echo with the next answer.

    Returns:
        Bytes of the status packet without echo and noise, a legacy servo's two data bytes little-endian; the
        board's error packet if that is the answer; None if this frame answers another request, or is ambiguous.
    """
    if body in (UNKNOWN_COMMAND_PACKET, SHORT_FRAME_PACKET):
        return body
    exchanged = _exchange(body) if pending.cmd == Command.READ else body
    params = pending.expected.params
    found = _answer(exchanged, pending, LEGACY_HEADER, params, sent)
    if found is not None:
        read = pending.packet.instruction == Instruction.READ
        return _exchange(found) if read and len(found) == _READ_ANSWER else found
    if params != 2 and pending.packet.instruction != Instruction.PING:
        # A board reports "no answer" to any packet of command 02 as for a 2-byte read.
        found = _answer(exchanged, pending, LEGACY_HEADER, 2, sent)
        if found == make_board_error(BOARD_ERRORS["read_silent"], pending.servo_id):
            return found
    if exchanged.count(pending.body) > body.count(pending.body):
        # The board exchanged the bytes, so this is a legacy servo, and the rest of the payload is not its answer.
        return None
    return _answer(body, pending, SERVO_HEADER, params, sent)


def _exchange(payload: bytes) -> bytes:
    """Exchange bytes 5 and 6 of a payload, if it has that many."""
    return payload[:5] + payload[6:7] + payload[5:6] + payload[7:] if len(payload) > _EXCHANGED else payload


def _answer(data: bytes, pending: Pending1, header: bytes, params: int, sent: Collection[bytes]) -> bytes | None:
    """Return the bytes of the only answer in a payload; None without one, or with several that differ."""
    collector = AnswerCollector(pending.body, (pending.servo_id,), params, header=header, sent=sent, all_sent=True)
    collector.receive(data)
    found = collector.answers.get(pending.servo_id)
    if found is None:
        # An answer followed by invalid bytes is trusted if it arrives twice.
        found = collector.murky.get(pending.servo_id)
        before, pending.murky[header, params] = pending.murky.get((header, params)), found
        if found is None or found != before:
            return None
    packet = make_status(found.servo_id, found.error, found.params, legacy=found.legacy)
    return packet if packet in data else make_legacy_ping_status(found.servo_id, found.error)


def clean_frame(frame: Frame, max_frame: int) -> tuple[Frame, bytes]:
    """Build a frame without 0D 0A in bytes 4..len-3, by changing fields that may change.

    These are the nanoseconds (in steps of 1 us), sn (to the next without the marker), and the seconds, which stay
    at the last value without the marker, for 256 s at most on a clock of this century.

    Returns:
        The frame as it is sent, and its bytes.

    Raises:
        LocalProtocolError: 0D 0A is in the body or a module id, which may not change; or the frame is too long.
    """
    body_end = BODY_OFFSET + len(frame.body)
    step = 1000 if frame.time_nsec < 999_000_000 else -1000
    for _ in range(_ATTEMPTS):
        data = serialize_frame(frame, max_frame)
        at = data.find(TAIL, 4, -2)
        if at < 0:
            return frame, data
        if at < _NSEC - 1:
            low = 8 * (at - _SEC)
            frame = frame._replace(time_sec=(frame.time_sec >> low << low) - 1)
        elif at < _SN - 1 or body_end - 1 <= at <= body_end:
            # The check of dialect 2 too: it changes with the time.
            frame = frame._replace(time_nsec=frame.time_nsec + step)
        elif at < _SRC:
            low = 8 * max(at - _SN, 0)
            frame = frame._replace(sn=((frame.sn >> low) + 1 << low) & 0xFFFFFFFF)
        else:
            break
    raise LocalProtocolError(
        f"{command_name(frame.cmd)} has 0D 0A inside, where a dialect-{PROTO_CHAPTER} board would cut it"
    )
