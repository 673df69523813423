"""A Hex7Bot board that speaks only the chapter's dialect: it passes servo packets on, one at a time.

Owns what PROTOCOL.md section 5 requires of a host: two-byte reads and which of their answers to trust, since they
may be late, damaged or mistaken; sync writes for legacy servos only; the 7-byte block for HLS servos; no 0D 0A
inside a frame, and which value is changed to avoid it. The host keeps stop and limits, since such a board has none.
Must not know links or callers.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from functools import partial

from hexwire.errors import (
    CommandRefusedError,
    LocalProtocolError,
    NotSupportedError,
    PreemptedError,
    RemoteProtocolError,
    ReplyTimeoutError,
    StoppedError,
    UsageError,
)
from hexwire.ipc.session import Session
from hexwire.model.arm import ArmModel, JointModel
from hexwire.model.state import JointFlag, JointState, JointTarget, SentTarget
from hexwire.session.effects import packet_only_reads
from hexwire.session.events import Reply
from hexwire.wire.command_frame import Command, Frame, Status
from hexwire.wire.commands import LimitRow, OffsetRow
from hexwire.wire.registers import Series
from hexwire.wire.servo_packet import (
    StatusPacket,
    find_status,
    make_ping,
    make_read,
    make_sync_write,
    make_write,
    parse_packet,
    parse_sync_write,
)
from hexwire.wire.tables import DEFAULT_CEILING, TAIL

from .base import JointProbe, StopMode
from .board import BoardFacts
from .replies import torque_flag
from .timed_path import TimedPath

__all__ = ["MIN_RUN_TIME", "Board1", "Dialect1Reader", "make_hls_block", "make_legacy_move"]

MIN_RUN_TIME = 9
"""Milliseconds; the 7Bot library accepts no run time of 8 ms or less."""
_POSITION = Series.SEVEN_BOT.register("target_position").address
_BLOCK = Series.HLS.register("acceleration").address


def make_legacy_move(targets: Mapping[int, int], run_time_ms: int) -> tuple[bytes, int, dict[int, int]]:
    """Build the sync write of dialect 1 for legacy servos, without 0D 0A inside.

    To avoid the marker, the run time is changed first, by 1 ms steps, then a position by one count (PROTOCOL.md
    section 5).

    Args:
        targets: Counts by servo id.
        run_time_ms: Duration of the motion, milliseconds.

    Returns:
        The packet, and the run time and counts in it.

    Raises:
        LocalProtocolError: No packet can be built; the ids themselves form the marker.
    """
    run_time = min(max(run_time_ms, MIN_RUN_TIME), 0xFFFF)
    for nudge in range(3):
        for extra in range(4):
            ms = run_time + extra if run_time + extra <= 0xFFFF else run_time - extra
            rows, counts_sent = {}, {}
            for servo_id, counts in targets.items():
                # Change a position only if the marker is in its bytes or next to them.
                value = min(max(counts, 0), 0xFFFF)
                if nudge and b"\x0d" in value.to_bytes(2, "little") + bytes((servo_id,)):
                    value += nudge if value < 0xFFFF - nudge else -nudge
                counts_sent[servo_id] = value
                rows[servo_id] = value.to_bytes(2, "little") + ms.to_bytes(2, "little")
            packet = make_sync_write(_POSITION, rows)
            if TAIL not in packet:
                return packet, ms, counts_sent
    raise LocalProtocolError("no sync write without 0D 0A inside can be built for these servos")


def make_hls_block(servo_id: int, counts: int, speed: int, ceiling: int) -> tuple[bytes, int]:
    """Build the write that moves one HLS servo: acceleration, position, current ceiling, speed at 0x29.

    Args:
        servo_id: Bus id.
        counts: Target position.
        speed: In units of 50 counts/s, at least 1.
        ceiling: Current ceiling in units of 6.5 mA.

    Returns:
        The packet, and the position in it.

    Raises:
        LocalProtocolError: No block without 0D 0A inside can be built.
    """
    hls = Series.HLS
    # Reduce the current by a unit if it is next to a position's high byte, which no small step changes.
    for less, nudge in ((0, 0), (0, 1), (1, 0), (1, 1)):
        for faster in range(4):
            block = (
                b"\0"
                + hls.register("goal_position").encode(counts + nudge)
                + hls.register("goal_torque").encode(ceiling - less)
                + hls.register("goal_speed").encode(speed + faster)
            )
            packet = make_write(servo_id, _BLOCK, block)
            if TAIL not in packet:
                return packet, counts + nudge
    raise LocalProtocolError(f"no write without 0D 0A inside can be built for servo {servo_id}")


_DOUBT = 1.0
"""Seconds for which a missing answer may still arrive."""
_ASKED_TWICE = 0.08
"""Seconds after which the board repeats a request; the first answer may still arrive."""
_CHECKS = 5
_ENOUGH = 3
_AGREE = 100
"""Counts by which two reads of a joint in motion may differ: 36 ms at 2800 counts/s."""


class Dialect1Reader:
    """Reader for one board.

    Args:
        session: A negotiated session.
        legacy: Whether each servo is of the legacy series, by id, as far as known.
    """

    def __init__(self, session: Session, legacy: Mapping[int, bool]) -> None:
        self._session = session
        self._legacy = legacy
        self._missed: dict[int, dict[int, float]] = {}

    def read(self, servo_id: int, address: int, *, urgent: bool = False, more: bool = True) -> StatusPacket | None:
        """Read two bytes of a servo; None if it, or the board, does not answer.

        The chapter's board keeps a late answer and returns it to the next request. The id exposes an answer of
        another servo, but not an answer of the same servo for another register. So after an unanswered read of
        another register, which the board requests twice, only three answers that agree are trusted.
        """
        now = self._session.now()
        missed = self._missed.get(servo_id, {})
        doubtful = any(other != address and now - when < _DOUBT for other, when in missed.items())
        status = self.read_once(servo_id, address, urgent=urgent, more=more)
        agreeing = 1
        for _ in range(_CHECKS if doubtful else 0):
            if status is None or agreeing == _ENOUGH:
                break
            again = self.read_once(servo_id, address, urgent=urgent, more=more)
            agrees = again is not None and abs(_value(again) - _value(status)) <= _AGREE
            status, agreeing = again, agreeing + 1 if agrees else 1
        return None if doubtful and agreeing < _ENOUGH else status

    def read_once(
        self, servo_id: int, address: int, *, urgent: bool, any_kind: bool = False, more: bool = True
    ) -> StatusPacket | None:
        try:
            reply = self._session.request(
                Command.READ, make_read(servo_id, address, 2), urgent=urgent, repeatable=True
            )
        except ReplyTimeoutError as error:
            self._missed.setdefault(servo_id, {})[address] = self._session.now()
            return self._read_beside(servo_id, address, urgent=urgent) if error.instead and more else None
        status, found = None, find_status(reply.body, servo_id, 2)
        # The board's form of "no answer"; a legacy servo with an error bit and value 0 looks the same.
        if found is not None and not (found[0].legacy and found[0].error == 1 and _value(found[0]) == 0):
            status = found[0] if any_kind or self.is_its_own(found[0]) else None
        if status is None or reply.rtt > _ASKED_TWICE:
            self._missed.setdefault(servo_id, {})[address] = self._session.now()
        return status

    def _read_beside(self, servo_id: int, address: int, *, urgent: bool) -> StatusPacket | None:
        """Read two bytes by the pairs before and after them, if the answer looks like the echo of its request.

        An HLS servo with error 2 at count 568 answers so. The high byte is read twice to match both bytes.
        """
        if self._legacy.get(servo_id, True):
            return None
        read = partial(self.read, servo_id, urgent=urgent, more=False)
        high = read(address + 1)
        low = high and read(address - 1)
        again = low and read(address + 1)
        if high is None or low is None or again is None or high.params[0] != again.params[0]:
            return None
        return low._replace(params=low.params[1:] + high.params[:1])

    def is_its_own(self, status: StatusPacket) -> bool:
        """Whether an answer has the header of this servo's series; a damaged echo has that of another."""
        return self._legacy.get(status.servo_id, status.legacy) == status.legacy


