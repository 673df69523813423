"""Dialect 2 on an emulated board: every command of PROTOCOL.md section 6.

Owns the meaning of the commands: what is checked, refused, clamped and answered. A handler is a job that talks
to servos through `board_bus` and answers through the connection. Knows nothing of links.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
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
from hexwire.wire.servo_packet import BROADCAST_ID, ServoPacket

from .board_bus import Job, Wait
from .board_state import JointSlot
from .board_stop import Stopping
from .gate import MAX_REPLY, Gate, Passed, RefusedError, check_packet, clamp, time_needed, written_ids

if TYPE_CHECKING:
    from .board import EmulatedBoard

__all__ = ["Dialect2"]

_FIRMWARE = (tables.VERSION_MAJOR, tables.VERSION_MINOR, tables.VERSION_PATCH)
_DEFAULT_TRANSACT_MS = 20
_CAPABILITIES = sum(tables.CAPABILITIES.values())
_OUTPUTS = 0x07

Passing = Generator[Wait, bytes | None, Passed]
Found = Generator[Wait, bytes | None, bool]


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
            Command.STOP: self._bad_stop,
            Command.RESUME: self._resume,
            Command.WATCHDOG: self._watchdog,
            Command.LIMITS: self._limits,
            Command.OFFSETS: self._offsets,
            Command.TRANSACT: self._transact,
            Command.STATS: self._stats,
            Command.IO: self._io,
            Command.MAINTENANCE: self._maintenance,
        }

    @staticmethod
    def stop_mode(frame: Frame) -> int | None:
        """What a stop asks for, which goes before everything that is queued; None for any other frame."""
        sound = frame.cmd == Command.STOP and frame.body in (b"\0", b"\1")
        return frame.body[0] if sound else None

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

    def _clamp(self, joint: JointSlot, position: int) -> int:
        """A position inside the joint's stored limits; notes whether that changed it."""
        inside = clamp(self._board.state.facts(self._board.time)[joint.servo_id], position)
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

    def refuse(self, request: Request, status: Status, *, voided: bool = False) -> None:
        """Answer a request that is not executed: a stop made it void, or the queue is full."""
        self._board.connection.reply(request, status, b"", self._board.time, voided=voided)

    def stop_job(self, mode: int) -> Job:
        """One stop; everybody who asked for it meanwhile has the same answer."""
        board = self._board
        stopped = yield from Stopping(board).run(mode)
        status = Status.SERVO_FAULT if stopped.taken else Status.OK
        if stopped.mask != (1 << len(board.state.joints)) - 1:
            status = Status.SERVO_SILENT
        for request in board.stops.finish():
            self._reply(request, status, make_stop_reply(mode, stopped.mask))

    # -- answers ------------------------------------------------------------------------------------

    def _reply(self, request: Request, status: Status, body: bytes = b"") -> None:
        self._board.connection.reply(request, status, body, self._board.time)

    def _refuse_if_stopped(self) -> None:
        if self._board.state.stopped:
            raise RefusedError(Status.STOPPED)

    def _refuse_motion(self) -> None:
        self._refuse_if_stopped()
        if self._board.state.maintenance:
            raise RefusedError(Status.FORBIDDEN)

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
            tables.PROTO_HEXWIRE, _FIRMWARE, state.boot_id, _CAPABILITIES, board.max_frame, state.board_flags, rows
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
        self._refuse_motion()
        yield from self._look_at([j for j, _ in targets])
        if any(j.present and not j.torque_on for j, _ in targets):
            raise RefusedError(Status.TORQUE_OFF)
        sent = [(j, self._clamp(j, p)) for j, p in targets if j.present]
        duration = max(move.duration_ms, self._slowest(sent))
        yield from self._board.bus.move(sent, duration)
        rows = tuple(SentRow(j.servo_id, p, j.clamped) for j, p in sent)
        status = Status.OK if len(sent) == len(targets) else Status.SERVO_SILENT
        self._reply(request, status, MoveReply(duration, rows).serialize())

    def _slowest(self, targets: list[tuple[JointSlot, int]]) -> int:
        """Milliseconds that the speed limits ask for."""
        facts = self._board.state.facts(self._board.time)
        return max((time_needed(facts[joint.servo_id], position) for joint, position in targets), default=0)

    def chapter_move(self, rows: list[tuple[int, int, int]], *, chapter: bool) -> Found:
        """The chapter's sync write: id, position and run time a row; judged like JOINT_MOVE.

        Returns:
            Whether every joint could be sent.

        Raises:
            RefusedError: Stopped, in maintenance, or in dialect 2 a joint has no torque.
        """
        state = self._board.state
        self._refuse_motion()
        named = [(joint, p, t) for i, p, t in rows if (joint := state.joint(i)) is not None]
        yield from self._look_at([joint for joint, _, _ in named])
        able = [(j, p, t) for j, p, t in named if j.present and not j.mode]
        if not chapter and any(not j.torque_on for j, _, _ in able):
            raise RefusedError(Status.TORQUE_OFF)
        groups: dict[int, list[tuple[JointSlot, int]]] = {}
        for joint, position, run_time in able:
            groups.setdefault(run_time, []).append((joint, self._clamp(joint, position)))
        for run_time, group in groups.items():
            for joint, _ in group:
                # The servo switches it on by a target; it is read back all the same.
                joint.torque_on = joint.unsure = True
            yield from self._board.bus.move(group, max(run_time, self._slowest(group)))
        return len(able) == len(named)

    def _torque(self, request: Request) -> Job:
        on, mask = parse_stop_reply(request.frame.body)
        joints = self._board.state.joints
        if on > 1 or mask >> len(joints):
            raise RefusedError(Status.BAD_RANGE)
        named = [j for i, j in enumerate(joints) if mask >> i & 1]
        if on:
            self._refuse_motion()
            confirmed = yield from self._board.bus.torque_on(named)
        else:
            confirmed = yield from self._board.bus.torque_off(named)
        missing = [j for i, j in enumerate(joints) if (mask & ~confirmed) >> i & 1]
        status = Status.OK
        if missing:
            astray = on and any(j.present and j.mode for j in missing)
            status = Status.SERVO_FAULT if astray else Status.SERVO_SILENT
        self._reply(request, status, make_stop_reply(on, confirmed))

    def _bad_stop(self, request: Request) -> Job:
        """A sound one never comes here: it goes before all others."""
        self._body(request, 1)
        yield from ()
        raise RefusedError(Status.BAD_RANGE)

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
        packet = check_packet(request.frame.body)
        passed = yield from self.let_through(packet, chapter=False)
        answers = yield from self._board.bus.ask_all(passed)
        if not answers:
            raise RefusedError(Status.SERVO_SILENT)
        status_bytes = self._board.dialect1.status_bytes
        self._reply(request, Status.OK, b"".join(status_bytes(packet, status) for status in answers))

    def _sync_write(self, request: Request) -> Job:
        rows = self._board.dialect1.sync_write_rows(request.frame.body)
        if not rows:
            raise RefusedError(Status.BAD_RANGE)
        whole = yield from self.chapter_move(rows, chapter=False)
        self._reply(request, Status.OK if whole else Status.SERVO_SILENT)

    def _transact(self, request: Request) -> Job:
        transact = TransactRequest.parse(request.frame.body)
        packet = check_packet(transact.packet)
        if transact.reply_length > MAX_REPLY:
            raise RefusedError(Status.BAD_RANGE)
        timeout = (transact.timeout_ms or _DEFAULT_TRANSACT_MS) / 1000
        passed = yield from self.let_through(packet, chapter=False)
        answer = yield from self._board.bus.raw(passed, transact.reply_length, timeout)
        if transact.reply_length and not answer:
            raise RefusedError(Status.SERVO_SILENT)
        self._reply(request, Status.OK, answer[: transact.reply_length])

    def let_through(self, packet: ServoPacket, *, chapter: bool) -> Passing:
        """Judge a well-formed packet of the host by the gate; returns what may go to the bus now.

        Raises:
            RefusedError: Nothing of it may.
        """
        board, state = self._board, self._board.state
        written = written_ids(packet)
        if written and not state.stopped:
            yield from self._look_at([j for j in state.joints if j.servo_id in written])
        passed = self._gate(chapter=chapter).judge(packet)
        if passed.hold:
            # Where it stands is what it holds, not where it is sent: a target would move it at once.
            yield from board.bus.poll_all()
            passed = self._gate(chapter=chapter).judge(packet)
            yield from board.bus.hold([j for j in state.joints if j.servo_id in passed.hold])
        return passed

    def _gate(self, *, chapter: bool) -> Gate:
        state = self._board.state
        return Gate(
            state.facts(self._board.time), chapter=chapter, stopped=state.stopped, maintenance=state.maintenance
        )

    def _look_at(self, joints: list[JointSlot]) -> Job:
        """Bring what the board knows of joints up to date before it judges a target for them."""
        board = self._board
        if not board.paced:
            yield from board.bus.poll_all()
        for joint in joints:
            if joint.present and joint.unsure:
                yield from board.bus.recheck(joint)

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

    def _maintenance(self, request: Request) -> Job:
        on = self._body(request, 1)[0]
        if on > 1:
            raise RefusedError(Status.BAD_RANGE)
        board, state = self._board, self._board.state
        if on:
            self._refuse_if_stopped()
            for joint in state.joints:
                if (yield from board.bus.read_switches(joint)) and joint.torque_on:
                    raise RefusedError(Status.FORBIDDEN)
        state.maintenance = bool(on)
        for joint in state.joints:
            # Whatever was or will be written then: mode and torque are read before a target goes out.
            joint.unsure = True
        self._reply(request, Status.OK, MaintenanceReply(state.maintenance, state.board_flags).serialize())
