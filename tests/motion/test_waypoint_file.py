from __future__ import annotations

import json
from typing import Any

import pytest

from hexwire.errors import UsageError
from hexwire.motion.waypoint_file import parse_waypoints
from hexwire.motion.waypoints import Waypoint

WHOLE: dict[str, Any] = {
    "joint_names": ["J2", "J1"],
    "points": [
        {"time_from_start": 0, "positions": [0.0, 0.1], "velocities": [], "accelerations": None},
        {"time_from_start": {"secs": 1, "nsecs": 500_000_000}, "positions": [1, 2], "velocities": [0.5, 0]},
        {"time_from_start": {"sec": 2, "nanosec": 1}, "positions": [1, 2], "velocities": [0, 0]},
    ],
}


@pytest.mark.parametrize("as_bytes", [False, True])
def test_what_people_and_ros_write(as_bytes: bool) -> None:
    text = json.dumps(WHOLE)
    way = parse_waypoints(text.encode() if as_bytes else text, "way.json")
    assert way.names == ("J2", "J1")
    assert way.waypoints == (
        Waypoint(0.0, (0.0, 0.1)),
        Waypoint(1.5, (1.0, 2.0), (0.5, 0.0)),
        Waypoint(2.000000001, (1.0, 2.0), (0.0, 0.0)),
    )


@pytest.mark.parametrize("content", ["", "{", "[1,", b"\xff\xfe{}", "[" * 100_000])
def test_what_is_no_json(content: str | bytes) -> None:
    with pytest.raises(UsageError, match=r"^way\.json is no JSON: "):
        parse_waypoints(content, "way.json")


@pytest.mark.parametrize(
    "content",
    [
        "null",
        "[]",
        "{}",
        '{"joint_names": 7, "points": []}',
        '{"joint_names": ["J1"]}',
        '{"joint_names": ["J1"], "points": [7]}',
        '{"joint_names": ["J1"], "points": [{"positions": [0]}]}',
        '{"joint_names": ["J1"], "points": [{"time_from_start": 0, "positions": ["x"]}]}',
        '{"joint_names": ["J1"], "points": [{"time_from_start": [], "positions": [0]}]}',
        '{"joint_names": ["J1"], "points": [{"time_from_start": {"secs": "x"}, "positions": [0]}]}',
    ],
)
def test_what_is_no_trajectory(content: str) -> None:
    with pytest.raises(UsageError, match=r"^way\.json is no trajectory: it needs joint_names, and points .*\)$"):
        parse_waypoints(content, "way.json")


@pytest.mark.parametrize(
    ("points", "error"),
    [
        ([], "without a point"),
        ([{"time_from_start": 1, "positions": [0]}], "it must be the start"),
        ([{"time_from_start": 0, "positions": [0, 0]}], "2 values for 1 joints"),
        ([{"time_from_start": 0, "positions": [float("nan")]}], "not a number"),
        ([{"time_from_start": 0, "positions": [0]}] * 2, "not after the one before"),
    ],
)
def test_points_that_make_no_trajectory(points: list[Any], error: str) -> None:
    with pytest.raises(UsageError, match=error):
        parse_waypoints(json.dumps({"joint_names": ["J1"], "points": points}), "way.json")
