"""`BusArm`: an arm whose servos are connected to an adapter, without a controller board.

Owns the translation between joints and servo registers on a bus: one sync read for the state, one packet per series
for a motion, torque, a stop that the host keeps, and the identification of its servos. Must not know links, packets
or callers.

A goal written to an STS servo switches its torque on, so goals for joints without torque are refused. Without a
board nothing stops the arm if this program dies: the servos go to their last goal and hold it.

Loops send goals and read positions of all joints hundreds of times a second, so what depends on the joint alone is
prepared once.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache, partial
from math import ceil
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self

from hexwire.bus import setup as servo_setup
from hexwire.bus.servo_bus import ServoBus
from hexwire.bus.values import Reading, Readings, ServoBlock, instead_in
from hexwire.errors import DeviceError, NotSupportedError, ReplyTimeoutError, UsageError
from hexwire.ipc.board_search import explain_no_servo
from hexwire.link.serial_port import DEFAULT_BAUD
from hexwire.model.arm import ArmModel, JointModel
from hexwire.model.arms import assembled_arms, assembly_of
from hexwire.model.calibration import Calibration, JointCalibration
from hexwire.model.state import LONGEST, JointFlag, JointState, JointTarget, SentTarget
from hexwire.motion.limits import check_target
from hexwire.session.effects import packet_only_reads
from hexwire.wire.command_frame import Command
from hexwire.wire.registers import Series
from hexwire.wire.servo_packet import make_sync_write, sync_write_packer
from hexwire.wire.tables import DEFAULT_CEILING

from .abilities import BareServos, Counters, ServoPing, SetPoints, SilenceCheck, StoredCalibration
from .arm_file import BusArmFile, load_arm_file, load_profile
from .base import ProbeReport, StopMode
from .board_reset import note_servos, warn_of_reset
from .plain import PlainDriver
from .replies import torque_flag
from .stop_memory import StopMemory
from .stored_calibration import not_calibrated, stored_ranges
from .values import JointProbe

if TYPE_CHECKING:
    from hexwire.link.base import Link
    from hexwire.link.diagnose import Finding

__all__ = [
    "FAULTS",
    "SPEED_UNIT",
    "BusArm",
    "BusGoals",
    "ChainArm",
    "PositionReader",
    "SevenBotArm",
    "So100Arm",
    "So101Arm",
    "arm_class",
    "probe_joint",
    "ratings",
]

SPEED_UNIT = 50.0
"""Counts per second of one unit of speed, unless a servo's register `phase` sets another."""
_PHASE_SPEED_UNIT = 0x04
"""Bit of STS register phase: a unit of speed is one count per second instead of 50."""
_SHORTEST, _LONGEST = 9, 0x7FFE
"""Milliseconds of a motion that a servo accepts; the shortest applies to the legacy series."""
_FASTEST = 0x7FFF
_STS_ROW = "<HHHH"
"""A servo's part of the packet: its id and its acceleration (0), position, time (the current ceiling of HLS) and
speed, which are adjacent registers."""
_sts_packer = lru_cache(partial(sync_write_packer, Series.STS_SMS.register("acceleration").address, _STS_ROW))
_STS_SERIES = frozenset((Series.STS_SMS.value, Series.HLS.value))
_MOST_COUNTS = 0x7FFF
"""Goals of STS and HLS servos up to this count have no sign bit."""

_Row = tuple[int, int, int, float, float, int, float, float, float, float, float]
"""What the goals of an STS or HLS servo depend on: its id, current ceiling, sign, offset, scale, neutral, unit of
speed; then the lower and the upper limit of its joint, its speed limit, and that of guided targets."""


