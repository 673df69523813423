"""What dialect 1 needs of a host: frames without 0D 0A, and answers known by servo id and length.

Owns the two rules of PROTOCOL.md section 5 that make an old board safe to talk to. Sans I/O and sans time.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from hexwire.errors import LocalProtocolError, RemoteProtocolError
from hexwire.wire.command_frame import Command, command_name, serialize_frame
from hexwire.wire.servo_packet import (
    Instruction,
    ServoPacket,
    StatusPacket,
    find_status,
    parse_packet,
    strip_echo,
)
from hexwire.wire.tables import PROTO_CHAPTER, TAIL

from .servo_bus import Expected, expected_answer

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
_STEPS = 32


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
    packet: ServoPacket = field(init=False)
    expected: Expected = field(init=False)

    def __post_init__(self) -> None:
        try:
            self.packet = parse_packet(self.body)
        except RemoteProtocolError as error:
            raise LocalProtocolError(f"dialect 1 carries servo packets only: {error}") from None
        if self.cmd not in (Command.PING, Command.READ, Command.SYNC_WRITE):
            raise LocalProtocolError(f"{command_name(self.cmd)} does not exist in dialect 1")
        if self.answered and len(self.body) > MAX_PACKET:
            raise LocalProtocolError(
                f"a packet of {len(self.body)} bytes would hang a dialect-1 board; {MAX_PACKET} is the most"
            )
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


def match_reply(body: bytes, pending: Pending1) -> bytes | None:
    """Find the status packet in a dialect-1 reply that answers `pending`.

    Returns:
        Its bytes, echo and noise removed; a board's error packet if that is the answer; None if this frame
        answers something else.
    """
    if body in (UNKNOWN_COMMAND_PACKET, SHORT_FRAME_PACKET):
        return body
    data = strip_echo(body, pending.body)
    params = pending.expected.params
    found = find_status(data, pending.servo_id, params)
    if found is None and params != 2 and pending.packet.instruction != Instruction.PING:
        # A board says "no answer" to anything sent with command 02 as to a 2-byte read.
        found = find_status(data, pending.servo_id, 2)
        if found is not None and not _is_no_answer(found[0]):
            return None
    if found is None:
        return None
    packet, end = found
    return data[end - (6 + len(packet.params)) : end]


def _is_no_answer(packet: StatusPacket) -> bool:
    return packet.legacy and packet.error == 1 and packet.params == b"\0\0"


def clean_frame(
    proto: int,
    cmd: int,
    body: bytes,
    seq: int,
    sn: int,
    src: int,
    dst: int,
    type: int,
    time_sec: int,
    time_nsec: int,
    cmd_ext: int,
    max_frame: int,
) -> tuple[bytes, int]:
    """Build a frame without 0D 0A in bytes 4..len-3, changing what is free: nanoseconds, sn, then seconds.

    Returns:
        The frame and the sn it used.

    Raises:
        LocalProtocolError: 0D 0A stands in what is not free: the body.
    """
    if TAIL in body:
        raise LocalProtocolError(
            f"the body of {command_name(cmd)} has 0D 0A inside, where a dialect-{PROTO_CHAPTER} board would cut it"
        )
    for sec_step in range(_STEPS):
        # A second that holds the marker keeps it for 256 s or more: step back in the same stride.
        sec = max(0, time_sec - (sec_step * 0x0100 if sec_step else 0))
        for sn_step in range(_STEPS):
            number = (sn + sn_step) & 0xFFFFFFFF
            for nsec_step in range(4):
                data = serialize_frame(
                    proto=proto,
                    cmd=cmd,
                    body=body,
                    seq=seq,
                    sn=number,
                    src=src,
                    dst=dst,
                    type=type,
                    time_sec=sec,
                    time_nsec=(time_nsec + nsec_step * 1000) % 1_000_000_000,
                    cmd_ext=cmd_ext,
                    max_frame=max_frame,
                )
                if TAIL not in data[4:-2]:
                    return data, number
    raise LocalProtocolError(f"no frame without 0D 0A could be built for {command_name(cmd)}")
