"""URDF files of the arms, from the same shapes as every other picture of them.

Owns the format. The joints are those of the driver, so joint states apply without conversion. Joints that only
follow others mimic them: the 7Bot's parallelogram, its crank and rod, and its two jaws. Lengths are published, and
masses of the SO-100 and SO-101; other masses, and all shapes, are estimates. Returns text and must not know files.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from .geometry import make_shapes
from .palette import joint_colour
from .shapes import COLOURS, ArmShapes, Inertia, Shape, ShapeJoint

if TYPE_CHECKING:
    from .kinematics import KinematicModel

__all__ = ["ROOT_LINK", "TIP_LINK", "make_urdf"]

ROOT_LINK = "base_link"
"""The root frame of an arm by REP-105. Without mass, since ROS's kinematics library accepts none in a root link."""
TIP_LINK = "tool"
"""The link whose frame is the pose of the kinematics."""

# Torques are not published; only the stall torque of the small servos, 6 kg.cm, is known.
_EFFORT = 3.0


def make_urdf(model: KinematicModel) -> str:
    """The URDF text of an arm.

    Raises:
        UsageError: No shapes are known for this model.
    """
    shapes = make_shapes(model)
    joints = {joint.child: joint for joint in shapes.joints}
    rows = [
        '<?xml version="1.0"?>',
        f"<!-- Made by 'hexwire model urdf'; {shapes.source.replace('--', '-')}.",
        f"     Lengths {shapes.published}. -->",
        f'<robot name="{shapes.name}">',
        *_materials(shapes),
    ]
    for link in shapes.links:
        if link.name in joints:
            rows += _joint(joints[link.name])
        parts = [
            *([_inertial(link.inertia)] if link.inertia is not None else []),
            *(_part("visual", shape, material=True) for shape in link.shapes),
            *(_part("collision", shape) for shape in link.shapes if shape.solid),
        ]
        rows += (
            [f'  <link name="{link.name}">', *parts, "  </link>"] if parts else [f'  <link name="{link.name}"/>']
        )
    return "\n".join([*rows, "</robot>", ""])


def _materials(shapes: ArmShapes) -> list[str]:
    colours = {name: light for name, (light, _) in COLOURS.items()}
    colours |= {name: joint_colour(i) for i, name in enumerate(shapes.driven)}
    used = {_material(shape) for link in shapes.links for shape in link.shapes}
    return [
        f'  <material name="{name}"><color rgba="{_rgba(colour)}"/></material>'
        for name, colour in colours.items()
        if name in used
    ]


def _material(shape: Shape) -> str:
    return shape.joint or shape.colour


def _rgba(colour: str) -> str:
    return " ".join(f"{int(colour[i : i + 2], 16) / 255:.4g}" for i in (1, 3, 5)) + " 1"


def _part(kind: str, shape: Shape, *, material: bool = False) -> str:
    origin = f'<origin xyz="{_three(shape.place)}" rpy="{_three(shape.rpy)}"/>'
    size = [_n(number) for number in shape.size]
    if shape.kind == "box":
        form = f'<box size="{" ".join(size)}"/>'
    elif shape.kind == "cylinder":
        form = f'<cylinder radius="{size[0]}" length="{size[1]}"/>'
    else:
        form = f'<sphere radius="{size[0]}"/>'
    colour = f'<material name="{_material(shape)}"/>' if material else ""
    return f"    <{kind}>{origin}<geometry>{form}</geometry>{colour}</{kind}>"


def _inertial(inertia: Inertia) -> str:
    across, along = inertia.moments
    middle, rpy = inertia.frame
    diagonal = f'ixx="{_n(across)}" iyy="{_n(across)}" izz="{_n(along)}" ixy="0" ixz="0" iyz="0"'
    origin = f'<origin xyz="{_three(middle)}" rpy="{_three(rpy)}"/>'
    return f'    <inertial>{origin}<mass value="{_n(inertia.mass)}"/><inertia {diagonal}/></inertial>'


def _joint(joint: ShapeJoint) -> list[str]:
    rows = [
        f'  <joint name="{joint.name}" type="{"fixed" if joint.axis is None else "revolute"}">',
        f'    <parent link="{joint.parent}"/><child link="{joint.child}"/>',
        f'    <origin xyz="{_three(joint.place)}" rpy="{_three(joint.rpy)}"/>',
    ]
    if joint.axis is not None and joint.drive is not None:
        low, high, speed = joint.limits
        rows += [
            f'    <axis xyz="{_three(joint.axis)}"/>',
            f'    <limit lower="{_n(low)}" upper="{_n(high)}" velocity="{_n(speed)}" effort="{_n(_EFFORT)}"/>',
            '    <dynamics damping="0.05" friction="0.02"/>',
        ]
        if joint.follows:
            lead = joint.drive
            numbers = f'multiplier="{_n(lead.multiplier)}" offset="{_n(lead.offset)}"'
            rows.append(f'    <mimic joint="{lead.joint}" {numbers}/>')
    return [*rows, "  </joint>"]


def _three(v: Iterable[float]) -> str:
    return " ".join(_n(x) for x in v)


def _n(value: float) -> str:
    """All significant digits: the poses must agree except for rounding."""
    return repr(value + 0.0)
