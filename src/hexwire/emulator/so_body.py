"""The body of an SO-100 or SO-101 arm for MuJoCo, as an MJCF text.

Owns lengths and masses, rounded from the public URDF of the SO-101 (`so101_new_calib` in TheRobotStudio/SO-ARM100),
in one plane: the small offsets to the side are left out. Shapes are rods. The SO-100 is nearly the same arm. Must
not know MuJoCo or servos.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

__all__ = ["TIP", "make_so_body"]


@dataclass(frozen=True, slots=True)
class _Link:
    """A link and the joint before it; lengths in metres, x forward and z up with all joints at 0.

    Attributes:
        joint: Name of the joint.
        place: The joint in the frame of the link before.
        axis: Its axis.
        end: End of the rod, in the frame of the joint.
        middle: Centre of mass.
        mass: Kilograms.
    """

    joint: str
    place: tuple[float, float, float]
    axis: str
    end: tuple[float, float, float]
    middle: tuple[float, float, float]
    mass: float


_RADIUS = 0.012
# A positive angle leans forward or down. The jaw is a child of the gripper; all others follow one another.
_LINKS = (
    _Link("shoulder_pan", (0.0, 0.0, 0.062), "0 0 -1", (0.0304, 0.0, 0.0542), (0.03, 0.0, 0.025), 0.1),
    _Link("shoulder_lift", (0.0304, 0.0, 0.0542), "0 1 0", (0.028, 0.0, 0.1126), (0.0084, 0.0, 0.0898), 0.103),
    _Link("elbow_flex", (0.028, 0.0, 0.1126), "0 1 0", (0.1349, 0.0, 0.0052), (0.0981, 0.0, 0.0032), 0.104),
    _Link("wrist_flex", (0.1349, 0.0, 0.0052), "0 1 0", (0.0611, 0.0, 0.0), (0.0386, 0.0, 0.0), 0.079),
    _Link("wrist_roll", (0.0611, 0.0, 0.0), "1 0 0", (0.0981, 0.0, 0.0), (0.0252, 0.0, 0.0), 0.087),
    _Link("gripper", (0.0234, 0.0202, 0.0), "0 0 1", (0.07, 0.0, 0.0), (0.03, 0.0, 0.0), 0.012),
)
TIP = "wrist_roll"
"""The link that carries a payload."""


def make_so_body() -> str:
    """The MJCF text: bodies and joints have the names of the joints, and no limits."""
    rows = []
    for link in _LINKS:
        length = math.hypot(*link.end)
        across = link.mass * (3 * _RADIUS**2 + length**2) / 12
        rows += [
            f'<body name="{link.joint}" pos="{_three(link.place)}">',
            f'<joint name="{link.joint}" axis="{link.axis}"/>',
            f'<inertial pos="{_three(link.middle)}" mass="{link.mass}" diaginertia="{across} {across} {across}"/>',
            f'<geom type="capsule" size="{_RADIUS}" fromto="0 0 0 {_three(link.end)}"/>',
        ]
    ends = "</body>" * len(_LINKS)
    body = f"<worldbody>{''.join(rows)}{ends}</worldbody>"
    return f'<mujoco model="so101"><compiler angle="radian"/>{body}</mujoco>'


def _three(values: tuple[float, float, float]) -> str:
    return " ".join(str(value) for value in values)
