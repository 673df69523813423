"""What a PUMA 260 looks like: a column, a drum at the shoulder, an arm beside it, a wrist, a flange without a tool.

Owns joints and shapes. Places of joints are those of the kinematics; sizes of parts are estimates after pictures.
"""

from __future__ import annotations

from hexwire.model.arms.puma260.kinematics import PUMA260
from hexwire.model.arms.puma260.links import DROP, FLANGE, FOREARM, SHOULDER, SIDE, UPPER
from hexwire.model.pose import Vector
from hexwire.model.shapes import ArmShapes, Drive, Inertia, Shape, ShapeJoint, ShapeLink, bar, box, cylinder

__all__ = ["make_puma260_shapes"]

_ZERO: Vector = (0.0, 0.0, 0.0)
_COLUMN = 0.2
"""Height of the part of the column that stands still, metres."""


def make_puma260_shapes() -> ArmShapes:
    """The arm."""
    rows: tuple[tuple[Vector, Vector, str, Inertia, tuple[Shape, ...]], ...] = (
        (_ZERO, (0.0, 0.0, 1.0), "trunk", Inertia(2.0, (0.0, 0.0, 0.05), (0.0, 0.0, SHOULDER), 0.05), _trunk()),
        (
            (0.0, 0.0, SHOULDER),
            (0.0, 1.0, 0.0),
            "upper_arm",
            Inertia(1.5, (0.0, SIDE, 0.0), (UPPER, SIDE, DROP), 0.03),
            _upper_arm(),
        ),
        (
            (UPPER, SIDE, DROP),
            (0.0, 1.0, 0.0),
            "forearm",
            Inertia(0.8, _ZERO, (0.0, 0.0, -0.8 * FOREARM), 0.025),
            _forearm(),
        ),
        ((0.0, 0.0, -FOREARM), (0.0, 0.0, 1.0), "roll", Inertia(0.1, (0.0, 0.0, 0.01), _ZERO, 0.02), _roll()),
        (_ZERO, (0.0, 1.0, 0.0), "hand", Inertia(0.1, _ZERO, (0.01, 0.0, 0.0), 0.018), _hand()),
        (_ZERO, (1.0, 0.0, 0.0), "flange", Inertia(0.1, (0.02, 0.0, 0.0), (FLANGE, 0.0, 0.0), 0.015), _flange()),
    )
    links = [ShapeLink("base_link"), ShapeLink("base", _base(), Inertia(4.0, _ZERO, (0.0, 0.0, 0.05), 0.08))]
    joints = [ShapeJoint("base_mount", "base_link", "base")]
    for joint, (place, axis, name, inertia, shapes) in zip(PUMA260.joints, rows, strict=True):
        limits = (joint.minimum, joint.maximum, joint.max_speed)
        joints.append(ShapeJoint(joint.name, links[-1].name, name, place, _ZERO, axis, Drive(joint.name), limits))
        links.append(ShapeLink(name, shapes, inertia))
    joints.append(ShapeJoint("tool_mount", links[-1].name, "tool", (FLANGE, 0.0, 0.0)))
    source = "model: see hexwire.model.arms.puma260.kinematics"
    published = "are published, masses and shapes estimated"
    return ArmShapes("puma260", (*links, ShapeLink("tool")), tuple(joints), "tool", source, published)


def _base() -> tuple[Shape, ...]:
    return (
        box("foot", "servo", (0.17, 0.17, 0.016), (0.0, 0.0, 0.008)),
        cylinder("column", "paint", 0.062, _COLUMN - 0.016, (0.0, 0.0, 0.5 * (_COLUMN + 0.016))),
        box("plug", "servo", (0.03, 0.05, 0.05), (-0.066, 0.0, 0.05), solid=False),
    )


def _trunk() -> tuple[Shape, ...]:
    return (
        cylinder("ring", "", 0.063, 0.012, (0.0, 0.0, _COLUMN + 0.006), joint="J1"),
        cylinder(
            "neck", "paint", 0.052, SHOULDER - _COLUMN - 0.012, (0.0, 0.0, 0.5 * (SHOULDER + _COLUMN + 0.012))
        ),
        cylinder("drum", "paint", 0.057, 0.148, (0.0, 0.012, SHOULDER), "y"),
        cylinder("drum_back", "base", 0.05, 0.012, (0.0, 0.092, SHOULDER), "y"),
    )


def _upper_arm() -> tuple[Shape, ...]:
    return (
        cylinder("shoulder_ring", "", 0.055, 0.01, (0.0, -0.067, 0.0), "y", joint="J2"),
        cylinder("shoulder_cap", "paint", 0.052, 0.062, (0.0, -0.1025, 0.0), "y"),
        bar("beam", "paint", (-0.07, SIDE + 0.012, 0.0067), (UPPER, SIDE + 0.012, DROP), 0.046, 0.072),
        cylinder("beam_end", "paint", 0.036, 0.046, (UPPER, SIDE + 0.012, DROP), "y"),
        bar("motors", "base", (-0.1, SIDE + 0.012, 0.0096), (-0.06, SIDE + 0.012, 0.0058), 0.04, 0.06),
    )


def _forearm() -> tuple[Shape, ...]:
    y = -0.034
    end = -FOREARM + 0.045
    return (
        cylinder("elbow_ring", "", 0.034, 0.01, (0.0, -0.016, 0.0), "y", joint="J3"),
        cylinder("elbow_cap", "paint", 0.034, 0.032, (0.0, y, 0.0), "y"),
        bar("beam", "paint", (0.0, y, 0.0), (0.0, y, end - 0.01), 0.032, 0.05),
        box("wrist_bracket", "paint", (0.048, 0.07, 0.02), (0.0, -0.015, end)),
    )


def _roll() -> tuple[Shape, ...]:
    return (
        cylinder("roll_ring", "", 0.022, 0.012, (0.0, 0.0, 0.031), joint="J4"),
        box("fork_base", "base", (0.03, 0.05, 0.008), (0.0, 0.0, 0.022)),
        box("fork_left", "base", (0.03, 0.006, 0.034), (0.0, 0.022, 0.006)),
        box("fork_right", "base", (0.03, 0.006, 0.034), (0.0, -0.022, 0.006)),
    )


def _hand() -> tuple[Shape, ...]:
    return (
        cylinder("hand_axle", "", 0.0095, 0.054, _ZERO, "y", joint="J5"),
        box("hand", "paint", (0.036, 0.036, 0.03), (0.004, 0.0, 0.0)),
    )


def _flange() -> tuple[Shape, ...]:
    return (
        cylinder("neck", "base", 0.011, FLANGE - 0.026, (0.5 * (FLANGE + 0.014), 0.0, 0.0), "x"),
        cylinder("flange", "", 0.021, 0.008, (FLANGE - 0.004, 0.0, 0.0), "x", joint="J6"),
    )
