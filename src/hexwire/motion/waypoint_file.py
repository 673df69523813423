"""Waypoints as people and ROS write them: JSON in the form of a JointTrajectory.

Owns that form. Pure: the content comes in as it is in the file. Must not know files, robots or clocks.
"""

from __future__ import annotations

from hexwire.errors import ConfigError, UsageError
from hexwire.inputs import Item, parse_json
from hexwire.model.state import LONGEST

from .waypoints import Spline, Waypoint

__all__ = ["parse_waypoints"]

_MOST_JOINTS = 253
_MOST = 1e4
"""Radians, or radians per second, that no joint does: a wrong unit."""
_MOST_ACCELERATION = 1e6


def parse_waypoints(content: str | bytes, name: str) -> Spline:
    """The trajectory that a file holds.

    Args:
        content: JSON, UTF-8: `joint_names`, and `points` with `time_from_start` (seconds, or ROS's secs and nsecs),
            `positions` (radians) and maybe `velocities` and `accelerations`.
        name: What errors call it.

    Returns:
        A spline through the points.

    Raises:
        ConfigError: It is no JSON, or not of this form, or its points make no trajectory; the text names the place.
    """
    root = parse_json(content, name).table(needed=("joint_names", "points"))
    names = [row.text(100, least=1) for row in root["joint_names"].rows(_MOST_JOINTS, 1)]
    if len(set(names)) != len(names):
        raise root["joint_names"].fault("name a joint twice")
    points = [_waypoint(row) for row in root["points"].rows()]
    try:
        way = Spline(names, points)
    except UsageError as error:
        raise ConfigError(str(error), file=name) from None
    if way.duration > LONGEST:
        raise ConfigError(f"lasts {way.duration:.6g} s; a motion may take {LONGEST:g} s", file=name)
    return way


def _waypoint(row: Item) -> Waypoint:
    point = row.table(needed=("time_from_start", "positions"))
    return Waypoint(
        _seconds(point["time_from_start"]),
        _values(point["positions"], _MOST) or (),
        _values(point.get("velocities"), _MOST),
        _values(point.get("accelerations"), _MOST_ACCELERATION),
    )


def _seconds(item: Item) -> float:
    """ROS writes a duration as seconds and nanoseconds; people write a number."""
    if not isinstance(item.value, dict):
        return item.number(0, LONGEST, "s")
    parts = item.table()
    whole, rest = (
        next((parts[key].number(0, high) for key in keys if key in parts), 0.0)
        for keys, high in ((("secs", "sec"), LONGEST), (("nsecs", "nanosec"), 1e9))
    )
    return whole + rest / 1e9


def _values(item: Item | None, most: float) -> tuple[float, ...] | None:
    """ROS writes an empty list for what is not given."""
    if item is None or item.value is None:
        return None
    return tuple([row.number(-most, most) for row in item.rows()]) or None
