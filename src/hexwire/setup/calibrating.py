"""Calibrates an arm on a servo bus: by hand or automatically, and stores the result in the servos.

Owns the order of such steps, the settings of the servos meanwhile, and that the arm has no torque at the end. Asks
and shows nothing; that is the caller's task.

For the automatic calibration a servo counts over many turns, since nobody knows yet where its range passes the end
of a turn, and its torque is limited. Both are lost with its supply; nothing is stored before the end. A servo bus
has no watchdog: if this program is killed, the joints hold where they are with this low torque, after at most a few
degrees, until torque is switched off.
"""

from __future__ import annotations

import math
import struct
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import replace
from typing import TYPE_CHECKING

from hexwire.bus import setup as servo_setup
from hexwire.control.loop.owner import RobotOwner
from hexwire.control.motion.path_check import PathCheck
from hexwire.drivers.arm_file import BusArmFile
from hexwire.errors import HexwireError, NotSupportedError, ServoError, StoppedError, UsageError
from hexwire.model.arm import ArmModel
from hexwire.model.arms import assembly_of
from hexwire.model.calibration import Calibration, JointCalibration

from .auto_calibration import COUNT, AutoCalibration
from .hand_calibration import HandCalibration, ServoFacts, endless_joints, fitted, full_turn, make_row

if TYPE_CHECKING:
    from hexwire.bus.servo_bus import ServoBus
    from hexwire.drivers.bus_arm import BusArm

__all__ = ["CalibrationBench", "counting_arm", "store"]

_RATE = 50.0
_LOOK = 5
"""Turns between two looks at the torque limits."""
_TURN = 4096
_TURNS = 7
"""Turns that a servo counts to either side."""
_FASTEST = math.radians(60.0)
_CLOSE = 100
"""Counts that a joint without torque may move while its offset is stored."""
_HOLDS = "the arm is stopped and holds with low torque; put it down, `hexwire resume`, then `hexwire torque off`"


def counting_arm(described: BusArmFile) -> BusArmFile:
    """The arm with counts, as radians, for joint angles, and room for several turns."""
    reach = _TURNS * math.tau
    joints = tuple(
        replace(
            joint, neutral=0, sign=1, offset=0.0, scale=COUNT, minimum=-reach, maximum=reach, max_speed=_FASTEST
        )
        for joint in described.model.joints
    )
    return BusArmFile(ArmModel(described.model.name, joints), described.baud)


