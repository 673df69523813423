"""A calibration by hand: collects positions while somebody moves the joints, and says what is still missing.

Owns the ends of each joint, across the end of a servo's turn and wherever the joint stood at the beginning, and the
offset with which the whole range lies within one turn. Time comes in as an argument. Must not know a bus.

Positions are counts as the servos report them: the sensor's count less the offset stored in the servo.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from hexwire.drivers.stored_calibration import TOO_FAR
from hexwire.errors import UsageError
from hexwire.model.arms import assembly_of
from hexwire.model.calibration import Calibration, JointCalibration

if TYPE_CHECKING:
    from hexwire.model.arm import ArmModel, JointModel

__all__ = [
    "HandCalibration",
    "JointProgress",
    "ServoFacts",
    "endless_joints",
    "fitted",
    "full_turn",
    "make_row",
]

_TURN = 4096
_MIDDLE = 2047
"""Count of the middle of a range, as in LeRobot's calibration of an endless joint."""
_LARGEST_OFFSET = 2047
_LEAST = math.radians(5.0)
"""A joint that moved less was forgotten."""
_ENOUGH = 0.9
"""Share of the usual range from which nothing is missing."""
_GAP = 0.2
"""Seconds without an answer after which a joint may have moved on unseen."""
_UNSEEN = 1024
"""Counts in such a time after which the direction is unknown: a quarter of a turn."""


def endless_joints(model: ArmModel) -> tuple[str, ...]:
    """Joints without mechanical stops, whose middle a person shows: wrist_roll of an SO-101."""
    return assembly_of(model).endless


class ServoFacts(NamedTuple):
    """What a calibration keeps of a servo.

    Attributes:
        offset: Position offset stored in it; None if its series has none.
        model: As in ``sts3215``.
        firmware: As in ``3.10``.
    """

    offset: int | None
    model: str = ""
    firmware: str = ""


@dataclass(frozen=True, slots=True)
class JointProgress:
    """One joint so far; angles in radians, relative to where it stood at the beginning.

    Attributes:
        name: Joint name.
        low: Lowest position.
        position: Present position.
        high: Highest position.
        usual: Usual distance from end to end; NaN for a joint without ends.
        missing: What is still to be done, in words; empty if nothing.
    """

    name: str
    low: float
    position: float
    high: float
    usual: float
    missing: str

    @property
    def travel(self) -> float:
        """Distance from the lowest to the highest position."""
        return self.high - self.low


class HandCalibration:
    """Follows the joints of an arm without torque.

    Args:
        model: The arm as it usually is: names, ids, signs, and limits that say how far a joint usually goes.
        servos: Facts of each joint's servo, by joint name.
        endless: Joints without stops; `endless_joints` if None.
    """

    def __init__(
        self, model: ArmModel, servos: Mapping[str, ServoFacts], *, endless: Collection[str] | None = None
    ) -> None:
        self.model, self.servos = model, dict(servos)
        self.endless = tuple(endless_joints(model) if endless is None else endless)
        self._tracks = {joint.name: _Track(self.servos[joint.name].offset) for joint in model.joints}
        self._middles: dict[str, int] = {}

    def receive(self, positions: Mapping[str, int | None], now: float) -> None:
        """Take a sample: counts by joint name, None or left out for a servo that did not answer."""
        for name, track in self._tracks.items():
            track.receive(positions.get(name), now)

    def mark_middle(self) -> None:
        """Take the present position of every endless joint as its middle.

        Raises:
            UsageError: A joint does not report its position.
        """
        for name in self.endless:
            track = self._tracks[name]
            if track.position is None or track.silent:
                raise UsageError(f"{name} does not report its position: check its cable, then try again")
            self._middles[name] = track.position

    @property
    def needs_middle(self) -> bool:
        """Whether `mark_middle` is still to be called."""
        return len(self._middles) < len(self.endless)

    @property
    def progress(self) -> tuple[JointProgress, ...]:
        """Every joint so far."""
        return tuple(self._progress(joint) for joint in self.model.joints)

    @property
    def missing(self) -> tuple[JointProgress, ...]:
        """The joints with something left to do."""
        return tuple(row for row in self.progress if row.missing)

    @property
    def unmoved(self) -> tuple[str, ...]:
        """Joints without which there is no calibration: not moved, lost, or without a middle."""
        return tuple(joint.name for joint in self.model.joints if not self._usable(joint))

    def finish(self, taken: str) -> Calibration:
        """The calibration. The offsets in it must be stored in the servos, which then report its counts.

        Args:
            taken: Date and time, ISO 8601.

        Raises:
            UsageError: A joint cannot be calibrated yet; the text says why.
        """
        blocked = [f"{row.name} {row.missing}" for row in self.progress if row.name in self.unmoved]
        if blocked:
            raise UsageError("; ".join(blocked))
        rows = []
        for joint in self.model.joints:
            track, facts = self._tracks[joint.name], self.servos[joint.name]
            assert track.position is not None
            if joint.name in self.endless:
                rows.append(make_row(joint, facts, full_turn(self._middles[joint.name], facts.offset)))
            else:
                rows.append(make_row(joint, facts, fitted(joint.name, track.low, track.high, facts.offset)))
        return Calibration(self.model.name, taken, tuple(rows))

    def _progress(self, joint: JointModel) -> JointProgress:
        track = self._tracks[joint.name]
        if track.position is None:
            return JointProgress(joint.name, math.nan, math.nan, math.nan, _usual(joint), "does not answer")
        low, position, high = (
            joint.sign * (counts - track.start) * joint.scale for counts in (track.low, track.position, track.high)
        )
        usual = math.nan if joint.name in self.endless else _usual(joint)
        return JointProgress(joint.name, min(low, high), position, max(low, high), usual, self._missing(joint))

    def _missing(self, joint: JointModel) -> str:
        track = self._tracks[joint.name]
        if track.silent:
            return "does not answer: check its cable"
        if joint.name in self.endless:
            return "" if joint.name in self._middles else "put it in its middle"
        travel, usual = (track.high - track.low) * joint.scale, _usual(joint)
        if track.high - track.low >= _TURN or travel > TOO_FAR * usual:
            return "beyond its stops: is its horn loose?"
        if travel < _ENOUGH * usual and track.restarted:
            return "lost from sight: go to both ends again"
        if travel < _LEAST:
            return "not moved yet"
        if travel < _ENOUGH * usual:
            return f"{math.degrees(travel):.0f} of {math.degrees(usual):.0f} deg: go to both ends"
        return ""

    def _usable(self, joint: JointModel) -> bool:
        track = self._tracks[joint.name]
        if track.position is None or track.silent:
            return False
        if joint.name in self.endless:
            return joint.name in self._middles
        return (track.high - track.low) * joint.scale >= _LEAST and track.high - track.low < _TURN


