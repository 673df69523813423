"""Dialect 2 on an emulated board: every command of PROTOCOL.md section 6.

Owns the meaning of the commands: what is checked, refused, clamped and answered. A handler is a job that talks
to servos through `board_bus` and answers through the connection. Knows nothing of links.
"""

from __future__ import annotations

from collections.abc import Callable, Generator

from hexwire.errors import RemoteProtocolError
from hexwire.session.connection import Connection
from hexwire.session.events import Request
from hexwire.wire import tables
from hexwire.wire.command_frame import Command, Frame, Status
from hexwire.wire.commands import (
    ALL_FIELDS,
    STATS_FIELDS,
    Identity,
    JointRow,
    LimitTable,
    MaintenanceReply,
    MoveReply,
    MoveRequest,
    OffsetTable,
    SentRow,
    Stats,
    TransactRequest,
    make_stop_reply,
    parse_stop_reply,
)
from hexwire.wire.servo_packet import BROADCAST_ID

from .board_bus import BoardBus, Clock, Job, Pause, Wait
from .board_chapter import status_bytes, sync_write_rows
from .board_messages import BoardMessages
from .board_orders import BoardOrders
from .board_rate import LineRate
from .board_state import BoardState, JointSlot
from .board_stop import Stopping, StopQueue
from .board_table import BoardTable, TableMessage
from .board_trajectory import BoardTrajectory, PointsMessage, TrajectoryCommands
from .gate import MAX_REPLY, RefusedError, check_packet

__all__ = ["Dialect2"]

_FIRMWARE = (tables.VERSION_MAJOR, tables.VERSION_MINOR, tables.VERSION_PATCH)
_DEFAULT_TRANSACT_MS = 20
_CAPABILITIES = sum(tables.CAPABILITIES.values()) & ~tables.CAPABILITY_HOST_BAUD
_OUTPUTS = 0x07
_STILL_TIME, _STILL = 0.1, 4
"""Seconds between two looks at joints that may move, and the most counts between them of one that does not."""