class BusGoals:
    """Builder of the goals of one arm.

    Args:
        bus: The bus of its servos.
        joints: Its joints by name.
    """

    def __init__(self, bus: ServoBus, joints: Mapping[str, JointModel]) -> None:
        self._bus, self._joints = bus, joints
        self._speed_units: dict[int, float] = {}
        self._ceilings: dict[int, int] = {}
        self._rows: dict[str, _Row] = {}

    def learn(self, joints: Iterable[JointModel]) -> None:
        """Read the settings that the goals of servos depend on."""
        self._rows.clear()
        ids: dict[Series, list[int]] = {}
        for joint in joints:
            ids.setdefault(Series(joint.series), []).append(joint.servo_id)
        for reading in self._read("phase", ids.get(Series.STS_SMS)):
            single = reading.raw is not None and reading.raw & _PHASE_SPEED_UNIT
            self._speed_units[reading.servo_id] = 1.0 if single else SPEED_UNIT
        for reading in self._read("protection_current", ids.get(Series.HLS)):
            self._ceilings[reading.servo_id] = reading.raw or DEFAULT_CEILING

    def unbind(self, joints: Iterable[JointModel]) -> None:
        """Take the last goal's speed from STS servos that do not move, as if they had just been switched on.

        Programs that give a goal without a speed, as LeRobot's own arms do, would crawl at it.
        """
        if ids := [joint.servo_id for joint in joints if joint.series == Series.STS_SMS.value]:
            self._bus.sync_write_raw("goal_speed", dict.fromkeys(ids, 0))
            # Nobody acknowledges such a packet, and the port may be closed next.
            for reading in self._bus.sync_read("goal_speed", ids):
                if reading.raw:
                    self._bus.write_raw(reading.servo_id, "goal_speed", 0)

    def _read(self, name: str, servo_ids: list[int] | None) -> Iterable[Reading]:
        return self._bus.sync_read(name, servo_ids) if servo_ids else ()

    def speed_unit(self, joint: JointModel) -> float:
        """Counts per second of one unit of a servo's speed."""
        return self._speed_units.get(joint.servo_id, SPEED_UNIT)

    def make(self, joint: JointModel, counts: int, duration: float, start: float | None) -> tuple[int, bytes]:
        """Make the address and bytes that send a servo to a position in a given time.

        Args:
            joint: The joint of the servo.
            counts: The goal position, encoder counts.
            duration: Seconds.
            start: Angle at the start, radians; None if it is unknown.
        """
        series = Series(joint.series)
        milliseconds = min(round(duration * 1000), _LONGEST)
        if series is Series.SEVEN_BOT:
            position, time = series.register("target_position"), series.register("run_time")
            return position.address, position.encode(max(counts, 0)) + time.encode(max(milliseconds, _SHORTEST))
        position = series.register("goal_position")
        if series is Series.SCS:
            # Position, time and speed are adjacent registers; the servo ignores the speed if there is a time.
            goal = position.encode(max(counts, 0)) + series.register("goal_time").encode(milliseconds)
            return position.address, goal + b"\0\0"
        distance = abs(counts - joint.angle_to_counts(start)) if start is not None else 0
        speed = min(max(1, ceil(distance / duration / self.speed_unit(joint))), _FASTEST)
        data = b"\0" + position.encode(counts) + self._ceiling(joint).to_bytes(2, "little")
        return series.register("acceleration").address, data + series.register("goal_speed").encode(speed)

    def make_packets(
        self, moves: Iterable[tuple[str, float]], duration: float, starts: Mapping[str, float]
    ) -> tuple[list[bytes], tuple[tuple[str, float], ...]]:
        """Make the goals of several joints; each as by `make`.

        Args:
            moves: Names of joints with the angles to which they go, radians.
            duration: Seconds.
            starts: Angles at the start by joint name, radians, where they are known.

        Returns:
            One packet for each address and length; and the angles as the servos round them.
        """
        rows: dict[tuple[int, int], dict[int, bytes]] = {}
        sent = []
        for name, angle in moves:
            joint = self._joints[name]
            counts = joint.angle_to_counts(angle)
            address, data = self.make(joint, counts, duration, starts.get(name))
            rows.setdefault((address, len(data)), {})[joint.servo_id] = data
            sent.append((name, joint.counts_to_angle(counts)))
        return [make_sync_write(address, data_of) for (address, _), data_of in rows.items()], tuple(sent)

    def checked_packet(
        self,
        positions: Iterable[tuple[str, float]],
        duration: float,
        starts: Mapping[str, float],
        guided: bool,
    ) -> tuple[bytes, tuple[tuple[str, float], ...], float] | None:
        """Check a target as `check_target`, and make its goals, in one pass over its joints.

        Args:
            positions: Names of joints with the angles to which they go, radians; each joint once.
            duration: Seconds.
            starts: Angles at the start by joint name, radians.
            guided: As in `JointTarget`.

        Returns:
            The packet, the angles as the servos round them, and the duration; None for a target that takes more
            than a look: one that is refused, or has a servo of another series, or a joint nobody knows where.
        """
        if not duration > _MIN_DURATION:
            duration = _MIN_DURATION
        rows, longest = self._rows, duration
        if not rows:
            self._rows = rows = self._make_rows()
        fields: list[int] = []
        sent = []
        for name, angle in positions:
            row, start = rows.get(name), starts.get(name)
            if row is None or start is None or type(angle) is not float:
                return None
            servo_id, ceiling, sign, offset, scale, neutral, unit, low, high, most, fastest = row
            if not low <= angle <= high:
                return None
            steps = round(sign * (angle - offset) / scale)
            counts = steps + neutral
            if not 0 <= counts <= _MOST_COUNTS:
                return None
            needed = abs(angle - start) / (fastest if guided else most)
            if longest < needed:
                longest = needed
            speed = ceil(abs(steps - round(sign * (start - offset) / scale)) / duration / unit) or 1
            fields += servo_id, counts, ceiling, speed if speed < _FASTEST else _FASTEST
            sent.append((name, sign * steps * scale + offset))
        if longest > duration:
            # Too fast: with the time that it needs, all of them are slower.
            return self.checked_packet(positions, longest, starts, guided)
        return _sts_packer(len(sent))(*fields), tuple(sent), duration

    def _make_rows(self) -> dict[str, _Row]:
        return {
            name: (
                joint.servo_id,
                self._ceiling(joint),
                joint.sign,
                joint.offset,
                joint.scale,
                joint.neutral,
                self.speed_unit(joint),
                joint.minimum,
                joint.maximum,
                joint.max_speed,
                joint.guided_speed,
            )
            for name, joint in self._joints.items()
            if joint.series in _STS_SERIES
        }

    def _ceiling(self, joint: JointModel) -> int:
        """Most current of an HLS servo; other servos have none, and 0 in its place."""
        if Series(joint.series) is not Series.HLS:
            return 0
        return self._ceilings.get(joint.servo_id, DEFAULT_CEILING)


