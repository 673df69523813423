"""URDF files of the arms, from the same constants as their kinematics.

Owns the format. The joints are those of the driver, so joint states apply without conversion. The 7Bot's
parallelogram is a joint that mimics J2 with the multiplier -1. Lengths are published, and masses of the SO-100 and
SO-101; other masses, and all shapes, are estimates for a simulation. Returns text and must not know files.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field

from hexwire.errors import UsageError

from . import puma260, puma260_links
from .hex7bot_kinematics import Hex7BotModel
from .kinematics import KinematicModel
from .pose import Vector
from .so_arm import SoArmModel

__all__ = ["LEVEL_JOINT", "ROOT_LINK", "TIP_LINK", "make_urdf"]

LEVEL_JOINT = "J2_level"
"""The mimic joint of the 7Bot: it keeps the elbow's frame level while J2 moves."""
ROOT_LINK = "base_link"
"""The root frame of an arm by REP-105. Without mass, since ROS's kinematics library accepts none in a root link."""
TIP_LINK = "tool"
"""The link whose frame is the pose of the kinematics."""

_HALF = math.pi / 2
_GREYS = (("dark", 0.45), ("light", 0.8))
# Torques are not published; only the stall torque of the small servos, 6 kg.cm, is known.
_EFFORT = 3.0
_SO_SPEED = math.pi


@dataclass
class _Writer:
    rows: list[str] = field(default_factory=list)
    links: int = 0

    def link(self, name: str, mass: float, start: Vector, end: Vector, radius: float) -> None:
        """A link that is a rod from `start` to `end`, metres and kilograms."""
        length = max(math.dist(start, end), 1e-3)
        middle = tuple((a + b) / 2 for a, b in zip(start, end, strict=True))
        along = tuple((b - a) / length for a, b in zip(start, end, strict=True))
        # Yaw and pitch that turn the z axis along the rod.
        pitch = math.atan2(math.hypot(along[0], along[1]), along[2]) if any(along) else 0.0
        yaw = math.atan2(along[1], along[0]) if any(along[:2]) else 0.0
        origin = f'<origin xyz="{_three(middle)}" rpy="{_three((0.0, pitch, yaw))}"/>'
        across = mass * (3 * radius**2 + length**2) / 12
        diagonal = f'ixx="{_n(across)}" iyy="{_n(across)}" izz="{_n(mass * radius**2 / 2)}"'
        inertia = f'<inertia {diagonal} ixy="0" ixz="0" iyz="0"/>'
        shape = f'<geometry><cylinder radius="{_n(radius)}" length="{_n(length)}"/></geometry>'
        # Alternating, so that adjacent links can be distinguished.
        shade, value = _GREYS[self.links % 2]
        colour = f'<material name="{shade}"><color rgba="{value} {value} {value} 1"/></material>'
        self.links += 1
        self.rows += [
            f'  <link name="{name}">',
            f'    <inertial>{origin}<mass value="{_n(mass)}"/>{inertia}</inertial>',
            f"    <visual>{origin}{shape}{colour}</visual>",
            f"    <collision>{origin}{shape}</collision>",
            "  </link>",
        ]

    def frame(self, name: str) -> None:
        """A link without mass."""
        self.rows.append(f'  <link name="{name}"/>')

    def joint(
        self,
        name: str,
        parent: str,
        child: str,
        xyz: Vector,
        rpy: Vector = (0.0, 0.0, 0.0),
        axis: Vector | None = None,
        limits: tuple[float, float, float] = (0.0, 0.0, 0.0),
        mimic: str = "",
    ) -> None:
        kind = "fixed" if axis is None else "revolute"
        self.rows += [
            f'  <joint name="{name}" type="{kind}">',
            f'    <parent link="{parent}"/><child link="{child}"/>',
            f'    <origin xyz="{_three(xyz)}" rpy="{_three(rpy)}"/>',
        ]
        if axis is not None:
            low, high, speed = limits
            self.rows += [
                f'    <axis xyz="{_three(axis)}"/>',
                f'    <limit lower="{_n(low)}" upper="{_n(high)}" velocity="{_n(speed)}" effort="{_n(_EFFORT)}"/>',
                '    <dynamics damping="0.05" friction="0.02"/>',
            ]
        self.rows += [mimic] if mimic else []
        self.rows.append("  </joint>")


