"""What an arm looks like: boxes, cylinders and balls on links that joints connect.

Owns the values and where they are at joint positions. One `ArmShapes` serves the 3D view of the studio, URDF files
and with them rviz, and the physics twin. Must not know a particular arm, nor any of these formats.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Literal

from .pose import IDENTITY, Matrix, Pose, Vector, apply, multiply, rotation_about, rotation_from_rpy

__all__ = [
    "COLOURS",
    "ArmShapes",
    "Drive",
    "Inertia",
    "Shape",
    "ShapeJoint",
    "ShapeLink",
    "bar",
    "box",
    "cylinder",
    "mirrored",
    "rod",
]

COLOURS: Mapping[str, tuple[str, str]] = MappingProxyType(
    {
        "base": ("#4b535d", "#67717d"),
        "frame": ("#d9dee5", "#cfd6de"),
        "servo": ("#2b2f36", "#474e58"),
        "print": ("#f2a51f", "#eda32a"),
        "paint": ("#e6e3da", "#d9d6cd"),
        "jaw": ("#a3aebb", "#a9b4c1"),
        "pad": ("#3a4048", "#555d68"),
    }
)
"""Colours of parts by name, on light and on dark backgrounds, as ``#rrggbb``. ``joint`` is no name in it: such a
shape has the colour of its joint in `hexwire.model.palette`."""

_ZERO: Vector = (0.0, 0.0, 0.0)
_TURNS: Mapping[str, Vector] = MappingProxyType(
    {"x": (0.0, math.pi / 2, 0.0), "y": (-math.pi / 2, 0.0, 0.0), "z": _ZERO}
)


@dataclass(frozen=True, slots=True)
class Shape:
    """One solid of a link.

    Attributes:
        name: What it is, unique in its link.
        kind: Form. A cylinder's axis is its z axis.
        size: Metres: lengths along x, y, z of a box; radius and length of a cylinder; radius of a ball.
        colour: A key of `COLOURS`, or ``joint``.
        place: Its centre in the frame of the link, metres.
        rpy: Its turn in that frame, as `rotation_from_rpy`, radians.
        joint: The driver's joint whose colour it has, if `colour` is ``joint``.
        solid: It can hit something; false for what is only there to be seen.
    """

    name: str
    kind: Literal["box", "cylinder", "sphere"]
    size: tuple[float, ...]
    colour: str
    place: Vector
    rpy: Vector = _ZERO
    joint: str = ""
    solid: bool = True

    @property
    def rotation(self) -> Matrix:
        """Its turn in the frame of its link."""
        return rotation_from_rpy(*self.rpy)


@dataclass(frozen=True, slots=True)
class Inertia:
    """Mass of a link; its inertia is estimated as that of a rod.

    Attributes:
        mass: Kilograms.
        start: One end of the rod in the frame of the link, metres.
        end: The other end.
        radius: Of the rod, metres.
    """

    mass: float
    start: Vector
    end: Vector
    radius: float

    @property
    def length(self) -> float:
        """Of the rod, metres; never 0."""
        return max(math.dist(self.start, self.end), 1e-3)

    @property
    def moments(self) -> tuple[float, float]:
        """Moments of inertia across and along the rod about its middle, kg m^2."""
        return self.mass * (3 * self.radius**2 + self.length**2) / 12, self.mass * self.radius**2 / 2

    @property
    def frame(self) -> tuple[Vector, Vector]:
        """Middle of the rod in metres, and the roll, pitch and yaw in radians that turn z along it."""
        return _along(self.start, self.end)


@dataclass(frozen=True, slots=True)
class ShapeLink:
    """A rigid part of the arm.

    Attributes:
        name: Name, unique in the arm.
        shapes: Its solids; none for a link that is only a frame.
        inertia: None for a frame, and for parts whose mass counts as that of another link.
    """

    name: str
    shapes: tuple[Shape, ...] = ()
    inertia: Inertia | None = None


@dataclass(frozen=True, slots=True)
class Drive:
    """What turns a joint: `multiplier` times the position of a joint of the driver, plus `offset` in radians."""

    joint: str
    multiplier: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True, slots=True)
class ShapeJoint:
    """What connects two links.

    Attributes:
        name: Name; a joint of the driver has the driver's.
        parent: Name of the link before it.
        child: Name of the link behind it, whose frame is the joint's.
        place: That frame in the frame of the parent at position 0, metres.
        rpy: Its turn there, radians.
        axis: The axis in that frame, a unit vector; None for a joint that does not move.
        drive: What turns it; None for a joint that does not move.
        limits: Lowest and highest position in radians, and speed in radians per second.
    """

    name: str
    parent: str
    child: str
    place: Vector = _ZERO
    rpy: Vector = _ZERO
    axis: Vector | None = None
    drive: Drive | None = None
    limits: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def follows(self) -> bool:
        """Whether it only follows a joint of the driver, as the second jaw follows the first."""
        return self.drive is not None and self.drive.joint != self.name


@dataclass(frozen=True, slots=True)
class ArmShapes:
    """A whole arm.

    Attributes:
        name: Of the robot.
        links: Its links; each but the first is the child of one joint.
        joints: Its joints, each after the joint of its parent.
        tip: The link whose frame is the pose of the kinematics.
        source: Where the lengths are from.
        published: What of the rest is published, for the head of a file.
    """

    name: str
    links: tuple[ShapeLink, ...]
    joints: tuple[ShapeJoint, ...]
    tip: str
    source: str
    published: str

    def link(self, name: str) -> ShapeLink:
        """A link by name."""
        return next(link for link in self.links if link.name == name)

    @property
    def driven(self) -> tuple[str, ...]:
        """Names of the driver's joints, in order."""
        return tuple(joint.name for joint in self.joints if joint.drive is not None and not joint.follows)

    @property
    def reach(self) -> float:
        """No pose has the tip farther from the origin than this, metres."""
        joints = {joint.child: joint for joint in self.joints}
        name, reach = self.tip, 0.0
        while name in joints:
            reach += math.hypot(*joints[name].place)
            name = joints[name].parent
        return reach

    @property
    def heading(self) -> float:
        """Where the arm points with all joints at 0, to the nearest quarter turn about z, radians."""
        x, y, _ = self.poses({})[self.tip].position
        return round(math.atan2(y, x) / (math.pi / 2)) * (math.pi / 2)

    def poses(self, positions: Mapping[str, float]) -> dict[str, Pose]:
        """Pose of every link in the frame of the first.

        Args:
            positions: Joint positions of the driver, radians; 0 for a joint that is not in it.
        """
        found = {self.links[0].name: Pose(_ZERO, IDENTITY)}
        for joint in self.joints:
            before = found[joint.parent]
            turned = multiply(before.rotation, rotation_from_rpy(*joint.rpy))
            if joint.axis is not None and joint.drive is not None:
                angle = joint.drive.multiplier * positions.get(joint.drive.joint, 0.0) + joint.drive.offset
                turned = multiply(turned, rotation_about(joint.axis, angle))
            found[joint.child] = Pose(moved(before, joint.place), turned)
        return found

    def placed(self, positions: Mapping[str, float]) -> Iterator[tuple[ShapeLink, Shape, Pose]]:
        """Every shape with its link and its pose in the frame of the first link; `positions` as in `poses`."""
        poses = self.poses(positions)
        for link in self.links:
            pose = poses[link.name]
            for shape in link.shapes:
                yield link, shape, Pose(moved(pose, shape.place), multiply(pose.rotation, shape.rotation))


