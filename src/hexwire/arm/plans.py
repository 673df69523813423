"""What a person names as the goal of a motion, as trajectories of one arm.

Owns how places, poses, angles and recordings are told apart, and the mistakes that people make with them. Must not
know how a motion is checked or run.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from hexwire.arguments import Wanted, check
from hexwire.control.via import Place, joint_points, tip_poses
from hexwire.errors import UsageError
from hexwire.motion.checks import InJoints
from hexwire.motion.limits import slow_enough
from hexwire.motion.line import Line, Lines
from hexwire.motion.teach import Taught, approach
from hexwire.motion.through import arm_path
from hexwire.motion.waypoints import Scaled, Trajectory

if TYPE_CHECKING:
    from hexwire.drivers.base import RobotDriver
    from hexwire.model.aim import Aim
    from hexwire.model.arm import ArmModel
    from hexwire.model.kinematics import KinematicModel
    from hexwire.model.pose import Pose, Vector

__all__ = ["SHARE", "Plans", "Point", "approached", "is_number", "straight"]

Point = str | Mapping[str, float] | Sequence[float]
"""A pose by name, radians by joint, or x, y, z in metres."""

_FARTHEST = 10.0
"""No arm reaches so far, metres: somebody has given millimetres."""
_MOST_TURNS = 4 * math.pi
"""No joint turns so far, radians: somebody has given degrees."""


def is_number(value: object) -> bool:
    """Whether a value is a finite number."""
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


SHARE = Wanted(
    "a share of the speed limits, above 0 and at most 1", lambda value: is_number(value) and 0 < value <= 1
)


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

    def pose(self, name: str) -> Mapping[str, float]:
        """Radians by joint of a pose; raises `UsageError` if there is none of this name."""
        if name not in self._poses:
            known = ", ".join(self._poses)
            raise UsageError(f"no pose {name!r} of {self._model.name}; known are: {known}")
        return self._poses[name]

    def angles(self, target: Mapping[str, float]) -> dict[str, float]:
        """Radians by joint, by the model's names; raises `UsageError` for an unknown joint, or degrees."""
        found = {}
        for given, angle in target.items():
            name = self._model.joint(given).name
            if not is_number(angle):
                raise UsageError(f"the angle of {name} is a number of radians, not {angle!r}")
            if abs(angle) > _MOST_TURNS:
                raise UsageError(f"{name} cannot turn {angle:g} radians; for degrees write deg({angle:g})")
            found[name] = float(angle)
        return found

    def points(
        self,
        verb: str,
        points: Sequence[Point],
        axes: tuple[float | None, float | None, float | None],
        aim: Aim,
        relative: bool,
    ) -> Callable[[dict[str, float]], list[Place | Mapping[str, float]]]:
        """What a person calls points, as a function of where the arm is.

        Args:
            verb: Of the arm, for error texts.
            points: As they were given.
            axes: Instead of points: x, y and z; None for one that stays as it is.
            aim: Where the tool is to point at places.
            relative: Places count from the tip, or from the point before.

        Raises:
            UsageError: A point is none.
        """
        by_axis = any(value is not None for value in axes)
        if by_axis == bool(points):
            raise UsageError(f"{verb}() takes points, as in {verb}((0, mm(200), mm(150))), or some of x, y and z")
        found: list[Place | Mapping[str, float]] = []
        for point in points:
            if isinstance(point, str):
                found.append(self.pose(point))
            elif isinstance(point, Mapping):
                found.append(self.angles(point))
            else:
                found.append(Place(_place(verb, point), aim, relative=relative))

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
        names, rows = joint_points(self._model, self._driver.kinematics, here, points)
        path = arm_path(self._model, names, rows, speed=share if duration is None else 1.0)
        if duration is None:
            return path
        if not path.duration <= duration < math.inf:
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
        goals = tip_poses(self.kinematics, here, points)
        return straight(self._model, self.kinematics, here, goals, speed=tip_speed, rounding=rounding)

    def played(
        self,
        motion: str | Path | Taught | Trajectory,
        factor: float,
        begin: float,
        end: float,
        smooth: float,
        trim: bool,
    ) -> Trajectory:
        """A recording, or another motion, as it is to be played; see `Arm.play` for the arguments."""
        if isinstance(motion, Trajectory):
            return Scaled(motion, factor)
        if not isinstance(motion, Taught):
            from .recorded import read_taught

            motion = read_taught(str(motion))
        if begin or end < math.inf:
            motion = motion.trimmed(begin, end)
        if trim:
            motion = motion.without_stillness()
        return motion.smoothed(smooth).faster(factor).within(self._model).trajectory()


def straight(
    model: ArmModel,
    kinematics: KinematicModel,
    here: Mapping[str, float],
    goals: Sequence[Pose],
    *,
    speed: float,
    rounding: float,
) -> Trajectory:
    """Straight lines of the tip, as fast as the joints' limits allow and no faster than asked for.

    Args:
        model: The arm.
        kinematics: Its geometry.
        here: Present radians by joint.
        goals: Poses of the tip at the end of each line.
        speed: Of the tip, metres per second.
        rounding: How far from a corner the tip may leave the lines, metres; 0 stops there.

    Raises:
        HexwireError: A line is not possible.
    """
    angles, gain = kinematics.from_joints(here), max(0.1, 4 * speed)
    path = (
        Line(kinematics, angles, goals[0], speed=speed, acceleration=gain)
        if len(goals) == 1
        else Lines(kinematics, angles, goals, rounding=rounding, speed=speed, acceleration=gain)
    )
    return slow_enough(model, InJoints(path, kinematics))


def approached(model: ArmModel, path: Trajectory, here: Mapping[str, float], repeat: int) -> list[Trajectory]:
    """A motion so many times, each time after the slow way to where it begins."""
    legs: list[Trajectory] = []
    at: Sequence[float] = [here[name] for name in path.names]
    for _ in range(repeat):
        first = approach(model, path.names, at, path.start)
        legs += [first, path] if first.duration else [path]
        at = path.goal
    return legs


def _place(verb: str, point: Sequence[float]) -> Vector:
    values = tuple(point)
    if len(values) != 3 or not all(map(is_number, values)):
        raise UsageError(f"a place of {verb}() is x, y, z in metres, not {point!r}")
    if abs(farthest := max(values, key=abs)) > _FARTHEST:
        raise UsageError(f"no arm reaches {farthest:g} m; for millimetres write mm({farthest:g})")
    return (float(values[0]), float(values[1]), float(values[2]))