def make_urdf(model: KinematicModel) -> str:
    """The URDF text of an arm.

    Raises:
        UsageError: There is no URDF for this model.
    """
    writer = _Writer()
    writer.frame(ROOT_LINK)
    writer.joint("base_mount", ROOT_LINK, "base", (0.0, 0.0, 0.0))
    masses = "are published, masses estimated"
    if isinstance(model, Hex7BotModel):
        _hex7bot(writer, model)
        remark = f"link set {model.links.name}: {model.links.source or 'own'}"
    elif isinstance(model, puma260.Puma260Model):
        _puma260(writer)
        remark = "model: see hexwire.model.puma260"
    elif isinstance(model, SoArmModel):
        _so_arm(writer, model)
        remark, masses = model.links.source, "and masses published, inertias estimated"
    else:
        raise UsageError(f"there is no URDF for {model.name}")
    head = [
        '<?xml version="1.0"?>',
        f"<!-- Made by 'hexwire model urdf'; {remark.replace('--', '-')}.",
        f"     Lengths {masses}. -->",
        f'<robot name="{model.name}">',
    ]
    return "\n".join([*head, *writer.rows, "</robot>", ""])


def _hex7bot(out: _Writer, model: Hex7BotModel) -> None:
    k = model.links
    joints = model.arm.joints

    def limits(i: int) -> tuple[float, float, float]:
        return joints[i].minimum, joints[i].maximum, joints[i].max_speed

    def zero(i: int, neutral: float = 0.0) -> float:
        """Servo angle from `neutral` at which the driver's joint angle is zero."""
        return neutral - joints[i].sign * joints[i].offset

    out.link("base", 0.6, (0.0, 0.0, 0.0), (0.0, 0.0, 0.6 * k.e), 0.055)
    # Signs: every joint turns like its servo angle, so J2 and J3 turn about -y and y, J4 about -x, J6 about -z.
    out.joint(
        "J1", "base", "turret", (0.0, 0.0, 0.0), (0.0, 0.0, zero(0, _HALF)), _axis(2, joints[0].sign), limits(0)
    )
    out.link("turret", 0.25, (0.0, 0.0, 0.7 * k.e), (k.d, 0.0, k.e), 0.03)
    out.joint(
        "J2", "turret", "upper_arm", (k.d, 0.0, k.e), (0.0, -zero(1), 0.0), _axis(1, -joints[1].sign), limits(1)
    )
    out.link("upper_arm", 0.20, (0.0, 0.0, 0.0), (0.0, 0.0, k.a), 0.015)
    low, high, speed = limits(1)
    level = (-high, -low, speed)
    mimic = '    <mimic joint="J2" multiplier="-1" offset="0"/>'
    pitch = (0.0, zero(1), 0.0)
    out.joint(LEVEL_JOINT, "upper_arm", "elbow", (0.0, 0.0, k.a), pitch, _axis(1, -joints[1].sign), level, mimic)
    out.link("elbow", 0.02, (0.0, -0.005, 0.0), (0.0, 0.005, 0.0), 0.012)
    pitch = (0.0, zero(2, _HALF - k.offset), 0.0)
    out.joint("J3", "elbow", "forearm", (0.0, 0.0, 0.0), pitch, _axis(1, joints[2].sign), limits(2))
    out.link("forearm", 0.18, (0.0, 0.0, k.h), (0.8 * k.c, 0.0, k.h), 0.015)
    out.joint("J4", "forearm", "roll", (k.c, 0.0, k.h), (-zero(3), 0.0, 0.0), _axis(0, -joints[3].sign), limits(3))
    out.link("roll", 0.04, (-0.01, 0.0, 0.0), (0.0, 0.0, 0.0), 0.012)
    out.joint(
        "J5", "roll", "hand", (0.0, 0.0, 0.0), (0.0, zero(4, _HALF), 0.0), _axis(1, joints[4].sign), limits(4)
    )
    out.link("hand", 0.04, (0.0, 0.0, 0.0), (0.0, 0.0, 0.4 * k.f), 0.012)
    out.joint(
        "J6", "hand", "flange", (0.0, 0.0, 0.0), (0.0, 0.0, -zero(5, _HALF)), _axis(2, -joints[5].sign), limits(5)
    )
    out.link("flange", 0.03, (0.0, 0.0, 0.4 * k.f), (0.0, 0.0, k.f), 0.008)
    out.joint("tool_mount", "flange", TIP_LINK, (0.0, 0.0, k.f))
    out.frame(TIP_LINK)
    # The jaw moved by the gripper's servo; its position is not published.
    out.joint("J7", "flange", "jaw", (0.0, 0.01, 0.5 * k.f), (zero(6), 0.0, 0.0), (1.0, 0.0, 0.0), limits(6))
    out.link("jaw", 0.01, (0.0, 0.0, 0.0), (0.0, 0.0, 0.5 * k.f), 0.003)


