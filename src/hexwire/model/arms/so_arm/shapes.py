"""What an SO-100 and an SO-101 look like: printed parts, black servos, one jaw that moves.

Owns joints and shapes. Places of joints follow from the links, masses are the published ones; shapes are simplified
after the makers' pictures, with servos of the size of an STS3215.
"""

from __future__ import annotations

import math

from hexwire.model.arms.so_arm.kinematics import SoArmModel
from hexwire.model.arms.so_arm.links import SoArmLinks
from hexwire.model.pose import Vector
from hexwire.model.shapes import ArmShapes, Drive, Inertia, Shape, ShapeJoint, ShapeLink, bar, box, cylinder

__all__ = ["make_so_arm_shapes"]

_HALF = math.pi / 2
_SPEED = math.pi
_PIVOT = 0.056
"""Height at which the base ends and the shoulder turns, metres."""
_FORK = 0.0225
"""Middle of a fork's plates from the arm's plane, metres."""


def make_so_arm_shapes(model: SoArmModel) -> ArmShapes:
    """The arm with the model's links and limits."""
    k = model.links
    ahead, below, left = k.tip
    shoulder = (k.shoulder[0], 0.0, k.shoulder[1] - k.pan[1])
    upper, forearm = (k.upper[0], 0.0, k.upper[1]), (k.forearm[0], 0.0, k.forearm[1])
    hand, tip = (k.hand, k.side, 0.0), (ahead, left, -below)
    zero = (0.0, 0.0, 0.0)
    # Place, turn and axis of each joint in the frame of the link before it; then the link, the end of its rod and
    # the rod's radius.
    rows: tuple[tuple[Vector, float, Vector, str, Vector, float, tuple[Shape, ...]], ...] = (
        ((k.pan[0], 0.0, k.pan[1]), 0.0, (0.0, 0.0, -1.0), "shoulder", shoulder, 0.025, _shoulder(k, shoulder)),
        (shoulder, 0.0, (0.0, 1.0, 0.0), "upper_arm", upper, 0.02, _segment(upper, "shoulder_lift", 0.5)),
        (upper, 0.0, (0.0, 1.0, 0.0), "lower_arm", forearm, 0.02, _segment(forearm, "elbow_flex", 0.45)),
        (forearm, 0.0, (0.0, 1.0, 0.0), "wrist", hand, 0.02, _wrist(k)),
        (hand, k.twist, (-1.0, 0.0, 0.0), "gripper_body", tip, 0.015, _gripper(k)),
    )
    base = Inertia(k.masses[0], zero, (k.pan[0], 0.0, 0.8 * k.pan[1]), 0.03)
    links = [ShapeLink("base_link"), ShapeLink("base", _base(k), base)]
    joints = [ShapeJoint("base_mount", "base_link", "base")]
    for joint, mass, (place, twist, axis, name, end, radius, shapes) in zip(
        model.ranges, k.masses[1:], rows, strict=False
    ):
        limits = (joint.minimum, joint.maximum, _SPEED)
        parent = links[-1].name
        joints.append(
            ShapeJoint(joint.name, parent, name, place, (twist, 0.0, 0.0), axis, Drive(joint.name), limits)
        )
        links.append(ShapeLink(name, shapes, Inertia(mass, zero, end, radius)))
    parent = links[-1].name
    joints.append(ShapeJoint("tool_mount", parent, "tool", tip, (0.0, _HALF, 0.0)))
    joints.append(
        ShapeJoint(
            "gripper", parent, "jaw", k.jaw, zero, (0.0, -1.0, 0.0), Drive("gripper"), (*k.jaw_range, _SPEED)
        )
    )
    jaw = Inertia(k.masses[6], (0.0, k.finger[1], 0.0), k.finger, 0.005)
    links += [ShapeLink("tool"), ShapeLink("jaw", _jaw(k), jaw)]
    published = "and masses are published, inertias and shapes estimated"
    return ArmShapes(k.name, tuple(links), tuple(joints), "tool", k.source, published)


def _base(k: SoArmLinks) -> tuple[Shape, ...]:
    x = k.pan[0]
    return (
        box("plate", "print", (0.104, 0.074, 0.008), (x - 0.024, 0.0, 0.004)),
        box("tower", "print", (0.052, 0.05, _PIVOT - 0.012), (x - 0.006, 0.0, 0.5 * (_PIVOT - 0.012))),
        box("pan_servo", "servo", (0.0455, 0.0535, 0.026), (x - 0.01, 0.0, 0.034)),
        cylinder("pan_seat", "servo", 0.017, 0.016, (x, 0.0, _PIVOT - 0.011)),
        box("back", "print", (0.012, 0.066, 0.038), (x - 0.068, 0.0, 0.019)),
        box("board", "servo", (0.004, 0.048, 0.026), (x - 0.0755, 0.0, 0.021), solid=False),
        box("foot_left", "print", (0.03, 0.024, 0.007), (x + 0.012, 0.046, 0.0035)),
        box("foot_right", "print", (0.03, 0.024, 0.007), (x + 0.012, -0.046, 0.0035)),
    )


