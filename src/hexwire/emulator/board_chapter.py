"""Dialect 1 on the chapter's board: how its sketch takes frames off the line, its `decode()`, and what it calls.

Owns the receive loop of the printed sketch, hazards and all, its replies, byte for byte, and its delays when the
bus is paced. Frames end at the first 0D 0A after the sync word, in a buffer that keeps the bytes of earlier frames;
bytes that arrive while a command runs have 63 bytes of room. The sketch verifies nothing, and passes on whatever is
in the serial buffer of the bus. Tests use it to show that a host never sends what such a board would misread. Knows
nothing of links.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

from hexwire.errors import RemoteProtocolError
from hexwire.session.connection import Connection
from hexwire.session.dialect1 import SHORT_FRAME_PACKET, UNKNOWN_COMMAND_PACKET
from hexwire.wire.command_frame import Command, Frame
from hexwire.wire.registers import Series
from hexwire.wire.servo_packet import (
    Instruction,
    ServoPacket,
    StatusPacket,
    make_board_error,
    make_legacy_ping_status,
    make_status,
    make_write,
    parse_packet,
)
from hexwire.wire.tables import BOARD_ERRORS

from .board_bus import BusBuffer, Clock, Delay, Job, SendPacket
from .board_state import BoardState

__all__ = [
    "MIDDLE",
    "TARGET",
    "ChapterDialect",
    "ChapterRow",
    "SketchFrame",
    "SketchReceiver",
    "is_packet",
    "no_answer",
    "status_bytes",
    "sync_write_rows",
]

TARGET = Series.SEVEN_BOT.register("target_position").address
_ROW = 5

ChapterRow = tuple[int, int, int]
"""Servo id, position in counts, run time in milliseconds."""


def no_answer(servo_id: int, *, ping: bool) -> bytes:
    """The board's own packet for a servo that does not answer."""
    return make_board_error(BOARD_ERRORS["ping_silent" if ping else "read_silent"], servo_id)


def status_bytes(packet: ServoPacket, status: StatusPacket) -> bytes:
    """What that board would send for this answer."""
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
        verified: Check register and checksum, as hexwire's board does; that with the sketch checks neither.
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


_BUFFER = 254
_RING = 63


class SketchFrame(NamedTuple):
    """What the sketch takes for a frame.

    Attributes:
        data: The whole buffer, stale bytes included.
        length: Number of bytes of it that arrived this time.
    """

    data: bytes
    length: int

    @property
    def short(self) -> bool:
        """Too short for a command, by the sketch's own test."""
        return self.length <= 40

    @property
    def hangs(self) -> bool:
        """Whether the sketch waits forever for room for this packet."""
        return not self.short and self.cmd in (Command.PING, Command.READ) and self.data[36] > _RING

    @property
    def cmd(self) -> int:
        """Command code, perhaps of an earlier frame."""
        return self.data[38]

    @property
    def body(self) -> bytes:
        """The body by the low byte of its length field, perhaps with bytes of an earlier frame."""
        return self.data[40 : 40 + self.data[36]]


class SketchReceiver:
    """The sketch's `loop()`, a byte at a time, behind the ring of the Arduino core.

    Attributes:
        hung: 254 bytes came after a sync word without 0D 0A: the sketch takes no more until reset.
        lost: Bytes that the ring had no room for.
    """

    def __init__(self) -> None:
        self.hung = False
        self.lost = 0
        self._ring = bytearray()
        self._buffer = bytearray(_BUFFER)
        self._head = 0
        self._window = 0

    @property
    def waiting(self) -> int:
        """Bytes in the ring."""
        return len(self._ring)

    def put(self, data: bytes, *, busy: bool) -> None:
        """Take bytes off the line. While the sketch is busy with a command, what the ring cannot hold is lost."""
        self._ring += data
        if busy and len(self._ring) > _RING:
            self.lost += len(self._ring) - _RING
            del self._ring[_RING:]

    def next_frame(self) -> SketchFrame | None:
        """Read bytes to the end of what the sketch takes for a frame; None if there is no end yet."""
        while self._ring and not self.hung:
            byte = self._ring.pop(0)
            if not self._head:
                self._window = (self._window << 8 | byte) & 0xFFFFFFFF
                if self._window == 0x5AFAFA5A:
                    self._buffer[:4] = b"\x5a\xfa\xfa\x5a"
                    self._head = 4
                continue
            last = self._buffer[self._head - 1]
            self._buffer[self._head] = byte
            self._head += 1
            if last == 0x0D and byte == 0x0A:
                frame = SketchFrame(bytes(self._buffer), self._head)
                self._head = self._window = 0
                if len(self._ring) > _RING:
                    # It is busy from here on.
                    self.lost += len(self._ring) - _RING
                    del self._ring[_RING:]
                return frame
            if self._head >= _BUFFER:
                self.hung = True
        if self.hung:
            self._ring.clear()
        return None


