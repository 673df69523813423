from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import pytest

from hexwire.control.goals import Point, TrajectoryOrder
from hexwire.ros1.messages import _OSRF
from hexwire.ros1.values import order_of, set_points_of, tolerances_of
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
    assert order_of(_trajectory(0), NOW) == TrajectoryOrder(
        ("J2", "J1"),
        (Point(0.5, (0.1, 0.2)), Point(1.0, (0.3, 0.4), (1.0, 2.0), (3.0, 4.0), (5.0, 6.0))),
        0.0,
    )


@pytest.mark.parametrize("nanoseconds", [250_000_001, 1, -500_000_000])
def test_stamp_is_told_from_now_and_exactly(nanoseconds: int) -> None:
    assert order_of(_trajectory(NOW.nanoseconds + nanoseconds), NOW).delay == nanoseconds / 1e9


def test_tolerances() -> None:
    rows = [SimpleNamespace(name="J1", position=0.1, velocity=-1.0, acceleration=0.0)]
    assert tolerances_of(rows) == [("J1", 0.1, -1.0, 0.0)]


def test_set_points_have_every_field_of_the_message() -> None:
    names = [line.split()[1] for line in _OSRF["JointCommands"][1].splitlines()]
    assert names == ["header", "name", *COMMAND_ARRAYS]
    message = SimpleNamespace(**{**dict.fromkeys(names, ()), "name": ["J1"], "position": [0.5]})
    assert set_points_of(message) == {**dict.fromkeys(COMMAND_ARRAYS, ()), "position": (0.5,)}
