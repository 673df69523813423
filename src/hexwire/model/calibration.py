"""Calibration of each joint: its middle and its ends in counts, the date, and the servo.

Owns the value, its TOML text, the import of LeRobot's files, and the data of the two calibration steps: move the
arm to the middle, then move every joint through its range. Reads and writes text, not files; must not know servos.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from hexwire.errors import ConfigError, UsageError
from hexwire.inputs import Item, parse_json, parse_toml

from .arm import ArmModel

__all__ = ["Calibration", "JointCalibration", "RangeSweep"]

_TURN = 4096
_LEAST_RANGE = 20
"""Counts that a joint must move in a sweep; a joint that moved less was forgotten."""


@dataclass(frozen=True, slots=True)
class JointCalibration:
    """One joint.

    Attributes:
        name: Joint name.
        servo_id: Id of its servo.
        middle: Count of the middle position.
        low: Lowest count it may go to.
        high: Highest count it may go to.
        sign: 1, or -1 if the direction is reversed.
        servo_offset: Position offset stored in the servo at that time; None if it has none.
        model: Servo model, such as ``sts3215``.
        firmware: Firmware version, such as ``3.10``.
    """

    name: str
    servo_id: int
    middle: int
    low: int
    high: int
    sign: int = 1
    servo_offset: int | None = None
    model: str = ""
    firmware: str = ""

    def __post_init__(self) -> None:
        if not self.low <= self.middle <= self.high:
            raise UsageError(f"{self.name}: middle {self.middle} is not between {self.low} and {self.high}")
        if self.sign not in (1, -1):
            raise UsageError(f"{self.name}: sign {self.sign} is neither 1 nor -1")


@dataclass(frozen=True, slots=True)
class Calibration:
    """All joints of one arm.

    Attributes:
        arm: Name of the arm's model.
        taken: Date and time, ISO 8601; empty if unknown.
        joints: One row per joint.
    """

    arm: str
    taken: str
    joints: tuple[JointCalibration, ...]

    def apply(self, model: ArmModel) -> ArmModel:
        """The model with these middles and limits instead of its own.

        Raises:
            UsageError: A joint has another servo id in the model, or does not exist there.
        """
        rows = {row.name: row for row in self.joints}
        for name in rows:
            model.joint(name)
        joints = []
        for joint in model.joints:
            row = rows.get(joint.name)
            if row is None:
                joints.append(joint)
                continue
            if row.servo_id != joint.servo_id:
                raise UsageError(
                    f"{joint.name} was calibrated on servo {row.servo_id}, but {model.name} has servo "
                    f"{joint.servo_id} there: calibrate again, or correct the servo's id"
                )
            joint = replace(joint, neutral=row.middle, sign=joint.sign * row.sign)
            ends = sorted((joint.counts_to_angle(row.low), joint.counts_to_angle(row.high)))
            joints.append(replace(joint, minimum=ends[0], maximum=ends[1]))
        return replace(model, joints=tuple(joints))

    def serialize(self) -> str:
        """As TOML text."""
        lines = [f"arm = {json.dumps(self.arm)}", f"taken = {json.dumps(self.taken)}"]
        for row in self.joints:
            lines += ["", "[[joints]]"]
            for key in row.__slots__:
                value = getattr(row, key)
                if value is not None:
                    lines.append(f"{key} = {json.dumps(value)}")
        return "\n".join(lines) + "\n"

    @classmethod
    def parse(cls, text: str, *, file: str = "") -> Calibration:
        """Read the TOML text.

        Raises:
            ConfigError: It is not TOML, or a key is unknown, missing or wrong; the text names it.
        """
        root = parse_toml(text, file).table(("arm", "taken", "joints"), ("arm", "taken", "joints"))
        rows = [_row(item) for item in root["joints"].rows(_MOST_JOINTS)]
        _check_names(rows, root["joints"])
        return cls(root["arm"].text(), root["taken"].text(), tuple(rows))

    @classmethod
    def from_lerobot(cls, text: str, *, arm: str, taken: str = "", file: str = "") -> Calibration:
        """Import a LeRobot calibration file.

        LeRobot's middle is the middle of its range, its `homing_offset` is stored in the servo, and `drive_mode` 1
        reverses a joint.

        Raises:
            ConfigError: It is not such a file.
        """
        root = parse_json(text, file)
        rows = []
        for name, item in root.table().items():
            row = item.table(needed=_LEROBOT)
            low, high = (row[key].integer(-_MOST_COUNTS, _MOST_COUNTS) for key in ("range_min", "range_max"))
            turned = row["drive_mode"].integer(0, 1)
            offset = row["homing_offset"].integer(-_MOST_COUNTS, _MOST_COUNTS)
            servo_id = row["id"].integer(0, _MOST_JOINTS)
            Item(name, file, "a joint's name").text(100, least=1)
            rows.append(_checked(item, name, servo_id, (low + high) // 2, low, high, -1 if turned else 1, offset))
        if not rows:
            raise root.fault("is not a LeRobot calibration: it has no joint")
        return cls(arm, taken, tuple(rows))


_MOST_JOINTS = 253
_MOST_COUNTS = 1_000_000
"""Counts beyond any servo, over all its turns."""
_LEROBOT = ("id", "drive_mode", "homing_offset", "range_min", "range_max")
_TEXTS = ("name", "model", "firmware")
_NEEDED = ("name", "servo_id", "middle", "low", "high")


def _row(item: Item) -> JointCalibration:
    row = item.table(JointCalibration.__slots__, _NEEDED)
    values: dict[str, Any] = {}
    for key, value in row.items():
        if key in _TEXTS:
            values[key] = value.text(100, least=key == "name")
        else:
            values[key] = value.integer(0, _MOST_JOINTS) if key == "servo_id" else value.integer(*_COUNTS)
    return _checked(item, **values)


_COUNTS = (-_MOST_COUNTS, _MOST_COUNTS)


def _checked(item: Item, *values: Any, **named: Any) -> JointCalibration:
    try:
        return JointCalibration(*values, **named)
    except UsageError as error:
        raise ConfigError(str(error), file=item.file) from None


def _check_names(rows: Sequence[JointCalibration], item: Item) -> None:
    names = [row.name for row in rows]
    if len(set(names)) != len(names):
        raise item.fault("name a joint twice")


class RangeSweep:
    """Collects positions while the user moves the joints, and finds the ends of each.

    Args:
        middles: Count of each joint's middle, by name.
    """

    def __init__(self, middles: Mapping[str, int]) -> None:
        self.middles = dict(middles)
        self._last = dict(middles)
        self._low = dict(middles)
        self._high = dict(middles)

    def receive(self, positions: Mapping[str, int | None]) -> None:
        """Process positions; a joint whose servo did not answer is None or left out."""
        for name, raw in positions.items():
            if raw is None or name not in self._last:
                continue
            last = self._last[name]
            # A single-turn sensor jumps from 4095 to 0: the joint took the shorter direction.
            counts = last + (raw - last + _TURN // 2) % _TURN - _TURN // 2
            self._last[name] = counts
            self._low[name] = min(self._low[name], counts)
            self._high[name] = max(self._high[name], counts)

    @property
    def ranges(self) -> dict[str, tuple[int, int]]:
        """Lowest and highest count of each joint so far."""
        return {name: (self._low[name], self._high[name]) for name in self.middles}

    @property
    def unmoved(self) -> tuple[str, ...]:
        """Joints that have not been moved yet."""
        return tuple(name for name, (low, high) in self.ranges.items() if high - low < _LEAST_RANGE)

    @property
    def wrapped(self) -> tuple[str, ...]:
        """Joints that passed the end of the sensor's turn: their middle must be set in the servo first."""
        return tuple(name for name, (low, high) in self.ranges.items() if low < 0 or high >= _TURN)

    def finish(
        self, model: ArmModel, taken: str, servos: Mapping[str, tuple[int | None, str, str]] | None = None
    ) -> Calibration:
        """The calibration.

        Args:
            model: The arm.
            taken: Date and time, ISO 8601.
            servos: Offset, model and firmware of each joint's servo.

        Raises:
            UsageError: A joint was not moved, or passed the end of a turn; the text names it.
        """
        _none_of(self.unmoved, "was not moved", "move every joint to both ends")
        _none_of(
            self.wrapped, "passed the end of the sensor's turn", "centre its servo first (`hexwire bus center`)"
        )
        rows: list[JointCalibration] = []
        for joint in model.joints:
            if joint.name not in self.middles:
                continue
            low, high = self.ranges[joint.name]
            offset, kind, firmware = (servos or {}).get(joint.name, (None, "", ""))
            middle = self.middles[joint.name]
            rows.append(JointCalibration(joint.name, joint.servo_id, middle, low, high, 1, offset, kind, firmware))
        return Calibration(model.name, taken, tuple(rows))


def _none_of(names: Iterable[str], what: str, advice: str) -> None:
    listed = ", ".join(names)
    if listed:
        raise UsageError(f"{listed} {what}: {advice}")
