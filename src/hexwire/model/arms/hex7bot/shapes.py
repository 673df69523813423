"""What a Hex7Bot looks like, for any link set.

Owns joints and shapes. Places of joints follow from the link set; masses, and the sizes of everything that is not a
length of the link set, are estimates after pictures of the 7Bot family.

The forearm's servo sits at the shoulder: a crank there and a rod beside the upper arm keep the forearm's pitch.
They only follow J2 and J3, as the jaws follow J7. The jaws meet at the tool's tip.
"""

from __future__ import annotations

import math
from typing import Literal

from hexwire.model.arms.hex7bot.kinematics import Hex7BotModel
from hexwire.model.arms.hex7bot.links import LinkSet
from hexwire.model.pose import Vector
from hexwire.model.shapes import (
    ArmShapes,
    Drive,
    Inertia,
    Shape,
    ShapeJoint,
    ShapeLink,
    bar,
    box,
    cylinder,
    mirrored,
    rod,
)

__all__ = ["LEVEL_JOINT", "make_hex7bot_shapes"]

LEVEL_JOINT = "J2_level"
"""The mimic joint of the 7Bot: it keeps the elbow's frame level while J2 moves."""

_HALF = math.pi / 2
_JAW = math.radians(40.0)
"""How far each jaw turns from closed to open."""
_SHORTEST = 0.018
"""Metres from the wrist to the jaws' tips if the link set has less."""


def make_hex7bot_shapes(model: Hex7BotModel) -> ArmShapes:
    """The arm with the model's link set, and the directions and limits of its joints."""
    k = model.links
    reach = max(k.f, _SHORTEST)
    links = (
        ShapeLink("base_link"),
        ShapeLink("base", _base(k), Inertia(0.6, (0.0, 0.0, 0.0), (0.0, 0.0, 0.6 * k.e), 0.055)),
        ShapeLink("turret", _turret(k), Inertia(0.25, (0.0, 0.0, 0.7 * k.e), (k.d, 0.0, k.e), 0.03)),
        ShapeLink("upper_arm", _upper_arm(k), Inertia(0.20, (0.0, 0.0, 0.0), (0.0, 0.0, k.a), 0.015)),
        ShapeLink(
            "elbow",
            (cylinder("elbow_pin", "servo", 0.008, 0.07, (0.0, 0.0, 0.0), "y"),),
            Inertia(0.02, (0.0, -0.005, 0.0), (0.0, 0.005, 0.0), 0.012),
        ),
        ShapeLink("forearm", _forearm(k), Inertia(0.18, (0.0, 0.0, k.h), (0.8 * k.c, 0.0, k.h), 0.015)),
        ShapeLink("roll", _roll(), Inertia(0.04, (-0.01, 0.0, 0.0), (0.0, 0.0, 0.0), 0.012)),
        ShapeLink("hand", _hand(), Inertia(0.04, (0.0, 0.0, 0.0), (0.0, 0.0, 0.4 * k.f), 0.012)),
        ShapeLink("flange", _flange(), Inertia(0.03, (0.0, 0.0, 0.4 * k.f), (0.0, 0.0, k.f), 0.008)),
        ShapeLink("tool"),
        ShapeLink(
            "jaw_servo",
            (cylinder("jaw_horn", "", 0.004, 0.022, (0.0, 0.0, 0.0), "y", joint="J7"),),
            Inertia(0.01, (0.0, 0.0, 0.0), (0.0, 0.0, 0.5 * k.f), 0.003),
        ),
        ShapeLink("jaw_left", _jaw(reach, 1.0)),
        ShapeLink("jaw_right", _jaw(reach, -1.0)),
        ShapeLink("crank", _crank(k)),
        ShapeLink("crank_end"),
        ShapeLink("rod", (rod("rod", "jaw", (0.0, 0.0, 0.0), (0.0, 0.0, k.a), 0.003, solid=False),)),
    )
    source = f"link set {k.name}: {k.source or 'own'}"
    return ArmShapes("hex7bot", links, _joints(model), "tool", source, "are published, masses and shapes estimated")