class CalibrationBench:
    """An arm that is calibrated.

    Args:
        arm: Attached, made with ``arm=counting_arm(described)``.
        described: The arm as its file or profile describes it.
        shield: Protects a step that must be completed, such as switching torque off, from signals.

    Attributes:
        servos: Facts of each joint's servo, by joint name; `examine` reads them.
    """

    def __init__(
        self,
        arm: BusArm,
        described: BusArmFile,
        *,
        shield: Callable[[], AbstractContextManager[object]] = nullcontext,
    ) -> None:
        self.arm, self.model = arm, described.model
        self.servos: dict[str, ServoFacts] = {}
        self._shield = shield
        self._ids = tuple(joint.servo_id for joint in self.model.joints)

    def examine(self) -> None:
        """Identify every servo. Nothing is written.

        Raises:
            ServoError: A servo does not answer, or shares its id.
        """
        self.servos = {}
        for joint in self.model.joints:
            self.servos[joint.name] = _facts(self.arm.bus, joint.name, joint.servo_id)

    def release(self) -> None:
        """Switch torque off: the arm may sink.

        Raises:
            ServoError: A joint does not confirm it.
        """
        with self._shield():
            missing = set(self.model.names) - set(self.arm.torque(False))
        if missing:
            raise ServoError(f"{', '.join(sorted(missing))} did not confirm torque off; nothing was saved")

    def positions(self) -> dict[str, int | None]:
        """Counts that the servos report; None for one that did not answer."""
        readings = self.arm.bus.sync_read("present_position", self._ids)
        return dict(zip(self.model.names, readings.raw, strict=True))

    def by_hand(self) -> HandCalibration:
        """Begin a calibration by hand; pass it `positions` until nothing is missing."""
        return HandCalibration(self.model, self.servos)

    def automatic(
        self,
        taken: str,
        *,
        watch: Callable[[AutoCalibration], object] = lambda auto: None,
        clock: Callable[[], float] | None = None,
        sleep: Callable[[float], object] | None = None,
    ) -> Calibration:
        """Find the stops of every joint. The arm moves, and has no torque afterwards, whatever ends it.

        Args:
            taken: Date and time, ISO 8601.
            watch: Called in every cycle.
            clock: Monotonic seconds; the system's if None.
            sleep: Waits for a number of seconds.

        Returns:
            The calibration; `store` is the next step.

        Raises:
            NotSupportedError: It is not an SO arm with STS servos.
            StoppedError: The arm was stopped; it holds with low torque.
            ServoError: Something odd happened; the text says what and to which joint.
        """
        if not assembly_of(self.model).search or any(joint.series != "sts_sms" for joint in self.model.joints):
            raise NotSupportedError(f"the order of motions is known only for SO arms, not for {self.model.name}")
        start = self._at_rest()
        gains = {joint.name: self.arm.bus.read(joint.servo_id, "position_p").raw for joint in self.model.joints}
        auto = AutoCalibration(self.model, gains={name: gain for name, gain in gains.items() if gain})
        with self._gently():
            unturned = self._at_rest()
            on = self.arm.torque(True)
            if len(on) < len(self.model.joints):
                missing = ", ".join(sorted(set(self.model.names) - set(on)))
                raise ServoError(f"{missing} did not confirm torque on")
            owner = RobotOwner(
                self.arm,
                # Its angles mean nothing yet.
                check=PathCheck.limits_only(self.model),
                borrowed=True,
                command_rate=_RATE,
                stop_on_failure=False,
                clock=clock or time.monotonic,
                sleep=sleep or time.sleep,
            )
            with owner:
                owner.group.members = (auto,)
                turns = 0
                while not auto.over:
                    owner.turn()
                    turns += 1
                    if not turns % _LOOK:
                        self._look_at_limits(auto)
                    watch(auto)
            if self.arm.epochs.stopped:
                raise StoppedError.unsent("a motion", StoppedError.STATUS, _HOLDS)
            if auto.fault:
                raise ServoError(f"{auto.fault}; nothing was saved")
        return self._calibration(auto, start, unturned, taken)

    def _look_at_limits(self, auto: AutoCalibration) -> None:
        """End it if a servo was without supply: it has its full torque then, and the next goal switches it on."""
        found = self.arm.bus.sync_read("torque_limit", self._ids).raw
        for name, raw in zip(self.model.names, found, strict=True):
            if raw is not None and raw != self._torque_limit(name):
                auto.fail(f"{name} was without supply for a moment: check its cable and the supply")

    def _torque_limit(self, joint: str) -> int:
        return round(1000 * assembly_of(self.model).joint(joint).force)

    def _at_rest(self) -> dict[str, int]:
        found = self.positions()
        silent = [name for name, counts in found.items() if counts is None]
        if silent:
            raise ServoError(f"{', '.join(silent)} does not answer: check cable and power")
        return {name: counts for name, counts in found.items() if counts is not None}

    def _calibration(
        self, auto: AutoCalibration, start: Mapping[str, int], unturned: Mapping[str, int], taken: str
    ) -> Calibration:
        rows: list[JointCalibration] = []
        for joint in self.model.joints:
            facts = self.servos[joint.name]
            if joint.name in endless_joints(self.model):
                middle = start[joint.name] + (facts.offset or 0)
                rows.append(make_row(joint, facts, full_turn(middle, facts.offset)))
                continue
            low, high = (counts + (facts.offset or 0) for counts in auto.ranges[joint.name])
            rows.append(make_row(joint, facts, fitted(joint.name, low, high, facts.offset)))
        return Calibration(self.model.name, taken, tuple(rows))

    @contextmanager
    def _gently(self) -> Iterator[None]:
        """Low torque and no end of a turn for a `with` block; no torque and the settings from before at the end."""
        bus, before = self.arm.bus, dict[int, tuple[int, bytes]]()
        try:
            for joint in self.model.joints:
                servo_id = joint.servo_id
                # With the lock set, stored settings change only until the supply is switched off.
                _accepted(bus, servo_id, "lock", 1)
                # Not the present limits: those may be left from a program that was killed here.
                limit = bus.read(servo_id, "max_torque").check().raw
                block = bus.read_block(servo_id, *_LIMITS).check().data
                before[servo_id] = limit or 0, block if any(block) else _WHOLE_TURN
                _accepted(bus, servo_id, "torque_limit", self._torque_limit(joint.name))
                bus.write_bytes(servo_id, _LIMITS[0], bytes(_LIMITS[1])).check()
                if any(bus.read_block(servo_id, *_LIMITS).check().data):
                    raise ServoError(f"{joint.name} does not accept positions of several turns")
            yield
        except BaseException as error:
            self._end(before, error)
            raise
        self._end(before, None)

    def _end(self, before: Mapping[int, tuple[int, bytes]], why: BaseException | None) -> None:
        """Switch torque off and put the settings back, whatever ended the motion.

        Raises:
            ServoError: Torque may still be on; the text says what to do, and what ended the motion.
        """
        said = f"{why}; " if isinstance(why, HexwireError) else ""
        with self._shield():
            if self.arm.epochs.stopped:
                return
            try:
                unsure = set(self.model.names) - set(self.arm.torque(False))
                for servo_id, (limit, block) in before.items():
                    self.arm.bus.write_bytes(servo_id, _LIMITS[0], block)
                    self.arm.bus.write_raw(servo_id, "torque_limit", limit)
            except HexwireError as error:
                said = said or f"{error}; "
                raise ServoError(f"{said}the arm may hold with low torque: switch its supply off") from error
        if unsure:
            names = ", ".join(sorted(unsure))
            raise ServoError(f"{said}{names} did not confirm torque off: hold the arm and switch its supply off")


