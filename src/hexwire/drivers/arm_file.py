"""Arms on a servo bus as TOML files: joints, ids, series, signs, neutral counts, limits, gearing.

Owns the format of the file and the profiles that come with hexwire.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path

from hexwire.errors import ConfigError, UsageError
from hexwire.inputs import Item, parse_toml, read_text
from hexwire.model.arm import MAX_ACCELERATION, MAX_JERK, ArmModel, JointModel
from hexwire.model.arms import record_of
from hexwire.model.calibration import Calibration
from hexwire.wire.registers import Series

__all__ = ["BusArmFile", "load_arm_file", "load_calibration", "load_profile", "profile_names"]

_NEEDED = ("name", "servo_id", "series", "minimum_deg", "maximum_deg")
_OPTIONAL = (
    "neutral", "sign", "offset_deg", "max_speed_deg_per_s", "max_acceleration_deg_per_s2",
    "max_jerk_deg_per_s3", "free_speed_deg_per_s", "gearing", "degrees_per_count",
)  # fmt: skip
_LONGEST_NAME = 100
_LONGEST_PATH = 4000
_MOST_JOINTS = 254
_MOST_COUNTS = 1_000_000
_MOST_DEGREES = 36_000.0
_MOST_CHANGE = 1e7
"""Degrees per second squared or cubed."""
_BAUD = 1_000_000
"""Factory setting of Feetech servos."""


@dataclass(frozen=True, slots=True)
class BusArmFile:
    """The contents of an arm's file.

    Attributes:
        model: The joints, without the calibration.
        baud: Rate of its bus.
        calibration: Neutral positions and limits of this individual arm, if the file names one.
    """

    model: ArmModel
    baud: int
    calibration: Calibration | None = None


def profile_names() -> tuple[str, ...]:
    """Names of the profiles that come with hexwire."""
    folder = resources.files("hexwire.drivers") / "profiles"
    return tuple(
        sorted(entry.name.removesuffix(".toml") for entry in folder.iterdir() if entry.name.endswith(".toml"))
    )


@cache
def load_profile(name: str) -> BusArmFile:
    """Load an arm profile that comes with hexwire.

    Raises:
        UsageError: There is no profile of this name; the text lists them.
    """
    if name not in profile_names():
        raise UsageError(f"no arm profile {name!r}; there are {', '.join(profile_names())}")
    file = resources.files("hexwire.drivers") / "profiles" / f"{name}.toml"
    return _parse(file.read_text(encoding="utf-8"), f"{name}.toml")


def load_arm_file(path: str | Path) -> BusArmFile:
    """Load an arm from a file.

    Raises:
        ConfigError: The file is invalid; the text names the first fault of each joint and its place.
    """
    return _parse(read_text(path), str(path))


def load_calibration(path: str | Path) -> Calibration:
    """Load a calibration from a file of hexwire, or of LeRobot if its name ends with ``.json``.

    Raises:
        ConfigError: The file is invalid.
    """
    text = read_text(path)
    if Path(path).suffix.lower() == ".json":
        return Calibration.from_lerobot(text, arm=Path(path).stem, file=str(path))
    return Calibration.parse(text, file=str(path))


def _parse(text: str, file: str) -> BusArmFile:
    root = parse_toml(text, file)
    arm = root.table(("name",), ("base", "baud", "calibration", "joints"))
    name = arm["name"].text(_LONGEST_NAME, least=1)
    taken: dict[object, str] = {}

    def own(item: Item) -> JointModel:
        joint = _joint(item)
        for key in ("name", "servo_id"):
            place = item.table()[key]
            if (first := taken.setdefault((key, place.value), item.where)) != item.where:
                raise place.fault(f"is {place.value!r}, as in {first}; every joint needs its own")
        return joint

    joints = arm["joints"].each(own, _MOST_JOINTS) if "joints" in arm else []
    if ("base" in arm) == bool(joints):
        raise root.fault(
            "base and [[joints]]: write only one of them"
            if joints
            else "no joints: write [[joints]] or base = 'PROFILE'"
        )
    baud, calibration, geometry = _BAUD, None, ""
    try:
        if "base" in arm:
            base_name = arm["base"].text(_LONGEST_NAME)
            base = load_profile(base_name)
            # An arm that has a record may have the servos of another one, and a geometry of its own.
            geometry = "" if record_of(name) is not None else base_name
            joints, baud = list(base.model.joints), base.baud
        if "baud" in arm:
            baud = arm["baud"].integer(1200, 12_000_000)
        model = ArmModel(name, tuple(joints), geometry)
        if "calibration" in arm:
            calibration = load_calibration(Path(file).parent / arm["calibration"].text(_LONGEST_PATH))
            calibration.apply(model)
        return BusArmFile(model, baud, calibration)
    except ConfigError:
        raise
    except UsageError as error:
        raise ConfigError(str(error), file=file) from None


def _joint(item: Item) -> JointModel:
    row = item.table(_NEEDED, _OPTIONAL)
    name, kind = row["name"].text(_LONGEST_NAME, least=1), row["series"].text(_LONGEST_NAME)

    def number(key: str, default: float, low: float = -_MOST_DEGREES, high: float = _MOST_DEGREES) -> float:
        return row[key].number(low, high) if key in row else default

    def change(key: str, default: float) -> float:
        return math.radians(row[key].number(1e-3, _MOST_CHANGE)) if key in row else default

    try:
        series = Series(kind)
    except ValueError:
        known = ", ".join(member.value for member in Series)
        raise row["series"].fault(
            f"of {name}: no servo series {kind!r}; there are {known} (sts and sms are sts_sms)"
        ) from None
    if "sign" in row and row["sign"].value not in (1, -1):
        raise row["sign"].fault("must be 1 or -1")
    low, high = number("minimum_deg", 0.0), number("maximum_deg", 0.0)
    if low >= high:
        raise row["minimum_deg"].fault(f"is {low:g}, but must be below maximum_deg {high:g}")
    per_count = number("degrees_per_count", series.range_deg / series.counts_per_rev, 1e-6, 360.0)
    return JointModel(
        name=name,
        servo_id=row["servo_id"].integer(0, 253),
        series=series.value,
        neutral=row["neutral"].integer(-_MOST_COUNTS, _MOST_COUNTS) if "neutral" in row else series.neutral,
        sign=row["sign"].integer(-1, 1) if "sign" in row else 1,
        offset=math.radians(number("offset_deg", 0.0)),
        scale=math.radians(per_count / number("gearing", 1.0, 1e-4, 1e4)),
        minimum=math.radians(low),
        maximum=math.radians(high),
        max_speed=math.radians(number("max_speed_deg_per_s", 90.0, 1e-3)),
        max_acceleration=change("max_acceleration_deg_per_s2", MAX_ACCELERATION),
        max_jerk=change("max_jerk_deg_per_s3", MAX_JERK),
        free_speed=math.radians(number("free_speed_deg_per_s", 0.0, 0.0)),
    )
