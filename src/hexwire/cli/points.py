"""Points that a user types for `goto` and `line`: places, names of saved poses, and where the tool is to point.

Owns the arguments and options for them, and their units. Must not know how a motion through them is planned.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar

import click

from hexwire.errors import UsageError
from hexwire.units import decimal

from .numbers import FiniteFloat, is_number, number_option

if TYPE_CHECKING:
    from hexwire.control.via import Place
    from hexwire.model.arm import ArmModel
    from hexwire.model.kinematics import KinematicModel
    from hexwire.model.pose import Vector

__all__ = ["Point", "ToolAim", "known_poses", "points_argument", "points_words", "pose_options", "to_points"]

Point = tuple[float, float, float] | str
"""A place as typed, or the name of a pose."""

_F = TypeVar("_F", bound=Callable[..., Any])
_METAVAR = "{X Y Z | POSE}..."


@dataclass(frozen=True, slots=True)
class ToolAim:
    """Where the tool is to point, as typed: degrees; None for what was not.

    Attributes:
        down: Straight down.
        rpy: Roll, pitch and yaw.
        pitch: Of the tool of an arm of five joints.
        roll: Of its last joint.
        relative: Places count from the point before them.
    """

    down: bool
    rpy: Vector | None
    pitch: float | None
    roll: float | None
    relative: bool

    @property
    def given(self) -> bool:
        """The tool is to point somewhere."""
        return self.down or self.rpy is not None or self.pitch is not None

    def check(self, model: KinematicModel) -> None:
        """Refuse options that contradict each other, or that the arm does not support.

        Raises:
            UsageError: They do.
        """
        given = {"--down": self.down, "--rpy": self.rpy is not None, "--pitch": self.pitch is not None}
        typed = [name for name, there in given.items() if there]
        if len(typed) > 1:
            raise UsageError(f"{typed[0]} and {typed[1]} contradict each other")
        if self.roll is not None and self.pitch is None:
            raise UsageError("--roll needs --pitch")
        if self.rpy is not None and len(model.ranges) < 6:
            raise UsageError(
                f"{model.name} has five joints, and the heading of its tool follows from the position: "
                "give --pitch and --roll instead of --rpy"
            )
        if self.pitch is not None and len(model.ranges) == 6:
            raise UsageError(f"{model.name} has six joints: give --rpy instead of --pitch")


def points_argument(command: _F) -> _F:
    """The argument ``points``: places of three numbers, and names of poses; the command gets a list of `Point`."""

    def parse(ctx: click.Context, param: click.Parameter, words: tuple[str, ...]) -> list[Point]:
        points: list[Point] = []
        numbers: list[float] = []
        kind = FiniteFloat("coordinate")
        for word in words:
            if not numbers and not is_number(word):
                points.append(word)
                continue
            numbers.append(kind.convert(word, param, ctx))
            if len(numbers) == 3:
                points.append((numbers[0], numbers[1], numbers[2]))
                numbers = []
        if numbers:
            typed = len(numbers) + 3 * sum(not isinstance(point, str) for point in points)
            raise click.UsageError(f"X Y Z takes 3 values, not {typed}", ctx)
        return points

    return click.argument("points", nargs=-1, required=True, metavar=_METAVAR, callback=parse)(command)


def pose_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """``--down``, ``--pitch``, ``--roll``, ``--rpy`` and ``--relative``; the command gets ``aim: ToolAim``."""

    def given(
        *args: Any,
        down: bool,
        rpy: Vector | None,
        pitch: float | None,
        roll: float | None,
        relative: bool,
        **rest: Any,
    ) -> Any:
        return command(*args, aim=ToolAim(down, rpy, pitch, roll, relative), **rest)

    packed: Callable[..., Any] = functools.wraps(command)(given)
    for option in (
        click.option(
            "--relative", is_flag=True, help="X Y Z is relative to the tip's position, or the point before."
        ),
        click.option(
            "--rpy",
            nargs=3,
            type=FiniteFloat("degrees"),
            metavar="R P Y",
            help="Roll, pitch and yaw of the tool in degrees.",
        ),
        number_option("--roll", "DEG", "With --pitch: angle of wrist_roll. If not given, it stays."),
        number_option("--pitch", "DEG", "SO-100, SO-101: pitch of the tool; 0 is level, 90 straight down."),
        click.option("--down", is_flag=True, help="The tool points straight down."),
    ):
        packed = option(packed)
    return packed


def known_poses(arm: ArmModel, names: Sequence[str], instead: str = "a number") -> dict[str, Mapping[str, float]]:
    """The poses of these names: radians by joint.

    Args:
        arm: Whose poses.
        names: Words that were typed.
        instead: What else such a word may be, for the error.

    Raises:
        UsageError: There is no such pose.
        ConfigError: The file of poses is damaged.
    """
    if not names:
        return {}
    from hexwire.control.pose_file import PoseFile

    known = PoseFile(arm).known()
    for name in names:
        if name not in known:
            raise UsageError(
                f"{name!r} is neither {instead} nor a pose of {arm.name}; known are: {', '.join(known)}"
            )
    return {name: known[name] for name in names}


def to_points(
    points: Sequence[Point],
    poses: Mapping[str, Mapping[str, float]],
    model: KinematicModel | None,
    aim: ToolAim,
    *,
    fixed: bool = False,
) -> list[Place | Mapping[str, float]]:
    """The points in metres and radians.

    Args:
        points: As typed.
        poses: The poses among them.
        model: Kinematics; None only without a place.
        aim: Where the tool is to point at places.
        fixed: Without that it keeps its direction in space, not relative to the arm.

    Raises:
        UsageError: The arm does not support the aim.
    """
    from hexwire.control.via import Place
    from hexwire.model.aim import Aim

    if model is not None:
        aim.check(model)
    elif aim.given:
        raise UsageError("the tool of an arm without a geometry cannot be aimed")
    rpy = (
        None if aim.rpy is None else (math.radians(aim.rpy[0]), math.radians(aim.rpy[1]), math.radians(aim.rpy[2]))
    )
    pitch, roll = (None if turn is None else math.radians(turn) for turn in (aim.pitch, aim.roll))
    how = Aim(aim.down, rpy, pitch, roll, fixed=fixed)
    unit = _unit("" if model is None else model.name)
    return [
        poses[point] if isinstance(point, str)
        else Place((point[0] * unit, point[1] * unit, point[2] * unit), how, relative=aim.relative)
        for point in points
    ]  # fmt: skip


def points_words(
    points: Sequence[Point], model: KinematicModel | None, aim: ToolAim, tips: Callable[[], Sequence[Vector]]
) -> str:
    """The points for people: places from the base, also where they were typed as relative.

    Args:
        points: As typed.
        model: Kinematics, for the unit; None without places.
        aim: As typed.
        tips: Returns where the tip is at each point, metres.
    """
    unit = _unit("" if model is None else model.name)
    if aim.relative:
        there = [(x / unit, y / unit, z / unit) for x, y, z in tips()]
        points = [point if isinstance(point, str) else place for point, place in zip(points, there, strict=True)]
    name = "mm" if unit == 1e-3 else "m"
    return ", ".join(
        point if isinstance(point, str) else " ".join(map(decimal, point)) + f" {name}" for point in points
    )


def _unit(robot: str) -> float:
    """Metres in the unit of coordinates."""
    return 1.0 if robot == "puma260" else 1e-3
