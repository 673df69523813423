"""Arms on a servo bus as TOML files: joints, ids, series, signs, neutral counts, limits, gearing.

Owns the form of the file and the profiles that come with hexwire. Must not know what is done with an arm.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hexwire.errors import ConfigError, UsageError
from hexwire.inputs import parse_toml, read_text
from hexwire.model.arm import ArmModel, JointModel
from hexwire.model.calibration import Calibration
from hexwire.wire.registers import Series

if TYPE_CHECKING:
    from pydantic import BaseModel

__all__ = ["BusArmFile", "load_arm_file", "load_calibration", "load_profile", "profile_names"]

_MOST_FAULTS = 10
_MOST_COUNTS = 1_000_000
_MOST_DEGREES = 36_000.0
_BAUD = 1_000_000
"""As Feetech servos leave the factory."""


@dataclass(frozen=True, slots=True)
class BusArmFile:
    """What an arm's file says.

    Attributes:
        model: The joints, without the calibration.
        baud: Rate of its bus.
        calibration: Middles and limits of this very arm, if the file names one.
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


def load_profile(name: str) -> BusArmFile:
    """An arm that comes with hexwire.

    Raises:
        UsageError: There is none of this name; the text lists them.
    """
    if name not in profile_names():
        raise UsageError(f"no arm profile {name!r}; there are {', '.join(profile_names())}")
    file = resources.files("hexwire.drivers") / "profiles" / f"{name}.toml"
    return _parse(file.read_text(encoding="utf-8"), f"{name}.toml")


def load_arm_file(path: str | Path) -> BusArmFile:
    """An arm from a file.

    Raises:
        ConfigError: The file is wrong; every fault is named, with its place.
    """
    return _parse(read_text(path), str(path))


def load_calibration(path: str | Path) -> Calibration:
    """A calibration from a file.

    Raises:
        ConfigError: The file is wrong.
    """
    return Calibration.parse(read_text(path), file=str(path))


@cache
def _schema() -> type[BaseModel]:
    """The form of the file; pydantic is imported only where a file is read."""
    from pydantic import BaseModel, ConfigDict, Field

    class Joint(BaseModel):
        model_config = ConfigDict(extra="forbid", strict=True)

        name: str = Field(min_length=1, max_length=100)
        servo_id: int = Field(ge=0, le=253)
        series: str = Field(max_length=100)
        neutral: int | None = Field(default=None, ge=-_MOST_COUNTS, le=_MOST_COUNTS)
        sign: int = 1
        offset_deg: float = Field(default=0.0, ge=-_MOST_DEGREES, le=_MOST_DEGREES)
        minimum_deg: float = Field(ge=-_MOST_DEGREES, le=_MOST_DEGREES)
        maximum_deg: float = Field(ge=-_MOST_DEGREES, le=_MOST_DEGREES)
        max_speed_deg_per_s: float = Field(default=90.0, ge=1e-3, le=_MOST_DEGREES)
        gearing: float = Field(default=1.0, ge=1e-4, le=1e4)
        degrees_per_count: float | None = Field(default=None, ge=1e-6, le=360.0)

    class Arm(BaseModel):
        model_config = ConfigDict(extra="forbid", strict=True)

        name: str = Field(min_length=1, max_length=100)
        base: str | None = Field(default=None, max_length=100)
        baud: int | None = Field(default=None, ge=1200, le=12_000_000)
        calibration: str | None = Field(default=None, max_length=4000)
        joints: list[Joint] = Field(default=[], max_length=254)

    return Arm


def _parse(text: str, file: str) -> BusArmFile:
    from pydantic import ValidationError

    content = parse_toml(text, file).value
    try:
        arm: Any = _schema().model_validate(content)
    except ValidationError as error:
        faults = [f"{_place(fault['loc'])}: {fault['msg'].lower()}" for fault in error.errors()[:_MOST_FAULTS]]
        if error.error_count() > _MOST_FAULTS:
            faults.append(f"and {error.error_count() - _MOST_FAULTS} more")
        raise ConfigError("; ".join(faults), file=file) from None
    for name in (arm.name, *(joint.name for joint in arm.joints)):
        if not name.isprintable():
            raise ConfigError(f"name {name[:40]!r} has characters that cannot be printed", file=file)
    try:
        if arm.base is None and not arm.joints:
            raise UsageError("no joints: write [[joints]], or base = a profile")
        if arm.base is not None and arm.joints:
            raise UsageError("base and [[joints]]: one of them says what the arm is")
        base = None if arm.base is None else load_profile(arm.base)
        joints = base.model.joints if base else tuple(_joint(joint) for joint in arm.joints)
        baud = arm.baud or (base.baud if base else _BAUD)
        calibration = load_calibration(Path(file).parent / arm.calibration) if arm.calibration else None
        model = ArmModel(arm.name, joints)
        if calibration is not None:
            calibration.apply(model)
        return BusArmFile(model, baud, calibration)
    except ConfigError:
        raise
    except UsageError as error:
        raise ConfigError(str(error), file=file) from None


def _place(path: tuple[int | str, ...]) -> str:
    # A key may hold anything, and an error is one line.
    return ".".join(str(step) if str(step).isprintable() else repr(step) for step in path)[:100]


def _joint(row: Any) -> JointModel:
    try:
        series = Series(row.series)
    except ValueError:
        known = ", ".join(kind.value for kind in Series)
        raise UsageError(
            f"{row.name}: no servo series {row.series!r}; there are {known} (sts and sms are sts_sms)"
        ) from None
    if row.sign not in (1, -1):
        raise UsageError(f"{row.name}: sign {row.sign} is neither 1 nor -1")
    if row.minimum_deg >= row.maximum_deg:
        raise UsageError(f"{row.name}: minimum_deg {row.minimum_deg} is not below maximum_deg {row.maximum_deg}")
    per_count = row.degrees_per_count or series.range_deg / series.counts_per_rev
    return JointModel(
        name=row.name,
        servo_id=row.servo_id,
        series=series.value,
        neutral=series.neutral if row.neutral is None else row.neutral,
        sign=row.sign,
        offset=math.radians(row.offset_deg),
        scale=math.radians(per_count / row.gearing),
        minimum=math.radians(row.minimum_deg),
        maximum=math.radians(row.maximum_deg),
        max_speed=math.radians(row.max_speed_deg_per_s),
    )
