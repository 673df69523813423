"""Messages about an arm: joint states, states of controllers, feedback, diagnostics, taught motions, transforms.

Owns which value is in which field, also where distributions differ, and which frames of an arm are transforms
(`/tf`, `/tf_static`): those of the URDF of `hexwire.model.urdf`. Must not know topics or clocks.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from hexwire.control.requests.teach_mode import to_points, tolerance_of
from hexwire.model.pose import multiply, quaternion, rotation_about, rotation_from_rpy
from zenoh_ros2 import Types, seconds_of, time_fields

if TYPE_CHECKING:
    from hexwire.control.loop.known_state import KnownState
    from hexwire.control.loop.outcomes import Progress
    from hexwire.control.requests.diagnostics import Row
    from hexwire.model.arm import ArmModel
    from hexwire.model.shapes import ArmShapes, ShapeJoint
    from hexwire.motion.teach import Taught

__all__ = [
    "CONTROLLER_STATE",
    "DIAGNOSTICS",
    "JOINT_STATE",
    "TRAJECTORY",
    "TRANSFORMS",
    "Reports",
    "Transforms",
]

CONTROLLER_STATE = "control_msgs/msg/JointTrajectoryControllerState"
DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"
JOINT_STATE = "sensor_msgs/msg/JointState"
TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
TRANSFORMS = "tf2_msgs/msg/TFMessage"

_HEADER, _STAMP = 4, struct.Struct("<iI")
"""Bytes before a message, which say how it is encoded; and the stamp at its beginning."""


class Reports:
    """Makes the messages of one distribution.

    Args:
        types: Its types.
    """

    def __init__(self, types: Types) -> None:
        self._time = types.message("builtin_interfaces/msg/Time")
        self._duration = types.message("builtin_interfaces/msg/Duration")
        self._header = types.message("std_msgs/msg/Header")
        self._joint_state = types.message(JOINT_STATE)
        # The last JointState, and of what its bytes consist.
        self._last, self._numbers = bytearray(), struct.Struct("")
        self._last_key: tuple[tuple[str, ...], str] = ((), "")
        self._trajectory = types.message(TRAJECTORY)
        self._point = types.message("trajectory_msgs/msg/JointTrajectoryPoint")
        self._controller_state = types.message(CONTROLLER_STATE)
        self._feedback = types.action("control_msgs/action/FollowJointTrajectory").feedback_content
        self._diagnostics = types.message(DIAGNOSTICS)
        self._status = types.message("diagnostic_msgs/msg/DiagnosticStatus")
        self._key_value = types.message("diagnostic_msgs/msg/KeyValue")

    def stamp(self, wall: float) -> Any:
        """A time, given in seconds of the wall clock."""
        seconds = math.floor(wall)
        return self._time(sec=seconds, nanosec=min(999_999_999, int((wall - seconds) * 1e9)))

    def header(self, wall: float, frame: str = "") -> Any:
        """A header; time as in `stamp`."""
        return self._header(stamp=self.stamp(wall), frame_id=frame)

    def joint_state(self, state: KnownState, wall: float, frame: str) -> bytes:
        """A JointState as it is sent, without efforts: servos measure none in newton metres."""
        # A hundred a second differ in stamp and numbers only, which are put into the bytes of the last one.
        if (key := (state.names, frame)) != self._last_key:
            message = self._joint_state(
                header=self.header(wall, frame), name=state.names, position=state.position, velocity=state.velocity
            )
            self._last = bytearray(self._joint_state.serialize(message))
            self._last_key, self._numbers = key, struct.Struct(f"<{len(state.names)}d")
        last, numbers = self._last, self._numbers
        seconds = math.floor(wall)
        _STAMP.pack_into(last, _HEADER, seconds, min(999_999_999, int((wall - seconds) * 1e9)))
        # The end: positions, the count of velocities with its padding, velocities, and the count of no efforts.
        velocities = len(last) - 4 - numbers.size
        numbers.pack_into(last, velocities, *state.velocity)
        numbers.pack_into(last, velocities - 8 - numbers.size, *state.position)
        return bytes(last)

    def controller_state(self, progress: Progress, wall: float, elapsed: float = 0.0) -> Any:
        """A JointTrajectoryControllerState.

        Args:
            progress: Progress of the controller.
            wall: As in `stamp`.
            elapsed: Seconds since the goal began; 0 or less without one.
        """
        wanted, actual, error = self._points(progress, elapsed)
        message = self._controller_state(
            header=self.header(wall), joint_names=progress.names, reference=wanted, feedback=actual, error=error
        )
        # What is sent to the servos is what is wanted: they close the loop.
        message.output = self._point(positions=progress.desired.position)
        for field, value in (("desired", wanted), ("actual", actual), ("speed_scaling_factor", 1.0)):
            if field in self._controller_state.fields:
                setattr(message, field, value)
        return message

    def feedback(self, progress: Progress, wall: float, goal: Any, elapsed: float) -> Any:
        """The feedback of FollowJointTrajectory.

        Args:
            progress: Progress of the goal.
            wall: As in `stamp`.
            goal: The FollowJointTrajectory_Goal.
            elapsed: Seconds since the goal began; negative before.
        """
        wanted, actual, error = self._points(progress, elapsed)
        message = self._feedback(
            header=self.header(wall), joint_names=progress.names, desired=wanted, actual=actual, error=error
        )
        if "index" in self._feedback.fields:
            message.index = _index(goal.trajectory.points, elapsed)
        return message

    def _points(self, progress: Progress, elapsed: float) -> tuple[Any, Any, Any]:
        desired, since = progress.desired, self._seconds(max(0.0, elapsed))
        speeds = [d - v for d, v in zip(desired.velocity, progress.velocity, strict=True)]
        return (
            self._point(
                positions=desired.position,
                velocities=desired.velocity,
                accelerations=desired.acceleration,
                time_from_start=since,
            ),
            self._point(positions=progress.position, velocities=progress.velocity, time_from_start=since),
            self._point(positions=progress.error, velocities=speeds),
        )

    def diagnostics(self, rows: Iterable[Row], wall: float, node: str, hardware_id: str) -> Any:
        """A DiagnosticArray according to REP-107.

        Args:
            rows: Of the arm; their levels have the numbers of ROS.
            wall: As in `stamp`.
            node: Name of the node.
            hardware_id: Of the arm.
        """
        status = [
            self._status(
                level=int(row.level),
                name=f"{node}: {row.name}",
                message=row.text,
                hardware_id=hardware_id,
                values=[self._key_value(key=key, value=value) for key, value in row.values],
            )
            for row in rows
        ]
        return self._diagnostics(header=self.header(wall), status=status)

    def taught(self, taught: Taught, arm: ArmModel) -> Any:
        """A taught motion as a JointTrajectory."""
        points = [
            self._point(positions=point.positions, time_from_start=self._seconds(point.time))
            for point in to_points(taught, tolerance_of(arm))
        ]
        return self._trajectory(joint_names=taught.names, points=points)

    def _seconds(self, seconds: float) -> Any:
        return self._duration(**time_fields(round(seconds * 1e9)))


class Transforms:
    """Makes the transforms of an arm, for machines without a robot_state_publisher.

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


def _index(points: Sequence[Any], elapsed: float) -> int:
    """Index of the point to which the joints move."""
    for i, point in enumerate(points):
        if elapsed < seconds_of(point.time_from_start):
            return i
    return max(0, len(points) - 1)
