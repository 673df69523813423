"""Frames of an arm as transforms (`/tf`, `/tf_static`), for machines without a robot_state_publisher.

Owns which frames these are: those of the URDF of `hexwire.model.urdf`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from hexwire.model.pose import multiply, quaternion, rotation_about, rotation_from_rpy

if TYPE_CHECKING:
    from hexwire.model.shapes import ArmShapes, ShapeJoint
    from zenoh_ros2 import Types

__all__ = ["TRANSFORMS", "Transforms"]

TRANSFORMS = "tf2_msgs/msg/TFMessage"


class Transforms:
    """Makes the transforms of an arm.

    Args:
        types: Types of the distribution.
        shapes: The arm.
    """

    def __init__(self, types: Types, shapes: ArmShapes) -> None:
        self._message = types.message(TRANSFORMS)
        self._stamped = types.message("geometry_msgs/msg/TransformStamped")
        self._header = types.message("std_msgs/msg/Header")
        self._transform = types.message("geometry_msgs/msg/Transform")
        self._vector = types.message("geometry_msgs/msg/Vector3")
        self._quaternion = types.message("geometry_msgs/msg/Quaternion")
        self._fixed = tuple(joint for joint in shapes.joints if joint.axis is None or joint.drive is None)
        self._moving = tuple(joint for joint in shapes.joints if joint not in self._fixed)

    def fixed(self, stamp: Any) -> Any:
        """A TFMessage of the joints that do not move; `stamp` is a builtin_interfaces Time."""
        return self._message(transforms=[self._of(joint, 0.0, stamp) for joint in self._fixed])

    def moving(self, positions: Mapping[str, float], stamp: Any) -> Any:
        """A TFMessage of the joints whose position is known.

        Args:
            positions: Radians by joint of the driver.
            stamp: A builtin_interfaces Time.
        """
        found = []
        for joint in self._moving:
            drive = joint.drive
            if drive is not None and drive.joint in positions:
                found.append(self._of(joint, drive.multiplier * positions[drive.joint] + drive.offset, stamp))
        return self._message(transforms=found)

    def _of(self, joint: ShapeJoint, angle: float, stamp: Any) -> Any:
        turned = rotation_from_rpy(*joint.rpy)
        if joint.axis is not None and angle:
            turned = multiply(turned, rotation_about(joint.axis, angle))
        x, y, z, w = quaternion(turned)
        place = dict(zip("xyz", joint.place, strict=True))
        transform = self._transform(
            translation=self._vector(**place), rotation=self._quaternion(x=x, y=y, z=z, w=w)
        )
        header = self._header(stamp=stamp, frame_id=joint.parent)
        return self._stamped(header=header, child_frame_id=joint.child, transform=transform)
