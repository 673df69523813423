from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import pytest

from hexwire.control.motion.goals import Point, TrajectoryGoal
from hexwire.ros1.values import trajectory_of


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
