"""Waypoints as people and ROS write them: JSON in the form of a JointTrajectory.

Owns that form. Pure: the content comes in as it is in the file. Must not know files, robots or clocks.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence

from hexwire.errors import UsageError

from .waypoints import Spline, Waypoint

__all__ = ["parse_waypoints"]


def parse_waypoints(content: str | bytes, name: str) -> Spline:
    """The trajectory that a file holds.

    Args:
        content: JSON, UTF-8: `joint_names`, and `points` with `time_from_start` (seconds, or ROS's secs and nsecs),
            `positions` (radians) and maybe `velocities` and `accelerations`.
        name: What errors call it.

    Returns:
        A spline through the points.

    Raises:
        UsageError: It is no JSON, or not of this form, or its points make no trajectory.
    """
    try:
        data = json.loads(content if isinstance(content, str) else content.decode("utf-8"))
    except (ValueError, RecursionError) as error:
        raise UsageError(f"{name} is no JSON: {error}") from None
    try:
        names = [str(joint) for joint in data["joint_names"]]
        points = [
            Waypoint(
                _seconds(point["time_from_start"]),
                _values(point["positions"]) or (),
                _values(point.get("velocities")),
                _values(point.get("accelerations")),
            )
            for point in data["points"]
        ]
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise UsageError(
            f"{name} is no trajectory: it needs joint_names, and points with time_from_start, positions ({error!r})"
        ) from None
    return Spline(names, points)


def _seconds(value: float | Mapping[str, float]) -> float:
    """ROS writes a duration as seconds and nanoseconds; people write a number."""
    if isinstance(value, Mapping):
        return (
            float(value.get("secs", value.get("sec", 0))) + float(value.get("nsecs", value.get("nanosec", 0))) / 1e9
        )
    return float(value)


def _values(value: Sequence[float] | None) -> tuple[float, ...] | None:
    """ROS writes an empty list for what is not given."""
    return tuple(float(v) for v in value) if value else None