def _joints(model: Hex7BotModel) -> tuple[ShapeJoint, ...]:
    k, joints = model.links, model.arm.joints

    def zero(i: int, neutral: float = 0.0) -> float:
        """Servo angle from `neutral` at which the driver's joint angle is zero."""
        return neutral - joints[i].sign * joints[i].offset

    def moving(
        i: int, parent: str, child: str, place: Vector, rpy: Vector, axis: Literal[0, 1, 2], sign: int
    ) -> ShapeJoint:
        joint = joints[i]
        limits = (joint.minimum, joint.maximum, joint.max_speed)
        return ShapeJoint(
            joint.name, parent, child, place, rpy, _axis(axis, sign * joint.sign), Drive(joint.name), limits
        )

    def following(
        name: str, parent: str, child: str, place: Vector, rpy: Vector, axis: Vector, drive: Drive
    ) -> ShapeJoint:
        lead = model.arm.joint(drive.joint)
        ends = sorted(drive.multiplier * end + drive.offset for end in (lead.minimum, lead.maximum))
        speed = abs(drive.multiplier) * lead.max_speed
        return ShapeJoint(name, parent, child, place, rpy, axis, drive, (ends[0], ends[1], speed))

    names = [joint.name for joint in joints]
    grip = joints[6]
    shoulder: Vector = (k.d, 0.0, k.e)
    lean, bend = (0.0, -zero(1), 0.0), (0.0, zero(2, _HALF - k.offset), 0.0)
    lean_axis, bend_axis = _axis(1, -joints[1].sign), _axis(1, joints[2].sign)
    # The upper limit of the gripper's joint is closed.
    share = _JAW / (grip.maximum - grip.minimum)
    opens = Drive(grip.name, -share, share * grip.maximum)
    # Signs: every joint turns like its servo angle, so J2 and J3 turn about -y and y, J4 about -x, J6 about -z.
    return (
        ShapeJoint("base_mount", "base_link", "base"),
        moving(0, "base", "turret", (0.0, 0.0, 0.0), (0.0, 0.0, zero(0, _HALF)), 2, 1),
        moving(1, "turret", "upper_arm", shoulder, lean, 1, -1),
        following(
            LEVEL_JOINT,
            "upper_arm",
            "elbow",
            (0.0, 0.0, k.a),
            (0.0, zero(1), 0.0),
            lean_axis,
            Drive(names[1], -1.0),
        ),
        moving(2, "elbow", "forearm", (0.0, 0.0, 0.0), bend, 1, 1),
        moving(3, "forearm", "roll", (k.c, 0.0, k.h), (-zero(3), 0.0, 0.0), 0, -1),
        moving(4, "roll", "hand", (0.0, 0.0, 0.0), (0.0, zero(4, _HALF), 0.0), 1, 1),
        moving(5, "hand", "flange", (0.0, 0.0, 0.0), (0.0, 0.0, -zero(5, _HALF)), 2, -1),
        ShapeJoint("tool_mount", "flange", "tool", (0.0, 0.0, k.f)),
        ShapeJoint(
            grip.name,
            "flange",
            "jaw_servo",
            (0.0, 0.0, 0.0085),
            (0.0, zero(6), 0.0),
            (0.0, 1.0, 0.0),
            Drive(grip.name),
            (grip.minimum, grip.maximum, grip.max_speed),
        ),
        following("J7_left", "flange", "jaw_left", (_LUG, 0.0, _HINGE), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0), opens),
        following(
            "J7_right", "flange", "jaw_right", (-_LUG, 0.0, _HINGE), (0.0, 0.0, 0.0), (0.0, -1.0, 0.0), opens
        ),
        following("J3_crank", "turret", "crank", shoulder, bend, bend_axis, Drive(names[2])),
        following(
            "J3_level",
            "crank",
            "crank_end",
            (-_crank_length(k), 0.0, 0.0),
            (0.0, -bend[1], 0.0),
            bend_axis,
            Drive(names[2], -1.0),
        ),
        following("J2_rod", "crank_end", "rod", (0.0, 0.0, 0.0), lean, lean_axis, Drive(names[1])),
    )