class _Track:
    """The sensor's counts of one joint, continued over the end of a turn.

    Attributes:
        start: Position of the first sample, or of the last restart.
        low: Lowest.
        high: Highest.
        position: Present; None before the first sample.
        silent: The last sample is missing for so long that the joint may have moved on.
        restarted: It has moved on unseen, so its ends were forgotten.
    """

    def __init__(self, offset: int | None) -> None:
        self._offset = offset or 0
        self.start = self.low = self.high = 0
        self.position: int | None = None
        self.silent = self.restarted = False
        self._heard = -math.inf

    def receive(self, reported: int | None, now: float) -> None:
        if reported is None:
            self.silent = now - self._heard > _GAP
            return
        sensor = reported + self._offset
        if self.position is None:
            self._begin(sensor)
        else:
            # A sensor of one turn jumps from 4095 to 0: the joint took the shorter direction.
            step = (sensor - self.position + _TURN // 2) % _TURN - _TURN // 2
            if now - self._heard > _GAP and abs(step) > _UNSEEN:
                self.restarted = True
                self._begin(self.position + step)
            else:
                self._go(self.position + step)
        self.silent, self._heard = False, now

    def _begin(self, counts: int) -> None:
        self.start = self.low = self.high = self.position = counts

    def _go(self, counts: int) -> None:
        self.position = counts
        self.low, self.high = min(self.low, counts), max(self.high, counts)


def fitted(name: str, low: int, high: int, offset: int | None) -> tuple[int | None, int, int]:
    """Fit a range into one turn.

    Args:
        name: Joint name, for the error.
        low: Lowest count of the sensor, continued over the end of its turn.
        high: Highest count.
        offset: The servo's present offset; None if it cannot store one.

    Returns:
        The offset to store, -2047 to 2047, and the ends as the servo then reports them, 0 to 4095.

    Raises:
        UsageError: The range is a turn or more, or cannot be moved within the turn.
    """
    if high - low >= _TURN - 1:
        raise UsageError(f"{name} turned by a whole turn or more: is its horn loose?")
    if offset is None:
        if low < 0 or high >= _TURN:
            raise UsageError(
                f"{name} passes the end of its servo's turn, and this servo stores no offset: mount its horn "
                "so that the middle of its range is the middle of the turn"
            )
        return None, low, high
    wanted = _storable((low + high) // 2 - _MIDDLE)
    first = (low - wanted) % _TURN
    return wanted, first, first + high - low


def full_turn(middle: int, offset: int | None) -> tuple[int | None, int, int]:
    """The same for an endless joint, whose range is the whole turn about its middle."""
    return None if offset is None else _storable(middle - _MIDDLE), 0, _TURN - 1


def make_row(joint: JointModel, facts: ServoFacts, fit: tuple[int | None, int, int]) -> JointCalibration:
    """Make the row of a joint from what `fitted` or `full_turn` returned."""
    offset, low, high = fit
    return JointCalibration(
        joint.name,
        joint.servo_id,
        (low + high) / 2,
        low,
        high,
        servo_offset=offset,
        model=facts.model,
        firmware=facts.firmware,
    )


def _usual(joint: JointModel) -> float:
    return joint.maximum - joint.minimum


def _storable(offset: int) -> int:
    """The offset within a turn. The register has a sign and 11 bits, so -2048 does not fit and is a count off."""
    return max(-_LARGEST_OFFSET, (offset + _TURN // 2) % _TURN - _TURN // 2)
