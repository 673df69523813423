from __future__ import annotations

import math
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import pytest

from hexwire.control.goals import Point, TrajectoryGoal
from hexwire.errors import UsageError
from hexwire.ros1.messages import _OSRF
from hexwire.ros1.values import set_points_of, trajectory_of
from hexwire.wire.robot_bodies import COMMAND_ARRAYS


@dataclass
class Time:
    """As ROS's times and durations: whole nanoseconds."""

    nanoseconds: int

    def is_zero(self) -> bool:
        return self.nanoseconds == 0

    def to_sec(self) -> float:
        return self.nanoseconds / 1e9

    def __sub__(self, other: Time) -> Time:
        return Time(self.nanoseconds - other.nanoseconds)


NOW = Time(1_700_000_000_500_000_000)


def _point(seconds: float, *values: list[float]) -> Any:
    fields = dict(
        zip(("positions", "velocities", "accelerations", "effort"), [*values, [], [], [], []], strict=False)
    )
    return SimpleNamespace(time_from_start=Time(round(seconds * 1e9)), **fields)


def _trajectory(stamp: int) -> Any:
    points = [_point(0.5, [0.1, 0.2]), _point(1.0, [0.3, 0.4], [1.0, 2.0], [3.0, 4.0], [5.0, 6.0])]
    return SimpleNamespace(header=SimpleNamespace(stamp=Time(stamp)), joint_names=["J2", "J1"], points=points)


def test_trajectory_is_read_as_it_is() -> None:
    assert trajectory_of(_trajectory(0), NOW) == TrajectoryGoal(
        ("J2", "J1"),
        (Point(0.5, (0.1, 0.2)), Point(1.0, (0.3, 0.4), (1.0, 2.0), (3.0, 4.0), (5.0, 6.0))),
        0.0,
    )


@pytest.mark.parametrize("nanoseconds", [250_000_001, 1, -500_000_000])
def test_stamp_is_told_from_now_and_exactly(nanoseconds: int) -> None:
    assert trajectory_of(_trajectory(NOW.nanoseconds + nanoseconds), NOW).delay == nanoseconds / 1e9


def _commands(names: list[str], **fields: list[float]) -> Any:
    return SimpleNamespace(**{**dict.fromkeys(COMMAND_ARRAYS, ()), "name": names, **fields})


def test_set_points_are_the_positions_and_other_fields_are_reported() -> None:
    names = [line.split()[1] for line in _OSRF["JointCommands"][1].splitlines()]
    assert names == ["header", "name", *COMMAND_ARRAYS], "every field of the message"
    message = _commands(["J4", "J1"], position=[0.5, 0.1], effort=[0.0, 0.0], kp_position=[9.0, 9.0])
    assert set_points_of(message) == ({"J4": 0.5, "J1": 0.1}, ("kp_position",))
    assert set_points_of(_commands(["J1"])) == ({}, ())


@pytest.mark.parametrize(
    ("names", "fields", "error"),
    [
        (["J1", "J1"], {"position": [0.0, 0.0]}, "named twice: J1, J1"),
        (["J1"], {"position": [0.0, 0.0]}, "position has 2 values for 1 names"),
        (["J1"], {"position": [0.0], "kp_position": [1.0, 1.0]}, "kp_position has 2 values for 1 names"),
        (["J1"], {"position": [math.nan]}, "the position of J1 is nan, not a number"),
        (["J1"], {"position": [0.0], "effort": [math.inf]}, "the effort of J1 is inf, not a number"),
        ([], {"position": [1.0]}, "position has 1 values for 0 names"),
    ],
)
def test_set_points_of_a_wrong_shape(names: list[str], fields: dict[str, list[float]], error: str) -> None:
    with pytest.raises(UsageError, match=error):
        set_points_of(_commands(names, **fields))
