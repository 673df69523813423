"""Dialect 2 on an emulated board: every command of PROTOCOL.md section 6.

Owns the meaning of the commands: what is checked, refused, clamped and answered. A handler is a job that talks
to servos through `board_bus` and answers through the connection. Knows nothing of links.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from hexwire.errors import RemoteProtocolError
from hexwire.session.events import Request
from hexwire.wire import tables
from hexwire.wire.command_frame import Command, Frame, Status
from hexwire.wire.commands import (
    ALL_FIELDS,
    STATS_FIELDS,
    Identity,
    JointRow,
    LimitTable,
    MoveReply,
    MoveRequest,
    OffsetTable,
    SentRow,
    Stats,
    TransactRequest,
    make_stop_reply,
    parse_stop_reply,
)
from hexwire.wire.registers import Series
from hexwire.wire.servo_packet import BROADCAST_ID, Instruction, ServoPacket, parse_packet, parse_sync_write

from .board_bus import READ_ONLY, Job, Many, RefusedError
from .board_state import JointSlot

if TYPE_CHECKING:
    from .board import EmulatedBoard

__all__ = ["FIRMWARE", "Dialect2"]

FIRMWARE = (2, 0, 0)
_MAX_REPLY = 120
_READS = tuple(bytes((code,)) for code in READ_ONLY)
_DEFAULT_TRANSACT_MS = 20
_TARGET = Series.HLS.register("goal_position").address
_CAPABILITIES = sum(tables.CAPABILITIES.values())
_OUTPUTS = 0x07


class Dialect2:
    """Dialect-2 dispatch of one board."""

    def __init__(self, board: EmulatedBoard) -> None:
        self._board = board
        self._handlers: dict[int, Callable[[Request], Job]] = {
            Command.PING: self._packet,
            Command.READ: self._packet,
            Command.SYNC_WRITE: self._sync_write,
            Command.IDENTIFY: self._identify,
            Command.JOINT_STATE: self._joint_state,
            Command.REPORT: self._report,
            Command.JOINT_MOVE: self._joint_move,
            Command.TORQUE: self._torque,
            Command.STOP: self._stop,
            Command.RESUME: self._resume,
            Command.WATCHDOG: self._watchdog,
            Command.LIMITS: self._limits,
            Command.OFFSETS: self._offsets,
            Command.TRANSACT: self._transact,
            Command.STATS: self._stats,
            Command.IO: self._io,
        }

    @staticmethod
    def is_urgent(frame: Frame) -> bool:
        """Whether this goes before everything that is queued."""
        return frame.cmd == Command.STOP

    @staticmethod
    def is_motion(frame: Frame) -> bool:
        """Whether a stop makes this void: what could move something, or go on doing so."""
        cmd, body = frame.cmd, frame.body
        if cmd == Command.TORQUE:
            return body[:1] == b"\1"
        if cmd in (Command.PING, Command.READ):
            return body[4:5] not in _READS
        if cmd == Command.TRANSACT and frame.proto == tables.PROTO_HEXWIRE:
            return body[6:7] not in _READS
        return cmd in (Command.JOINT_MOVE, Command.SYNC_WRITE)

    def job(self, request: Request) -> Job:
        """Act on a request; every way out answers it once."""
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

    def clamp(self, joint: JointSlot, position: int) -> int:
        """A position inside the joint's stored limits; notes whether that changed it."""
        limit = self._board.state.limits[self._board.state.joints.index(joint)]
        inside = min(max(position, limit.minimum), limit.maximum)
        joint.clamped = inside != position
        return inside

    def report_job(self) -> Job:
        """One unsolicited JOINT_STATE."""
        board = self._board
        if not board.paced:
            yield from board.bus.poll_all()
        state = board.state
        if state.report_due is not None:
            if state.report_due - board.time < state.report_period / 2:
                # This one is late: the next must not follow on its heels.
                state.report_due += state.report_period
            board.report(board.state.report(board.state.report_fields, board.time).serialize())

    def refuse(self, request: Request, status: Status) -> None:
        """Answer a request that is not executed: a stop made it void, or the queue is full."""
        self._reply(request, status)

    def watchdog_job(self) -> Job:
        """The host fell silent."""
        state = self._board.state
        state.watchdog_tripped = True
        state.watchdog_trips += 1
        yield from self._execute_stop(state.watchdog_mode)

    # -- answers ------------------------------------------------------------------------------------

    def _reply(self, request: Request, status: Status, body: bytes = b"") -> None:
        self._board.connection.reply(request, status, body, self._board.time)

    def _refuse_if_stopped(self) -> None:
        if self._board.state.stopped:
            raise RefusedError(Status.STOPPED)

    @staticmethod
    def _body(request: Request, length: int) -> bytes:
        body = request.frame.body
        if len(body) != length:
            raise RefusedError(Status.BAD_LENGTH)
        return body

    # -- who and how --------------------------------------------------------------------------------

    def _identify(self, request: Request) -> Job:
        self._body(request, 0)
        board, state = self._board, self._board.state
        # A host that identifies itself anew wants no reports it did not ask for.
        state.report_due, state.report_period = None, 0.0
        rows = tuple(JointRow(j.servo_id, j.series.code, j.present) for j in state.joints)
        identity = Identity(
            tables.PROTO_HEXWIRE, FIRMWARE, state.boot_id, _CAPABILITIES, board.max_frame, state.board_flags, rows
        )
        self._reply(request, Status.OK, identity.serialize())
        yield from ()

    def _joint_state(self, request: Request) -> Job:
        fields = self._body(request, 1)[0]
        if fields > ALL_FIELDS:
            raise RefusedError(Status.BAD_RANGE)
        if not self._board.paced:
            yield from self._board.bus.poll_all()
        self._reply(request, Status.OK, self._board.state.report(fields, self._board.time).serialize())

    def _report(self, request: Request) -> Job:
        body = self._body(request, 3)
        period, fields = int.from_bytes(body[:2], "little"), body[2]
        if fields > ALL_FIELDS or (period and not 5 <= period <= 10_000):
            raise RefusedError(Status.BAD_RANGE)
        board, state = self._board, self._board.state
        state.report_period, state.report_fields = period / 1000, fields
        state.report_due = board.time + state.report_period if period else None
        self._reply(request, Status.OK, body)
        yield from ()

    def _stats(self, request: Request) -> Job:
        self._body(request, 0)
        board, state = self._board, self._board.state
        counters, decoder = board.connection.counters, board.connection.decoder.counters
        values = {
            "uptime_ms": int((board.time - state.now) * 1000),
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

    # -- motion -------------------------------------------------------------------------------------

    def _joint_move(self, request: Request) -> Job:
        move = MoveRequest.parse(request.frame.body)
        if not move.rows:
            raise RefusedError(Status.BAD_LENGTH)
        state = self._board.state
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
        self._refuse_if_stopped()
        if not self._board.paced:
            yield from self._board.bus.poll_all()
        for joint, _ in targets:
            if joint.present and joint.unsure:
                yield from self._board.bus.recheck(joint)
        if any(j.present and not j.torque_on for j, _ in targets):
            raise RefusedError(Status.TORQUE_OFF)
        sent = [(j, self.clamp(j, p)) for j, p in targets if j.present]
        duration = max(move.duration_ms, self.slowest(sent))
        yield from self._board.bus.move(sent, duration)
        rows = tuple(SentRow(j.servo_id, p, j.clamped) for j, p in sent)
        status = Status.OK if len(sent) == len(targets) else Status.SERVO_SILENT
        self._reply(request, status, MoveReply(duration, rows).serialize())

    def slowest(self, targets: list[tuple[JointSlot, int]]) -> int:
        """Milliseconds that the speed limits ask for."""
        state = self._board.state
        needed = 0
        for joint, position in targets:
            speed = state.limits[state.joints.index(joint)].speed
            needed = max(needed, -(-abs(position - joint.position) * 1000 // max(speed, 1)))
        return min(needed, 0xFFFF)

    def _torque(self, request: Request) -> Job:
        on, mask = parse_stop_reply(request.frame.body)
        joints = self._board.state.joints
        if on > 1 or mask >> len(joints):
            raise RefusedError(Status.BAD_RANGE)
        if on:
            self._refuse_if_stopped()
        confirmed = yield from self._board.bus.torque([j for i, j in enumerate(joints) if mask >> i & 1], bool(on))
        status = Status.OK if confirmed == mask else Status.SERVO_SILENT
        self._reply(request, status, make_stop_reply(on, confirmed))

    def _stop(self, request: Request) -> Job:
        mode = self._body(request, 1)[0]
        if mode > 1:
            raise RefusedError(Status.BAD_RANGE)
        mask = yield from self._execute_stop(mode)
        status = Status.OK if mask == (1 << len(self._board.state.joints)) - 1 else Status.SERVO_SILENT
        self._reply(request, status, make_stop_reply(mode, mask))

    def _execute_stop(self, mode: int) -> Many:
        """Stop; returns the mask of joints that confirmed it, or have no torque to stop."""
        board, state, bus = self._board, self._board.state, self._board.bus
        state.stopped = True
        state.watchdog_due = None
        board.drop_motion()
        if mode:
            state.torque_off_stop = True
            return (yield from bus.torque(state.joints, on=False))
        yield from bus.poll_all()
        present = [j for j in state.joints if j.present]
        for joint in present:
            if joint.unsure:
                yield from bus.recheck(joint)
        # A joint without torque stays without: writing it a target could switch it on. Where a write went out and
        # the servo does not say what became of it, it may be moving, and is held.
        limp = [j for j in present if not j.torque_on and not j.unsure]
        held = yield from bus.hold_checked([j for j in present if j not in limp])
        return held | sum(1 << i for i, j in enumerate(state.joints) if j in limp)

    def _resume(self, request: Request) -> Job:
        self._body(request, 0)
        state = self._board.state
        state.stopped = state.watchdog_tripped = state.torque_off_stop = False
        state.feed_watchdog(self._board.time)
        self._reply(request, Status.OK, bytes((state.board_flags,)))
        yield from ()

    def _watchdog(self, request: Request) -> Job:
        body = self._body(request, 3)
        timeout, mode = int.from_bytes(body[:2], "little"), body[2]
        if mode > 1 or (timeout and not 50 <= timeout <= 60_000):
            raise RefusedError(Status.BAD_RANGE)
        state = self._board.state
        state.watchdog_timeout, state.watchdog_mode = timeout / 1000, mode
        state.watchdog_due = None
        state.watchdog_tripped = False
        state.feed_watchdog(self._board.time)
        self._reply(request, Status.OK, body)
        yield from ()

    # -- settings -----------------------------------------------------------------------------------

    def _limits(self, request: Request) -> Job:
        state = self._board.state
        if request.frame.body:
            rows = LimitTable.parse_request(request.frame.body)
            self._refuse_if_stopped()
            if len(rows) != len(state.joints):
                raise RefusedError(Status.BAD_LENGTH)
            if any(row.minimum >= row.maximum or not row.speed for row in rows):
                raise RefusedError(Status.BAD_RANGE)
            self._board.settings.limits = state.limits = list(rows)
        table = LimitTable(tables.SETTINGS_VERSION, tuple(state.limits))
        self._reply(request, Status.OK, table.serialize())
        yield from ()

    def _offsets(self, request: Request) -> Job:
        state = self._board.state
        if request.frame.body:
            rows = OffsetTable.parse_request(request.frame.body)
            self._refuse_if_stopped()
            if len(rows) != len(state.joints):
                raise RefusedError(Status.BAD_LENGTH)
            if any(row.sign not in (1, -1) for row in rows):
                raise RefusedError(Status.BAD_RANGE)
            self._board.settings.offsets = state.offsets = list(rows)
        table = OffsetTable(tables.SETTINGS_VERSION, tuple(state.offsets))
        self._reply(request, Status.OK, table.serialize())
        yield from ()

    # -- servo packets ------------------------------------------------------------------------------

    def _packet(self, request: Request) -> Job:
        """PING and READ in a dialect-2 frame: as dialect 1, but a silent servo is a status."""
        packet = self._parse_packet(request.frame.body)
        answers = yield from self._board.bus.ask_all(request.frame.body)
        if not answers:
            raise RefusedError(Status.SERVO_SILENT)
        status_bytes = self._board.dialect1.status_bytes
        self._reply(request, Status.OK, b"".join(status_bytes(packet, status) for status in answers))

    def _sync_write(self, request: Request) -> Job:
        if not self._board.dialect1.sync_write_rows(request.frame.body):
            raise RefusedError(Status.BAD_RANGE)
        self._refuse_if_stopped()
        yield from self._board.dialect1.job(request.frame)
        self._reply(request, Status.OK)

    def _transact(self, request: Request) -> Job:
        transact = TransactRequest.parse(request.frame.body)
        self._parse_packet(transact.packet)
        if transact.reply_length > _MAX_REPLY:
            raise RefusedError(Status.BAD_RANGE)
        timeout = (transact.timeout_ms or _DEFAULT_TRANSACT_MS) / 1000
        bus = self._board.bus
        answer = yield from bus.raw(transact.packet, transact.reply_length, timeout)
        if transact.reply_length and not answer:
            raise RefusedError(Status.SERVO_SILENT)
        self._reply(request, Status.OK, answer[: transact.reply_length])

    def _parse_packet(self, data: bytes) -> ServoPacket:
        try:
            packet = parse_packet(data)
        except RemoteProtocolError:
            raise RefusedError(Status.BAD_RANGE) from None
        self.check_packet(packet)
        return packet

    def check_packet(self, packet: ServoPacket) -> None:
        """Whether a packet of a host may go to the bus now.

        Raises:
            RefusedError: It is no sound read, it has a target outside the limits, or the arm is stopped.
        """
        params = packet.params
        if packet.instruction == Instruction.READ and (len(params) != 2 or not 0 < params[1] <= _MAX_REPLY - 6):
            raise RefusedError(Status.BAD_RANGE)
        if packet.instruction == Instruction.SYNC_READ and (
            len(params) < 3 or not params[1] or (params[1] + 6) * (len(params) - 2) > _MAX_REPLY
        ):
            raise RefusedError(Status.BAD_RANGE)
        if packet.instruction not in READ_ONLY:
            self._check_targets(packet)
            self._refuse_if_stopped()

    def _check_targets(self, packet: ServoPacket) -> None:
        """Refuse a raw write of a target position outside a joint's limits."""
        if packet.instruction == Instruction.SYNC_WRITE:
            try:
                address, rows = parse_sync_write(packet)
            except RemoteProtocolError:
                raise RefusedError(Status.BAD_RANGE) from None
            writes = [(servo_id, address, data) for servo_id, data in rows]
        elif packet.instruction in (Instruction.WRITE, Instruction.REG_WRITE):
            if len(packet.params) < 2:
                raise RefusedError(Status.BAD_RANGE)
            writes = [(packet.servo_id, packet.params[0], packet.params[1:])]
        else:
            return
        for servo_id, address, data in writes:
            at = _TARGET - address
            low, high = 0 <= at < len(data), 0 <= at + 1 < len(data)
            if not (low or high):
                continue
            for joint, limit in zip(self._board.state.joints, self._board.state.limits, strict=True):
                if servo_id not in (joint.servo_id, BROADCAST_ID):
                    continue
                # Half a position cannot be judged.
                if not (low and high):
                    raise RefusedError(Status.BAD_RANGE)
                name = "target_position" if joint.series is Series.SEVEN_BOT else "goal_position"
                position = joint.series.register(name).decode(data[at : at + 2])
                if not limit.minimum <= position <= limit.maximum:
                    raise RefusedError(Status.BAD_RANGE)

    def _io(self, request: Request) -> Job:
        mask, value = self._body(request, 2)
        if mask & ~_OUTPUTS:
            raise RefusedError(Status.BAD_RANGE)
        state = self._board.state
        if mask:
            self._refuse_if_stopped()
            state.io = (state.io & ~mask) | (value & mask)
        self._reply(request, Status.OK, bytes((mask, state.io)))
        yield from ()