# -- shapes ---------------------------------------------------------------------------------------------------

_HINGE = 0.004
"""The jaws' hinges from the wrist along the tool, metres."""
_LUG = 0.019
"""The jaws' hinges from the tool's axis, metres."""


def _crank_length(k: LinkSet) -> float:
    return max(k.b, 0.001)


def _height(k: LinkSet) -> float:
    return max(k.e, 0.01)


def _base(k: LinkSet) -> tuple[Shape, ...]:
    top = 0.45 * _height(k)
    return (
        cylinder("foot", "servo", 0.064, 0.008, (0.0, 0.0, 0.004)),
        cylinder("drum", "base", 0.054, top, (0.0, 0.0, 0.5 * top)),
        box("plug", "servo", (0.022, 0.03, 0.5 * top), (-0.05, 0.0, 0.5 * top), solid=False),
    )


def _turret(k: LinkSet) -> tuple[Shape, ...]:
    low, high = 0.45 * _height(k), 0.6 * _height(k)
    rise = _height(k) - high
    shapes = [
        cylinder("ring", "", 0.055, 0.15 * _height(k), (0.0, 0.0, low + 0.05 * _height(k)), joint="J1"),
        cylinder("table", "frame", 0.049, 0.1 * _height(k) + 1e-6, (0.0, 0.0, high - 0.05 * _height(k))),
        box("deck", "frame", (0.072 + k.d, 0.062, 0.006), (0.5 * k.d, 0.0, high)),
    ]
    for side, name in ((1.0, "left"), (-1.0, "right")):
        y = 0.024 * side
        shapes += [
            box(f"cheek_{name}", "frame", (0.044, 0.004, rise), (k.d, y, high + 0.5 * rise)),
            cylinder(f"cheek_top_{name}", "frame", 0.022, 0.004, (k.d, y, k.e), "y"),
            box(f"servo_{name}", "servo", (0.036, 0.017, 0.03), (k.d - 0.006, 0.0135 * side, k.e - 0.006)),
        ]
    return tuple(shapes)


def _upper_arm(k: LinkSet) -> tuple[Shape, ...]:
    shapes = [
        cylinder("shoulder_axle", "", 0.0125, 0.072, (0.0, 0.0, 0.0), "y", joint="J2"),
        rod("brace", "base", (0.0, -0.03, 0.5 * k.a), (0.0, 0.03, 0.5 * k.a), 0.0065),
    ]
    for y, name in ((0.03, "left"), (-0.03, "right")):
        shapes += [
            box(f"plate_{name}", "frame", (0.024, 0.005, k.a), (0.0, y, 0.5 * k.a)),
            cylinder(f"plate_low_{name}", "frame", 0.018, 0.005, (0.0, y, 0.0), "y"),
            cylinder(f"plate_high_{name}", "frame", 0.0155, 0.005, (0.0, y, k.a), "y"),
        ]
    return tuple(shapes)


