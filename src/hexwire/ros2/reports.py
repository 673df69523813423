"""Messages about an arm: joint states, states of controllers, feedback, diagnostics, taught motions.

Owns which value is in which field, also where distributions differ. Must not know topics or clocks.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

from hexwire.control.requests.teach_mode import to_points, tolerance_of
from zenoh_ros2 import seconds_of, time_fields

if TYPE_CHECKING:
    from hexwire.control.loop.known_state import KnownState
    from hexwire.control.loop.outcomes import Progress
    from hexwire.control.requests.diagnostics import Row
    from hexwire.model.arm import ArmModel
    from hexwire.motion.teach import Taught
    from zenoh_ros2 import Types

__all__ = ["CONTROLLER_STATE", "DIAGNOSTICS", "JOINT_STATE", "TRAJECTORY", "Reports"]

CONTROLLER_STATE = "control_msgs/msg/JointTrajectoryControllerState"
DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"
JOINT_STATE = "sensor_msgs/msg/JointState"
TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"

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


def _index(points: Sequence[Any], elapsed: float) -> int:
    """Index of the point to which the joints move."""
    for i, point in enumerate(points):
        if elapsed < seconds_of(point.time_from_start):
            return i
    return max(0, len(points) - 1)
