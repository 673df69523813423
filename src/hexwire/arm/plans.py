"""What a person names as the goal of a motion, as trajectories of one arm.

Owns how places, poses, angles and recordings are told apart, and the mistakes that people make with them. Must not
know how a motion is checked or run.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hexwire.arguments import NAME, POSE, Wanted, check, shown
from hexwire.control.motion.via import Place, straight, through
from hexwire.control.requests.pose_file import find_pose, without_gripper
from hexwire.errors import LimitError, UsageError
from hexwire.model.aim import Aim
from hexwire.motion.teach import Edits, Taught
from hexwire.motion.trajectory import Scaled, Trajectory

if TYPE_CHECKING:
    from hexwire.drivers.base import RobotDriver
    from hexwire.model.arm import ArmModel
    from hexwire.model.kinematics import KinematicModel
    from hexwire.model.pose import Vector

__all__ = [
    "ANGLES",
    "FARTHEST",
    "SECONDS",
    "SHARE",
    "Plans",
    "Point",
    "is_number",
    "joint_angles",
    "length",
]

Point = str | Mapping[str, float] | Sequence[float] | Place
"""A pose by name, radians by joint, x, y, z in metres, or a place with an aim of its own."""

FARTHEST = 3.0
"""No arm reaches farther, or is so fast, metres or metres per second: somebody has given millimetres."""
_TURN = 2 * math.pi
"""Nothing is turned farther, radians: somebody has given degrees."""


def is_number(value: object) -> bool:
    """Whether a value is a finite number, NumPy's too."""
    try:
        return not isinstance(value, bool) and isinstance(value, Real) and math.isfinite(value)
    except OverflowError:
        return False


SHARE = Wanted(
    "a share of the speed limits, above 0 and at most 1", lambda value: is_number(value) and 0 < value <= 1
)
ANGLES = Wanted("angles by joint, as in {'J1': 0.1}", lambda value: isinstance(value, Mapping))
SECONDS = Wanted("a number of seconds above 0", lambda value: is_number(value) and value > 0)


def length(what: str, value: float, unit: str = "m") -> float:
    """A length in metres, or a speed of the tip; raises `UsageError` for no number, or millimetres."""
    if not is_number(value):
        raise UsageError(f"{what} is a number in {unit}, not {shown(value)}")
    if abs(value) > FARTHEST:
        raise UsageError(f"{what} cannot be {value:g} {unit}; for millimetres write mm({value:g})")
    return float(value)


def _angle(what: str, value: float, most: float = _TURN) -> float:
    if not is_number(value):
        raise UsageError(f"the angle of {what} is a number of radians, not {shown(value)}")
    if abs(value) > most:
        raise UsageError(f"{what} cannot turn {value:g} radians; for degrees write deg({value:g})")
    return float(value)


def joint_angles(
    model: ArmModel, target: Mapping[str, float] | Iterable[tuple[str, float]], *, within: bool = False
) -> dict[str, float]:
    """Radians by joint, by the model's names.

    Args:
        model: The arm.
        target: Radians by joint, ignoring case.
        within: Refuse an angle outside the limits of its joint, too.

    Raises:
        UsageError: A joint is wrong or repeated, or has degrees; the text lists all faults.
        LimitError: All faults are of limits.
    """
    found: dict[str, float] = {}
    wrong: list[UsageError] = []
    for given, angle in target.items() if isinstance(target, Mapping) else target:
        try:
            joint = model.joint(check("joint", "name", NAME, given))
            if joint.name in found:
                raise UsageError(f"{joint.name} is named twice")
            if within:
                joint.check(angle)
            found[joint.name] = _angle(joint.name, angle, max(_TURN, joint.maximum - joint.minimum))
        except UsageError as error:
            wrong.append(error)
    texts = [str(error).removesuffix("; nothing was sent") for error in wrong]
    if wrong and all(isinstance(error, LimitError) for error in wrong):
        raise LimitError("; ".join([*texts, "nothing was sent"]))
    if wrong:
        raise UsageError("; ".join([*texts, "nothing was sent"] if within else texts))
    return found