_SILENT = int(JointFlag.SILENT)
FAULTS = int(JointFlag(0xFF).faults) & ~_SILENT
"""The bits of a servo's error byte that are faults of its joint."""


class PositionReader:
    """Makes states of readings, and keeps the newest position of each joint.

    Args:
        model: The arm.

    Attributes:
        ids: Servo ids, in the order of the joints.
        positions: Newest known position by joint name, radians.
        sampled: Time of the sample by joint name, seconds.
    """

    def __init__(self, model: ArmModel) -> None:
        self._model = model
        self.ids = tuple(joint.servo_id for joint in model.joints)
        self.positions: dict[str, float] = {}
        self.sampled: dict[str, float] = {}
        self._unknown = (math.nan,) * len(self.ids)
        self._no_ages = (0.0,) * len(self.ids)
        self._newest: JointState | None = None
        self._torque: list[bool | None] = []

    def keep(self, state: JointState, torque: Sequence[bool | None]) -> JointState:
        """Return a state, which `recent` may return again if every joint has answered.

        Args:
            state: Just read.
            torque: Whether each joint has torque; None if unknown.
        """
        self._newest, self._torque = (None if any(state.age) else state), list(torque)
        return state

    def recent(self, now: float, within: float, torque: Sequence[bool | None], stopped: bool) -> JointState | None:
        """The last state with its age, if it is recent enough. Its positions are the newest known again.

        Args:
            now: Seconds.
            within: Most age, seconds.
            torque: As in `keep`; a state from before torque was switched does not count.
            stopped: Whether the arm is stopped.
        """
        newest = self._newest
        if newest is None or not 0.0 <= now - newest.stamp <= within or self._torque != torque:
            return None
        self.positions.update(zip(newest.names, newest.position, strict=True))
        ages = (now - newest.stamp,) * len(self.ids)
        return replace(newest, age=ages, stamp=now, stopped=stopped)

    def state(self, readings: Readings, torque: Sequence[bool | None], stopped: bool) -> JointState:
        """Make the state.

        Args:
            readings: Of ``present_position``, one per joint.
            torque: Whether each joint has torque; None if unknown.
            stopped: Whether the arm is stopped.
        """
        joints, names, now = self._model.joints, self._model.names, readings.stamp
        flags = [torque_flag(on) for on in torque]
        if readings.ok:
            # Nearly every call comes here.
            angles = [
                joint.sign * (counts - joint.neutral) * joint.scale + joint.offset
                for joint, counts in zip(joints, readings.raw, strict=True)
                if counts is not None
            ]
            self.positions.update(zip(names, angles, strict=True))
            self.sampled.update(dict.fromkeys(names, now))
            ages = self._no_ages
        else:
            angles = []
            for i, (joint, one) in enumerate(zip(joints, readings, strict=True)):
                if one.raw is None:
                    flags[i] |= _SILENT
                else:
                    flags[i] |= one.status & FAULTS
                    self.positions[joint.name] = joint.counts_to_angle(one.raw)
                    self.sampled[joint.name] = now
                angles.append(self.positions.get(joint.name, math.nan))
            ages = tuple([now - self.sampled.get(name, -math.inf) for name in names])
        unknown = self._unknown
        return JointState(
            names=names,
            position=tuple(angles),
            velocity=unknown,
            load=unknown,
            current=unknown,
            voltage=unknown,
            temperature=unknown,
            flags=tuple(flags),
            age=ages,
            stamp=now,
            stopped=stopped,
        )


