"""Set-points in messages: of a forward command controller, and of a controller manager elsewhere.

Owns reading the messages. Must not know which set-points are allowed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from hexwire.errors import UsageError

__all__ = ["ARRAY", "of_array", "of_joint_state"]

ARRAY = "std_msgs/msg/Float64MultiArray"
"""Type of the commands of a forward command controller."""


def of_array(message: Any, joints: Sequence[str]) -> dict[str, float]:
    """The set-points in a std_msgs/msg/Float64MultiArray: one for each joint.

    Args:
        message: The message; its layout is ignored, as usual.
        joints: The joints, in the order of the values.

    Returns:
        Radians by joint.

    Raises:
        UsageError: There are more or fewer values, or one is not a finite number.
    """
    if len(message.data) != len(joints):
        raise UsageError(f"data has {len(message.data)} values for the {len(joints)} joints {', '.join(joints)}")
    for joint, value in zip(joints, message.data, strict=True):
        if not math.isfinite(value):
            raise UsageError(f"the value of {joint} is {value}, not a number")
    return dict(zip(joints, message.data, strict=True))


def of_joint_state(message: Any) -> dict[str, float]:
    """The set-points in a sensor_msgs/msg/JointState, as `joint_state_topic_hardware_interface` sends it.

    NaN means no command for that joint, as long as no controller has claimed it. Velocities and efforts are
    ignored: they come beside the positions of a controller, and the servos take positions only.

    Returns:
        Radians by joint; empty if there is no command.

    Raises:
        UsageError: A joint is named twice, the positions are not as many as the names, or one is infinite.
    """
    names, positions = message.name, message.position
    if len(set(names)) != len(names):
        raise UsageError(f"a joint is named twice: {', '.join(names)}")
    if len(positions) != len(names):
        raise UsageError(
            f"position has {len(positions)} values for {len(names)} names; give each joint of the ros2_control tag "
            "the command interface position, and no other joint"
        )
    found = {joint: value for joint, value in zip(names, positions, strict=True) if not math.isnan(value)}
    for joint, value in found.items():
        if math.isinf(value):
            raise UsageError(f"the position of {joint} is {value}, not a number")
    return found
