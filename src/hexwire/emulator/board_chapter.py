"""Dialect 1 on the chapter's board: its `decode()` and what it calls.

Owns the replies of the chapter's sketch, byte for byte, and its delays when the bus is paced. It verifies nothing,
and passes on whatever is in the serial buffer of the bus. Knows nothing of links.
"""

from __future__ import annotations

from typing import Literal

from hexwire.session.connection import Connection
from hexwire.session.dialect1 import SHORT_FRAME_PACKET, UNKNOWN_COMMAND_PACKET
from hexwire.wire.command_frame import Command, Frame
from hexwire.wire.registers import Series
from hexwire.wire.servo_packet import make_write

from .board_jobs import BusBuffer, Clock, Delay, Job, Send
from .board_state import BoardState
from .chapter_packets import TARGET, no_answer, sync_write_rows
from .sketch import SketchFrame

__all__ = ["MIDDLE", "ChapterDialect"]

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
    """Dispatch of the chapter's board.

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
            yield Send(make_write(joint.servo_id, _TORQUE, b"\1"))
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
            yield Send(body)
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
            yield Send(body)
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

    def _joint_move(self, servo_id: int, position: int, run_time: int) -> Send:
        """`joint_move` of the library."""
        order: Literal["big", "little"] = "big" if self._is_legacy(servo_id) else "little"
        return Send(make_write(servo_id, TARGET, position.to_bytes(2, order) + run_time.to_bytes(2, order)))