class Dialect2:
    """Dialect-2 dispatch of one board.

    Args:
        state: What the board knows.
        bus: Its servos.
        clock: The board's time.
        connection: Where answers go.
        stops: Stops that wait or are under way.
        trajectory: The board's trajectory.
        line: The rate of the host line.

    Attributes:
        messages: Messages in fragments.
    """

    def __init__(
        self,
        state: BoardState,
        bus: BoardBus,
        clock: Clock,
        connection: Connection,
        stops: StopQueue,
        trajectory: BoardTrajectory,
        line: LineRate,
    ) -> None:
        self._state = state
        self._bus = bus
        self._clock = clock
        self._connection = connection
        self._stops = stops
        self._line = line
        self._moves = trajectory
        self._orders = BoardOrders(state, bus, clock)
        self._trajectory = TrajectoryCommands(state, trajectory, self._orders, clock)
        table = BoardTable(state, bus, self._orders, trajectory)
        consumers: dict[int, Callable[[], TableMessage | PointsMessage]] = {
            Command.TRAJECTORY_POINTS: self._trajectory.points_message,
            Command.SERVO_TABLE: lambda: TableMessage(table),
        }
        self.messages = BoardMessages(connection, clock, table, consumers)
        self._handlers: dict[int, Callable[[Request], Job]] = {
            Command.PING: self._packet,
            Command.READ: self._packet,
            Command.SYNC_WRITE: self._sync_write,
            Command.IDENTIFY: self._identify,
            Command.JOINT_STATE: self._joint_state,
            Command.REPORT: self._report,
            Command.JOINT_MOVE: self._joint_move,
            Command.TORQUE: self._torque,
            Command.STOP: self._bad_stop,
            Command.RESUME: self._resume,
            Command.WATCHDOG: self._watchdog,
            Command.LIMITS: self._limits,
            Command.OFFSETS: self._offsets,
            Command.TRANSACT: self._transact,
            Command.STATS: self._stats,
            Command.IO: self._io,
            Command.MAINTENANCE: self._maintenance,
            Command.FRAGMENT: self.messages.fragment,
            Command.FRAGMENT_MISSING: self.messages.missing,
            Command.SERVO_TABLE: self.messages.table,
            Command.HOST_BAUD: self._host_baud,
            **dict.fromkeys(self._trajectory.handlers, self._trajectory_command),
        }

    @staticmethod
    def stop_mode(frame: Frame) -> int | None:
        """The mode of a valid STOP, which goes ahead of everything in the queue; None for any other frame."""
        sound = frame.cmd == Command.STOP and frame.body in (b"\0", b"\1")
        return frame.body[0] if sound else None

    def job(self, request: Request) -> Job:
        """Act on a request and answer it exactly once."""
        handler = self._handlers.get(request.frame.cmd)
        if handler is None:
            self._reply(request, Status.UNKNOWN_COMMAND)
            return
        try:
            yield from handler(request)
        except RefusedError as refused:
            self._reply(request, refused.status)
        except RemoteProtocolError:
            self._reply(request, Status.BAD_LENGTH)

    def report_job(self) -> Job:
        """One unsolicited JOINT_STATE."""
        yield from self._bus.refresh()
        state = self._state
        if state.report_due is not None:
            now = self._clock()
            if state.report_due - now < state.report_period / 2:
                # This report is late: the next must not follow it at once.
                state.report_due += state.report_period
            body = state.report(state.report_fields, now).serialize()
            self._connection.report(Command.JOINT_STATE, body, now)

    def refuse(self, request: Request, status: Status, *, voided: bool = False) -> None:
        """Answer a request that is not executed: a stop made it void, or the queue is full."""
        if request.frame.cmd not in (Command.FRAGMENT, Command.FRAGMENT_MISSING):
            self._connection.reply(request, status, b"", self._clock(), voided=voided)
        elif not voided:
            self._connection.answer(request.frame, status, b"", self._clock())
        elif request.frame.cmd == Command.FRAGMENT:
            self.messages.void(request.frame)

    def stop_job(self, mode: int) -> Job:
        """Carry out one stop; all requests for it that arrive meanwhile get the same answer."""
        joints = self._state.joints
        stopped = yield from Stopping(joints, self._bus, self._clock).run(mode)
        status = Status.SERVO_FAULT if stopped.taken else Status.OK
        if stopped.mask != (1 << len(joints)) - 1:
            status = Status.SERVO_SILENT
        for request in self._stops.finish():
            self._reply(request, status, make_stop_reply(mode, stopped.mask))

    # -- answers ------------------------------------------------------------------------------------

    def _reply(self, request: Request, status: Status, body: bytes = b"") -> None:
        self._connection.reply(request, status, body, self._clock())

    @staticmethod
    def _body(request: Request, length: int) -> bytes:
        body = request.frame.body
        if len(body) != length:
            raise RefusedError(Status.BAD_LENGTH)
        return body

    # -- identity, states, counters -----------------------------------------------------------------

    def _identify(self, request: Request) -> Job:
        self._body(request, 0)
        state = self._state
        self.messages.identified(request.frame.src)
        # A host that sends IDENTIFY again has not asked for reports yet.
        state.report_due, state.report_period = None, 0.0
        rows = tuple(JointRow(j.servo_id, j.series.code, j.present) for j in state.joints)
        identity = Identity(
            tables.PROTO_HEXWIRE,
            _FIRMWARE,
            state.boot_id,
            _CAPABILITIES | (tables.CAPABILITY_HOST_BAUD if self._line.own else 0),
            self._connection.max_frame,
            state.board_flags,
            rows,
        )
        self._reply(request, Status.OK, identity.serialize())
        yield from ()

    def _joint_state(self, request: Request) -> Job:
        fields = self._body(request, 1)[0]
        if fields > ALL_FIELDS:
            raise RefusedError(Status.BAD_RANGE)
        yield from self._bus.refresh()
        self._reply(request, Status.OK, self._state.report(fields, self._clock()).serialize())

    def _report(self, request: Request) -> Job:
        body = self._body(request, 3)
        period, fields = int.from_bytes(body[:2], "little"), body[2]
        if fields > ALL_FIELDS or (period and not 5 <= period <= 10_000):
            raise RefusedError(Status.BAD_RANGE)
        state = self._state
        state.report_period, state.report_fields = period / 1000, fields
        state.report_due = self._clock() + state.report_period if period else None
        self._reply(request, Status.OK, body)
        yield from ()

    def _stats(self, request: Request) -> Job:
        self._body(request, 0)
        state = self._state
        counters, decoder = self._connection.counters, self._connection.decoder.counters
        values = {
            "uptime_ms": int((self._clock() - state.now) * 1000),
            "frames_received": decoder.frames,
            "frames_sent": counters.frames_sent,
            "bad_checks": decoder.bad_checks,
            "bad_frames": decoder.bad_frames,
            "resyncs": decoder.resyncs,
            "bytes_dropped": decoder.bytes_dropped,
            "repeats": counters.repeats,
        }
        values |= {name: getattr(state, name) for name in STATS_FIELDS if hasattr(state, name)}
        self._reply(request, Status.OK, Stats(values).serialize())
        yield from ()

    def _host_baud(self, request: Request) -> Job:
        body, line = self._body(request, 4), self._line
        rate = int.from_bytes(body, "little")
        if not line.own:
            raise RefusedError(Status.NOT_SUPPORTED)
        if not line.knows(rate):
            raise RefusedError(Status.BAD_RANGE)
        if rate not in (line.now, line.own):
            moved = yield from self._moved()
            if moved or self._moves.due_at is not None:
                raise RefusedError(Status.BUSY)
        self._reply(request, Status.OK, body)
        line.change(rate)

    def _moved(self) -> Generator[Wait, bytes | None, bool]:
        """Read positions twice; whether a joint with torque is elsewhere the second time."""
        before: dict[int, int] = {}
        yield from self._bus.poll_all()
        for joint in self._state.joints:
            before[joint.servo_id] = joint.position
        yield Pause(_STILL_TIME)
        yield from self._bus.poll_all()
        return any(
            j.present and j.torque_on and abs(j.position - before[j.servo_id]) > _STILL for j in self._state.joints
        )

    # -- motion -------------------------------------------------------------------------------------

    def _joint_move(self, request: Request) -> Job:
        move = MoveRequest.parse(request.frame.body)
        if not move.rows:
            raise RefusedError(Status.BAD_LENGTH)
        state = self._state
        targets: list[tuple[JointSlot, int]] = []
        for row in move.rows:
            joint = state.joint(row.servo_id)
            if row.servo_id == BROADCAST_ID:
                targets.extend((j, row.position) for j in state.joints)
            elif joint is None:
                raise RefusedError(Status.BAD_RANGE)
            else:
                targets.append((joint, row.position))
        if len({j.servo_id for j, _ in targets}) != len(targets):
            raise RefusedError(Status.BAD_RANGE)
        self._orders.refuse_motion()
        self._orders.refuse_following(j for j, _ in targets)
        yield from self._orders.look_at([j for j, _ in targets])
        if any(j.present and not j.torque_on for j, _ in targets):
            raise RefusedError(Status.TORQUE_OFF)
        sent = [(j, self._orders.clamp(j, p)) for j, p in targets if j.present]
        duration = max(move.duration_ms, self._orders.slowest(sent))
        yield from self._bus.move(sent, duration)
        rows = tuple(SentRow(j.servo_id, p, j.clamped) for j, p in sent)
        status = Status.OK if len(sent) == len(targets) else Status.SERVO_SILENT
        self._reply(request, status, MoveReply(duration, rows).serialize())

    def _torque(self, request: Request) -> Job:
        on, mask = parse_stop_reply(request.frame.body)
        joints = self._state.joints
        if on > 1 or mask >> len(joints):
            raise RefusedError(Status.BAD_RANGE)
        named = [j for i, j in enumerate(joints) if mask >> i & 1]
        if on:
            self._orders.refuse_motion()
            # It would make the present position the target.
            self._orders.refuse_following(named)
            confirmed = yield from self._bus.torque_on(named)
        else:
            confirmed = yield from self._bus.torque_off(named)
        missing = [j for i, j in enumerate(joints) if (mask & ~confirmed) >> i & 1]
        status = Status.OK
        if missing:
            astray = on and any(j.present and j.mode for j in missing)
            status = Status.SERVO_FAULT if astray else Status.SERVO_SILENT
        self._reply(request, status, make_stop_reply(on, confirmed))

    def _trajectory_command(self, request: Request) -> Job:
        body = yield from self._trajectory.handlers[request.frame.cmd](request.frame.body)
        if request.frame.cmd == Command.TRAJECTORY_BEGIN and self.messages.streams_points:
            self.messages.drop_incoming()
        self._reply(request, Status.OK, body)

    def _bad_stop(self, request: Request) -> Job:
        """Refuse a malformed STOP; a valid one does not go through the queue."""
        self._body(request, 1)
        yield from ()
        raise RefusedError(Status.BAD_RANGE)

    def _resume(self, request: Request) -> Job:
        self._body(request, 0)
        state = self._state
        state.stopped = state.watchdog_tripped = state.torque_off_stop = False
        state.feed_watchdog(self._clock())
        self._reply(request, Status.OK, bytes((state.board_flags,)))
        yield from ()

    def _watchdog(self, request: Request) -> Job:
        body = self._body(request, 3)
        timeout, mode = int.from_bytes(body[:2], "little"), body[2]
        if mode > 1 or (timeout and not 50 <= timeout <= 60_000):
            raise RefusedError(Status.BAD_RANGE)
        state = self._state
        state.watchdog_timeout, state.watchdog_mode = timeout / 1000, mode
        state.watchdog_due = None
        state.feed_watchdog(self._clock())
        self._reply(request, Status.OK, body)
        yield from ()

    # -- settings -----------------------------------------------------------------------------------

    def _limits(self, request: Request) -> Job:
        state = self._state
        if request.frame.body:
            rows = LimitTable.parse_request(request.frame.body)
            self._orders.refuse_if_stopped()
            if len(rows) != len(state.joints):
                raise RefusedError(Status.BAD_LENGTH)
            if any(row.minimum >= row.maximum or not row.speed for row in rows):
                raise RefusedError(Status.BAD_RANGE)
            self._may_store(list(rows) == state.settings.limits)
            state.settings.limits = state.limits = list(rows)
        table = LimitTable(tables.SETTINGS_VERSION, tuple(state.limits))
        self._reply(request, Status.OK, table.serialize())
        yield from ()

    def _may_store(self, same: bool) -> None:
        """Refuse rows that would wear out the EEPROM."""
        if not same and not self._state.may_store(self._clock()):
            raise RefusedError(Status.BUSY)

    def _offsets(self, request: Request) -> Job:
        state = self._state
        if request.frame.body:
            rows = OffsetTable.parse_request(request.frame.body)
            self._orders.refuse_if_stopped()
            if len(rows) != len(state.joints):
                raise RefusedError(Status.BAD_LENGTH)
            if any(row.sign not in (1, -1) for row in rows):
                raise RefusedError(Status.BAD_RANGE)
            self._may_store(list(rows) == state.settings.offsets)
            state.settings.offsets = state.offsets = list(rows)
        table = OffsetTable(tables.SETTINGS_VERSION, tuple(state.offsets))
        self._reply(request, Status.OK, table.serialize())
        yield from ()

    # -- servo packets ------------------------------------------------------------------------------

    def _packet(self, request: Request) -> Job:
        """PING and READ in a dialect-2 frame: as in dialect 1, but a silent servo gives a status."""
        packet = check_packet(request.frame.body)
        passed = yield from self._orders.let_through(packet, chapter=False)
        answers = yield from self._bus.ask_all(passed)
        if not answers:
            raise RefusedError(Status.SERVO_SILENT)
        self._reply(request, Status.OK, b"".join(status_bytes(packet, status) for status in answers))

    def _sync_write(self, request: Request) -> Job:
        rows = sync_write_rows(request.frame.body, len(self._state.joints), verified=True)
        if not rows:
            raise RefusedError(Status.BAD_RANGE)
        whole = yield from self._orders.chapter_move(rows, chapter=False)
        self._reply(request, Status.OK if whole else Status.SERVO_SILENT)

    def _transact(self, request: Request) -> Job:
        transact = TransactRequest.parse(request.frame.body)
        packet = check_packet(transact.packet)
        if transact.reply_length > MAX_REPLY:
            raise RefusedError(Status.BAD_RANGE)
        timeout = (transact.timeout_ms or _DEFAULT_TRANSACT_MS) / 1000
        passed = yield from self._orders.let_through(packet, chapter=False)
        answer = yield from self._bus.raw(passed, transact.reply_length, timeout)
        if transact.reply_length and not answer:
            raise RefusedError(Status.SERVO_SILENT)
        self._reply(request, Status.OK, answer[: transact.reply_length])

    def _io(self, request: Request) -> Job:
        mask, value = self._body(request, 2)
        if mask & ~_OUTPUTS:
            raise RefusedError(Status.BAD_RANGE)
        state = self._state
        if mask:
            self._orders.refuse_if_stopped()
            state.io = (state.io & ~mask) | (value & mask)
        self._reply(request, Status.OK, bytes((mask, state.io)))
        yield from ()

    def _maintenance(self, request: Request) -> Job:
        on = self._body(request, 1)[0]
        if on > 1:
            raise RefusedError(Status.BAD_RANGE)
        state = self._state
        if on:
            self._orders.refuse_if_stopped()
            for joint in state.joints:
                if (yield from self._bus.read_switches(joint)) and joint.torque_on:
                    raise RefusedError(Status.FORBIDDEN)
        state.maintenance = bool(on)
        for joint in state.joints:
            # Maintenance may change mode and torque: they are read before a target is sent.
            joint.unsure = True
        self._reply(request, Status.OK, MaintenanceReply(state.maintenance, state.board_flags).serialize())
