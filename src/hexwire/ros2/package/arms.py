"""What MoveIt and ros2_control are told of an arm: joints, groups, poses.

Owns the names of groups and controllers, and the poses that get names. Limits are the narrower of the driver's and
the robot description's, so that neither refuses what the other plans. Must not know the format of any file.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from hexwire.drivers.registry import load_driver
from hexwire.model.arms import arm_with_geometry
from hexwire.model.arms.hex7bot.kinematics import Hex7BotModel
from hexwire.model.arms.hex7bot.links import LINK_SETS
from hexwire.model.geometry import make_kinematics, make_shapes
from hexwire.model.gripper import Jaws, jaws_of
from hexwire.model.kinematics import KinematicModel
from hexwire.model.shapes import ArmShapes

__all__ = ["ACCELERATION", "ARM_GROUP", "GRIPPER_GROUP", "NamedPose", "PackageArm", "PackageJoint", "make_arm"]

ARM_GROUP = "arm"
GRIPPER_GROUP = "gripper"
ACCELERATION = 6.0
"""Radians per second squared: what `hexwire goto` plans with. No arm's own limit is published."""

_DIGITS = 4
_SIX = 6


@dataclass(frozen=True, slots=True)
class PackageJoint:
    """One joint of the driver.

    Attributes:
        name: Name.
        lower: Radians.
        upper: Radians.
        speed: Radians per second.
    """

    name: str
    lower: float
    upper: float
    speed: float


@dataclass(frozen=True, slots=True)
class NamedPose:
    """A pose with a name.

    Attributes:
        name: Name, unique in its group.
        group: `ARM_GROUP` or `GRIPPER_GROUP`.
        positions: Radians by joint.
    """

    name: str
    group: str
    positions: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class PackageArm:
    """An arm as its package describes it.

    Attributes:
        name: Of the robot.
        links: Name of the 7Bot's link set, or path of the file with one's own; empty for other arms.
        kinematics: Its kinematics.
        shapes: Its links and joints.
        joints: The driver's joints, in order.
        jaws: The gripper; None if it has none.
        poses: The named poses.
        pose_speed: Share of the joints' speed with which poses are approached.
    """

    name: str
    links: str
    kinematics: KinematicModel
    shapes: ArmShapes
    joints: tuple[PackageJoint, ...]
    jaws: Jaws | None
    poses: tuple[NamedPose, ...]
    pose_speed: float

    @property
    def arm_joints(self) -> tuple[str, ...]:
        """Names of the joints that move the tool."""
        return tuple(joint.name for joint in self.joints if self.jaws is None or joint.name != self.jaws.joint)

    @property
    def joints_short_of_six(self) -> bool:
        """It has too few joints for every orientation of its tool."""
        return len(self.arm_joints) < _SIX

    @property
    def gripper_joints(self) -> tuple[str, ...]:
        """The gripper's joint, and those that only follow it; empty without a gripper."""
        if self.jaws is None:
            return ()
        return tuple(
            joint.name
            for joint in self.shapes.joints
            if joint.drive is not None and joint.drive.joint == self.jaws.joint
        )

    @property
    def groups(self) -> Mapping[str, tuple[str, ...]]:
        """The driver's joints by group; there is one controller for each."""
        groups = {ARM_GROUP: self.arm_joints}
        if self.jaws is not None:
            groups[GRIPPER_GROUP] = (self.jaws.joint,)
        return groups


def make_arm(robot: str, links: str = "A") -> PackageArm:
    """The arm of a robot that has a geometry.

    Args:
        robot: One of `hexwire.model.arms.arms_with_geometry`.
        links: Link set of the 7Bot, as in `make_kinematics`.

    Raises:
        UsageError: As `make_kinematics`.
    """
    kinematics = make_kinematics(robot, links)
    shapes = make_shapes(kinematics)
    record = arm_with_geometry(robot)
    model = load_driver(robot).from_url(record.port).model
    jaws = jaws_of(model)
    drawn = {joint.name: joint.limits for joint in shapes.joints}
    joints = []
    for joint in model.joints:
        low, high, _ = drawn[joint.name]
        # Rounded inwards: a value that is typed from the file is within both.
        lower = math.ceil(max(low, joint.minimum) * 10**_DIGITS) / 10**_DIGITS
        upper = math.floor(min(high, joint.maximum) * 10**_DIGITS) / 10**_DIGITS
        joints.append(PackageJoint(joint.name, lower, upper, joint.max_speed))
    names = [joint.name for joint in joints if jaws is None or joint.name != jaws.joint]
    own = _links(kinematics, links)
    poses = [
        NamedPose(name, ARM_GROUP, dict(zip(names, angles, strict=True)))
        for name, angles in record.poses.items()
        if own in record.poses_of_links.get(name, (own,))
    ]
    if jaws is not None:
        grip = next(joint for joint in joints if joint.name == jaws.joint)
        for name, angle in (("open", jaws.opened), ("closed", jaws.closed)):
            poses.append(NamedPose(name, GRIPPER_GROUP, {jaws.joint: min(max(angle, grip.lower), grip.upper)}))
    return PackageArm(
        robot,
        own,
        kinematics,
        shapes,
        tuple(joints),
        jaws,
        tuple(poses),
        record.pose_speed,
    )


def _links(kinematics: KinematicModel, given: str) -> str:
    """The name of a published link set, or the path of the file with another one."""
    if not isinstance(kinematics, Hex7BotModel):
        return ""
    own = kinematics.links
    return own.name if LINK_SETS.get(own.name) == own else str(Path(given).absolute())
