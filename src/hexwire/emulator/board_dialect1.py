"""Dialect 1 on an emulated board: the chapter's `decode()` and what it calls.

Owns the replies of the chapter's board, byte for byte, and its delays when the bus is paced. The board that
also knows dialect 2 answers the same to a correct client, but verifies answers, removes echoes and keeps to its
limits. Knows nothing of time but what a `Delay` says.
"""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING

from hexwire.errors import RemoteProtocolError
from hexwire.session.dialect1 import SHORT_FRAME_PACKET, UNKNOWN_COMMAND_PACKET
from hexwire.wire.command_frame import Command, Frame
from hexwire.wire.registers import Series
from hexwire.wire.servo_packet import (
    Instruction,
    ServoPacket,
    StatusPacket,
    make_status,
    make_write,
    parse_packet,
)

from .board_bus import Delay, Job, Send
from .gate import RefusedError, check_packet

if TYPE_CHECKING:
    from .board import EmulatedBoard
    from .sketch import SketchFrame

__all__ = ["Dialect1"]

_TARGET = Series.SEVEN_BOT.register("target_position").address
# The sketch's waits: see the listing of servo_read and servo_ping.
_READ_WAIT = 0.010
_READ_POLL = 0.020
_PING_POLL = 0.010
_BYTE_WAIT = 0.002
_POLLS = 4
_TRIES = 2
_ROW = 5
_STACK = 16


