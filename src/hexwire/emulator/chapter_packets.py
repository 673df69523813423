"""Packets as the chapter's board makes and takes them.

Owns its answers for servos and its reading of a sync write, as pure functions. Knows neither state nor the bus.
"""

from __future__ import annotations

from hexwire.errors import RemoteProtocolError
from hexwire.wire.registers import Series
from hexwire.wire.servo_packet import (
    Instruction,
    ServoPacket,
    StatusPacket,
    make_board_error,
    make_legacy_ping_status,
    make_status,
    parse_packet,
)
from hexwire.wire.tables import BOARD_ERRORS

__all__ = ["TARGET", "ChapterRow", "is_packet", "no_answer", "status_bytes", "sync_write_rows"]

TARGET = Series.SEVEN_BOT.register("target_position").address
_ROW = 5

ChapterRow = tuple[int, int, int]
"""Servo id, position in counts, run time in milliseconds."""


def no_answer(servo_id: int, *, ping: bool) -> bytes:
    """The board's own packet for a servo that does not answer."""
    return make_board_error(BOARD_ERRORS["ping_silent" if ping else "read_silent"], servo_id)


def status_bytes(packet: ServoPacket, status: StatusPacket) -> bytes:
    """What the chapter's board would send for this answer."""
    params = status.params
    if status.legacy and packet.instruction == Instruction.PING:
        return make_legacy_ping_status(status.servo_id, status.error)
    if status.legacy and len(params) == 2 and packet.instruction == Instruction.READ:
        params = params[::-1]
    return make_status(status.servo_id, status.error, params, legacy=status.legacy)


def sync_write_rows(body: bytes, joints: int, *, verified: bool) -> list[ChapterRow]:
    """Rows of a sync write as `arm_sync_write` takes them.

    Args:
        body: The packet.
        joints: Number of joints; an id that is not below it ends the rows.
        verified: Check register and checksum, as hexwire's board does; the chapter's checks neither.
    """
    if len(body) < 11 or body[4] != Instruction.SYNC_WRITE or body[3] < 9 or body[6] != 4:
        return []
    if verified and (body[5] != TARGET or not is_packet(body)):
        return []
    rows = []
    offset, total = 7, body[3]
    while offset < total and offset + _ROW <= len(body) and body[offset] < joints:
        row = body[offset : offset + _ROW]
        rows.append((row[0], row[1] | row[2] << 8, row[3] | row[4] << 8))
        offset += _ROW
    return rows


def is_packet(body: bytes) -> bool:
    """Whether bytes are one whole servo packet."""
    try:
        parse_packet(body)
    except RemoteProtocolError:
        return False
    return True
