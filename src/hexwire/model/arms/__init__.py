"""What hexwire knows of an arm, one record each, found through the entry-point group ``hexwire.arms``.

Owns the record and the look-up. Geometry, pictures, physics, gripper, set-up, named poses, the emulated arm and the
ROS files of an arm all come from here, so that a package adds an arm by one entry point. Must not know who uses a
record: what belongs to rooms above, such as the driver, is named as text and loaded there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache
from typing import TYPE_CHECKING, Any

from hexwire.errors import UsageError
from hexwire.extras import installed

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

    from hexwire.model.arm import ArmModel
    from hexwire.model.kinematics import KinematicModel
    from hexwire.model.pose import Vector
    from hexwire.model.shapes import ArmShapes

__all__ = [
    "ArmRecord",
    "Assembly",
    "AssemblyJoint",
    "Go",
    "Rod",
    "Seek",
    "arm_names",
    "arm_record",
    "arm_with_geometry",
    "arms_with_geometry",
    "assembled_arms",
    "assembly_of",
    "record_of",
    "simulated_arms",
]

_GROUP = "hexwire.arms"


@dataclass(frozen=True, slots=True)
class Rod:
    """The mass of a link in a physics simulation: that of a thin rod.

    Attributes:
        centre: Centre of mass from the joint that carries the link, metres.
        length: Length of the rod that has its inertia, metres.
        mass: Kilograms.
        reference: Joint from whose place `centre` is measured; empty for the joint that carries the link.
        in_plane: The centre is in the plane of the arm, as the link's shapes say, though its joint is beside it.
    """

    centre: Vector
    length: float
    mass: float
    reference: str = ""
    in_plane: bool = False


@dataclass(frozen=True, slots=True)
class Seek:
    """Find a stop.

    Attributes:
        joint: Name.
        direction: 1 or -1, in joint angles.
    """

    joint: str
    direction: int

    def __str__(self) -> str:
        return f"{self.joint}: looks for its {'upper' if self.direction > 0 else 'lower'} stop"


@dataclass(frozen=True, slots=True)
class Go:
    """Move joints, of which at least one stop is known.

    Attributes:
        angles: Joint angles in degrees by name, 0 in the middle of the usual range of the profile.
    """

    angles: Mapping[str, float]

    def __str__(self) -> str:
        return " and ".join(f"{name} goes to {angle:g} deg" for name, angle in self.angles.items())


@dataclass(frozen=True, slots=True)
class AssemblyJoint:
    """A joint that a person assembles: its place, its mechanical range, and what its servo carries.

    Attributes:
        name: Name of the driver's joint.
        where: Where its servo is and what it moves, for the set-up.
        low: Lower end of the mechanical range in degrees; the stop lies 5 degrees further out.
        high: Upper end of the range.
        start: Angle at which the arm is put down, degrees.
        endless: Only a cable limits it: it has no stops, and a person shows its middle.
        weight: Greatest torque of gravity, as a share of the servo's stall torque.
        upright: Angle 0 points upward, not forward.
        leader_gears: Gears of the servo in a leader arm, as in 191 for 1:191; 0 for the follower's.
        leader_part: Part number with these gears.
        force: Torque with which the joint may push against its stops, as a share of the servo's stall torque: what
            it needs to carry the arm.
    """

    name: str
    where: str = ""
    low: float = -180.0
    high: float = 180.0
    start: float = 0.0
    endless: bool = False
    weight: float = 0.0
    upright: bool = False
    leader_gears: int = 0
    leader_part: str = ""
    force: float = 0.3


@dataclass(frozen=True, slots=True)
class Assembly:
    """An arm of STS servos that a person assembles, sets up and calibrates, and that hexwire can emulate.

    Attributes:
        joints: In the order of the driver's joints.
        gears: Gears of each servo in a follower, as in 345 for 1:345; 0 if not known.
        part: Part numbers with these gears, as on the label.
        servo_models: Models of its servos, as in ``sts3215``.
        picture: The arm from its side as lines of text; ``{3}`` stands for the servo with id 3.
        search: Motions that find all stops and keep the arm clear of the table, for `hexwire bus calibrate --auto`;
            empty if nobody knows any. They begin with the arm as it is put down.
    """

    joints: tuple[AssemblyJoint, ...] = ()
    gears: int = 0
    part: str = ""
    servo_models: tuple[str, ...] = ()
    picture: tuple[str, ...] = ()
    search: tuple[Seek | Go, ...] = ()

    @property
    def endless(self) -> tuple[str, ...]:
        """Names of the joints without stops."""
        return tuple(joint.name for joint in self.joints if joint.endless)

    def joint(self, name: str) -> AssemblyJoint:
        """A joint by name; one of which nothing is known for another name."""
        return next((joint for joint in self.joints if joint.name == name), AssemblyJoint(name))

    def label(self, name: str, *, leader: bool) -> str:
        """Gears and part number of a joint's servo, as in ``1:191 (C044)``; empty if not known."""
        gears, part = self.gears, self.part
        if leader:
            own = self.joint(name)
            gears, part = own.leader_gears, own.leader_part
        return f"1:{gears} ({part})" if gears and part else ""


