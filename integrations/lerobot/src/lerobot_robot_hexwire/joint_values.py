"""LeRobot's numbers for joints, and the angles that hexwire uses.

Owns the names (``shoulder_pan.pos``) and the units: degrees, -100 to 100 over a joint's range, 0 to 100 for a
gripper. Must not know LeRobot, robots or calibrations; the limits of the arm's model are those of its calibration.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Collection, Iterable, Mapping
from typing import TYPE_CHECKING

from hexwire.model.gripper import jaws_of

if TYPE_CHECKING:
    from hexwire.model.arm import ArmModel

__all__ = ["SUFFIX", "JointValues", "names_of"]

SUFFIX = ".pos"
_MOST = sys.float_info.max
"""Degrees have no ends; an infinite value is no number of degrees."""


def names_of(joints: Iterable[str]) -> tuple[str, ...]:
    """Names of observations and actions of joints."""
    return tuple(name + SUFFIX for name in joints)


class JointValues:
    """Converts both ways.

    Args:
        model: The arm with its calibrated limits.
        degrees: Degrees for all joints but the gripper; otherwise -100 to 100.
        reversed_joints: Joints with LeRobot's drive mode 1, which reverses -100 to 100 and 0 to 100, not degrees.
    """

    def __init__(self, model: ArmModel, *, degrees: bool, reversed_joints: Collection[str] = ()) -> None:
        self.joints = model.names
        self.names = names_of(model.names)
        # By joint: value = slope * angle + shift, and the ends of the value.
        self._rows: list[tuple[str, float, float, float, float]] = []
        jaws = jaws_of(model)
        for joint, name in zip(model.joints, self.names, strict=True):
            if jaws is not None and joint.name == jaws.joint:
                ends, first, last = (0.0, 100.0), jaws.closed, jaws.opened
            elif degrees:
                self._rows.append((name, math.degrees(1.0), 0.0, -_MOST, _MOST))
                continue
            else:
                ends, first, last = (-100.0, 100.0), joint.minimum, joint.maximum
            if joint.name in reversed_joints:
                first, last = last, first
            slope = (ends[1] - ends[0]) / (last - first)
            self._rows.append((name, slope, ends[0] - slope * first, *ends))
        self._by_name = {row[0]: (joint, *row[1:]) for joint, row in zip(self.joints, self._rows, strict=True)}
        self._by_joint = dict(zip(self.joints, self._rows, strict=True))

    def values(self, angles: Iterable[float]) -> dict[str, float]:
        """Values by name of the angles of all joints, radians."""
        return self.named(zip(self.joints, angles, strict=True))

    def named(self, positions: Iterable[tuple[str, float]]) -> dict[str, float]:
        """Values by name of pairs of joint and angle in radians."""
        found, rows = {}, self._by_joint
        for joint, angle in positions:
            name, slope, shift, least, most = rows[joint]
            value = slope * angle + shift
            found[name] = value if least <= value <= most else min(most, max(least, value))
        return found

    def value(self, joint: str, angle: float) -> float:
        """Value of one joint at an angle in radians."""
        return self.named([(joint, angle)])[joint + SUFFIX]

    def angles(self, action: Mapping[str, float]) -> dict[str, float]:
        """Angles in radians by joint of an action, which may name some of the joints. Other keys are left out.

        Raises:
            ValueError: A value is not a finite number, or an action of a joint that does not exist.
        """
        angles = {}
        for key, given in action.items():
            found = self._by_name.get(key)
            if found is None:
                if key.endswith(SUFFIX):
                    raise ValueError(f"no joint {key.removesuffix(SUFFIX)!r}; there are {', '.join(self.joints)}")
                continue
            joint, slope, shift, least, most = found
            try:
                value = float(given)
            except (TypeError, ValueError, OverflowError):
                raise ValueError(
                    f"the action of {joint} is {repr(given)[:40]}, not a number; nothing was sent"
                ) from None
            if not least <= value <= most:
                if not math.isfinite(value):
                    raise ValueError(f"the action of {joint} is {value}; nothing was sent")
                value = min(most, max(least, value))
            angles[joint] = (value - shift) / slope
        return angles