def moved(pose: Pose, place: Vector) -> Vector:
    """A point that is at `place` in the frame of `pose`, in the frame of that pose's parent, metres."""
    x, y, z = apply(pose.rotation, place)
    return (pose.position[0] + x, pose.position[1] + y, pose.position[2] + z)


def box(
    name: str,
    colour: str,
    size: Vector,
    place: Vector,
    rpy: Vector = _ZERO,
    *,
    solid: bool = True,
) -> Shape:
    """A box by its lengths and its centre, metres."""
    return Shape(name, "box", size, colour, place, rpy, solid=solid)


def cylinder(
    name: str,
    colour: str,
    radius: float,
    length: float,
    place: Vector,
    along: Literal["x", "y", "z"] = "z",
    *,
    joint: str = "",
    solid: bool = True,
) -> Shape:
    """A cylinder along an axis of the link's frame, by its centre, metres; with `joint` in that joint's colour."""
    return Shape(
        name, "cylinder", (radius, length), "joint" if joint else colour, place, _TURNS[along], joint, solid
    )


def rod(name: str, colour: str, start: Vector, end: Vector, radius: float, *, solid: bool = True) -> Shape:
    """A cylinder from one point to another, metres."""
    middle, rpy = _along(start, end)
    return Shape(name, "cylinder", (radius, math.dist(start, end)), colour, middle, rpy, solid=solid)


def _along(start: Vector, end: Vector) -> tuple[Vector, Vector]:
    """Middle of two points, and the roll, pitch and yaw that turn the z axis from one to the other."""
    x, y, z = (b - a for a, b in zip(start, end, strict=True))
    middle = ((start[0] + end[0]) / 2, (start[1] + end[1]) / 2, (start[2] + end[2]) / 2)
    return middle, (0.0, math.atan2(math.hypot(x, y), z), math.atan2(y, x) if x or y else 0.0)


def bar(
    name: str, colour: str, start: Vector, end: Vector, width: float, thickness: float, *, solid: bool = True
) -> Shape:
    """A box from one point to another in a plane of constant y: `width` along y, `thickness` across; metres."""
    x, z = end[0] - start[0], end[2] - start[2]
    middle = ((start[0] + end[0]) / 2, (start[1] + end[1]) / 2, (start[2] + end[2]) / 2)
    size = (math.hypot(x, z), width, thickness)
    return Shape(name, "box", size, colour, middle, (0.0, -math.atan2(z, x), 0.0), solid=solid)


def mirrored(shape: Shape) -> Shape:
    """The mirror image on the other side of the plane of y and z; for shapes that only pitch."""
    x, y, z = shape.place
    return replace(shape, place=(-x, y, z), rpy=(0.0, -shape.rpy[1], 0.0))
