"""The links of the SO-100 and the SO-101, metres, kilograms and radians.

Owns the constants and the source of each. Must not know the kinematics.

All numbers are facts of public models under the Apache License 2.0: for the SO-101 `Simulation/SO101/
so101_new_calib.urdf` of TheRobotStudio/SO-ARM100 (385e8d7), whose zero is the middle of each joint's range, as in
LeRobot. For the SO-100 `Simulation/SO100/so100.urdf` of the same project, and for the tip of its fixed jaw
`trs_so_arm100` of google-deepmind/mujoco_menagerie. That file of the SO-100 has its zero elsewhere and turns
shoulder_pan the other way. Here the SO-100 has the zero pose and the directions of the SO-101, whose upper arm and
forearm it shares, as in the SO-100 of haosulab/ManiSkill, which was compared with the real arm.

Simplified: both arms are exact in the place of every axis. In the files, a quarter turn is rounded to 1.5708, which
moves the tip by less than 0.01 mm. The base frame of the SO-100 is turned so that x is ahead.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from hexwire.model.kinematics import JointRange

__all__ = ["SO_ARMS", "SoArmLinks"]


@dataclass(frozen=True, slots=True)
class SoArmLinks:
    """The links of one arm. In the zero pose, x is ahead, y to the left and z up; the tool is level.

    Attributes:
        name: Name of the robot.
        source: Where the numbers are from.
        pan: Ahead and height of the shoulder_pan joint's frame on its axis, from the base.
        shoulder: Ahead of the pan axis, and height above the base, of the shoulder_lift axis.
        side: The wrist_roll axis to the left of the pan axis.
        upper: Ahead and up from the shoulder_lift to the elbow_flex axis.
        forearm: Ahead and up from the elbow_flex to the wrist_flex axis.
        hand: Ahead from the wrist_flex axis to the wrist_roll joint's frame.
        tip: The tip of the fixed jaw in the frame of wrist_roll: ahead, below and to the left of the roll axis.
        twist: Angle of wrist_roll at which the jaws open straight up.
        jaw: The hinge of the moving jaw in the frame of wrist_roll: ahead, to the left, up.
        finger: The tip of the moving jaw from its hinge when it is at zero: ahead, to the left, up.
        masses: Of base, shoulder, upper arm, forearm, wrist, gripper and jaw.
        jaw_range: Limits of the gripper's joint.
        ranges: Limits of the five joints.
    """

    name: str
    source: str
    pan: tuple[float, float]
    shoulder: tuple[float, float]
    side: float
    upper: tuple[float, float]
    forearm: tuple[float, float]
    hand: float
    tip: tuple[float, float, float]
    twist: float
    jaw: tuple[float, float, float]
    finger: tuple[float, float, float]
    masses: tuple[float, float, float, float, float, float, float]
    jaw_range: tuple[float, float]
    ranges: tuple[JointRange, ...]

    @property
    def lengths(self) -> tuple[float, float]:
        """Straight lengths of upper arm and forearm."""
        return math.hypot(*self.upper), math.hypot(*self.forearm)

    @property
    def reach(self) -> tuple[float, float]:
        """Shortest and longest distance from the shoulder_lift to the wrist_flex axis."""
        upper, forearm = self.lengths
        return abs(upper - forearm), upper + forearm


_NAMES = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll")


def _ranges(*limits: tuple[float, float]) -> tuple[JointRange, ...]:
    return tuple(JointRange(name, low, high) for name, (low, high) in zip(_NAMES, limits, strict=True))


def _degrees(*limits: float) -> tuple[JointRange, ...]:
    return _ranges(*((-math.radians(limit), math.radians(limit)) for limit in limits))


SO_ARMS = {
    "so101": SoArmLinks(
        name="so101",
        source="TheRobotStudio/SO-ARM100, so101_new_calib.urdf, Apache-2.0",
        pan=(0.0388353, 0.0624),
        shoulder=(0.0303992, 0.0624 + 0.0542),
        side=0.0181 - 0.0182778,
        upper=(0.028, 0.11257),
        forearm=(0.1349, 0.0052),
        hand=0.0611,
        tip=(0.0981274, 0.0079, -0.000218121),
        twist=0.0486795,
        jaw=(0.0234, 0.0188, 0.0202),
        # Not in that file: the pads of the SO-100's jaw, whose finger is as long.
        finger=(0.077, -0.0188, -0.0113),
        masses=(0.147, 0.100006, 0.103, 0.104, 0.079, 0.087, 0.012),
        jaw_range=(-0.174533, 1.74533),
        ranges=_ranges(
            (-1.91986, 1.91986), (-1.74533, 1.74533), (-1.69, 1.69), (-1.65806, 1.65806), (-2.74385, 2.84121)
        ),
    ),
    "so100": SoArmLinks(
        name="so100",
        source="TheRobotStudio/SO-ARM100, so100.urdf, and mujoco_menagerie, trs_so_arm100, Apache-2.0",
        pan=(0.0452, 0.0165),
        shoulder=(0.0306, 0.0165 + 0.1025),
        side=0.0,
        upper=(0.028, 0.11257),
        forearm=(0.1349, 0.0052),
        hand=0.0601,
        # The inner face of the outermost pad of the fixed jaw.
        tip=(0.1014, 0.0079, 0.0),
        twist=0.0,
        jaw=(0.0244, 0.0, 0.0202),
        finger=(0.077, 0.0, -0.0113),
        # The base's mass is ManiSkill's: the makers' file has a rough estimate.
        masses=(0.193184, 0.119226, 0.162409, 0.147968, 0.0661321, 0.0929859, 0.0202444),
        jaw_range=(-0.174533, 1.74533),
        # Those of the driver's profile: the published ones differ by a few degrees from file to file.
        ranges=_degrees(110, 100, 90, 95, 160),
    ),
}
"""The published arms by the name of the robot."""
