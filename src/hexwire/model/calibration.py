"""Calibration of each joint: its middle and its ends in counts, the date, and the servo.

Owns the value, its TOML text, and the text of LeRobot's files in both directions. Reads and writes text, not files;
must not know servos.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from hexwire.errors import ConfigError, UsageError
from hexwire.inputs import Item, parse_json, parse_toml

from .arm import ArmModel

__all__ = ["LEROBOT_TURN", "Calibration", "JointCalibration"]

_TURN = 4096
LEROBOT_TURN = 4095
"""Counts that LeRobot takes for a turn of 360 degrees (`MotorsBus._normalize`, LeRobot 0.4.4)."""
_LARGEST_OFFSET = 2047
"""Largest offset that a servo can store: 11 bits and a sign."""


@dataclass(frozen=True, slots=True)
class JointCalibration:
    """One joint.

    Attributes:
        name: Joint name.
        servo_id: Id of its servo.
        middle: Count at which the joint's angle is 0; may lie between two counts.
        low: Lowest count it may go to.
        high: Highest count it may go to.
        sign: 1, or -1 if the direction is reversed.
        servo_offset: Position offset stored in the servo at that time; None if it has none.
        model: Servo model, such as ``sts3215``.
        firmware: Firmware version, such as ``3.10``.
        turn: Counts that are 360 degrees: 4096, or 4095 in files of LeRobot.
        drive_mode: LeRobot's; 1 reverses its values from -100 to 100, but not its degrees: no effect here.
    """

    name: str
    servo_id: int
    middle: float
    low: int
    high: int
    sign: int = 1
    servo_offset: int | None = None
    model: str = ""
    firmware: str = ""
    turn: int = _TURN
    drive_mode: int = 0

    def __post_init__(self) -> None:
        if not self.low <= self.middle <= self.high:
            raise UsageError(f"{self.name}: middle {self.middle:g} is not between {self.low} and {self.high}")
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
            # The middle of a range may lie between two counts; a joint's neutral position does not.
            neutral, sign = math.floor(row.middle), joint.sign * row.sign
            scale = joint.scale * _TURN / row.turn
            offset = joint.offset - sign * (row.middle - neutral) * scale
            joint = replace(joint, neutral=neutral, sign=sign, scale=scale, offset=offset)
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
                if value is not None and value != _USUAL.get(key):
                    lines.append(f"{key} = {json.dumps(_plain(value))}")
        return "\n".join(lines) + "\n"

    @classmethod
    def parse(cls, text: str, *, file: str = "") -> Calibration:
        """Read the TOML text.

        Raises:
            ConfigError: It is not TOML, or a key is unknown, missing or wrong; the text names it.
        """
        root = parse_toml(text, file).table(("arm", "taken", "joints"), ())
        rows = root["joints"].each(_row, _MOST_JOINTS)
        _check_names(rows, root["joints"])
        return cls(root["arm"].text(), root["taken"].text(), tuple(rows))

    @classmethod
    def from_lerobot(cls, text: str, *, arm: str, taken: str = "", file: str = "") -> Calibration:
        """Import a LeRobot calibration file.

        The angles of the joints are then LeRobot's degrees: 0 is the middle of the range, 4095 counts are a turn,
        and `drive_mode` has no effect. `homing_offset` must be stored in the servo.

        Raises:
            ConfigError: It is not such a file.
        """
        root = parse_json(text, file)
        rows = []
        for name, item in root.table().items():
            row = item.table(_LEROBOT)
            low, high = (row[key].integer(-_MOST_COUNTS, _MOST_COUNTS) for key in ("range_min", "range_max"))
            turned = row["drive_mode"].integer(0, 1)
            offset = row["homing_offset"].integer(-_MOST_COUNTS, _MOST_COUNTS)
            servo_id = row["id"].integer(0, _MOST_JOINTS)
            Item(name, file, "a joint's name").text(100, least=1)
            rows.append(
                _checked(
                    item,
                    name,
                    servo_id,
                    (low + high) / 2,
                    low,
                    high,
                    servo_offset=offset,
                    turn=LEROBOT_TURN,
                    drive_mode=turned,
                )
            )
        if not rows:
            raise root.fault("is not a LeRobot calibration: it has no joint")
        return cls(arm, taken, tuple(rows))

    def to_lerobot(self) -> str:
        """As the text of a LeRobot calibration file.

        Raises:
            UsageError: LeRobot cannot express a joint; the text says why.
        """
        rows = {}
        for row in self.joints:
            why = _why_not_lerobot(row)
            if why:
                raise UsageError(f"{row.name} cannot be written as a LeRobot calibration: {why}")
            rows[row.name] = {
                "id": row.servo_id,
                "drive_mode": row.drive_mode,
                "homing_offset": row.servo_offset,
                "range_min": row.low,
                "range_max": row.high,
            }
        return json.dumps(rows, indent=4) + "\n"


def _why_not_lerobot(row: JointCalibration) -> str:
    if row.servo_offset is None:
        return "the offset stored in its servo is unknown; calibrate again"
    if abs(row.servo_offset) > _LARGEST_OFFSET:
        return f"its offset {row.servo_offset} is more than {_LARGEST_OFFSET}; calibrate again"
    if not 0 <= row.low < row.high < _TURN:
        return f"its range {row.low} to {row.high} passes the end of the turn; calibrate again"
    if abs(row.middle - (row.low + row.high) / 2) > 0.5:
        return f"its middle {row.middle:g} is not the middle of its range, as LeRobot assumes; calibrate again"
    return "it is reversed, and LeRobot's degrees cannot be" if row.sign != 1 else ""


def _plain(value: object) -> object:
    return int(value) if isinstance(value, float) and value.is_integer() else value


_MOST_JOINTS = 253
_MOST_COUNTS = 1_000_000
"""Counts beyond any servo, over all its turns."""
_LEROBOT = ("id", "drive_mode", "homing_offset", "range_min", "range_max")
_TEXTS = ("name", "model", "firmware")
_NEEDED = ("name", "servo_id", "middle", "low", "high")
_USUAL = {"turn": _TURN, "drive_mode": 0}
"""Values that are not written."""


def _row(item: Item) -> JointCalibration:
    row = item.table(_NEEDED, JointCalibration.__slots__)
    values: dict[str, Any] = {}
    for key, value in row.items():
        if key in _TEXTS:
            values[key] = value.text(100, least=key == "name")
        else:
            values[key] = value.number(*_COUNTS) if key == "middle" else value.integer(*_BOUNDS.get(key, _COUNTS))
    return _checked(item, **values)


_COUNTS = (-_MOST_COUNTS, _MOST_COUNTS)
_BOUNDS = {"servo_id": (0, _MOST_JOINTS), "turn": (1, _MOST_COUNTS), "drive_mode": (0, 1)}


def _checked(item: Item, *values: Any, **named: Any) -> JointCalibration:
    try:
        return JointCalibration(*values, **named)
    except UsageError as error:
        raise ConfigError(str(error), file=item.file) from None


def _check_names(rows: Sequence[JointCalibration], item: Item) -> None:
    names = [row.name for row in rows]
    if len(set(names)) != len(names):
        raise item.fault("name a joint twice")