def probe_joint(bus: ServoBus, joint: JointModel, calibration: Calibration | None = None) -> JointProbe:
    """Identify the servo of a joint.

    Args:
        bus: An open bus.
        joint: The joint in the arm's file.
        calibration: The calibration of the arm, if it has one.
    """
    info = servo_setup.identify(bus, joint.servo_id)
    if info is None:
        return JointProbe(joint.name, joint.servo_id, "unknown", False)
    series = "unknown" if info.series is None else info.series.value
    notes = [] if series == joint.series else [f"answers as {series}, the arm's file says {joint.series}"]
    notes += _at_odds(bus, joint, calibration)
    model = f"{info.model_name} {info.firmware}" if info.firmware else ""
    supply, hottest = _ratings(bus, joint.servo_id)
    return JointProbe(joint.name, joint.servo_id, series, True, ", ".join(notes), model, supply, hottest)


def _ratings(bus: ServoBus, servo_id: int) -> tuple[tuple[float, float] | None, float | None]:
    """Read the limits of voltage (V) and temperature (deg C) that a servo has stored."""
    if "max_voltage" not in bus.series_of(servo_id).registers:
        return None, None
    low, high, hottest = (bus.read(servo_id, name) for name in ("min_voltage", "max_voltage", "max_temperature"))
    return ratings(low.value, high.value, hottest.value)


def ratings(low: float, high: float, hottest: float) -> tuple[tuple[float, float] | None, float | None]:
    """What the stored limits of voltage (V) and temperature (deg C) say; None for one that says nothing.

    Args:
        low: Of the voltage; like the others NaN where it was not read.
        high: Of the voltage.
        hottest: Of the temperature.
    """
    return (low, high) if low < high else None, hottest if hottest > 0.0 else None


def _at_odds(bus: ServoBus, joint: JointModel, calibration: Calibration | None) -> list[str]:
    """Compare a servo's stored offset with the calibration: with another offset every position is wrong."""
    for row in () if calibration is None else calibration.joints:
        if row.name == joint.name and row.servo_offset is not None:
            now = bus.read(joint.servo_id, "position_offset").raw
            if now is not None and now != row.servo_offset:
                return [f"its offset is {now} but was {row.servo_offset} at calibration: calibrate again"]
    return []


_LIVE_FIRST, _LIVE_COUNT, _TO_LOAD = 56, 15, 6
_MIN_DURATION = 0.02
_MOST_BACKLOG = 0.001
"""Seconds that the line may be behind with goals while old positions serve for new ones."""
_THERE = math.radians(1.0)
"""How far a joint may be from its goal and count as there: a servo that holds a load sags."""
_ADVICE = "check power, cable, and --robot if it is another one; `hexwire doctor` looks for the reason"