class Plans:
    """Makes trajectories of an arm's joints from what a person names.

    Args:
        driver: The arm: its joints and its geometry.
        poses: Its poses by name.
    """

    def __init__(self, driver: RobotDriver, poses: Mapping[str, Mapping[str, float]]) -> None:
        self._driver, self._model, self._poses = driver, driver.model, poses

    @property
    def kinematics(self) -> KinematicModel:
        """The arm's geometry.

        Raises:
            UsageError: It is not known.
        """
        kinematics = self._driver.kinematics
        if kinematics is None:
            raise UsageError(f"no geometry is known for {self._model.name}, so its tip has no place")
        return kinematics

    @property
    def moved(self) -> tuple[str, ...]:
        """The joints that a motion of the tip may move; all of an arm whose geometry is not known."""
        kinematics = self._driver.kinematics
        return self._model.names if kinematics is None else kinematics.joint_names

    def pose(self, name: str, *, gripper: bool = True) -> Mapping[str, float]:
        """Radians by joint of a pose, maybe without its gripper; raises `UsageError` if there is none."""
        check("pose", "name", POSE, name)
        angles = find_pose(self._model, self._poses, name)
        return angles if gripper else without_gripper(self._model, angles)

    def angles(self, goals: Mapping[str, float]) -> Mapping[str, float]:
        """Radians by joint, by the model's names; raises as `joint_angles`."""
        return joint_angles(self._model, goals)

    def aim(
        self,
        down: bool,
        rpy: object,
        pitch: float | None,
        roll: float | None,
        *,
        fixed: bool = False,
    ) -> Aim:
        """Where the tool is to point; see `Aim`. Raises `UsageError` if this arm's tool cannot, or for degrees."""
        turns = None
        if rpy is not None:
            angles = _row(rpy)
            if len(angles) != 3:
                raise UsageError(f"rpy is roll, pitch and yaw in radians, not {shown(rpy)}")
            turns = (_angle("roll", angles[0]), _angle("pitch", angles[1]), _angle("yaw", angles[2]))
        aim = Aim(
            down,
            turns,
            None if pitch is None else _angle("pitch", pitch),
            None if roll is None else _angle("roll", roll),
            fixed,
        )
        if aim.given or roll is not None:
            aim.check(self.kinematics)
        return aim

    def points(
        self,
        verb: str,
        points: Sequence[Point],
        axes: tuple[float | None, float | None, float | None],
        aim: Aim,
        relative: bool,
        *,
        gripper: bool = True,
    ) -> Callable[[dict[str, float]], list[Place | Mapping[str, float]]]:
        """What a person calls points, as a function of where the arm is.

        Args:
            verb: Of the arm, for error texts.
            points: As they were given.
            axes: Instead of points: x, y and z; None for one that stays as it is.
            aim: Where the tool is to point at places.
            relative: Places count from the tip, or from the point before.
            gripper: Of a pose by its name, it goes where the pose has it.

        Raises:
            UsageError: A point is none.
        """
        by_axis = any(value is not None for value in axes)
        if by_axis == bool(points):
            raise UsageError(f"{verb}() takes points, as in {verb}((0, mm(200), mm(150))), or some of x, y and z")
        found: list[Place | Mapping[str, float]] = []
        for point in points:
            if isinstance(point, str):
                found.append(self.pose(point, gripper=gripper))
            elif isinstance(point, Place):
                found.append(point)
            elif isinstance(point, Mapping):
                found.append(joint_angles(self._model, point))
            else:
                found.append(Place(_place(verb, point), aim, relative=relative))
        if (aim.given or relative) and not by_axis and not any(isinstance(point, Place) for point in found):
            raise UsageError(f"{verb}() aims the tool, and counts relative, at places, not at poses")

        def at(here: dict[str, float]) -> list[Place | Mapping[str, float]]:
            if not by_axis:
                return found
            tip = self.kinematics.forward(self.kinematics.from_joints(here)).position
            stays = (0.0, 0.0, 0.0) if relative else tip
            place = [old if new is None else new for old, new in zip(stays, axes, strict=True)]
            return [Place(_place(verb, place), aim, relative=relative)]

        return at

    def through(
        self,
        points: Sequence[Place | Mapping[str, float]],
        here: dict[str, float],
        speed: float,
        duration: float | None,
    ) -> Trajectory:
        """The fastest path of the joints through points.

        Args:
            points: Places and poses.
            here: Present radians by joint.
            speed: Share of the speed limits.
            duration: Seconds, instead of that speed; None for none.

        Raises:
            UsageError: The speed is none, or the duration too short.
            LimitError: A place is out of reach.
        """
        share = check("move", "speed", SHARE, speed)
        # Before the path: a person hears of the angle that was asked for.
        for point in points:
            if isinstance(point, Mapping):
                joint_angles(self._model, point, within=True)
        fastest = share if duration is None else 1.0
        path = through(self._model, self._driver.kinematics, here, points, speed=fastest)
        if duration is None:
            return path
        if not path.duration <= duration:
            raise UsageError(f"{duration:g} s is too short: the joints' limits need {path.duration:.2f} s for this")
        return Scaled(path, path.duration / duration) if path.duration else path

    def line(
        self,
        points: Sequence[Place | Mapping[str, float]],
        here: dict[str, float],
        tip_speed: float,
        rounding: float,
    ) -> Trajectory:
        """Straight lines of the tip through points.

        Args:
            points: Places and poses.
            here: Present radians by joint.
            tip_speed: Metres per second.
            rounding: How far from a corner the tip may leave the lines, metres; 0 stops there.

        Raises:
            HexwireError: As `through`.
        """
        speed, round_by = length("tip_speed", tip_speed, "m/s"), length("rounding", rounding)
        if speed <= 0:
            raise UsageError(f"tip_speed must be above 0 m/s, not {speed:g}")
        if round_by < 0:
            raise UsageError(f"rounding must be 0 m or more, not {round_by:g}")
        return straight(self._model, self.kinematics, here, points, speed=speed, rounding=round_by)

    def played(self, motion: str | Path | Taught | Trajectory, edits: Edits) -> Callable[[float], Trajectory]:
        """A recording, or another motion, as it is to be played, by the factor of its speed."""
        if isinstance(motion, Trajectory):
            whole = motion
            return lambda factor: whole if factor == 1.0 else Scaled(whole, factor)
        if not isinstance(motion, Taught):
            from .recorded import read_taught

            if not isinstance(motion, str | Path):
                raise UsageError(f"play() takes a file, a lesson, a recording or a trajectory, not {shown(motion)}")
            motion = read_taught(str(motion))
        return motion.played(self._model, edits)


def _row(values: Any) -> tuple[Any, ...]:
    """Numbers in their order, such as NumPy's; nothing for what has none, as a set."""
    if isinstance(values, Sequence) and not isinstance(values, str | bytes):
        return tuple(values)
    return tuple(values.tolist()) if getattr(values, "ndim", None) == 1 else ()


def _place(verb: str, point: object) -> Vector:
    values = _row(point)
    if len(values) != 3 or not all(map(is_number, values)):
        example = f"{verb}((0, mm(200), mm(150)))"
        raise UsageError(f"a place of {verb}() is x, y, z in metres, as in {example}, not {shown(point)}")
    # The hint shows the number that is farthest off.
    length("a place", max(values, key=abs))
    return (float(values[0]), float(values[1]), float(values[2]))
