"""Waypoint files: JSON in the format of ROS's JointTrajectory.

Owns that format. Pure: the content of the file comes in as an argument. Must not know files, robots or clocks.
"""

from __future__ import annotations

from hexwire.errors import ConfigError, UsageError
from hexwire.inputs import Item, parse_json
from hexwire.model.state import LONGEST

from .trajectory import Spline, Waypoint

__all__ = ["parse_points", "parse_waypoints"]

_MOST_JOINTS = 253
_MOST = 1e4
"""Radians, or radians per second, beyond any joint: the unit is wrong."""
_MOST_ACCELERATION = 1e6


def parse_waypoints(content: str | bytes, name: str) -> Spline:
    """Parse the trajectory in a file.

    Args:
        content: JSON, UTF-8: `joint_names`, and `points` with `time_from_start` (seconds, or ROS's secs and nsecs),
            `positions` (radians) and optionally `velocities` and `accelerations`.
        name: Name of the file in error texts.

    Returns:
        A spline through the points.

    Raises:
        ConfigError: Not JSON, another format, or the points are not a trajectory; the text names the place.
    """
    names, rows = _names_and_points(content, name)
    points = [_waypoint(row) for row in rows]
    try:
        spline = Spline(names, points)
    except UsageError as error:
        raise ConfigError(str(error), file=name) from None
    if spline.duration > LONGEST:
        raise ConfigError(f"lasts {spline.duration:.6g} s; a motion may take {LONGEST:g} s", file=name)
    return spline


def parse_points(content: str | bytes, name: str) -> tuple[tuple[str, ...], list[tuple[float, ...]]]:
    """Parse the positions in a file, whatever their times.

    Args:
        content: As for `parse_waypoints`; only `positions` are read.
        name: Name of the file in error texts.

    Returns:
        Joint names, and a row of radians for each point.

    Raises:
        ConfigError: Not JSON, another format, or a point has not one position for each joint; the text names the
            place.
    """
    names, rows = _names_and_points(content, name)
    points = []
    for row in rows:
        positions = row.table(("positions",))["positions"]
        points.append(_values(positions, _MOST) or ())
        if len(points[-1]) != len(names):
            raise positions.fault(f"has {len(points[-1])} values for {len(names)} joints")
    return names, points


def _names_and_points(content: str | bytes, name: str) -> tuple[tuple[str, ...], list[Item]]:
    root = parse_json(content, name).table(("joint_names", "points"))
    names = tuple(row.text(100, least=1) for row in root["joint_names"].rows(_MOST_JOINTS, 1))
    if len(set(names)) != len(names):
        raise root["joint_names"].fault("name a joint twice")
    return names, list(root["points"].rows())


def _waypoint(row: Item) -> Waypoint:
    point = row.table(("time_from_start", "positions"))
    return Waypoint(
        _seconds(point["time_from_start"]),
        _values(point["positions"], _MOST) or (),
        _values(point.get("velocities"), _MOST),
        _values(point.get("accelerations"), _MOST_ACCELERATION),
    )


def _seconds(item: Item) -> float:
    """A duration: ROS writes seconds and nanoseconds; handwritten files have a number."""
    if not isinstance(item.value, dict):
        return item.number(0, LONGEST, "s")
    parts = item.table()
    whole, rest = (
        next((parts[key].number(0, high) for key in keys if key in parts), 0.0)
        for keys, high in ((("secs", "sec"), LONGEST), (("nsecs", "nanosec"), 1e9))
    )
    return whole + rest / 1e9


def _values(item: Item | None, most: float) -> tuple[float, ...] | None:
    """A list of values; ROS writes an empty list for missing values."""
    if item is None or item.value is None:
        return None
    return tuple([row.number(-most, most) for row in item.rows()]) or None