MIDDLE = 2048
"""Counts of every joint in the middle pose."""

# The sketch's waits: see the listing of servo_read and servo_ping.
_READ_WAIT = 0.010
_READ_POLL = 0.020
_PING_POLL = 0.010
_BYTE_WAIT = 0.002
_POLLS = 4
_TRIES = 2
_STACK = 16
_TORQUE = Series.SEVEN_BOT.register("torque_enable").address
# The listing of setup() has position_init() and a delay; how fast the library moves there is not known.
_HOME_TIME = 1000
_SETUP_WAIT = 1.0


class ChapterDialect:
    """Dispatch of a board with the sketch.

    Args:
        state: What the board knows, here of its joints.
        buffer: The serial buffer of its bus.
        clock: The board's time.
        connection: Where answers go.
    """

    def __init__(self, state: BoardState, buffer: BusBuffer, clock: Clock, connection: Connection) -> None:
        self._state = state
        self._buffer = buffer
        self._clock = clock
        self._connection = connection

    def setup(self) -> Job:
        """`setup`: every joint gets torque and is driven to its middle, and the board is deaf meanwhile."""
        for joint in self._state.joints:
            yield SendPacket(make_write(joint.servo_id, _TORQUE, b"\1"))
            yield self._joint_move(joint.servo_id, MIDDLE, _HOME_TIME)
        yield Delay(_SETUP_WAIT)
        # Its library is not public: taken is that it reads the answers to its own writes.
        self._read_bus()

    def job(self, frame: Frame | SketchFrame) -> Job:
        """Act on a frame, or on what the sketch takes for one."""
        if isinstance(frame, SketchFrame) and frame.short:
            return self._answer(SHORT_FRAME_PACKET)
        if frame.cmd == Command.SYNC_WRITE:
            return self._sync_write(frame.body)
        if frame.cmd == Command.READ:
            return self._read(frame.body)
        if frame.cmd == Command.PING:
            return self._ping(frame.body)
        return self._answer(UNKNOWN_COMMAND_PACKET)

    def _send(self, packet: bytes) -> None:
        self._connection.reply_dialect1(packet, self._clock())

    def _answer(self, packet: bytes) -> Job:
        self._send(packet)
        yield from ()

    def _waiting(self) -> int:
        return self._buffer.waiting(self._clock())

    def _read_bus(self) -> bytes:
        return self._buffer.read(self._clock())

    def _is_legacy(self, servo_id: int) -> bool:
        joint = self._state.joint(servo_id)
        return joint is not None and joint.series is Series.SEVEN_BOT

    def _read(self, body: bytes) -> Job:
        """`servo_read`: it never empties the buffer, so a late answer goes to the next request."""
        servo_id = body[2] if len(body) > 2 else 0
        buffer = bytearray([0xFF, 0xF5, servo_id, 4, 1, 0, 0, ~(servo_id + 5) & 0xFF])
        count = polls = 0
        for _ in range(_TRIES):
            yield SendPacket(body)
            yield Delay(_READ_WAIT)
            while self._waiting() < 8 and polls < _POLLS:
                polls += 1
                yield Delay(_READ_POLL)
            while data := self._read_bus():
                # The sketch's buffer has 8 bytes; a longer answer overwrites the stack. On the simulated chip the
                # 16 bytes of an echo and an answer do no harm, so 16 are kept here.
                buffer[count : count + len(data)] = data
                count += len(data)
                yield Delay(_BYTE_WAIT * len(data))
            if count:
                break
        count = min(count, _STACK) or 8
        if self._is_legacy(servo_id):
            buffer[5], buffer[6] = buffer[6], buffer[5]
        self._send(bytes(buffer[:count]))

    def _ping(self, body: bytes) -> Job:
        """`servo_ping`."""
        servo_id = body[2] if len(body) > 2 else 0
        buffer = b""
        polls = 0
        for _ in range(_TRIES):
            self._read_bus()
            yield SendPacket(body)
            while self._waiting() < 6 and polls < _POLLS:
                polls += 1
                yield Delay(_PING_POLL)
            while data := self._read_bus():
                buffer += data
                yield Delay(_BYTE_WAIT * len(data))
            if buffer:
                break
        self._send(buffer[:6] or no_answer(servo_id, ping=True))

    def _sync_write(self, body: bytes) -> Job:
        for servo_id, position, run_time in sync_write_rows(body, len(self._state.joints), verified=False):
            yield self._joint_move(servo_id, position, run_time)

    def _joint_move(self, servo_id: int, position: int, run_time: int) -> SendPacket:
        """`joint_move` of the library."""
        order: Literal["big", "little"] = "big" if self._is_legacy(servo_id) else "little"
        return SendPacket(make_write(servo_id, TARGET, position.to_bytes(2, order) + run_time.to_bytes(2, order)))