def _puma260(out: _Writer) -> None:
    axes: tuple[Vector, ...] = tuple(_axis(i, 1) for i in (2, 1, 1, 2, 1, 0))
    names = ("trunk", "upper_arm", "forearm", "roll", "hand", "flange")
    places: tuple[Vector, ...] = (
        (0.0, 0.0, 0.0),
        (0.0, 0.0, puma260_links.SHOULDER),
        (puma260_links.UPPER, puma260_links.SIDE, puma260_links.DROP),
        (0.0, 0.0, -puma260_links.FOREARM),
        (0.0, 0.0, 0.0),
        (0.0, 0.0, 0.0),
    )
    rods: tuple[tuple[float, Vector, Vector, float], ...] = (
        (2.0, (0.0, 0.0, 0.05), (0.0, 0.0, puma260_links.SHOULDER), 0.05),
        (1.5, (0.0, puma260_links.SIDE, 0.0), (puma260_links.UPPER, puma260_links.SIDE, puma260_links.DROP), 0.03),
        (0.8, (0.0, 0.0, 0.0), (0.0, 0.0, -0.8 * puma260_links.FOREARM), 0.025),
        (0.1, (0.0, 0.0, 0.01), (0.0, 0.0, 0.0), 0.02),
        (0.1, (0.0, 0.0, 0.0), (0.01, 0.0, 0.0), 0.018),
        (0.1, (0.02, 0.0, 0.0), (puma260_links.FLANGE, 0.0, 0.0), 0.015),
    )
    out.link("base", 4.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.05), 0.08)
    parent = "base"
    for joint, axis, name, place, rod in zip(puma260.PUMA260.joints, axes, names, places, rods, strict=True):
        limits = (joint.minimum, joint.maximum, joint.max_speed)
        out.joint(joint.name, parent, name, place, (0.0, 0.0, 0.0), axis, limits)
        out.link(name, *rod)
        parent = name
    out.joint("tool_mount", parent, TIP_LINK, (puma260_links.FLANGE, 0.0, 0.0))
    out.frame(TIP_LINK)


def _so_arm(out: _Writer, model: SoArmModel) -> None:
    k = model.links
    ahead, below, left = k.tip
    shoulder = (k.shoulder[0], 0.0, k.shoulder[1] - k.pan[1])
    upper, forearm = (k.upper[0], 0.0, k.upper[1]), (k.forearm[0], 0.0, k.forearm[1])
    hand, tip = (k.hand, k.side, 0.0), (ahead, left, -below)
    zero = (0.0, 0.0, 0.0)
    right: Vector = (0.0, -1.0, 0.0)
    # Place, turn and axis of each joint in the frame of the link before it; then the link and the end of its rod.
    rows: tuple[tuple[Vector, float, Vector, str, Vector, float], ...] = (
        ((k.pan[0], 0.0, k.pan[1]), 0.0, _axis(2, -1), "shoulder", shoulder, 0.025),
        (shoulder, 0.0, _axis(1, 1), "upper_arm", upper, 0.02),
        (upper, 0.0, _axis(1, 1), "lower_arm", forearm, 0.02),
        (forearm, 0.0, _axis(1, 1), "wrist", hand, 0.02),
        (hand, k.twist, _axis(0, -1), "gripper_body", tip, 0.015),
    )
    out.link("base", k.masses[0], zero, (k.pan[0], 0.0, 0.8 * k.pan[1]), 0.03)
    parent = "base"
    for joint, mass, (place, twist, axis, name, end, radius) in zip(model.ranges, k.masses[1:], rows, strict=False):
        limits = (joint.minimum, joint.maximum, _SO_SPEED)
        out.joint(joint.name, parent, name, place, (twist, 0.0, 0.0), axis, limits)
        out.link(name, mass, zero, end, radius)
        parent = name
    out.joint("tool_mount", parent, TIP_LINK, tip, (0.0, _HALF, 0.0))
    out.frame(TIP_LINK)
    out.joint("gripper", parent, "jaw", k.jaw, zero, right, (*k.jaw_range, _SO_SPEED))
    out.link("jaw", k.masses[6], (0.0, k.finger[1], 0.0), k.finger, 0.005)


def _axis(i: int, sign: int) -> Vector:
    x, y, z = (float(sign) * (i == n) + 0.0 for n in range(3))
    return (x, y, z)


def _three(v: Iterable[float]) -> str:
    return " ".join(_n(x) for x in v)


def _n(value: float) -> str:
    """All significant digits: the poses must agree except for rounding."""
    return repr(value + 0.0)
