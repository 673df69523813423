from __future__ import annotations

import json
import math
from typing import Any

import pytest

from hexwire.errors import ConfigError, UsageError
from hexwire.motion.trajectory import Waypoint
from hexwire.motion.waypoint_file import parse_points, parse_waypoints

WHOLE: dict[str, Any] = {
    "joint_names": ["J2", "J1"],
    "points": [
        {"time_from_start": 0, "positions": [0.0, 0.1], "velocities": [], "accelerations": None},
        {"time_from_start": {"secs": 1, "nsecs": 500_000_000}, "positions": [1, 2], "velocities": [0.5, 0]},
        {"time_from_start": {"sec": 2, "nanosec": 1}, "positions": [1, 2], "velocities": [0, 0]},
    ],
}


def _point(time: str, positions: object) -> str:
    point = f'{{"time_from_start": {time}, "positions": {json.dumps(positions)}}}'
    return f'{{"joint_names": ["J1"], "points": [{point}]}}'


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


@pytest.mark.parametrize(
    ("content", "place"),
    [
        ("", ":1:1: not JSON"),
        ("{", ":1:2: not JSON"),
        ("[1,", ":1:4: not JSON"),
        (b"\xff\xfe{}", ":1:1: is UTF-16 text"),
        (b'{"a\xff"', ":1:4: not UTF-8 text"),
        (b"{}\n\0", ":2:1: not UTF-8 text"),
        ("[" * 100_000, ": brackets are nested too deeply"),
        ('{"points": 1, "points": 2}', ": the key 'points' occurs twice"),
    ],
)
def test_invalid_json_is_refused(content: str | bytes, place: str) -> None:
    with pytest.raises(ConfigError, match=rf"^way\.json{place}"):
        parse_waypoints(content, "way.json")


@pytest.mark.parametrize(
    ("content", "error"),
    [
        ("null", "must be a table, not nothing"),
        ("[]", "must be a table, not the list []"),
        ("{}", "joint_names is missing"),
        ('{"joint_names": 7, "points": []}', "joint_names must be a list, not 7"),
        ('{"joint_names": [], "points": []}', "joint_names has 0 values, but must have 1 to 253"),
        ('{"joint_names": ["J1", "J1"], "points": []}', "joint_names name a joint twice"),
        ('{"joint_names": ["J1"]}', "points is missing"),
        ('{"joint_names": ["J1"], "points": [7]}', "points[0] must be a table, not 7"),
        ('{"joint_names": ["J1"], "points": [{"positions": [0]}]}', "points[0].time_from_start is missing"),
        (_point("0", "x"), "points[0].positions must be a list, not the text 'x'"),
        (_point("0", ["x"]), "points[0].positions[0] must be a number, not the text 'x'"),
        (_point("[]", [0]), "points[0].time_from_start must be a number, not the list []"),
        (_point('{"secs": "x"}', [0]), "points[0].time_from_start.secs must be a number, not the text 'x'"),
        (_point("1e308", [0]), "points[0].time_from_start is 1e+308, but must be 0 to 3600 s"),
        (_point("1e999", [0]), "points[0].time_from_start must be a finite number"),
        (_point("9" * 5000, [0]), "points[0].time_from_start must be a finite number"),
        (_point("-1", [0]), "points[0].time_from_start is -1, but must be 0 to 3600 s"),
        (_point("true", [0]), "points[0].time_from_start must be a number, not true"),
        (_point("0", [1e5]), "points[0].positions[0] is 100000, but must be -10000 to 10000"),
        (_point("0", [math.nan]), "points[0].positions[0] must be a finite number"),
        (_point("0", [None]), "points[0].positions[0] must be a number, not nothing"),
    ],
)
def test_values_that_are_not_a_trajectory_are_refused(content: str, error: str) -> None:
    with pytest.raises(ConfigError) as caught:
        parse_waypoints(content, "way.json")
    assert str(caught.value) == f"way.json: {error}"


