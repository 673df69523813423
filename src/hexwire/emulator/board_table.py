"""SERVO_TABLE on an emulated board: reading and writing many registers of one servo.

Owns the pieces in which they are read and written, and what is refused (PROTOCOL.md section 6.10). Knows no frames;
`board_messages` splits and joins.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import replace

from hexwire.session.servo_answers import expected_answer
from hexwire.wire.board_trajectory import PathState
from hexwire.wire.command_frame import Status
from hexwire.wire.registers import Series
from hexwire.wire.servo_packet import make_read, make_write, parse_packet
from hexwire.wire.servo_table import TABLE_HEAD_SIZE, TABLE_REGISTERS, ServoTable

from .board_bus import BoardBus, Job, Transaction, Wait
from .board_orders import BoardOrders
from .board_state import BoardState, JointSlot
from .board_trajectory import BoardTrajectory
from .gate import RefusedError

__all__ = ["BoardTable", "TableMessage"]

_READ, _WRITE, _LEGACY = 64, 32, 2
"""Registers of one read and of one write, and of either to a legacy servo."""
_CONFIRMS = 0.020
_FOLLOWS = (PathState.WAITING, PathState.RUNNING, PathState.BRAKING)

Registers = Generator[Wait, bytes | None, bytes]
Reply = Generator[Wait, bytes | None, bytes]


class BoardTable:
    """Register tables of one board's servos.

    Args:
        state: What the board knows.
        bus: Its servos.
        orders: What may be written to them.
        trajectory: The board's trajectory.
    """

    def __init__(self, state: BoardState, bus: BoardBus, orders: BoardOrders, trajectory: BoardTrajectory) -> None:
        self._state = state
        self._bus = bus
        self._orders = orders
        self._trajectory = trajectory

    def check_range(self, table: ServoTable) -> JointSlot:
        """The joint of a request.

        Raises:
            RefusedError: There is no such joint or register.
        """
        joint = self._state.joint(table.servo_id)
        if joint is None or not table.count or table.first + table.count > TABLE_REGISTERS:
            raise RefusedError(Status.BAD_RANGE)
        return joint

    @property
    def is_busy(self) -> bool:
        """Whether a trajectory leaves no time for reads."""
        self._trajectory.update()
        return self._trajectory.state in _FOLLOWS

    def check_write(self) -> None:
        """Check whether registers may be written at all.

        Raises:
            RefusedError: Stopped, or not in maintenance.
        """
        self._orders.refuse_if_stopped()
        if not self._state.maintenance:
            raise RefusedError(Status.FORBIDDEN)

    def read(self, joint: JointSlot, first: int, count: int) -> Registers:
        """Read registers.

        Raises:
            RefusedError: The servo does not answer.
        """
        most = _LEGACY if joint.series is Series.SEVEN_BOT else _READ
        found = b""
        for address in range(first, first + count, most):
            found += yield from self._read_piece(joint, address, min(most, first + count - address))
        return found

    def _read_piece(self, joint: JointSlot, address: int, count: int) -> Registers:
        status = yield from self._bus.ask(make_read(joint.servo_id, address, count))
        if status is None:
            raise RefusedError(Status.SERVO_SILENT)
        return status.params

    def write(self, joint: JointSlot, first: int, data: bytes) -> Job:
        """Write the registers that differ.

        Raises:
            RefusedError: The gate lets it not pass, the servo does not answer, or does not keep a value.
        """
        if not data:
            return
        packet = parse_packet(make_write(joint.servo_id, first, data))
        passed = yield from self._orders.let_through(packet, chapter=False)
        self._bus.note(passed)
        most = _LEGACY if joint.series is Series.SEVEN_BOT else _WRITE
        for at in range(0, len(data), most):
            yield from self._write_piece(joint, first + at, data[at : at + most])

    def _write_piece(self, joint: JointSlot, address: int, data: bytes) -> Job:
        if (yield from self._read_piece(joint, address, len(data))) == data:
            return
        packet = make_write(joint.servo_id, address, data)
        yield Transaction(packet, expected_answer(parse_packet(packet)).length, _CONFIRMS)
        if (yield from self._read_piece(joint, address, len(data))) != data:
            raise RefusedError(Status.SERVO_FAULT)


class TableMessage:
    """A SERVO_TABLE that writes and comes in pieces.

    Args:
        table: The board's tables.
    """

    head_size = TABLE_HEAD_SIZE

    def __init__(self, table: BoardTable) -> None:
        self._table = table
        self._asked = ServoTable(0, 0, 0)
        self._joint: JointSlot | None = None
        self._done = 0

    def begin(self, head: bytes, check_length: Callable[[int], None]) -> None:
        """Check the fixed part; `check_length` gets the length of the whole body.

        Raises:
            RefusedError: It is refused.
        """
        self._asked = ServoTable.parse(head)
        self._joint = self._table.check_range(self._asked)
        self._table.check_write()
        check_length(TABLE_HEAD_SIZE + self._asked.count)

    def take(self, data: bytes) -> Job:
        """Write what came next.

        Raises:
            RefusedError: It is refused, or failed.
        """
        assert self._joint is not None
        self._table.check_write()
        yield from self._table.write(self._joint, self._asked.first + self._done, data)
        self._done += len(data)

    def finish(self) -> bytes:
        """The body of the reply, when all has come."""
        return replace(self._asked, data=b"").serialize()

    def drop(self) -> None:
        """Forget the rest; what is written stays."""
