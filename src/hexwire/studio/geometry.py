"""An arm's shapes for the browser's 3D view, as plain values that become JSON.

Owns the format, which `static/arm3d.js` reads. Must not know pages.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

from hexwire.model.geometry import kinematics_for, make_shapes
from hexwire.model.palette import DARK, LIGHT
from hexwire.model.pose import quaternion, rotation_from_rpy
from hexwire.model.shapes import COLOURS, Shape, rod

if TYPE_CHECKING:
    from hexwire.model.arm import ArmModel
    from hexwire.model.kinematics import KinematicModel
    from hexwire.model.pose import Vector
    from hexwire.model.shapes import ArmShapes, Drive, ShapeJoint
    from hexwire.model.urdf_robot import UrdfJoint, UrdfRobot, UrdfVisual

__all__ = ["make_geometry", "make_turns", "make_urdf_geometry"]

_DIGITS = 7
"""Of metres and of quaternions: a ten-thousandth of a millimetre, at a third of the bytes."""


def make_geometry(arm: ArmModel, links: str = "A") -> dict[str, Any] | None:
    """The 3D geometry of an arm, or None for an arm whose lengths are unknown, such as a plain chain.

    The frame is that of the kinematics: z up, z = 0 at the foot. Lengths are metres, angles radians, quaternions
    x, y, z, w. Each link has its parent's index (-1 for the first), the place and turn of its frame in the frame of
    its parent, and, if a joint moves it, the axis and how the joint's position becomes its angle: ``multiplier``
    times the position of joint number ``joint`` plus ``offset``.

    Args:
        arm: The arm with its own limits.
        links: Link set of a 7Bot, as in `make_kinematics`.

    Raises:
        UsageError: The link set is unknown or wrong.
    """
    model = kinematics_for(arm, links)
    if model is None:
        return None
    shapes = make_shapes(model)
    order = {name: i for i, name in enumerate(arm.names)}
    joints = {joint.child: joint for joint in shapes.joints}
    # A parent comes before its children.
    rows = sorted((link.name for link in shapes.links), key=lambda name: _depth(shapes, name))
    place = {name: i for i, name in enumerate(rows)}
    return {
        "name": arm.name,
        **_common(arm),
        "links": [
            {
                "name": name,
                **_frame(joints.get(name), place, order),
                "shapes": [_shape(shape, order) for shape in shapes.link(name).shapes],
            }
            for name in rows
        ],
        "tip": place[shapes.tip],
        "heading": _round(shapes.heading),
        "reach": _round(shapes.reach),
    }


def make_urdf_geometry(robot: UrdfRobot, arm: ArmModel, meshes: Mapping[str, tuple[int, str]]) -> dict[str, Any]:
    """The 3D geometry of a robot's URDF, as `make_geometry`.

    A link may have ``meshes``, each with its number, kind and scale, and what is drawn in their place while one of
    them is missing, ``plain``: rods to the joints of the link. Shapes and meshes have an ``rgb`` of their own. A
    link with ``slides`` moves along its axis.

    Args:
        robot: The robot.
        arm: The arm whose joints move it, by their names.
        meshes: Number and kind of each mesh that pages may load, by its address.
    """
    order = {name: i for i, name in enumerate(arm.names)}
    place = {link.name: i for i, link in enumerate(robot.links)}
    joints = {joint.child: joint for joint in robot.joints}
    depths, distances = [0] * len(place), [0.0] * len(place)
    for name, i in place.items():
        if (joint := joints.get(name)) is not None:
            parent = place[joint.parent]
            depths[i] = depths[parent] + (joint.drive.joint in order)
            distances[i] = distances[parent] + math.hypot(*joint.place)
    reach = min(max(*distances, 0.05), 20.0)
    rows = []
    for link in robot.links:
        found = [(meshes.get(visual.file), visual) for visual in link.visuals if visual.kind == "mesh"]
        plain = [
            _shape(rod(joint.name, "frame", (0.0, 0.0, 0.0), joint.place, 0.03 * reach), order)
            for joint in robot.joints
            if found and joint.parent == link.name and math.hypot(*joint.place) > 1e-6
        ]
        # A leaf has no rod: a ball shows where it is.
        if found and not plain:
            plain = [_shape(Shape(link.name, "sphere", (0.03 * reach,), "frame", (0.0, 0.0, 0.0)), order)]
        lost = any(number is None for number, _ in found)
        rows.append(
            {
                "name": link.name,
                **_urdf_frame(joints.get(link.name), place, order),
                "shapes": [_visual(row) for row in link.visuals if row.kind != "mesh"] + (plain if lost else []),
                "plain": [] if lost else plain,
                "meshes": [
                    _visual(row) | {"mesh": number[0], "kind": number[1]}
                    for number, row in found
                    if number is not None
                ],
            }
        )
    return {
        "name": arm.name,
        **_common(arm),
        "links": rows,
        # The last link of the longest chain.
        "tip": max(range(len(rows)), key=lambda i: (depths[i], distances[i])),
        "heading": 0.0,
        "reach": _round(reach),
    }


def _urdf_frame(joint: UrdfJoint | None, place: Mapping[str, int], order: Mapping[str, int]) -> dict[str, Any]:
    frame = _rest(joint, place)
    if joint is not None and joint.axis is not None and joint.drive.joint in order:
        frame |= _motion(joint.axis, joint.drive, order) | {"slides": joint.slides}
    return frame


def _visual(visual: UrdfVisual) -> dict[str, Any]:
    return {
        "kind": visual.kind,
        "size": _rounded(visual.size),
        "place": _rounded(visual.place),
        "turn": _rounded(quaternion(rotation_from_rpy(*visual.rpy))),
        "rgb": visual.colour,
    }


def _common(arm: ArmModel) -> dict[str, Any]:
    """What every picture of an arm has: its joints, and colours."""
    return {
        "joints": [
            {"name": joint.name, "minimum": _round(joint.minimum), "maximum": _round(joint.maximum)}
            for joint in arm.joints
        ],
        "colours": {theme: {name: pair[i] for name, pair in COLOURS.items()} for i, theme in enumerate(_THEMES)},
        "palette": dict(zip(_THEMES, (LIGHT, DARK), strict=True)),
    }


_THEMES = ("light", "dark")


def make_turns(arm: ArmModel, kinematics: KinematicModel) -> list[dict[str, Any]] | None:
    """How a browser computes pitch and roll of the tool in each frame: both are sums of joint angles.

    Returns:
        Pitch, then roll, each with an ``offset`` in radians and its ``factors`` by place of the joint in the arm;
        None for an arm that aims its tool by other angles.
    """
    n = len(kinematics.ranges)
    zero = kinematics.pitch_and_roll([0.0] * n)
    if zero is None:
        return None
    ones = [kinematics.pitch_and_roll([float(i == k) for k in range(n)]) or zero for i in range(n)]
    places = [arm.index(name) for name in kinematics.joint_names]
    return [
        {"offset": zero[row], "factors": {places[i]: one[row] - zero[row] for i, one in enumerate(ones)}}
        for row in range(2)
    ]


def _frame(joint: ShapeJoint | None, place: Mapping[str, int], order: Mapping[str, int]) -> dict[str, Any]:
    frame = _rest(joint, place)
    if joint is not None and joint.axis is not None and joint.drive is not None:
        frame |= _motion(joint.axis, joint.drive, order)
    return frame


def _rest(joint: ShapeJoint | UrdfJoint | None, place: Mapping[str, int]) -> dict[str, Any]:
    """Where the frame of the link behind a joint is at position 0."""
    if joint is None:
        return {"parent": -1, "place": [0.0] * 3, "turn": [0.0, 0.0, 0.0, 1.0]}
    return {
        "parent": place[joint.parent],
        "place": _rounded(joint.place),
        "turn": _rounded(quaternion(rotation_from_rpy(*joint.rpy))),
    }


def _motion(axis: Vector, drive: Drive, order: Mapping[str, int]) -> dict[str, Any]:
    """How a joint of the arm moves that frame."""
    return {
        "axis": list(axis),
        "joint": order[drive.joint],
        "multiplier": drive.multiplier,
        "offset": drive.offset,
    }


def _shape(shape: Shape, order: Mapping[str, int]) -> dict[str, Any]:
    colour = {"joint": order[shape.joint]} if shape.colour == "joint" else {"colour": shape.colour}
    return {
        "kind": shape.kind,
        "size": _rounded(shape.size),
        "place": _rounded(shape.place),
        "turn": _rounded(quaternion(shape.rotation)),
        **colour,
    }


def _depth(shapes: ArmShapes, name: str) -> int:
    parents = {joint.child: joint.parent for joint in shapes.joints}
    depth = 0
    while name in parents:
        name, depth = parents[name], depth + 1
    return depth


def _rounded(values: Iterable[float]) -> list[float]:
    return [_round(value) for value in values]


def _round(value: float) -> float:
    return round(value, _DIGITS) + 0.0