@pytest.mark.parametrize(
    ("points", "error"),
    [
        ([], "without a point"),
        ([{"time_from_start": 1, "positions": [0]}], "it must be the start"),
        ([{"time_from_start": 0, "positions": [0, 0]}], "2 values for 1 joints"),
        ([{"time_from_start": 0, "positions": [0]}] * 2, "not after the one before"),
    ],
)
def test_invalid_points_are_refused(points: list[Any], error: str) -> None:
    with pytest.raises(UsageError, match=error):
        parse_waypoints(json.dumps({"joint_names": ["J1"], "points": points}), "way.json")


def _whole(**changes: Any) -> str:
    point = {"time_from_start": 0, "positions": [0], "velocities": [0], "accelerations": [0]}
    return json.dumps({"joint_names": ["J1"], "points": [point | changes]})


@pytest.mark.parametrize(("key", "most"), [("positions", 1e4), ("velocities", 1e4), ("accelerations", 1e6)])
def test_values_have_bounds(key: str, most: float) -> None:
    for value in (most, -most):
        point = parse_waypoints(_whole(**{key: [value]}), "way.json").waypoints[0]
        assert value in (*point.position, *(point.velocity or ()), *(point.acceleration or ()))
        with pytest.raises(ConfigError, match=rf"points\[0\]\.{key}\[0\]"):
            parse_waypoints(_whole(**{key: [1.01 * value]}), "way.json")


def test_times_have_bounds() -> None:
    def until(*times: object) -> float:
        points = [{"time_from_start": t, "positions": [0]} for t in times]
        return parse_waypoints(json.dumps({"joint_names": ["J1"], "points": points}), "way.json").duration

    assert until(0, 3600) == 3600.0
    assert until({}, {"secs": 3599, "nsecs": 1e9}) == 3600.0
    assert until(0, {"nsecs": 500_000_000}) == 0.5
    with pytest.raises(ConfigError, match=r"^way\.json: lasts 3600\.5 s; a motion may take 3600 s$"):
        until(0, {"secs": 3600, "nsecs": 500_000_000})
    for bad in ({"secs": 3601}, {"nsecs": 1e9 + 1}, {"secs": -1}, {"nanosec": -1}):
        with pytest.raises(ConfigError, match=r"points\[1\]\.time_from_start\.n?"):
            until(0, bad)


def test_names_have_bounds() -> None:
    def names(*given: str) -> tuple[str, ...]:
        point = {"time_from_start": 0, "positions": [0] * len(given)}
        return parse_waypoints(json.dumps({"joint_names": given, "points": [point]}), "way.json").names

    many = tuple(f"J{i}" for i in range(253))
    assert names(*many) == many
    assert names("x" * 100, "y") == ("x" * 100, "y")
    for bad in ((*many, "J253"), ("x" * 101,), ("",)):
        with pytest.raises(ConfigError, match="joint_names"):
            names(*bad)


def test_positions_without_times() -> None:
    data = {
        "joint_names": ["J2", "J1"],
        "points": [{"positions": [0.0, 0.1]}, {"positions": [1, 2], "velocities": 7}],
    }
    assert parse_points(json.dumps(data), "way.json") == (("J2", "J1"), [(0.0, 0.1), (1.0, 2.0)])
    assert parse_points(json.dumps(WHOLE), "way.json")[1] == [(0.0, 0.1), (1.0, 2.0), (1.0, 2.0)]


@pytest.mark.parametrize(
    ("point", "error"),
    [
        ({"time_from_start": 1}, "positions"),
        ({"positions": [1]}, r"points\[0\]\.positions has 1 values for 2 joints"),
        ({"positions": []}, "has 0 values for 2 joints"),
        ({"positions": [1, 1e9]}, "must be"),
        (7, "must be"),
    ],
)
def test_positions_that_are_none_are_refused(point: object, error: str) -> None:
    with pytest.raises(ConfigError, match=error):
        parse_points(json.dumps({"joint_names": ["J2", "J1"], "points": [point]}), "way.json")