_LIMITS = (9, 4)
"""Address and length of the two position limits of an STS servo; both 0 mean positions of several turns."""
_WHOLE_TURN = bytes((0, 0)) + (_TURN - 1).to_bytes(2, "little")


def _facts(bus: ServoBus, name: str, servo_id: int) -> ServoFacts:
    info = servo_setup.identify(bus, servo_id)
    if info is None:
        raise ServoError(f"{name} (servo {servo_id}) does not answer: check cable and power", servo_id=servo_id)
    if servo_setup.shares_id(bus, servo_id):
        raise ServoError(f"several servos seem to have id {servo_id}: `hexwire bus setup`", servo_id=servo_id)
    offset = None
    if "position_offset" in bus.series_of(servo_id).registers:
        reading = bus.read(servo_id, "position_offset")
        if reading.raw is None:
            reading.check()
        offset = reading.raw
    return ServoFacts(offset, info.model_name, info.firmware)


def _accepted(bus: ServoBus, servo_id: int, name: str, raw: int) -> None:
    """Write a value that must be there afterwards; a reported fault is left to the first state."""
    answer = bus.write_raw(servo_id, name, raw)
    if answer.error:
        answer.check()
    now = bus.read(servo_id, name).raw
    if now != raw:
        raise ServoError(f"servo {servo_id} has {name} {now} after {raw} was written", servo_id=servo_id)