@dataclass(frozen=True, slots=True, kw_only=True)
class ArmRecord:
    """An arm.

    Attributes:
        name: Name of the robot.
        title: As a person calls it.
        driver: Its `RobotDriver`, as ``package.module:Class``, or the file of an arm on a servo bus, as
            ``package:file.toml``.
        kinematics: Makes its kinematics of a link set's name or file; None if its lengths are not known.
        link_sets: Whether it has more than one link set.
        shapes: Makes its links, joints and parts of its kinematics; None if nobody knows what it looks like.
        rods: Masses of links in the physics simulation, by name, where they differ from those of the shapes.
        gripper: Joint that opens and closes the gripper; empty without one.
        closed_at_maximum: The upper limit of that joint is closed, not the lower one.
        poses: Named poses in radians, of the joints that move the tool.
        pose_speed: Share of the joints' speed with which these are approached.
        poses_of_links: Link sets that can take a pose; a pose that is not listed fits all.
        unit: Metres in the unit in which coordinates are typed and printed.
        port: Where it is usually plugged in.
        emulated: Address of an emulated one, ``sim://NAME`` where `emulate` or `assembly` makes it; empty if none.
        emulator: Program that must run for that address, as in ``hexwire sim puma260``; empty if none.
        emulate: What makes the emulated arm of ``sim://NAME``, as ``package.module:function``; see
            `hexwire.emulator.serve_sim`. Empty for the servos of `assembly`.
        assembly: How it is assembled; None if it comes assembled.
        place: Its place in lists of arms. Where a recording fits several, the first counts: a later model before an
            earlier one.
    """

    name: str
    title: str
    driver: str
    kinematics: Callable[[str], KinematicModel] | None = None
    link_sets: bool = False
    shapes: Callable[[Any], ArmShapes] | None = None
    rods: Mapping[str, Rod] = field(default_factory=dict)
    gripper: str = ""
    closed_at_maximum: bool = False
    poses: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    pose_speed: float = 0.15
    poses_of_links: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    unit: float = 1e-3
    port: str = "/dev/ttyUSB0"
    emulated: str = ""
    emulator: str = ""
    emulate: str = ""
    assembly: Assembly | None = None
    place: int = 100

    @property
    def simulated(self) -> bool:
        """Whether ``sim://NAME`` emulates it inside the program that opens it."""
        return self.emulated == f"sim://{self.name}"


def arm_names() -> tuple[str, ...]:
    """Names of the arms that have a record, sorted."""
    return tuple(sorted({point.name for point in installed(_GROUP)}))


def record_of(name: str) -> ArmRecord | None:
    """The record of an arm; None if there is none.

    Raises:
        UsageError: The entry point does not name a record, or that of another arm.
    """
    return next((_load(point) for point in installed(_GROUP) if point.name == name), None)


@cache
def _load(point: EntryPoint) -> ArmRecord:
    record = point.load()
    if not isinstance(record, ArmRecord) or record.name != point.name:
        raise UsageError(f"entry point {point.value!r} of arm {point.name!r} is not an ArmRecord of this name")
    return record


def assembly_of(arm: ArmModel) -> Assembly:
    """How an arm is assembled; without joints if nobody has said it."""
    record = record_of(arm.kind)
    return Assembly() if record is None or record.assembly is None else record.assembly


def arm_record(name: str) -> ArmRecord:
    """As `record_of`.

    Raises:
        UsageError: There is none; the text lists those that there are.
    """
    record = record_of(name)
    if record is None:
        raise UsageError(f"nothing is known of an arm {name!r}; there are {', '.join(arm_names())}")
    return record


def _records() -> Iterator[ArmRecord]:
    """The records of all arms, sorted by name; a package with a wrong one takes no other arm from a list."""
    for name in arm_names():
        with suppress(UsageError, ImportError, AttributeError):
            yield arm_record(name)


def arms_with_geometry() -> tuple[str, ...]:
    """Names of the arms whose geometry is known, sorted."""
    return tuple(record.name for record in _records() if record.kinematics is not None)


def arm_with_geometry(name: str) -> ArmRecord:
    """The record of an arm whose geometry is known.

    Raises:
        UsageError: There is none; the text lists those that there are.
    """
    record = record_of(name)
    if record is None or record.kinematics is None:
        known = ", ".join(arms_with_geometry())
        raise UsageError(f"no geometry is known for robot {name!r}; choose one of {known}")
    return record


def assembled_arms() -> dict[str, str]:
    """The arms that a person assembles: title by name, by their places."""
    records = sorted(_records(), key=lambda record: record.place)
    return {record.name: record.title for record in records if record.assembly is not None}


def simulated_arms() -> tuple[str, ...]:
    """Names of the arms that ``sim://NAME`` emulates inside the program that opens it, by their places."""
    records = sorted(_records(), key=lambda record: record.place)
    return tuple(record.name for record in records if record.simulated)
