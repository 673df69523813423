"""A Hex7Bot board that speaks dialect 2: joint commands to request bodies and back.

Owns the translation between SI and the wire's units for this dialect, with a fast path for the usual report of
states, and the relation of the board's clock to the host's. Limits, stop and watchdog are on the board. Must not
know links or callers.

A frame arrives some time after it was sent: a millisecond later, or seconds if this program was stopped meanwhile
and the frame waited in the port. The frame with the shortest transit time gives the best relation, so the smallest
difference counts, as far as the clocks may have drifted apart since.
"""

from __future__ import annotations

import logging
import math
import os
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from math import inf
from operator import add, mul, sub
from typing import TypeVar

from hexwire.errors import DeviceError, HexwireError, NotSupportedError, ServoError, StoppedError, UsageError
from hexwire.ipc.session import Session
from hexwire.model.arm import ArmModel, JointModel
from hexwire.model.state import JointState, JointTarget, SentTarget
from hexwire.motion.limits import rest_duration
from hexwire.session.events import Reply
from hexwire.wire.board_trajectory import BeginReply, PathState, PathStatus
from hexwire.wire.command_frame import Command, Frame, Status
from hexwire.wire.commands import (
    AGE_NEVER,
    ALL_FIELDS,
    Identity,
    JointReport,
    LimitRow,
    LimitTable,
    MaintenanceReply,
    MoveReply,
    MoveRequest,
    MoveRow,
    OffsetRow,
    OffsetTable,
    Stats,
    TransactRequest,
    make_stop_reply,
    parse_stop_reply,
)
from hexwire.wire.registers import Series
from hexwire.wire.scaled_report import ReportScaler
from hexwire.wire.servo_table import TABLE_REGISTERS, ServoTable
from hexwire.wire.tables import (
    BOARD_FLAGS_MAINTENANCE,
    BOARD_FLAGS_STOPPED,
    BOARD_FLAGS_WATCHDOG_TRIPPED,
    CAPABILITIES,
    CAPABILITY_FINE_POSITIONS,
    CAPABILITY_FRAGMENTS,
    CAPABILITY_MAINTENANCE,
    CAPABILITY_SERVO_TABLE,
    CAPABILITY_TRAJECTORY,
)

from .base import JointProbe, StopMode
from .board import BoardFacts
from .board2_path import DRIFT, MOST_BODY, Board2Path, BoardTime, begin_request
from .replies import check_reply

__all__ = ["Board2", "BoardClock", "StateDecoder"]

_WAITED = 10.0
"""Longest time that a report waits, seconds, while a later answer is taken before it."""
_AT_ONCE = 1.0
"""Seconds in which all that waited are taken; a board that was reset needs longer to be back."""


class BoardClock:
    """Relates the clock of one board to the host's."""

    def __init__(self) -> None:
        self._clock = self._arrived = math.inf
        self._difference = 0.0

    def sent(self, clock: float, arrived: float) -> float:
        """When a frame was sent, in seconds of the host's clock; at the latest when it arrived.

        Args:
            clock: The board's clock at sending, seconds.
            arrived: The host's clock at arrival, seconds.
        """
        difference = arrived - clock
        if clock > self._clock:
            drift = DRIFT * max(0.0, arrived - self._arrived)
            self._set(clock, arrived, min(difference, self._difference + drift))
        elif self._waited(clock, arrived):
            # A frame with a shorter transit time than those before also gives a better relation.
            self._difference = min(difference, self._difference)
        else:
            # The board was reset; or it has no clock.
            self._set(clock, arrived, difference)
        return clock + self._difference

    def _waited(self, clock: float, arrived: float) -> bool:
        """Whether a frame that is not newer than the newest one is a report that waited."""
        return (
            self._clock - _WAITED < clock <= self._clock < math.inf
            and clock != 0.0
            and arrived - self._arrived < _AT_ONCE
        )

    def _set(self, clock: float, arrived: float, difference: float) -> None:
        self._clock, self._arrived, self._difference = clock, arrived, difference


_HALF_WRAP = (1 << 31) * 1e-6
_AGE_UNIT = 0.001
_NEVER = _AGE_UNIT * AGE_NEVER


