"""Paths that people ask for: through places of the tip and poses of joints, on straight lines, along a motion.

Owns how points become joint angles, and paths through them: each place is reached from the point before it, so that
the tool and the elbow stay as they are. Nothing moves here.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from hexwire.errors import LimitError, UsageError
from hexwire.model.aim import Aim, aimed_pose
from hexwire.model.state import finite
from hexwire.motion.checks import InJoints
from hexwire.motion.limits import slow_enough
from hexwire.motion.line import Line, Lines
from hexwire.motion.teach import approach
from hexwire.motion.through import arm_path

from ..loop.reader import position_unknown

if TYPE_CHECKING:
    from hexwire.model.arm import ArmModel
    from hexwire.model.kinematics import KinematicModel, Solution
    from hexwire.model.pose import Pose, Vector
    from hexwire.motion.trajectory import Trajectory

__all__ = ["Place", "approached", "chosen_solution", "joint_points", "straight", "through", "tip_poses"]


@dataclass(frozen=True, slots=True)
class Place:
    """Where the tip is to go.

    Attributes:
        position: x, y, z, metres.
        aim: Where the tool is to point.
        relative: The position counts from the tip's present one.
        straight: The tip moves on a straight line.
        branch: Name of the solution of the inverse kinematics to use; empty for the nearest allowed one.
    """

    position: Vector
    aim: Aim = field(default_factory=Aim)
    relative: bool = False
    straight: bool = False
    branch: str = ""


def joint_points(
    arm: ArmModel,
    kinematics: KinematicModel | None,
    here: Mapping[str, float],
    points: Sequence[Place | Mapping[str, float]],
) -> tuple[tuple[str, ...], list[tuple[float, ...]]]:
    """Joint angles of points, the present position first.

    Args:
        arm: The arm.
        kinematics: Its geometry; only poses of joints can be points without it.
        here: Present positions of all joints, radians.
        points: Places, and poses as radians by joint; a joint that a pose omits stays where it is.

    Returns:
        The joints that move, and a row of their angles for each point.

    Raises:
        LimitError: A place cannot be reached within the joints' limits; of several points the text has the number.
        UsageError: A joint is unknown, its position too, or the tool cannot be aimed so.
    """
    moved: set[str] = set()
    now, postures = dict(here), [dict(here)]
    for number, point in enumerate(points, 1):
        if isinstance(point, Place):
            if kinematics is None:
                raise UsageError(f"no geometry is known for {arm.name}, so its tip cannot be sent to a place")
            _refuse_unknown(kinematics.joint_names, now)
            angles = kinematics.from_joints(now)
            x, y, z = (finite(value, name) for value, name in zip(point.position, "xyz", strict=True))
            pose = aimed_pose(kinematics, angles, (x, y, z), point.aim, relative=point.relative)
            try:
                goal = kinematics.to_joints(chosen_solution(kinematics, pose, point.branch, angles).angles)
            except LimitError as error:
                if len(points) == 1:
                    raise
                raise LimitError(f"point {number}: {error}") from None
        else:
            joints = {arm.joint(name): finite(angle, f"the goal of {name}") for name, angle in point.items()}
            goal = {joint.name: joint.inside(angle) for joint, angle in joints.items()}
        now |= goal
        moved |= goal.keys()
        postures.append(dict(now))
    names = tuple(name for name in arm.names if name in moved)
    _refuse_unknown(names, here)
    return names, [tuple(posture[name] for name in names) for posture in postures]


def tip_poses(
    kinematics: KinematicModel, here: Mapping[str, float], points: Sequence[Place | Mapping[str, float]]
) -> list[Pose]:
    """Poses of the tip at points.

    Args:
        kinematics: The arm's geometry.
        here: Present positions of all joints, radians.
        points: As in `joint_points`.

    Raises:
        LimitError: A place before the last cannot be reached.
        UsageError: As `joint_points`.
    """
    now = dict(here)
    poses: list[Pose] = []
    for point in points:
        _refuse_unknown(kinematics.joint_names, now)
        angles = kinematics.from_joints(now)
        if poses and isinstance(points[len(poses) - 1], Place):
            # The aim may depend on how the arm stands there.
            angles = chosen_solution(kinematics, poses[-1], "", angles).angles
            now |= kinematics.to_joints(angles)
        if isinstance(point, Place):
            x, y, z = (finite(value, name) for value, name in zip(point.position, "xyz", strict=True))
            poses.append(aimed_pose(kinematics, angles, (x, y, z), point.aim, relative=point.relative))
        else:
            now |= point
            poses.append(kinematics.forward(kinematics.from_joints(now)))
    return poses


def through(
    arm: ArmModel,
    kinematics: KinematicModel | None,
    here: Mapping[str, float],
    points: Sequence[Place | Mapping[str, float]],
    *,
    speed: float = 1.0,
) -> Trajectory:
    """The fastest path of the joints through points, without a stop before the last.

    Args:
        arm: As for `joint_points`.
        kinematics: As for `joint_points`.
        here: As for `joint_points`.
        points: As for `joint_points`.
        speed: Share of the speed limits.

    Raises:
        HexwireError: As `joint_points`.
    """
    names, rows = joint_points(arm, kinematics, here, points)
    return arm_path(arm, names, rows, speed=speed)


def straight(
    arm: ArmModel,
    kinematics: KinematicModel,
    here: Mapping[str, float],
    points: Sequence[Place | Mapping[str, float]],
    *,
    speed: float,
    rounding: float,
) -> Trajectory:
    """Straight lines of the tip, as fast as the joints' limits allow and no faster than asked for.

    Args:
        arm: The arm.
        kinematics: Its geometry.
        here: Present radians by joint.
        points: Places and poses, at the end of each line.
        speed: Of the tip, metres per second.
        rounding: How far from a corner the tip may leave the lines, metres; 0 stops there.

    Raises:
        HexwireError: A line is not possible.
    """
    goals = tip_poses(kinematics, here, points)
    angles, gain = kinematics.from_joints(here), max(0.1, 4 * speed)
    path = (
        Line(kinematics, angles, goals[0], speed=speed, acceleration=gain)
        if len(goals) == 1
        else Lines(kinematics, angles, goals, rounding=rounding, speed=speed, acceleration=gain)
    )
    return slow_enough(arm, InJoints(path, kinematics))


def approached(
    arm: ArmModel, path: Trajectory, here: Mapping[str, float], repeat: int = 1, *, speed: float = 0.5
) -> list[Trajectory]:
    """A motion so many times, each time after the slow way to where it begins.

    Args:
        arm: The arm.
        path: The motion.
        here: Present radians by joint.
        repeat: How often.
        speed: Share of the speed limits on the way.
    """
    legs: list[Trajectory] = []
    at: Sequence[float] = [here[name] for name in path.names]
    for _ in range(repeat):
        first = approach(arm, path.names, at, path.start, speed=speed)
        legs += [first, path] if first.duration else [path]
        at = path.goal
    return legs


def chosen_solution(
    kinematics: KinematicModel,
    pose: Pose,
    branch: str,
    near: Sequence[float],
    solutions: Sequence[Solution] | None = None,
) -> Solution:
    """The solution of the inverse kinematics with a branch, or the nearest allowed one.

    Args:
        kinematics: The geometry.
        pose: Where the tip is to be.
        branch: Name of the branch; empty for the nearest.
        near: Joint angles of the model that it should be near to, radians.
        solutions: Of this pose, if they are known.

    Raises:
        LimitError: There is none within the limits.
    """
    if not branch:
        return kinematics.best(pose, near)
    solutions = kinematics.inverse(pose) if solutions is None else solutions
    for solution in solutions:
        if solution.branch == branch:
            if solution.violations:
                raise LimitError(f"{branch}: {'; '.join(solution.violations)}")
            return solution
    raise LimitError(
        f"the place has no solution {branch!r}; there are {', '.join(s.branch for s in solutions) or 'none'}"
    )


def _refuse_unknown(names: Sequence[str], here: Mapping[str, float]) -> None:
    if unknown := [name for name in names if not math.isfinite(here.get(name, math.nan))]:
        raise UsageError(position_unknown(unknown))