def _shoulder(k: SoArmLinks, axis: Vector) -> tuple[Shape, ...]:
    foot = _PIVOT - k.pan[1]
    rise = axis[2] - foot
    return (
        cylinder("pan_horn", "", 0.021, 0.006, (0.0, 0.0, foot), joint="shoulder_pan"),
        box("turn_plate", "print", (0.056, 0.046, 0.008), (0.008, 0.0, foot + 0.006)),
        box("bracket", "print", (0.026, 0.041, rise), (axis[0] - 0.024, 0.0, foot + 0.5 * rise + 0.004)),
        box("lift_servo", "servo", (0.0455, 0.037, 0.026), (axis[0] - 0.011, 0.0, axis[2])),
        box("lift_holder", "print", (0.02, 0.0405, 0.031), (axis[0] - 0.026, 0.0, axis[2])),
    )


def _segment(end: Vector, joint: str, forked: float) -> tuple[Shape, ...]:
    """A link from one servo to the next: a fork about the servo before it, and at its end a servo in a holder."""
    length = math.hypot(end[0], end[2])

    def at(distance: float, y: float = 0.0) -> Vector:
        return (end[0] * distance / length, y, end[2] * distance / length)

    fork = forked * length
    shapes = [cylinder("axle", "", 0.0095, 2 * _FORK + 0.0085, (0.0, 0.0, 0.0), "y", joint=joint)]
    for y, side in ((_FORK, "left"), (-_FORK, "right")):
        shapes += [
            bar(f"fork_{side}", "print", at(0.0, y), at(fork, y), 0.005, 0.026),
            cylinder(f"fork_end_{side}", "print", 0.0155, 0.005, (0.0, y, 0.0), "y"),
        ]
    return (
        *shapes,
        bar("web", "print", at(0.38 * fork + 0.014), at(fork), 2 * _FORK, 0.012),
        bar("holder", "print", at(fork - 0.006), at(length - 0.014), 0.041, 0.031),
        bar("servo", "servo", at(length - 0.0345), at(length + 0.011), 0.037, 0.026),
    )


def _wrist(k: SoArmLinks) -> tuple[Shape, ...]:
    end = k.hand - 0.006
    shapes = [cylinder("axle", "", 0.0095, 2 * _FORK + 0.0085, (0.0, 0.0, 0.0), "y", joint="wrist_flex")]
    for y, side in ((_FORK, "left"), (-_FORK, "right")):
        shapes += [
            box(f"fork_{side}", "print", (0.028, 0.005, 0.024), (0.014, y, 0.0)),
            cylinder(f"fork_end_{side}", "print", 0.0145, 0.005, (0.0, y, 0.0), "y"),
        ]
    return (
        *shapes,
        box("web", "print", (0.008, 2 * _FORK + 0.005, 0.03), (0.024, 0.0, 0.0)),
        box("roll_holder", "print", (0.012, 0.042, 0.036), (0.034, k.side, 0.0)),
        box("roll_servo", "servo", (end - 0.026, 0.037, 0.027), (0.5 * (end + 0.026), k.side, 0.004)),
    )


def _gripper(k: SoArmLinks) -> tuple[Shape, ...]:
    ahead, below, left = k.tip
    hinge = k.jaw
    tip = (ahead, left, -below)
    return (
        cylinder("roll_horn", "", 0.0165, 0.008, (-0.004, 0.0, 0.0), "x", joint="wrist_roll"),
        box("palm", "print", (0.008, 0.048, 0.052), (0.004, 0.0, 0.002)),
        box("jaw_servo", "servo", (0.034, 0.037, 0.026), (hinge[0] - 0.004, 0.0, hinge[2])),
        box("fixed_root", "print", (0.05, 0.044, 0.008), (0.028, 0.0, -0.02)),
        bar("fixed_jaw", "print", (0.05, left, -0.019), (tip[0] - 0.0015, left, tip[2] - 0.0035), 0.03, 0.007),
        bar("fixed_pad", "pad", (0.06, left, -0.0125), (tip[0], left, tip[2] - 0.001), 0.026, 0.002),
        box("fixed_side", "print", (0.044, 0.004, 0.02), (0.026, -0.022, -0.012)),
    )


def _jaw(k: SoArmLinks) -> tuple[Shape, ...]:
    x, y, z = k.finger
    aside = -k.jaw[1]
    knee = (0.042, aside, 0.006)
    return (
        cylinder("jaw_axle", "", 0.009, 0.0475, (0.0, aside, 0.0), "y", joint="gripper"),
        cylinder("jaw_hub_left", "print", 0.0145, 0.004, (0.0, aside + 0.0205, 0.0), "y"),
        cylinder("jaw_hub_right", "print", 0.0145, 0.004, (0.0, aside - 0.0205, 0.0), "y"),
        bar("jaw_arm_left", "print", (0.0, aside + 0.0205, 0.003), (0.03, aside + 0.0205, 0.006), 0.004, 0.02),
        bar("jaw_arm_right", "print", (0.0, aside - 0.0205, 0.003), (0.03, aside - 0.0205, 0.006), 0.004, 0.02),
        bar("jaw_bridge", "print", (0.022, aside, 0.007), knee, 0.045, 0.012),
        bar("jaw", "print", knee, (x - 0.001, y, z + 0.0035), 0.03, 0.007),
        bar("jaw_pad", "pad", (0.05, aside, -0.0015), (x, y, z + 0.001), 0.026, 0.002),
    )