class StateDecoder:
    """Decoder for the states of one board.

    Args:
        model: The arm.
        order: The board's joints in its own order, including every joint of the model; None for a joint that the
            model does not have.
    """

    def __init__(self, model: ArmModel, order: Sequence[JointModel | None]) -> None:
        self._count = len(order)
        self._places = tuple(order.index(joint) for joint in model.joints)
        self._in_order = in_order = self._places == tuple(range(len(order)))
        self._names = model.names
        self._neutral = tuple(j.neutral for j in model.joints)
        self._offset = tuple(j.offset for j in model.joints)
        self._factor = tuple(j.sign * j.scale for j in model.joints)
        # A legacy servo always reports 0 for load, current, voltage and temperature: give NaN, not a false 0.
        told = [math.nan if j.series == "seven_bot" else 1.0 for j in model.joints]
        self._milli = tuple(j.sign * 0.001 * k for j, k in zip(model.joints, told, strict=True))
        self._deci = tuple(0.1 * k for k in told)
        self._told = tuple(told)
        # The fast path for the usual case: the board's joints are the model's, in the same order.
        self._scaler = (
            ReportScaler(
                speed=self._factor,
                load=self._milli,
                voltage=self._deci,
                temperature=self._told,
                current=self._milli,
                age=_AGE_UNIT,
            )
            if in_order and len(order) == len(model.joints)
            else None
        )
        self._nan = (math.nan,) * len(model.joints)
        self._zero_age = (0.0,) * len(model.joints)
        self._age_units = (_AGE_UNIT,) * len(model.joints)
        self._clock = BoardClock()

    def decode(self, body: bytes, frame: Frame, now: float, slow: JointState | None = None) -> JointState:
        """Turn a JOINT_STATE body into SI units.

        Args:
            body: Of a reply or a report.
            frame: Its frame, whose time is the board's clock at sending.
            now: Host clock at arrival.
            slow: Whose voltage, temperature and current it gets.

        Raises:
            ServoError: It has no positions, or not these joints.
        """
        scaled = self._scaler.parse(body) if self._scaler is not None else None
        time_us, flags, columns = scaled or self._scale(JointReport.parse(body))
        position, status, velocity, load, voltage, temperature, current, age = columns
        if _NEVER in age:
            # The row of a servo that was never sampled holds no measurement: give NaN, not a false 0.
            known = [math.nan if a == _NEVER else 1.0 for a in age]
            position, velocity, load, voltage, temperature, current = (
                tuple(map(mul, column, known))
                for column in (position, velocity, load, voltage, temperature, current)
            )
            age = tuple([a if a != _NEVER else inf for a in age])
        since_sample = ((frame.time_sec * 1_000_000 + frame.time_nsec // 1000 - time_us) & 0xFFFFFFFF) * 1e-6
        if since_sample > _HALF_WRAP:
            since_sample = 0.0  # the board rounds the two stamps differently
        newest = min(age)
        if 0.0 < newest < inf:
            # The board counts ages from the time it made this body; the stamp here is that of the newest sample.
            # The frame's time does not serve: a repeated reply is older than its frame.
            age = tuple([a - newest for a in age])
        if slow is not None:
            voltage, temperature, current = slow.voltage, slow.temperature, slow.current
        clock = frame.time_sec + frame.time_nsec * 1e-9
        return JointState(
            names=self._names,
            position=tuple(map(add, map(mul, self._factor, map(sub, position, self._neutral)), self._offset)),
            velocity=velocity,
            load=load,
            current=current,
            voltage=voltage,
            temperature=temperature,
            flags=status,  # type: ignore[arg-type]  # whole numbers: the scaler leaves this column as it is
            age=age,
            # Not by its arrival: it may have waited in the port while this program could not run.
            stamp=self._clock.sent(clock, now) - since_sample,
            board_time=clock - since_sample,
            stopped=flags & BOARD_FLAGS_STOPPED != 0,
            watchdog_tripped=flags & BOARD_FLAGS_WATCHDOG_TRIPPED != 0,
            maintenance=flags & BOARD_FLAGS_MAINTENANCE != 0,
        )

    def _scale(self, report: JointReport) -> tuple[int, int, tuple[tuple[float, ...], ...]]:
        """Scale a report with fewer fields or with joints in another order, as the scaler does."""
        factors = (self._factor, self._milli, self._deci, self._told, self._milli)
        if len(column := report.position) != self._count:
            raise ServoError(
                f"the board reports {len(column)} joints instead of {self._count}: was it changed? attach again"
            )
        position, status, *columns, age = report[2:] if self._in_order else map(self._ordered, report[2:])
        if position is None or status is None:
            raise ServoError("the board reports no positions")
        scaled = [
            self._nan if column is None else tuple(map(mul, column, factor))
            for column, factor in zip(columns, factors, strict=True)
        ]
        ages = self._zero_age if age is None else tuple(map(mul, age, self._age_units))
        return report.time_us, report.board_flags, (position, status, *scaled, ages)

    def _ordered(self, column: tuple[int, ...] | None) -> tuple[int, ...] | None:
        return None if column is None else tuple(column[i] for i in self._places)


_log = logging.getLogger(__name__)

_Row = TypeVar("_Row")
_MAX_DURATION_MS = 0xFFFF
_OUTLIVES = 0x80
"""Bit in the id of a path that outlives its program: a later one may end it. The others are its joints, or 0."""
_LOOK, _REST = 0.02, 3.0
"""Seconds between two looks whether such a path is at rest, and the most until it is."""
# The board may take half a second to check that the joints stand still, and drops repeats meanwhile. A lost STOP
# must be repeated much sooner.
_STOP_WINDOW = 0.1
_STOP_ATTEMPTS = 20
# A long request or answer goes in fragments; the window begins anew with each of them. A legacy servo takes half a
# second for a chunk that is written.
_LONG_WINDOW, _LONG_ATTEMPTS = 0.6, 5
_STALLED = 0.5
"""Share of the watchdog's time-out for which an emulated arm must have stalled, to blame that."""
_SERIES_NAMES = {series.code: series.value for series in Series}


def _packed(serialize: Callable[[tuple[_Row, ...]], bytes], rows: tuple[_Row, ...]) -> bytes:
    try:
        return serialize(rows)
    except (struct.error, ValueError):
        raise UsageError(f"a value does not fit its field on the wire: {', '.join(map(str, rows))}") from None


class Board2:
    """Dialect-2 commands of one session.

    Args:
        session: A negotiated session.
        model: The arm.
        identity: The board's reply to IDENTIFY.

    Attributes:
        clock: The board's clock when it sent its latest frame, seconds since its start; NaN before the first.
    """

    dialect = 2
    command_rate = 20.0
    """A cycle takes 0.03 s at 115200 baud."""
    has_watchdog = True
    reports_states = True
    keeps_stop = True
    unprotected = ""

    def __init__(self, session: Session, model: ArmModel, identity: Identity) -> None:
        self._session = session
        self._model = model
        self.clock = math.nan
        self.identity = identity
        self._order = tuple(model.by_servo(row.servo_id) for row in identity.joints)
        missing = [j.name for j in model.joints if j not in self._order]
        if missing:
            known = ", ".join(str(row.servo_id) for row in identity.joints)
            raise ServoError(f"the board has no servo for {', '.join(missing)}; it has the ids {known}")
        self._decoder = StateDecoder(model, self._order)
        # The watchdog's time-out, when it was last known not to have tripped, and for how long a program that
        # emulates the arm did not run before it has; None if it has not.
        self._patience = 0.0
        self._guarded = session.now()
        self._stalled: float | None = None
        self._time = BoardTime(session.now, getattr(session.ipc.link, "baud", 0))
        # Another program at this board begins paths too, and must not take one for its own.
        self._paths = os.urandom(1)[0] & 0x7F

    # -- state --------------------------------------------------------------------------------------

    def read(self, fields: int = ALL_FIELDS) -> JointState:
        """Request and decode one JOINT_STATE."""
        session = self._session
        reply = session.request(Command.JOINT_STATE, bytes((fields,)), repeatable=True)
        if reply.status or reply.frame is None:
            check_reply(reply)
        return self.decode_state(reply.body, reply.frame, session.now())  # type: ignore[arg-type]  # dialect 2 has a frame

    def decode_state(self, body: bytes, frame: Frame, now: float, slow: JointState | None = None) -> JointState:
        """Turn a JOINT_STATE body into SI units; see `StateDecoder.decode`."""
        self.clock = frame.time_sec + frame.time_nsec * 1e-9
        state = self._decoder.decode(body, frame, now, slow)
        if not state.watchdog_tripped:
            self._stalled, self._guarded = None, now
            return state
        if self._stalled is None:
            # It tripped after the last state that said no, and what made it trip came before that.
            found = self._session.ipc.link.stalled(now - self._guarded + self._patience)
            self._stalled = found if found >= _STALLED * self._patience else 0.0
        return replace(state, stalled=self._stalled) if self._stalled else state

    # -- motion -------------------------------------------------------------------------------------

    def move(self, target: JointTarget, present: Mapping[str, float]) -> SentTarget:
        """Send JOINT_MOVE; the board writes one block to each series of servos."""
        model = self._model
        rows = tuple(
            MoveRow(joint.servo_id, joint.angle_to_counts(angle))
            for joint, angle in ((model.joint(name), angle) for name, angle in target.positions)
        )
        duration = min(round(target.duration * 1000), _MAX_DURATION_MS)
        names = [name for name, _ in target.positions]
        reply = self._ask_cleared(Command.JOINT_MOVE, MoveRequest(duration, rows).serialize(), names)
        self._check_done(reply, Status.SERVO_SILENT)
        sent = MoveReply.parse(reply.body)
        named = [(model.by_servo(row.servo_id), row) for row in sent.rows]
        done = {joint.name for joint, _ in named if joint}
        silent = tuple(model.joint(n).name for n, _ in target.positions if model.joint(n).name not in done)
        return SentTarget(
            tuple((joint.name, joint.counts_to_angle(row.position)) for joint, row in named if joint),
            sent.duration_ms / 1000,
            tuple(joint.name for joint, row in named if joint and row.clamped),
            silent if reply.status == Status.SERVO_SILENT else (),
        )

    @property
    def times_motion(self) -> bool:
        """Whether the board follows a path in its own time."""
        return bool(self.identity.capabilities & CAPABILITY_TRAJECTORY)

    def path(
        self, joints: Sequence[str] | None, *, smooth: bool, brake: float | None, outlives: bool
    ) -> Board2Path:
        """Send TRAJECTORY_BEGIN; see `OnboardPaths.path`."""
        if not self.times_motion:
            version = ".".join(map(str, self.identity.firmware))
            raise NotSupportedError(f"the board's firmware {version} follows no path of its own; flash a newer one")
        if brake is None:
            brake = rest_duration(self._model, self._model.names if joints is None else joints)
        mask = self._board_mask(joints)
        self._paths = (self._paths + 1) % _OUTLIVES
        capabilities = self.identity.capabilities
        fine = bool(capabilities & CAPABILITY_FINE_POSITIONS)
        number = _OUTLIVES | (mask if mask < _OUTLIVES else 0) if outlives else self._paths
        request = begin_request(number, mask, brake, smooth=smooth, outlives=outlives, fine=fine)
        reply = self._check_done(self._ask(Command.TRAJECTORY_BEGIN, request.serialize()))
        named = [joint for i, joint in enumerate(self._order) if joint is not None and mask >> i & 1]
        return Board2Path(
            self._ask,
            lambda command, body: self._ask(command, body, repeatable=True),
            named,
            self._time,
            BeginReply.parse(reply.body),
            smooth=smooth,
            fine=fine,
            whole=bool(capabilities & CAPABILITY_FRAGMENTS),
        )

    def left_path(self) -> tuple[str, ...]:
        """Send TRAJECTORY_STATUS; the id of a path that outlives its program tells its joints."""
        path = self._running_path()
        return () if path is None else self._joints_on(path)

    def clear_path(self, joints: Sequence[str] | None) -> bool:
        """Send TRAJECTORY_ABORT for a path that outlives its program, and wait for its end."""
        path = self._running_path()
        if path is None:
            return False
        on = self._joints_on(path)
        wanted = self._model.names if joints is None else [self._model.joint(name).name for name in joints]
        if set(on).isdisjoint(wanted):
            return False
        if others := [name for name in on if name not in wanted]:
            words = "as a program has told the board; wait until they have stopped, or move all joints together"
            raise UsageError(f"still moving: {', '.join(others)}, {words}; nothing was sent")
        if path.state is not PathState.BRAKING:
            # Its end may have come first: then this is without effect.
            self._check_done(self._ask(Command.TRAJECTORY_ABORT, bytes((path.id,))))
        deadline = self._session.now() + _REST
        while self._running_path() is not None:
            if self._session.now() > deadline:
                raise DeviceError("the board does not end its path")
            self._session.sleep(_LOOK)
        return True

    def _running_path(self) -> PathStatus | None:
        """The path that joints follow although its program may have ended, or None."""
        if not self.times_motion:
            return None
        reply = self._check_done(self._ask(Command.TRAJECTORY_STATUS, repeatable=True))
        path = PathStatus.parse(reply.body)
        runs = path.state in (PathState.RUNNING, PathState.BRAKING)
        return path if runs and path.id & _OUTLIVES else None

    def _joints_on(self, path: PathStatus) -> tuple[str, ...]:
        mask = path.id & _OUTLIVES - 1
        rows = enumerate(self._order)
        return tuple(joint.name for i, joint in rows if joint and (mask >> i & 1 or not mask))

    def _ask_cleared(self, cmd: int, body: bytes, joints: Sequence[str] | None) -> Reply:
        """Send a request that moves or holds joints; a path that outlives its program gives way to it."""
        reply = self._ask(cmd, body)
        if reply.status != Status.BUSY or not self.times_motion:
            return reply
        # It may be over by now: so once more in any case.
        self.clear_path(joints)
        return self._ask(cmd, body)

    def torque(self, on: bool, joints: Sequence[str] | None) -> tuple[str, ...]:
        """Send TORQUE with the mask of the joints."""
        body = make_stop_reply(int(on), self._board_mask(joints))
        asked = self._ask_cleared(Command.TORQUE, body, joints)
        reply = self._check_done(asked, Status.SERVO_SILENT, Status.SERVO_FAULT)
        confirmed = self._confirmed(reply)
        if reply.status == Status.SERVO_FAULT:
            wanted = self._model.names if joints is None else [self._model.joint(n).name for n in joints]
            missing = ", ".join(n for n in wanted if n not in confirmed)
            _log.warning("no torque on %s: a servo is not in position mode; set its register mode to 0", missing)
        return confirmed

    def stop(self, mode: StopMode) -> tuple[str, ...]:
        """Send STOP ahead of all other requests."""
        reply = self._ask(
            Command.STOP,
            bytes((mode,)),
            window=_STOP_WINDOW,
            attempts=_STOP_ATTEMPTS,
            urgent=True,
            repeatable=True,
        )
        confirmed = self._confirmed(check_reply(reply, Status.SERVO_SILENT, Status.SERVO_FAULT))
        missing = [name for name in self._model.names if name not in confirmed]
        if missing:
            _log.warning("the stop is not confirmed by %s", ", ".join(missing))
        if reply.status == Status.SERVO_FAULT:
            _log.warning("a joint did not hold and its torque is off; joints without torque: %s", self._limp())
        return confirmed

    def _limp(self) -> str:
        """Names of the joints without torque, for a log line."""
        try:
            on = self.read(0).torque_on
        except HexwireError as error:
            return f"unknown ({error})"
        return ", ".join(name for name in self._model.names if name not in on)

    def resume(self) -> None:
        """Send RESUME."""
        check_reply(self._ask(Command.RESUME))

    def watchdog(self, timeout: float, mode: StopMode) -> None:
        """Send WATCHDOG; 0 s disarms it."""
        body = round(timeout * 1000).to_bytes(2, "little") + bytes((mode,))
        check_reply(self._ask(Command.WATCHDOG, body))
        self._patience = timeout or self._patience

    # -- settings and tools -------------------------------------------------------------------------

    def report(self, period: float, fields: int = ALL_FIELDS) -> None:
        """Send REPORT: a state every `period` seconds; 0 ends the reports."""
        body = round(period * 1000).to_bytes(2, "little") + bytes((fields,))
        check_reply(self._ask(Command.REPORT, body, repeatable=True))

    def limits(self) -> tuple[LimitRow, ...]:
        """Read the limits that the board has stored, in its joint order."""
        return LimitTable.parse(check_reply(self._ask(Command.LIMITS, repeatable=True)).body).rows

    def store_limits(self, rows: Sequence[LimitRow]) -> tuple[LimitRow, ...]:
        """Store limits; returns the limits that the board then has."""
        reply = self._ask(Command.LIMITS, _packed(LimitTable.serialize_request, tuple(rows)))
        return LimitTable.parse(self._check_done(reply).body).rows

    def offsets(self) -> tuple[OffsetRow, ...]:
        """Read the neutral counts and signs that the board has stored, in its joint order."""
        return OffsetTable.parse(check_reply(self._ask(Command.OFFSETS, repeatable=True)).body).rows

    def store_offsets(self, rows: Sequence[OffsetRow]) -> tuple[OffsetRow, ...]:
        """Store neutral counts and signs; returns what the board then has."""
        reply = self._ask(Command.OFFSETS, _packed(OffsetTable.serialize_request, tuple(rows)))
        return OffsetTable.parse(self._check_done(reply).body).rows

    def transact(self, packet: bytes, reply_length: int, timeout: float) -> bytes:
        """Send one raw servo packet by TRANSACT; returns its answer, empty if none is expected."""
        if not 0 <= reply_length <= 255 or not 0 <= timeout <= 0.255:
            raise UsageError(
                f"an answer of {reply_length} bytes in {timeout:g} s is too long: at most 255 bytes and 0.255 s"
            )
        ms = max(1, math.ceil(timeout * 1000))
        body = TransactRequest(reply_length, ms, packet).serialize()
        reply = self._ask(Command.TRANSACT, body, window=self._session.policy.window + timeout)
        return self._check_done(reply).body

    def read_table(self, servo_id: int, first: int, count: int) -> bytes:
        """Send one SERVO_TABLE that reads; a long answer comes in fragments."""
        body = self._table(ServoTable(servo_id, first, count))
        reply = self._ask(Command.SERVO_TABLE, body, window=_LONG_WINDOW, attempts=_LONG_ATTEMPTS, repeatable=True)
        table = ServoTable.parse(self._check_done(reply).body)
        if (table.servo_id, table.first, len(table.data)) != (servo_id, first, count):
            raise ServoError(f"the board's answer is a table of servo {table.servo_id} from register {table.first}")
        return table.data

    def write_table(self, servo_id: int, first: int, data: bytes) -> None:
        """Send one SERVO_TABLE that writes; a long one goes in fragments."""
        body = self._table(ServoTable(servo_id, first, len(data), data))
        reply = self._ask(Command.SERVO_TABLE, body, window=_LONG_WINDOW, attempts=_LONG_ATTEMPTS)
        if reply.status == Status.SERVO_FAULT:
            raise ServoError(f"servo {servo_id} does not keep a value that was written to it", servo_id=servo_id)
        self._check_done(reply)

    def _table(self, table: ServoTable) -> bytes:
        if not self.identity.capabilities & CAPABILITY_SERVO_TABLE:
            version = ".".join(map(str, self.identity.firmware))
            raise NotSupportedError(f"the board's firmware {version} reads no register tables; flash a newer one")
        if not (table.first >= 0 and 0 < table.count <= TABLE_REGISTERS - table.first):
            last = table.first + table.count - 1
            raise UsageError(
                f"registers {table.first} to {last} do not exist; a servo has 0 to {TABLE_REGISTERS - 1}"
            )
        return table.serialize()

    def maintenance(self, on: bool) -> None:
        """Send MAINTENANCE.

        Raises:
            NotSupportedError: The firmware has no maintenance.
        """
        if not self.identity.capabilities & CAPABILITY_MAINTENANCE:
            version = ".".join(map(str, self.identity.firmware))
            raise NotSupportedError(f"the board's firmware {version} has no maintenance; flash a newer one")
        reply = MaintenanceReply.parse(self._check_done(self._ask(Command.MAINTENANCE, bytes((on,)))).body)
        if reply.on != on:
            raise ServoError(f"the board reports that maintenance is {'on' if reply.on else 'off'}")

    def stats(self) -> dict[str, int]:
        """Read the board's counters."""
        return Stats.parse(check_reply(self._ask(Command.STATS, repeatable=True)).body).counters

    def command(self, cmd: int, body: bytes) -> bytes:
        """Send any command of the schema; returns the reply's body."""
        return self._check_done(self._ask(cmd, body)).body

    def probe_joints(self) -> tuple[JointProbe, ...]:
        """Identify the servos by a new IDENTIFY."""
        self.identity = Identity.parse(check_reply(self._ask(Command.IDENTIFY, repeatable=True)).body)
        rows = {row.servo_id: row for row in self.identity.joints}
        probes = []
        for joint in self._model.joints:
            row = rows.get(joint.servo_id)
            series = _SERIES_NAMES.get(row.series, "unknown") if row else "unknown"
            present = bool(row and row.present)
            note = "" if not present or series == joint.series else f"is {series}, the model says {joint.series}"
            probes.append(JointProbe(joint.name, joint.servo_id, series, present, note))
        return tuple(probes)

    def ping(self, servo_id: int) -> int | None:
        """Error byte of a servo, or None if it does not answer."""
        from hexwire.wire.servo_packet import find_status, make_ping

        reply = self._ask(Command.PING, make_ping(servo_id), repeatable=True)
        if reply.status == Status.SERVO_SILENT:
            return None
        found = find_status(check_reply(reply).body, servo_id, 0)
        return None if found is None else found[0].error

    @property
    def keeps_trip(self) -> bool:
        """Whether nothing but RESUME makes the board forget that its watchdog has tripped."""
        return bool(self.identity.capabilities & CAPABILITY_MAINTENANCE)

    def facts(self) -> BoardFacts:
        """Return what the last IDENTIFY reported."""
        identity = self.identity
        return BoardFacts(
            ".".join(map(str, identity.firmware)),
            identity.boot_id,
            tuple(name for name, bit in CAPABILITIES.items() if identity.capabilities & bit),
            bool(identity.board_flags & BOARD_FLAGS_STOPPED),
            bool(identity.board_flags & BOARD_FLAGS_MAINTENANCE),
        )

    def _ask(
        self,
        cmd: int,
        body: bytes = b"",
        *,
        window: float | None = None,
        attempts: int | None = None,
        urgent: bool = False,
        repeatable: bool = False,
    ) -> Reply:
        """Send a request of the session; keeps the board's clock from the reply."""
        if len(body) > MOST_BODY and window is None:
            window, attempts = _LONG_WINDOW, _LONG_ATTEMPTS
        reply = self._session.request(
            cmd, body, window=window, attempts=attempts, urgent=urgent, repeatable=repeatable
        )
        if reply.frame is not None:
            self.clock = reply.frame.time_sec + reply.frame.time_nsec * 1e-9
        return reply

    def _check_done(self, reply: Reply, *accepted: Status) -> Reply:
        """As `check_reply`; if the watchdog has tripped, the error names it as the cause of the stop."""
        try:
            return check_reply(reply, *accepted)
        except StoppedError as error:
            if why := self._trip_reason():
                text = f"the board's watchdog stopped the arm because {why}; `hexwire resume` ends that"
                raise StoppedError(error.command, error.status, text) from None
            raise

    def _trip_reason(self) -> str:
        """Why the watchdog has tripped; empty if it has not, or the board does not say."""
        try:
            state = self.read(0)
        except HexwireError:
            return ""
        return state.trip_reason if state.watchdog_tripped else ""

    def _board_mask(self, joints: Sequence[str] | None) -> int:
        wanted = self._model.names if joints is None else [self._model.joint(n).name for n in joints]
        return sum(1 << i for i, joint in enumerate(self._order) if joint and joint.name in wanted)

    def _confirmed(self, reply: Reply) -> tuple[str, ...]:
        _, mask = parse_stop_reply(reply.body)
        return tuple(joint.name for i, joint in enumerate(self._order) if joint and mask >> i & 1)