class BusArm(PlainDriver, BareServos, StoredCalibration, Counters, ServoPing, SetPoints, SilenceCheck):
    """An arm on a servo bus.

    `ioctl` takes Command.TRANSACT with reply length, milliseconds (not used: the bus computes the time-out) and a
    servo packet, and returns the parameters of the answer.

    Args:
        link: Link to the adapter.
        arm: Description of the arm; the class's profile if None.
        calibration: Neutral positions and limits that replace those of the arm. Without one, an arm that a person
            assembles has what its servos have stored, from its first `attach` on.
        bus: An open bus on that link, to be used instead of a bus of its own. It stays open and keeps its stops.
    """

    port_leads_to = "adapter"
    profile: ClassVar[str] = "chain"
    _file: ClassVar[Path | None] = None

    def __init__(
        self,
        link: Link,
        *,
        arm: BusArmFile | None = None,
        calibration: Calibration | None = None,
        bus: ServoBus | None = None,
    ) -> None:
        super().__init__()
        described = arm or self.described()
        calibration = calibration or described.calibration
        # Only of the arms that hexwire knows by name it is known what their servos have stored.
        self._asks = arm is None and calibration is None and described.model.name in assembled_arms()
        self._usual = described.model
        self._stored: dict[str, JointCalibration | None] | None = None
        self.uncalibrated = {}
        # A link opened without a rate has the default of serial ports.
        self._baud = described.baud if getattr(link, "baud", DEFAULT_BAUD) == DEFAULT_BAUD else None
        self._borrowed = bus is not None
        self.bus = bus or ServoBus(link, servos={joint.servo_id: joint.series for joint in self._usual.joints})
        # One arm, one set of stops: a stop also cancels the calls that wait for the bus.
        if bus is None:
            self.bus.epochs = self.epochs
        else:
            self._epochs = bus.epochs
        self._memory = StopMemory(link.url)
        self._torque: list[bool | None] = [None] * len(self._usual.joints)
        self._adopt(calibration)

    def _adopt(self, calibration: Calibration | None) -> None:
        self.calibration = calibration
        self.model: ArmModel = self._usual if calibration is None else calibration.apply(self._usual)
        self._kinematics = None
        self._goals = BusGoals(self.bus, self.model.by_name)
        self._reader = PositionReader(self.model)
        self._positions, self._sampled = self._reader.positions, self._reader.sampled

    @classmethod
    def described(cls) -> BusArmFile:
        """The arm as its file or profile describes it.

        Raises:
            ConfigError: The file is invalid.
        """
        return load_profile(cls.profile) if cls._file is None else load_arm_file(cls._file)

    @classmethod
    def from_url(cls, url: str, **options: Any) -> Self:
        """Make a driver for the adapter that `url` names; options as in the constructor."""
        if unknown := set(options) - {"arm", "calibration"}:
            names = ", ".join(sorted(unknown))
            raise UsageError(f"an arm on a servo bus has no option {names}; its address may, as in ?baud=57600")
        from hexwire.link.open import make_link

        return cls(make_link(url), **options)

    @property
    def url(self) -> str:
        return self.bus.link.url

    @property
    def servo_link(self) -> Link:
        return self.bus.link

    @property
    def is_attached(self) -> bool:
        # A borrowed bus is open before the arm is attached.
        return self.bus.link.is_open and (self._open or not self._borrowed)

    @property
    def may_change_model(self) -> bool:
        return self._asks and self._stored is None

    def abort(self) -> None:
        self.bus.close()

    # -- attaching and detaching --------------------------------------------------------------------

    def attach(self) -> None:
        """Open the bus and ping every servo. Nothing moves.

        Raises:
            LinkError: The port cannot be opened.
            WrongDeviceError: The port leads to a controller board, or to another robot.
            ReplyTimeoutError: No servo answers.
            DeviceError: The servos have stored another calibration than at the first `attach`.
        """
        bus = self.bus
        if not self._borrowed:
            if self._baud is not None and hasattr(bus.link, "set_baud"):
                bus.set_baud(self._baud)
            warn_of_reset(bus.link)  # a controller board may be there by mistake
            bus.open(settle=False)  # pings come first
        try:
            errors = [bus.ping(joint.servo_id).error for joint in self.model.joints]
            here = [joint for joint, error in zip(self.model.joints, errors, strict=True) if not error]
            if not here:
                if (wrong := explain_no_servo(bus.link)) is not None:
                    raise wrong
                ids = ", ".join(str(joint.servo_id) for joint in self.model.joints)
                instead = next(filter(None, map(instead_in, errors)), "")
                raise ReplyTimeoutError(
                    f"pings of servos {ids}", attempts=1 + bus.retries, instead=instead, advice=_ADVICE
                )
            note_servos(bus)
            if self._asks:
                self._ask_calibration(here)
            self._goals.learn(here)
            self._torque = [None] * len(self.model.joints)
            self._read_torque(here)
        except BaseException:
            self._release()
            raise
        self._open = True
        if not self._borrowed:
            self.epochs.forget()
        if self._memory.stopped and not self.epochs.stopped:
            self.epochs.assume_stopped()

    def _ask_calibration(self, here: Sequence[JointModel]) -> None:
        """Take the calibration that the servos have stored; once, since callers keep what they know of the arm."""
        found = stored_ranges(self.bus, here)
        if self._stored is not None:
            changed = [name for name, row in found.items() if self._stored.get(name, row) != row]
            if changed:
                raise DeviceError(
                    f"the servos of {', '.join(changed)} have stored another calibration than when this arm was "
                    "opened, so its angles would be wrong; open it again"
                )
            return
        rows = [row for row in found.values() if row is not None]
        stored = Calibration(self._usual.name, "", tuple(rows))
        self._stored, self.uncalibrated = found, not_calibrated(stored, self._usual)
        # The range of a joint without stops tells nothing: it is calibrated if all others are.
        endless = assembly_of(self._usual).endless if self.uncalibrated else ()
        taken = tuple(row for row in rows if row.name not in self.uncalibrated and row.name not in endless)
        if taken:
            self._adopt(replace(stored, joints=taken))

    def detach(self, *, torque_off: bool = False) -> None:
        was, self._open = self._open, False
        try:
            if was and torque_off and self.bus.link.is_open:
                self.epochs.free(partial(self.on_torque, False, self.model.names))
        finally:
            self._release()

    def _release(self) -> None:
        if not self._borrowed:
            self.bus.close()

    def probe(self) -> ProbeReport:
        self._check_attached()
        rows = []
        for joint in self.model.joints:
            probe = probe_joint(self.bus, joint, self.calibration)
            rows.append(probe)
            if probe.present:
                self._read_torque([joint])
        return ProbeReport(
            robot=self.model.name,
            link=self.url,
            capabilities=("servo bus",),
            stopped=self.epochs.stopped,
            joints=tuple(rows),
            counters=self.host_counters(),
            unprotected="no watchdog, no limits: servos without a board",
        )

    @property
    def round_trips(self) -> Sequence[float]:
        return self.bus.timing.round_trips

    def host_counters(self) -> dict[str, int]:
        return self.bus.counters.as_dict()

    def now(self) -> float:
        return self.bus.now()

    def ping(self, servo_id: int) -> int | None:
        self._check_attached()
        found = self.bus.ping(servo_id)
        return None if found.error else found.status

    def examine(self) -> list[Finding]:
        from hexwire.link.diagnose import Finding, Level

        from .checkup import examine_bus

        findings = examine_bus(self.bus, self.model, self.probe(), self.read())
        if self.doubt:
            findings.append(Finding(Level.HINT, "calibration", self.doubt, self.cure))
        return findings

    def explain_silence(self) -> list[Finding]:
        from .checkup import explain_silence

        with self.bus as bus:
            return explain_silence(bus, self.model)

    # -- reading ------------------------------------------------------------------------------------

    def on_read(self) -> JointState:
        return self._read(_LIVE_COUNT)

    def read_loads(self) -> JointState:
        self._check_attached()
        return self._read(_TO_LOAD)

    def _read(self, count: int) -> JointState:
        self.epochs.let_through()
        bus, joints = self.bus, self.model.joints
        able = tuple(joint.servo_id for joint in joints if joint.series != "seven_bot")
        found = bus.sync_read_blocks(_LIVE_FIRST, count, able) if able else []
        blocks = {block.servo_id: block for block in found}
        rows = []
        for i, joint in enumerate(joints):
            block = blocks.get(joint.servo_id)
            if block is None:
                # A legacy servo reports only its position.
                reading = bus.read(joint.servo_id, "present_position")
                rows.append(self._row(i, joint, reading.raw, reading.status, [math.nan] * 5))
            else:
                rows.append(self._live(i, joint, block))
        now = bus.now()
        position, velocity, load, current, voltage, temperature, flags = zip(*rows, strict=True)
        for joint, angle, condition in zip(joints, position, flags, strict=True):
            if not condition & _SILENT:
                self._positions[joint.name], self._sampled[joint.name] = angle, now
        state = JointState(
            names=self.model.names,
            position=position,
            velocity=velocity,
            load=load,
            current=current,
            voltage=voltage,
            temperature=temperature,
            flags=flags,
            age=tuple(now - self._sampled.get(joint.name, -math.inf) for joint in joints),
            stamp=now,
            stopped=self.epochs.stopped,
        )
        return self._reader.keep(state, self._torque)

    def read_positions(self, within: float = 0.0) -> JointState:
        """Read positions only: half the time of `read` on the line. Velocity, load and the like may be NaN."""
        self._check_attached()
        self.epochs.let_through()
        bus, reader, torque, stopped = self.bus, self._reader, self._torque, self.epochs.stopped
        # Goals that are not awaited must not pile up on a slow line: to read is to wait for them.
        if within and bus.backlog() < _MOST_BACKLOG:
            state = reader.recent(bus.now(), within, torque, stopped)
            if state is not None:
                return state
        readings = bus.sync_read("present_position", reader.ids)
        return reader.keep(reader.state(readings, torque, stopped), torque)

    def _live(self, i: int, joint: JointModel, block: ServoBlock) -> tuple[Any, ...]:
        registers = Series(joint.series).registers
        step = joint.scale / registers["present_position"].si_factor
        speed = block.value(registers["present_speed"])
        if joint.series == "sts_sms":
            speed *= self._goals.speed_unit(joint) / SPEED_UNIT
        values = [
            joint.sign * step * speed,
            joint.sign * block.value(registers["present_load"]),
            block.value(registers["present_current"]) if registers["present_current"].si_unit == "A" else math.nan,
            block.value(registers["present_voltage"]),
            block.value(registers["present_temperature"]),
        ]
        return self._row(i, joint, block.raw(registers["present_position"]), block.status, values)

    def _row(
        self, i: int, joint: JointModel, counts: int | None, status: int, values: list[float]
    ) -> tuple[Any, ...]:
        if counts is None:
            position, flags = self._positions.get(joint.name, math.nan), _SILENT
        else:
            position, flags = joint.counts_to_angle(counts), status & FAULTS
        return position, *values, flags | torque_flag(self._torque[i])

    # -- moving -------------------------------------------------------------------------------------

    def guide(self, positions: Mapping[str, float], duration: float) -> tuple[tuple[str, float], ...]:
        if type(positions) is dict and positions and type(duration) is float and 0.0 <= duration <= LONGEST:
            return self._act("a move", self._post, positions.items(), duration, True)[0]
        return self.write(JointTarget.of(positions, duration, guided=True)).positions

    def _send(self, target: JointTarget) -> SentTarget:
        return SentTarget(*self._post(target.positions, target.duration, target.guided))

    def _post(
        self, targets: Collection[tuple[str, float]], duration: float, guided: bool
    ) -> tuple[tuple[tuple[str, float], ...], float]:
        """Send a target; returns the positions that were sent, and the duration."""
        # Nearly every target of a loop: all joints have torque, and nothing is to be refused.
        positions = self._positions
        made = self._goals.checked_packet(targets, duration, positions, guided) if all(self._torque) else None
        if made is None:
            whole = super()._send(JointTarget(tuple(targets), duration, guided=guided))
            return whole.positions, whole.duration
        packet, sent, duration = made
        self.bus.post(packet)
        # The start of the next move, until the next read.
        positions.update(targets)
        return sent, duration

    def _checked(self, target: JointTarget) -> JointTarget:
        model, positions = self.model, self._positions
        if not all(self._torque) or len(positions) < len(model.names):
            joints = [model.joint(name) for name, _ in target.positions]
            self._refuse_without_torque(joints)
            if any(joint.name not in positions for joint in joints):
                self.read()
        return check_target(model, target, positions)

    def on_target(self, target: JointTarget) -> SentTarget:
        positions, duration = self._positions, max(target.duration, _MIN_DURATION)
        packets, sent = self._goals.make_packets(target.positions, duration, positions)
        for packet in packets:
            self.bus.post(packet)
        # The start of the next move, until the next read.
        positions.update(target.positions)
        return SentTarget(sent, duration)

    def on_torque(self, on: bool, joints: tuple[str, ...]) -> tuple[str, ...]:
        wanted = [self.model.index(name) for name in joints]
        if not on:
            unsure = servo_setup.torque_off(self.bus, [self.model.joints[i].servo_id for i in wanted])
            for i in wanted:
                self._torque[i] = self.model.joints[i].servo_id in unsure and None
            self._goals.unbind([self.model.joints[i] for i in wanted if self._torque[i] is False])
            return tuple(self.model.joints[i].name for i in wanted if self._torque[i] is False)
        # Goals first: torque must hold a joint where it is, not drive it to an old goal.
        held = self._hold_together([self.model.joints[i] for i in wanted])
        if held:
            self.bus.sync_write_raw("torque_enable", {joint.servo_id: 1 for joint in held})
            self._read_torque(held)
        for joint in held:
            if not self._torque[self.model.index(joint.name)]:
                self.bus.write_raw(joint.servo_id, "torque_enable", 1)
                self._read_torque([joint])
        return tuple(self.model.joints[i].name for i in wanted if self._torque[i])

    def read_torque(self) -> None:
        """Ask the servos whether they have torque: one that restarts loses it, other programs may switch it off.

        States say it from then on, and a joint without torque gets no goal, which would switch its torque on.
        """
        self._check_attached()
        self._read_torque(self.model.joints)

    def unbind(self) -> None:
        """Take the last goal's speed from joints with torque that are where they were sent; torque off does of all.

        Others keep it: on its way, or once nothing is in its way, a joint would go on as fast as its servo can.
        """
        self._check_attached()
        bus, joints = self.bus, [joint for on, joint in zip(self._torque, self.model.joints, strict=True) if on]
        ids = [joint.servo_id for joint in joints]
        if not ids:
            return
        rows = zip(joints, bus.sync_read("goal_position", ids), bus.sync_read("present_position", ids), strict=True)
        self._goals.unbind(
            joint
            for joint, goal, here in rows
            if goal.raw is not None and here.raw is not None and abs(goal.raw - here.raw) * joint.scale <= _THERE
        )

    def stop(self, mode: StopMode = StopMode.HOLD) -> tuple[str, ...]:
        self._check_attached()
        # It waits for no turn: it goes first on the bus, which refuses the packets of calls made before it.
        with self.epochs.stopping():
            try:
                return self._halt(mode)
            finally:
                self._memory.remember()

    def resume(self) -> None:
        super().resume()
        self._memory.forget()

    @property
    def stop_kept_by(self) -> str:
        return self._memory.kept_by

    def on_hold(self) -> tuple[str, ...]:
        rows = enumerate(self.model.joints)
        # A joint without torque gets no goal: the goal would switch its torque on.
        return tuple(joint.name for i, joint in rows if self._torque[i] is False or self._hold(joint))

    def _hold(self, joint: JointModel) -> bool:
        """Make the present position of a joint its goal; False if the servo does not confirm it."""
        bus, servo_id = self.bus, joint.servo_id
        counts = bus.read(servo_id, "present_position").raw
        if counts is None:
            return False
        self._positions[joint.name] = joint.counts_to_angle(counts)
        address, data = self._goals.make(joint, counts, _MIN_DURATION, self._positions[joint.name])
        if joint.series == "seven_bot":
            # Only a sync write applies goal and time together.
            bus.sync_write_bytes(address, {servo_id: data})
            return True
        return not bus.write_bytes(servo_id, address, data).error

    def _hold_together(self, joints: Sequence[JointModel]) -> list[JointModel]:
        """Make the present positions of joints their goals; returns the joints of which the servos confirm it."""
        bus, held = self.bus, list[JointModel]()
        counts = bus.sync_read("present_position", [joint.servo_id for joint in joints]).raw if joints else ()
        packets: dict[tuple[int, int], dict[int, bytes]] = {}
        sent: dict[int, tuple[JointModel, int]] = {}
        for joint, here in zip(joints, counts, strict=True):
            if here is not None:
                angle = self._positions[joint.name] = joint.counts_to_angle(here)
                address, data = self._goals.make(joint, here, _MIN_DURATION, angle)
                packets.setdefault((address, len(data)), {})[joint.servo_id] = data
                sent[joint.servo_id] = joint, here
        for (address, _), rows in packets.items():
            bus.sync_write_bytes(address, rows)
        held += [joint for joint, _ in sent.values() if joint.series == "seven_bot"]
        # Nobody acknowledges such a packet. What a servo has not got, or keeps otherwise, it is sent alone.
        asked = [servo_id for servo_id, (joint, _) in sent.items() if joint.series != "seven_bot"]
        for reading in bus.sync_read("goal_position", asked) if asked else ():
            joint, wanted = sent[reading.servo_id]
            if reading.raw == wanted or self._hold(joint):
                held.append(joint)
        return held

    def _read_torque(self, joints: Sequence[JointModel]) -> None:
        readings = self.bus.sync_read("torque_enable", [joint.servo_id for joint in joints]) if joints else ()
        for joint, reading in zip(joints, readings, strict=True):
            self._torque[self.model.index(joint.name)] = None if reading.raw is None else bool(reading.raw)

    def _refuse_without_torque(self, joints: Sequence[JointModel]) -> None:
        index = self.model.index
        self._read_torque([joint for joint in joints if self._torque[index(joint.name)] is None])
        self._refuse_limp([joint.name for joint in joints if not self._torque[index(joint.name)]])

    def ioctl(self, sub_cmd: int, data: bytes = b"") -> bytes:
        self._check_attached()
        if sub_cmd == Command.IO:
            raise NotSupportedError("an arm on a servo bus has no outputs for a pump or a valve")
        if sub_cmd != Command.TRANSACT or len(data) < 8:
            text = f"an arm on a servo bus has no ioctl 0x{sub_cmd:02X}; use TRANSACT with a servo packet"
            raise NotSupportedError(text)
        packet, length = data[2:], data[0]
        if not packet_only_reads(packet):
            self._refuse_if_stopped("a servo packet")
        return self.bus.raw(packet, (packet[2],) if length else (), max(0, length - 6)).get(packet[2], b"")

    def may_move(self, sub_cmd: int, data: bytes = b"") -> bool:
        return not packet_only_reads(data[2:])


class So100Arm(BusArm):
    """The SO-100 arm."""

    profile = "so100"


class So101Arm(BusArm):
    """The SO-101 arm."""

    profile = "so101"


class SevenBotArm(BusArm):
    """The servos of the Hex7Bot on an adapter, without its board."""

    profile = "sevenbot"


class ChainArm(BusArm):
    """A plain chain of STS servos."""

    profile = "chain"


def arm_class(path: str | Path) -> type[BusArm]:
    """Make the driver class of an arm that a file describes.

    Raises:
        ConfigError: The file is invalid.
    """
    load_arm_file(path)
    return type("FileArm", (BusArm,), {"_file": Path(path), "__doc__": f"The arm of {path}."})
