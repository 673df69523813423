"""Dialect 1 on hexwire's board: the chapter's commands, verified, checked by the gate and kept within joint limits.

Owns its answers: a correct client gets the same as from the chapter's board, whose answers are in `board_chapter`.
Knows nothing of links.
"""

from __future__ import annotations

from contextlib import suppress

from hexwire.errors import RemoteProtocolError
from hexwire.session.connection import Connection
from hexwire.session.dialect1 import UNKNOWN_COMMAND_PACKET
from hexwire.wire.command_frame import Command, Frame
from hexwire.wire.servo_packet import parse_packet

from .board_bus import BoardBus, Clock, Job
from .board_chapter import is_packet, no_answer, status_bytes, sync_write_rows
from .board_orders import BoardOrders
from .board_state import BoardState
from .gate import RefusedError, check_packet

__all__ = ["Dialect1"]


class Dialect1:
    """Dialect-1 dispatch of hexwire's board.

    Args:
        state: What the board knows.
        bus: Its servos.
        clock: The board's time.
        connection: Where answers go.
    """

    def __init__(self, state: BoardState, bus: BoardBus, clock: Clock, connection: Connection) -> None:
        self._state = state
        self._bus = bus
        self._clock = clock
        self._connection = connection
        self._orders = BoardOrders(state, bus, clock)

    def job(self, frame: Frame) -> Job:
        """Act on a frame."""
        if frame.cmd == Command.SYNC_WRITE:
            return self._sync_write(frame.body)
        if frame.cmd in (Command.READ, Command.PING):
            return self._packet(frame.body, ping=frame.cmd == Command.PING)
        return self._unknown()

    def void(self, frame: Frame) -> None:
        """Answer a frame that a stop made void, as if the servo were silent; a sync write is not answered."""
        if frame.cmd == Command.SYNC_WRITE:
            return
        if frame.cmd in (Command.READ, Command.PING) and is_packet(frame.body):
            self._send(no_answer(frame.body[2], ping=frame.cmd == Command.PING))
        else:
            self._send(UNKNOWN_COMMAND_PACKET)

    def _send(self, packet: bytes) -> None:
        self._connection.reply_dialect1(packet, self._clock())

    def _unknown(self) -> Job:
        self._send(UNKNOWN_COMMAND_PACKET)
        yield from ()

    def _packet(self, body: bytes, *, ping: bool) -> Job:
        try:
            packet = parse_packet(body)
        except RemoteProtocolError:
            self._send(UNKNOWN_COMMAND_PACKET)
            return
        try:
            passed = yield from self._orders.let_through(check_packet(body), chapter=True)
        except RefusedError:
            # This dialect cannot say "refused"; the closest is a servo that does not answer.
            self._send(no_answer(packet.servo_id, ping=ping))
            return
        answers = yield from self._bus.ask_all(passed)
        if answers:
            self._send(b"".join(status_bytes(packet, status) for status in answers))
        else:
            self._send(no_answer(packet.servo_id, ping=ping))

    def _sync_write(self, body: bytes) -> Job:
        rows = sync_write_rows(body, len(self._state.joints), verified=True)
        with suppress(RefusedError):
            yield from self._orders.chapter_move(rows, chapter=True)
