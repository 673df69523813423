"""What dialect 1 needs of a host: frames an old board survives, and answers known by servo id and length.

Owns the rules of PROTOCOL.md section 5 that make an old board safe to talk to. Sans I/O and sans time.
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
"""Longest servo packet with commands 01 and 02: more hangs the chapter's sketch (its ring has 63 bytes)."""

SHORT_FRAME_PACKET = bytes.fromhex("FFF5FF0604F6")
UNKNOWN_COMMAND_PACKET = bytes.fromhex("FFF5FF0607F3")
_TARGET = Series.SEVEN_BOT.register("target_position").address
_SYNC_WRITE_DATA = 4
_READ_ANSWER = 8
_EXCHANGED = 6
_OFFSETS = {name: offset for name, _, offset in HEADER_FIELDS}
_SEC, _NSEC, _SN, _SRC = (_OFFSETS[name] for name in ("time_sec", "time_nsec", "sn", "src"))
_ATTEMPTS = 256
"""Builds of a frame before giving up. The nanoseconds need at most 66 steps, every other field one."""


@dataclass(slots=True)
class Pending1:
    """A request of dialect 1 that waits to be sent or answered.

    Raises:
        LocalProtocolError: Its body is no servo packet, or one the chapter's board could not survive.
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
        """Whether the board answers it at all."""
        return self.cmd != Command.SYNC_WRITE

    @property
    def servo_id(self) -> int:
        """The servo that is asked."""
        return self.packet.servo_id


def _problem(cmd: int, packet: ServoPacket, size: int) -> str:
    """Why the chapter's board would not survive a request, or would do something else with it; empty if not."""
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
            return f"a dialect-1 board takes any sync write for {_SYNC_WRITE_DATA} bytes at 0x{_TARGET:02X} a servo"
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

    The payload is what the board heard on its bus: noise, an echo, late answers and all. With command 02 and a
    legacy servo, the chapter's board has exchanged bytes 5 and 6 of it, whatever those are. So it is looked at
    twice: with that undone for a legacy servo's answer (FF F5), as it is for any other's (FF FF). What counts as an
    answer then is `servo_answers`' to say.

    Args:
        body: The payload.
        pending: What was asked. It remembers what came and was doubtful.
        sent: Packets sent before: the board keeps an echo that comes late, and hands it to whoever asks next.

    Returns:
        Its bytes, echo and noise removed, a legacy servo's two data bytes little-endian; a board's error packet if
        that is the answer; None if this frame answers something else, or nobody can tell.
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
        # A board says "no answer" to anything sent with command 02 as to a 2-byte read.
        found = _answer(exchanged, pending, LEGACY_HEADER, 2, sent)
        if found == make_board_error(BOARD_ERRORS["read_silent"], pending.servo_id):
            return found
    if exchanged.count(pending.body) > body.count(pending.body):
        # The board did exchange them, so this is a legacy servo, and what else is there is none of its answers.
        return None
    return _answer(body, pending, SERVO_HEADER, params, sent)


def _exchange(payload: bytes) -> bytes:
    """A payload with bytes 5 and 6 exchanged; as it is where it has fewer."""
    return payload[:5] + payload[6:7] + payload[5:6] + payload[7:] if len(payload) > _EXCHANGED else payload


def _answer(data: bytes, pending: Pending1, header: bytes, params: int, sent: Collection[bytes]) -> bytes | None:
    """The bytes of the one answer in what the board heard; None if there is none or several that differ."""
    collector = AnswerCollector(pending.body, (pending.servo_id,), params, header=header, sent=sent, all_sent=True)
    collector.receive(data)
    found = collector.answers.get(pending.servo_id)
    if found is None:
        # What has something odd behind it is believed if it comes twice.
        found = collector.murky.get(pending.servo_id)
        before, pending.murky[header, params] = pending.murky.get((header, params)), found
        if found is None or found != before:
            return None
    packet = make_status(found.servo_id, found.error, found.params, legacy=found.legacy)
    return packet if packet in data else make_legacy_ping_status(found.servo_id, found.error)


def clean_frame(frame: Frame, max_frame: int) -> tuple[Frame, bytes]:
    """Build a frame without 0D 0A in bytes 4..len-3, changing what is free where it stands.

    Free are the nanoseconds (1 us more at a time), sn (the next without), and the seconds: those stand still at
    the last one without the marker, for 256 s at most on a clock of this century.

    Returns:
        The frame as it is sent, and its bytes.

    Raises:
        LocalProtocolError: 0D 0A stands in what is not free: the body, or a module id; or the frame is too long.
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
            # In the check of dialect 2 too: any other time gives another.
            frame = frame._replace(time_nsec=frame.time_nsec + step)
        elif at < _SRC:
            low = 8 * max(at - _SN, 0)
            frame = frame._replace(sn=((frame.sn >> low) + 1 << low) & 0xFFFFFFFF)
        else:
            break
    raise LocalProtocolError(
        f"{command_name(frame.cmd)} has 0D 0A inside, where a dialect-{PROTO_CHAPTER} board would cut it"
    )
