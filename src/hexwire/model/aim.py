"""Where the tip of a tool is to be and where the tool is to point, and how a pose is told to people.

Owns the ways to give a tool's direction, and roll, pitch and yaw of a rotation. Must not know particular arms.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from hexwire.errors import UsageError
from hexwire.units import plain

from .kinematics import KinematicModel
from .pose import Matrix, Pose, Vector, rotation_from_rpy

__all__ = ["Aim", "Tip", "aimed_pose", "rpy_of"]

_GIMBAL = 1e-9
"""Cosine of the pitch below which roll and yaw turn about the same line."""


@dataclass(frozen=True, slots=True)
class Aim:
    """Where the tool is to point; without any of these it keeps its direction relative to the arm.

    Attributes:
        down: Straight down.
        rpy: Roll, pitch and yaw about the base's fixed axes, radians; for arms of six joints.
        pitch: Radians: 0 is level, a quarter turn is straight down; for arms of five joints.
        roll: Angle of the last joint, radians, with `pitch`; None to keep it.
        fixed: Keep the direction in space instead of relative to the arm.
    """

    down: bool = False
    rpy: Vector | None = None
    pitch: float | None = None
    roll: float | None = None
    fixed: bool = False

    @property
    def given(self) -> bool:
        """The tool is to point somewhere."""
        return self.down or self.rpy is not None or self.pitch is not None

    def check(self, model: KinematicModel, option: str = "") -> None:
        """Refuse ways that contradict each other, or that the arm does not support.

        Args:
            model: The kinematics.
            option: What is before the names of options as a person types them.

        Raises:
            UsageError: They do.
        """
        down, rpy, pitch, roll = (option + name for name in ("down", "rpy", "pitch", "roll"))
        given = {down: self.down, rpy: self.rpy is not None, pitch: self.pitch is not None}
        typed = [name for name, there in given.items() if there]
        if len(typed) > 1:
            raise UsageError(f"{typed[0]} and {typed[1]} contradict each other")
        if self.roll is not None and self.pitch is None:
            raise UsageError(f"{roll} needs {pitch}")
        if self.rpy is not None and len(model.ranges) < 6:
            raise UsageError(
                f"{model.name} has five joints, and the heading of its tool follows from the position: "
                f"give {pitch} and {roll} instead of {rpy}"
            )
        if self.pitch is not None and len(model.ranges) == 6:
            raise UsageError(f"{model.name} has six joints: give {rpy} instead of {pitch}")


@dataclass(frozen=True, slots=True, repr=False)
class Tip:
    """The pose of the tip of the tool, as people read it.

    Attributes:
        position: x, y, z, metres.
        rpy: Roll, pitch and yaw about the base's fixed axes, radians.
        pitch_roll: Pitch and roll of the tool, radians, for an arm of five joints; None for others.
    """

    position: Vector
    rpy: Vector
    pitch_roll: tuple[float, float] | None

    @classmethod
    def of(cls, model: KinematicModel, angles: Sequence[float]) -> Tip:
        """The pose at joint angles of the model, radians.

        Raises:
            UsageError: The angles are not one finite number for each joint.
        """
        pose = model.forward(angles)
        return cls(pose.position, rpy_of(pose.rotation), model.pitch_and_roll(angles))

    def __repr__(self) -> str:
        place = ", ".join(plain(1e3 * value, 1) for value in self.position)
        names, angles = ("pitch, roll", self.pitch_roll) if self.pitch_roll else ("rpy", self.rpy)
        return f"<Tip: {place} mm; {names} {', '.join(plain(math.degrees(angle), 1) for angle in angles)} deg>"


def aimed_pose(
    model: KinematicModel, angles: Sequence[float], place: Vector, aim: Aim, *, relative: bool = False
) -> Pose:
    """The pose of the tip at a place.

    Args:
        model: The kinematics.
        angles: Present joint angles of the model, radians.
        place: x, y, z in metres.
        aim: Where the tool is to point.
        relative: The place counts from the tip's present position.

    Raises:
        UsageError: The arm's tool cannot be aimed in this way.
    """
    here = model.forward(angles)
    if relative:
        place = (place[0] + here.position[0], place[1] + here.position[1], place[2] + here.position[2])
    if aim.down:
        return Pose(place, model.tool_down(place, angles))
    if aim.rpy is not None:
        if len(model.ranges) < 6:
            raise UsageError(
                f"{model.name} has five joints, and the heading of its tool follows from the position: "
                "give its pitch and roll"
            )
        return Pose(place, rotation_from_rpy(*aim.rpy))
    if aim.pitch is not None:
        roll = angles[4] if aim.roll is None else aim.roll
        return Pose(place, model.aimed(place, aim.pitch, roll, angles))
    return Pose(place, here.rotation if aim.fixed else model.carried(place, angles))


def rpy_of(rotation: Matrix) -> Vector:
    """Roll about x, then pitch about y, then yaw about z of a rotation, about fixed axes as URDF has it; radians.

    With a pitch of a quarter turn, roll and yaw turn about the same line, and the roll is 0.
    """
    cosine = math.hypot(rotation[0][0], rotation[1][0])
    pitch = math.atan2(-rotation[2][0], cosine)
    if cosine < _GIMBAL:
        return 0.0, pitch, math.atan2(-rotation[0][1], rotation[1][1])
    return (
        math.atan2(rotation[2][1], rotation[2][2]),
        pitch,
        math.atan2(rotation[1][0], rotation[0][0]),
    )