def store(bus: ServoBus, calibration: Calibration) -> tuple[str, ...]:
    """Store offsets and position limits of a calibration in the servos, as LeRobot does. Nothing moves.

    First every servo must answer and have no torque. If one of them fails later, all get their old values back.

    Returns:
        Names of the joints whose servos had other values before.

    Raises:
        ServoError: A servo fails, or has torque; the text says whether anything changed.
    """
    rows = [row for row in calibration.joints if row.servo_offset is not None]
    for row in rows:
        if not (0 <= row.low < row.high < _TURN):
            raise UsageError(f"{row.name}: the range {row.low} to {row.high} cannot be stored in a servo")
        if _facts(bus, row.name, row.servo_id).offset is None:
            raise NotSupportedError(
                f"{row.name} (servo {row.servo_id}) cannot store an offset; nothing was changed"
            )
        torque = bus.read(row.servo_id, "torque_enable")
        if torque.raw != 0:
            what = "has torque: it would jump" if torque.raw else "does not answer"
            raise ServoError(f"{row.name} {what}; nothing was changed", servo_id=row.servo_id)
    wanted = {row: (row.servo_offset or 0, struct.pack("<HH", row.low, row.high)) for row in rows}
    before: dict[JointCalibration, tuple[int, bytes]] = {}
    changed: list[JointCalibration] = []
    try:
        for row in rows:
            before[row] = _stored_in(bus, row.servo_id)
        # First no joint has a range: if this program is killed then, the arm counts as not calibrated.
        for row in rows:
            if before[row] != wanted[row]:
                changed.append(row)
                _store_limits(bus, row, _WHOLE_TURN)
        for row in changed:
            _store_one(bus, row, before[row][0], *wanted[row])
    except HexwireError as error:
        kept = _undo(bus, changed, before)
        what = f"but {', '.join(kept)} may have new values" if kept else "all servos have their old values again"
        raise ServoError(f"{error}; {what}") from error
    return tuple(row.name for row in changed)


def _stored_in(bus: ServoBus, servo_id: int) -> tuple[int, bytes]:
    """Offset and position limits; a servo that reports a fault has them, too."""
    offset, block = bus.read(servo_id, "position_offset"), bus.read_block(servo_id, *_LIMITS)
    if offset.raw is None or not block.data:
        raise ServoError(f"servo {servo_id} does not answer", servo_id=servo_id)
    return offset.raw, block.data


def _refuse_torque(bus: ServoBus, row: JointCalibration) -> None:
    """Another program may have switched it on since the first look."""
    if servo_setup.read_raw(bus, row.servo_id, "torque_enable"):
        raise ServoError(f"{row.name} has torque now: it would jump", servo_id=row.servo_id)


def _store_offset(bus: ServoBus, row: JointCalibration, offset: int) -> None:
    _refuse_torque(bus, row)
    servo_setup.write_setting(bus, row.servo_id, "position_offset", offset)


def _store_limits(bus: ServoBus, row: JointCalibration, block: bytes) -> None:
    """Store both position limits in one packet, so that there is never one old and one new."""
    if _stored_in(bus, row.servo_id)[1] != block:
        _refuse_torque(bus, row)
        servo_setup.write_stored(bus, row.servo_id, _LIMITS[0], block)


def _store_one(bus: ServoBus, row: JointCalibration, before: int, offset: int, limits: bytes) -> None:
    servo_id = row.servo_id
    here = bus.read(servo_id, "present_position").raw
    if offset != before:
        _store_offset(bus, row, offset)
    _store_limits(bus, row, limits)
    now = bus.read(servo_id, "present_position").raw
    if here is None or now is None:
        raise ServoError(f"servo {servo_id} does not answer", servo_id=servo_id)
    if not 0 <= now < _TURN:
        # A servo that counts turns has counted one; its supply would clear that too.
        bus.reset_turns(servo_id)
        now = bus.read(servo_id, "present_position").raw
    moved = offset - before
    if now is None or not 0 <= now < _TURN or abs((now - here + moved + _TURN // 2) % _TURN - _TURN // 2) > _CLOSE:
        raise ServoError(
            f"{row.name} reports position {now} after its offset was stored: switch the supply off and on",
            servo_id=servo_id,
        )


def _undo(
    bus: ServoBus, changed: list[JointCalibration], before: Mapping[JointCalibration, tuple[int, bytes]]
) -> list[str]:
    """Write the old values back; returns the joints where that failed."""
    kept = []
    for row in changed:
        offset, limits = before[row]
        try:
            if _stored_in(bus, row.servo_id)[0] != offset:
                _store_offset(bus, row, offset)
            _store_limits(bus, row, limits)
        except HexwireError:
            kept.append(row.name)
    return kept