def _forearm(k: LinkSet) -> tuple[Shape, ...]:
    lever, front = _crank_length(k), k.c - _WRIST
    shapes = [
        cylinder("elbow_axle", "", 0.011, 0.072, (0.0, 0.0, 0.0), "y", joint="J3"),
        box("lever", "jaw", (lever, 0.006, 0.012), (-0.5 * lever, 0.0, 0.0), solid=False),
        cylinder("lever_pin", "servo", 0.006, 0.012, (-lever, 0.0, 0.0), "y", solid=False),
        # The beam is beside the elbow by h: the plates carry it there.
        box("beam", "frame", (0.66 * k.c, 0.034, 0.026), (0.21 * k.c, 0.0, k.h)),
        box("beam_back", "servo", (0.024, 0.038, 0.03), (-0.12 * k.c - 0.006, 0.0, k.h)),
        rod("tube", "base", (0.5 * k.c, 0.0, k.h), (front - 0.004, 0.0, k.h), 0.0145),
        box("wrist_servo", "servo", (0.034, 0.028, 0.036), (front - 0.0165, 0.0, k.h)),
    ]
    rise = k.h + 0.013
    for y, name in ((0.0195, "left"), (-0.0195, "right")):
        shapes += [
            box(f"plate_{name}", "frame", (0.03, 0.005, rise), (0.0, y, 0.5 * rise)),
            cylinder(f"plate_end_{name}", "frame", 0.015, 0.005, (0.0, y, 0.0), "y"),
        ]
    return tuple(shapes)


_WRIST = 0.036
"""From the end of the forearm to the centre of the wrist, metres."""


def _roll() -> tuple[Shape, ...]:
    shapes = [
        cylinder("collar", "", 0.0155, 0.009, (0.0045 - _WRIST, 0.0, 0.0), "x", joint="J4"),
        box("fork_base", "frame", (0.006, 0.038, 0.02), (-0.026, 0.0, 0.0)),
    ]
    for y, name in ((0.0165, "left"), (-0.0165, "right")):
        shapes += [
            box(f"fork_{name}", "frame", (0.028, 0.004, 0.016), (-0.014, y, 0.0)),
            cylinder(f"fork_end_{name}", "frame", 0.01, 0.004, (0.0, y, 0.0), "y"),
        ]
    return tuple(shapes)


def _hand() -> tuple[Shape, ...]:
    return (
        cylinder("hand_axle", "", 0.0065, 0.042, (0.0, 0.0, 0.0), "y", joint="J5"),
        box("hand", "servo", (0.02, 0.026, 0.018), (0.0, 0.0, -0.004)),
    )


def _flange() -> tuple[Shape, ...]:
    return (
        cylinder("flange", "", 0.011, 0.004, (0.0, 0.0, 0.004), joint="J6"),
        box("palm", "base", (2 * _LUG, 0.018, 0.006), (0.0, 0.0, 0.0085)),
        cylinder("hinge_left", "base", 0.005, 0.018, (_LUG, 0.0, _HINGE), "y"),
        cylinder("hinge_right", "base", 0.005, 0.018, (-_LUG, 0.0, _HINGE), "y"),
    )


def _jaw(reach: float, side: float) -> tuple[Shape, ...]:
    """A jaw in the frame of its hinge, when closed; `side` is 1 for the one at positive x."""
    top, knee = reach - _HINGE, 0.45 * (reach - _HINGE)
    bow = (0.0025, 0.0, knee)
    mine = {
        "leg": bar("leg", "jaw", (0.0, 0.0, 0.0), bow, 0.016, 0.007),
        "finger": bar("finger", "jaw", bow, (0.004 - _LUG, 0.0, top), 0.014, 0.006),
        "pad": box("pad", "pad", (0.0022, 0.013, 0.006), (0.0012 - _LUG, 0.0, top - 0.003)),
    }
    return tuple(shape if side > 0 else mirrored(shape) for shape in mine.values())


def _crank(k: LinkSet) -> tuple[Shape, ...]:
    length = _crank_length(k)
    return (
        cylinder("crank_hub", "servo", 0.01, 0.009, (0.0, 0.0, 0.0), "y", solid=False),
        box("crank", "jaw", (length, 0.006, 0.012), (-0.5 * length, 0.0, 0.0), solid=False),
        cylinder("crank_pin", "servo", 0.006, 0.012, (-length, 0.0, 0.0), "y", solid=False),
    )


def _axis(i: int, sign: int) -> Vector:
    x, y, z = (float(sign) * (i == n) + 0.0 for n in range(3))
    return (x, y, z)