class Dialect1:
    """Dialect-1 dispatch of one board."""

    def __init__(self, board: EmulatedBoard) -> None:
        self._board = board
        self._chapter = board.dialect == 1

    def job(self, frame: Frame) -> Job:
        """Act on a frame."""
        return self._decode(frame.cmd, frame.body)

    def void(self, frame: Frame) -> None:
        """Answer a frame that a stop made void: as by a silent servo, a sync write not at all."""
        if frame.cmd == Command.SYNC_WRITE:
            return
        known = frame.cmd in (Command.READ, Command.PING) and _is_packet(frame.body)
        if known:
            self._send(self.no_answer(frame.body[2], ping=frame.cmd == Command.PING))
        else:
            self._send(UNKNOWN_COMMAND_PACKET)

    def sketch_job(self, frame: SketchFrame) -> Job:
        """Act on what the sketch took for a frame."""
        if frame.short:
            return self._answer(SHORT_FRAME_PACKET)
        return self._decode(frame.cmd, frame.body)

    def _decode(self, cmd: int, body: bytes) -> Job:
        if cmd == Command.SYNC_WRITE:
            return self._sync_write(body)
        if cmd in (Command.READ, Command.PING):
            if self._chapter:
                return self._chapter_read(body) if cmd == Command.READ else self._chapter_ping(body)
            return self._read(body, ping=cmd == Command.PING)
        return self._answer(UNKNOWN_COMMAND_PACKET)

    def _answer(self, packet: bytes) -> Job:
        self._send(packet)
        yield from ()

    def _send(self, packet: bytes) -> None:
        self._board.reply_dialect1(packet)

    def _is_legacy(self, servo_id: int) -> bool:
        joint = self._board.state.joint(servo_id)
        return joint is not None and joint.series is Series.SEVEN_BOT

    # -- the chapter's board ------------------------------------------------------------------------

    def _chapter_read(self, body: bytes) -> Job:
        """`servo_read`: it never drains the bus, so an answer too late goes to the next who asks."""
        board = self._board
        servo_id = body[2] if len(body) > 2 else 0
        buffer = bytearray([0xFF, 0xF5, servo_id, 4, 1, 0, 0, ~(servo_id + 5) & 0xFF])
        count = polls = 0
        for _ in range(_TRIES):
            yield Send(body)
            yield Delay(_READ_WAIT)
            while board.bus_waiting < 8 and polls < _POLLS:
                polls += 1
                yield Delay(_READ_POLL)
            while data := board.read_bus():
                # The sketch's buffer has 8 bytes; what is longer runs over its stack, and on the simulated chip an
                # echo and an answer do so without harm. Here the stack has 16.
                buffer[count : count + len(data)] = data
                count += len(data)
                yield Delay(_BYTE_WAIT * len(data))
            if count:
                break
        count = min(count, _STACK) or 8
        if self._is_legacy(servo_id):
            buffer[5], buffer[6] = buffer[6], buffer[5]
        self._send(bytes(buffer[:count]))

    def _chapter_ping(self, body: bytes) -> Job:
        board = self._board
        servo_id = body[2] if len(body) > 2 else 0
        buffer = b""
        polls = 0
        for _ in range(_TRIES):
            board.read_bus()
            yield Send(body)
            while board.bus_waiting < 6 and polls < _POLLS:
                polls += 1
                yield Delay(_PING_POLL)
            while data := board.read_bus():
                buffer += data
                yield Delay(_BYTE_WAIT * len(data))
            if buffer:
                break
        self._send(buffer[:6] or _board_error(servo_id, 5))

    # -- hexwire's board ----------------------------------------------------------------------------

    def _read(self, body: bytes, *, ping: bool) -> Job:
        try:
            packet = parse_packet(body)
        except RemoteProtocolError:
            self._send(UNKNOWN_COMMAND_PACKET)
            return
        try:
            passed = yield from self._board.dialect2.let_through(check_packet(body), chapter=True)
        except RefusedError:
            # This dialect has no word for "refused": the servo did not answer.
            self._send(self.no_answer(packet.servo_id, ping=ping))
            return
        answers = yield from self._board.bus.ask_all(passed)
        if answers:
            self._send(b"".join(self.status_bytes(packet, status) for status in answers))
        else:
            self._send(self.no_answer(packet.servo_id, ping=ping))

    @staticmethod
    def no_answer(servo_id: int, *, ping: bool) -> bytes:
        """The board's own packet for a servo that does not answer."""
        return _board_error(servo_id, 5) if ping else make_status(servo_id, 1, b"\0\0", legacy=True)

    @staticmethod
    def status_bytes(packet: ServoPacket, status: StatusPacket) -> bytes:
        """What the chapter's board would send for this answer."""
        params = status.params
        if status.legacy and packet.instruction == Instruction.PING:
            return _board_error(status.servo_id, status.error)
        if status.legacy and len(params) == 2 and packet.instruction == Instruction.READ:
            params = params[::-1]
        return make_status(status.servo_id, status.error, params, legacy=status.legacy)

    # -- both ---------------------------------------------------------------------------------------

    def _sync_write(self, body: bytes) -> Job:
        rows = self.sync_write_rows(body)
        if self._chapter:
            yield from self._chapter_move(rows)
            return
        with suppress(RefusedError):
            yield from self._board.dialect2.chapter_move(rows, chapter=True)

    def _chapter_move(self, rows: list[tuple[int, int, int]]) -> Job:
        for servo_id, position, run_time in rows:
            order = "big" if self._is_legacy(servo_id) else "little"
            data = position.to_bytes(2, order) + run_time.to_bytes(2, order)  # type: ignore[arg-type]  # one of two literals
            yield Send(make_write(servo_id, _TARGET, data))

    def sync_write_rows(self, body: bytes) -> list[tuple[int, int, int]]:
        """Rows of a sync write as `arm_sync_write` takes them: id, position, run time.

        The chapter's board looks at neither the register nor the checksum; hexwire's at both.
        """
        if len(body) < 11 or body[4] != Instruction.SYNC_WRITE or body[3] < 9 or body[6] != 4:
            return []
        if not self._chapter and (body[5] != _TARGET or not _is_packet(body)):
            return []
        rows = []
        steer_num = len(self._board.state.joints)
        offset, total = 7, body[3]
        while offset < total and offset + _ROW <= len(body) and body[offset] < steer_num:
            row = body[offset : offset + _ROW]
            rows.append((row[0], row[1] | row[2] << 8, row[3] | row[4] << 8))
            offset += _ROW
        return rows


def _board_error(servo_id: int, error: int) -> bytes:
    """FF F5 and 6 bytes in all, whatever it says: as a legacy servo's ping answer."""
    return bytes([0xFF, 0xF5, servo_id, 6, error, ~(servo_id + 6 + error) & 0xFF])


def _is_packet(body: bytes) -> bool:
    try:
        parse_packet(body)
    except RemoteProtocolError:
        return False
    return True