def _value(status: StatusPacket) -> int:
    return int.from_bytes(status.params, "little")


_TORQUE = Series.HLS.register("torque_enable").address
_PRESENT = Series.HLS.register("present_position").address
_LOAD = Series.HLS.register("present_load")
_CURRENT_CEILING = Series.HLS.register("protection_current")
_SPEED_UNIT = 50
"""Counts per second of one unit of an HLS goal speed."""
_NO_TABLES = "a dialect-1 board reads two registers at a time; `transact` sends such a read"


class Board1:
    """Dialect-1 commands of one session.

    Such a board latches no stop. The session does, and keeps it when the board is disconnected.

    Args:
        session: A negotiated session.
        model: The arm.
    """

    dialect = 1
    command_rate = 1.5
    """A state of seven joints takes eight requests, seven positions and a load: 0.3 s, with a target 0.5 s."""
    has_watchdog = False
    reports_states = False
    keeps_stop = False
    keeps_trip = True
    """There is no watchdog whose trip the board could forget."""
    unprotected = "no watchdog, no limits on this board"

    def __init__(self, session: Session, model: ArmModel) -> None:
        self._session = session
        self._model = model
        n = len(model.joints)
        self._positions: list[float] = [math.nan] * n
        self._sampled: list[float] = [-math.inf] * n
        self._loads: list[float] = [math.nan] * n
        self._flags: list[int] = [int(JointFlag.SILENT)] * n
        self._torque: list[bool | None] = [None] * n
        self._freeing: list[list[int]] = []
        self._reader = Dialect1Reader(session, {j.servo_id: j.series == "seven_bot" for j in model.joints})
        self._ceilings: dict[int, int] = {}
        self._next_load = 0
        self._mode = StopMode.HOLD

    # -- state --------------------------------------------------------------------------------------

    def read(self, fields: int = 0) -> JointState:
        """Read the position of every servo, and the load of one HLS servo in turn."""
        model, session = self._model, self._session
        for i, joint in enumerate(model.joints):
            self._sample(i, joint)
        hls = [i for i, joint in enumerate(model.joints) if joint.series == "hls"]
        if hls:
            i = hls[self._next_load % len(hls)]
            self._next_load += 1
            status = self._reader.read(model.joints[i].servo_id, _LOAD.address)
            if status is not None:
                self._loads[i] = model.joints[i].sign * _LOAD.decode(status.params) * 0.001
        now = session.now()
        return JointState.of(
            dict(zip(model.names, self._positions, strict=True)),
            load=tuple(self._loads),
            flags=tuple(f | torque_flag(t) for f, t in zip(self._flags, self._torque, strict=True)),
            age=tuple(now - t for t in self._sampled),
            stamp=now,
            stopped=self.stopped,
        )

    def _sample(self, i: int, joint: JointModel, *, urgent: bool = False) -> None:
        status = self._reader.read(joint.servo_id, _PRESENT, urgent=urgent)
        if status is None:
            self._flags[i] = int(JointFlag.SILENT)
            return
        # The board swaps the bytes of legacy answers, so values are little-endian for every servo.
        counts = int.from_bytes(status.params, "little")
        if joint.series == "hls":
            counts = Series.HLS.register("present_position").decode(status.params)
        self._positions[i] = joint.counts_to_angle(counts)
        self._sampled[i] = self._session.now()
        self._flags[i] = status.error & int(JointFlag(0xFF).faults) & ~int(JointFlag.SILENT)

    # -- motion -------------------------------------------------------------------------------------

    def move(self, target: JointTarget, present: Mapping[str, float]) -> SentTarget:
        """Move legacy joints by one sync write, and HLS joints by one write each."""
        self._refuse_if_stopped()
        model = self._model
        joints = [(model.joint(name), angle) for name, angle in target.positions]
        self._refuse_without_torque([joint for joint, _ in joints])
        duration = max(target.duration, 0.001)
        guard = partial(self._refuse_now, [joint for joint, _ in joints])
        sent: list[tuple[str, float]] = []
        silent: list[str] = []
        legacy = {joint.servo_id: joint.angle_to_counts(angle) for joint, angle in joints if joint.series != "hls"}
        if legacy:
            packet, ms, legacy = make_legacy_move(legacy, round(duration * 1000))
            self._act(Command.SYNC_WRITE, packet, guard=guard)
            duration = ms / 1000
            for joint, _ in joints:
                if joint.servo_id in legacy:
                    sent.append((joint.name, joint.counts_to_angle(legacy[joint.servo_id])))
        for joint, angle in joints:
            if joint.servo_id in legacy:
                continue
            counts = joint.angle_to_counts(angle)
            start = present.get(joint.name, math.nan)
            # From an unknown position, use the speed that covers the whole range in this duration.
            low, high = joint.count_limits
            distance = abs(counts - joint.angle_to_counts(start)) if math.isfinite(start) else high - low
            speed = max(1, math.ceil(distance / max(duration, 0.02) / _SPEED_UNIT))
            packet, counts = make_hls_block(joint.servo_id, counts, speed, self._ceiling(joint))
            if self._write(packet, guard=guard):
                sent.append((joint.name, joint.counts_to_angle(counts)))
            else:
                silent.append(joint.name)
        return SentTarget(tuple(sent), duration, (), tuple(silent))

    def torque(self, on: bool, joints: Sequence[str] | None) -> tuple[str, ...]:
        """Switch torque by one write per servo and read it back; first make the present position the target."""
        wanted = [self._model.index(n) for n in (self._model.names if joints is None else joints)]
        if not on:
            return self._free(wanted)
        self._refuse_if_stopped()
        wanted = [i for i in wanted if self._hold(i, guard=self._refuse_if_stopped)]
        for i in wanted:
            packet = make_write(self._model.joints[i].servo_id, _TORQUE, b"\1")
            self._write(packet, guard=self._refuse_if_stopped)
        return self._names(i for i in wanted if self._check_torque(i))

    def stop(self, mode: StopMode) -> tuple[str, ...]:
        """Hold or free every joint; the session refuses motion until `resume`."""
        self._mode = mode
        joints = range(len(self._model.joints))
        if mode == StopMode.TORQUE_OFF:
            return self._free(joints, urgent=True)
        stopped = []
        for i in joints:
            if self._torque[i] is None:
                self._check_torque(i, urgent=True)
            # Write no target to a joint without torque: that could switch its torque on.
            if self._torque[i] is False or self._hold(i, urgent=True):
                stopped.append(i)
        return self._names(stopped)

    @property
    def stopped(self) -> bool:
        """Whether a stop is latched."""
        return self._session.epochs.stopped

    def resume(self) -> None:
        """End the stop, if none came since this was called."""
        epochs = self._session.epochs
        token = epochs.token("resume", freeing=True)
        epochs.check(token, "resume")
        epochs.resumed(token)

    def _hold(self, i: int, *, urgent: bool = False, guard: Callable[[], None] | None = None) -> bool:
        """Make the present position of a joint its target, right after reading it; False if the servo is silent."""
        joint = self._model.joints[i]
        self._sample(i, joint, urgent=urgent)
        if self._flags[i] & JointFlag.SILENT:
            return False
        counts = joint.angle_to_counts(self._positions[i])
        if joint.series == "hls":
            packet, _ = make_hls_block(joint.servo_id, counts, 1, self._ceiling(joint, urgent=urgent))
            return self._write(packet, urgent=urgent, guard=guard)
        packet, _, _ = make_legacy_move({joint.servo_id: counts}, MIN_RUN_TIME)
        self._act(Command.SYNC_WRITE, packet, urgent=urgent, guard=guard)
        return True

    def _act(
        self, cmd: int, packet: bytes, *, urgent: bool = False, guard: Callable[[], None] | None = None
    ) -> Reply:
        """Send a request that acts.

        A signal handler may stop the arm after the last check and before the bytes leave. The board then receives
        them after the stop, so the stop is sent again: such a board latches none.
        """
        epochs = self._session.epochs
        try:
            return self._session.request(cmd, packet, urgent=urgent, guard=guard)
        except PreemptedError:
            if epochs.stopped_by_this_thread and not urgent:
                with epochs.stopping():
                    self.stop(self._mode)
            raise

    def _free(self, wanted: Iterable[int], *, urgent: bool = False) -> tuple[str, ...]:
        """Switch the torque of joints off and read it back; repeat once for joints that do not confirm."""
        wanted = list(wanted)
        free: set[int] = set()
        # A move that waits for the line in another thread must not switch it on again.
        self._freeing.append(wanted)
        try:
            for _ in range(2):
                left = [i for i in wanted if i not in free]
                for i in left:
                    self._torque[i] = None
                    self._write(make_write(self._model.joints[i].servo_id, _TORQUE, b"\0"), urgent=urgent)
                free |= {i for i in left if self._check_torque(i, urgent=urgent) is False}
        finally:
            self._freeing.remove(wanted)
        return self._names(i for i in wanted if i in free)

    def _check_torque(self, i: int, *, urgent: bool = False) -> bool | None:
        """Read whether a joint has torque; None if the servo does not answer."""
        state = self._read_torque(self._model.joints[i], urgent=urgent)
        if state is not None:
            self._torque[i] = state
        return state

    def _names(self, places: Iterable[int]) -> tuple[str, ...]:
        return tuple(self._model.joints[i].name for i in places)

    def _ceiling(self, joint: JointModel, *, urgent: bool = False) -> int:
        """Current ceiling for an HLS servo: its protection current."""
        ceiling = self._ceilings.get(joint.servo_id)
        if ceiling is None:
            status = self._reader.read(joint.servo_id, _CURRENT_CEILING.address, urgent=urgent)
            if status is None:
                return DEFAULT_CEILING
            ceiling = self._ceilings[joint.servo_id] = _CURRENT_CEILING.decode(status.params) or DEFAULT_CEILING
        return ceiling

    def _write(self, packet: bytes, *, urgent: bool = False, guard: Callable[[], None] | None = None) -> bool:
        """Send a write; True if the servo acknowledged it. Legacy servos never acknowledge."""
        try:
            reply = self._act(Command.READ, packet, urgent=urgent, guard=guard)
        except ReplyTimeoutError:
            return False
        found = find_status(reply.body, packet[2], 0)
        return found is not None and self._reader.is_its_own(found[0])

    def _read_torque(self, joint: JointModel, *, urgent: bool = False) -> bool | None:
        status = self._reader.read(joint.servo_id, _TORQUE, urgent=urgent)
        if status is None:
            return None
        # Two registers at 0x28: big-endian for a legacy servo (swapped by the board), little-endian otherwise.
        return bool(status.params[0] if joint.series == "hls" else status.params[1])

    def _refuse_if_stopped(self) -> None:
        if self.stopped:
            raise StoppedError.unsent(
                "the command", Status.STOPPED, "the arm is stopped; `hexwire resume` ends that"
            )

    def _refuse_without_torque(self, joints: Sequence[JointModel]) -> None:
        limp = []
        for joint in joints:
            i = self._model.index(joint.name)
            if self._torque[i] is None:
                self._torque[i] = self._read_torque(joint)
            if not self._torque[i]:
                limp.append(joint.name)
        self._refuse_limp(limp)

    def _refuse_now(self, joints: Sequence[JointModel]) -> None:
        """Check again once the line is free: stops and torque off since the first check of a move."""
        self._refuse_if_stopped()
        places = {joint.name: self._model.index(joint.name) for joint in joints}
        off = {i for i in places.values() if self._torque[i] is False}.union(*self._freeing)
        self._refuse_limp([name for name, i in places.items() if i in off])

    @staticmethod
    def _refuse_limp(limp: Sequence[str]) -> None:
        if limp:
            raise CommandRefusedError(
                "a move", Status.TORQUE_OFF, f"{', '.join(limp)}: no torque; `hexwire torque on` first"
            )

    # -- tools --------------------------------------------------------------------------------------

    def ping(self, servo_id: int) -> int | None:
        """Error byte of a servo, or None if it does not answer."""
        try:
            reply = self._session.request(Command.PING, make_ping(servo_id), repeatable=True)
        except ReplyTimeoutError as error:
            # With an adapter that echoes, the chapter's board answers a ping with the echo alone; its answer to a
            # read also has the bytes of the servo.
            status = self._reader.read(servo_id, _PRESENT) if error.instead else None
            return None if status is None else status.error
        found = find_status(reply.body, servo_id, 0)
        if found is None:
            return None
        status = found[0]
        return None if status.legacy and status.error == 5 else status.error

    def probe_joints(self) -> tuple[JointProbe, ...]:
        """Ping and read every servo; the header of the answer identifies the series."""
        probes = []
        for i, joint in enumerate(self._model.joints):
            error = self.ping(joint.servo_id)
            status = None
            if error is not None:
                status = self._reader.read_once(joint.servo_id, _PRESENT, urgent=False, any_kind=True)
            if status is None:
                probes.append(JointProbe(joint.name, joint.servo_id, "unknown", False))
                continue
            family = "seven_bot" if status.legacy else "hls"
            note = "" if family == joint.series else f"answers as {family}, the model says {joint.series}"
            probes.append(JointProbe(joint.name, joint.servo_id, family, True, note))
            self._check_torque(i)
        return tuple(probes)

    def read_table(self, servo_id: int, first: int, count: int) -> bytes:
        """Not in dialect 1."""
        raise NotSupportedError(_NO_TABLES)

    def write_table(self, servo_id: int, first: int, data: bytes) -> None:
        """Not in dialect 1."""
        raise NotSupportedError(_NO_TABLES)

    def transact(self, packet: bytes, reply_length: int, timeout: float) -> bytes:
        """Send one servo packet by command 02, if a dialect-1 board can process it.

        Raises:
            NotSupportedError: A read of other than 2 bytes, or an answer longer than 8 bytes.
        """
        if reply_length not in (0, 6, 8):
            raise NotSupportedError(
                f"an answer of {reply_length} bytes would overrun a dialect-1 board; read 2 bytes at a time"
            )
        reply = self._raw(Command.READ, packet, self._session.policy.dialect1_window + timeout)
        return reply.body if reply_length else b""

    def stats(self) -> dict[str, int]:
        """Return nothing: a board of this dialect has no counters."""
        return {}

    def command(self, cmd: int, body: bytes) -> bytes:
        """Send PING, READ or SYNC_WRITE with a servo packet as its body, or TRANSACT by means of READ.

        The reply is the status packet, the data of a legacy servo little-endian; empty to SYNC_WRITE.

        Raises:
            UsageError: The packet is malformed, would overrun such a board, or is a sync write for an HLS servo.
            NotSupportedError: The command is another one.
        """
        if cmd == Command.TRANSACT and len(body) > 2:
            return self.transact(body[2:], body[0], body[1] / 1000)
        if cmd not in (Command.PING, Command.READ, Command.SYNC_WRITE):
            raise _unsupported(f"ioctl 0x{cmd:02X}")
        if cmd == Command.SYNC_WRITE:
            self._refuse_hls(body)
        try:
            return self._raw(cmd, body).body
        except LocalProtocolError as error:
            raise UsageError(f"{error}; nothing was sent") from None

    def _refuse_hls(self, packet: bytes) -> None:
        with suppress(RemoteProtocolError):  # the session refuses a malformed one
            joints = [self._model.by_servo(servo_id) for servo_id, _ in parse_sync_write(parse_packet(packet))[1]]
            if hls := [joint.name for joint in joints if joint is not None and joint.series == "hls"]:
                raise UsageError(
                    f"the chapter's sync write would set the current ceiling of {', '.join(hls)}; "
                    "send an HLS servo a write by READ"
                )

    def _raw(self, cmd: int, packet: bytes, window: float | None = None) -> Reply:
        reads = packet_only_reads(packet)
        # A raw packet may switch torque.
        self._torque = self._torque if reads else [None] * len(self._torque)
        return self._session.request(cmd, packet, window=window, guard=None if reads else self._refuse_if_stopped)

    def facts(self) -> BoardFacts:
        """Return the stop alone: such a board reports nothing about itself."""
        return BoardFacts("", None, (), self.stopped, False)

    # -- supported by dialect 2 only ----------------------------------------------------------------

    @property
    def times_motion(self) -> bool:
        return False

    def path(self, joints: Sequence[str] | None, *, smooth: bool, brake: float | None, outlives: bool) -> TimedPath:
        raise _unsupported("a path in its own time")

    def left_path(self) -> tuple[str, ...]:
        return ()

    def clear_path(self, joints: Sequence[str] | None) -> bool:
        return False

    def report(self, period: float, fields: int = 0) -> None:
        raise _unsupported("REPORT")

    def decode_state(self, body: bytes, frame: Frame, now: float, slow: JointState | None = None) -> JointState:
        raise _unsupported("REPORT")

    def watchdog(self, timeout: float, mode: StopMode) -> None:
        raise _unsupported("WATCHDOG")

    def maintenance(self, on: bool) -> None:
        raise _unsupported("MAINTENANCE")

    def limits(self) -> tuple[LimitRow, ...]:
        raise _unsupported("LIMITS")

    def store_limits(self, rows: Sequence[LimitRow]) -> tuple[LimitRow, ...]:
        raise _unsupported("LIMITS")

    def offsets(self) -> tuple[OffsetRow, ...]:
        raise _unsupported("OFFSETS")

    def store_offsets(self, rows: Sequence[OffsetRow]) -> tuple[OffsetRow, ...]:
        raise _unsupported("OFFSETS")


def _unsupported(what: str) -> NotSupportedError:
    return NotSupportedError(f"{what} needs a board with dialect 2; this board speaks the chapter's dialect only")
