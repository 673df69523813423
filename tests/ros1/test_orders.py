from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from hexwire.ros1.goals import Point, TrajectoryOrder
from hexwire.ros1.messages import osrf_msgs
from hexwire.ros1.orders import FIELDS, Sparing, order_of, set_points_of, tolerances_of
from hexwire.ros1.path import find_ros

assert find_ros()

import genpy  # noqa: E402  # found only now
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint  # noqa: E402  # likewise


def _trajectory(stamp: Any = None) -> Any:
    message = JointTrajectory(joint_names=["J2", "J1"])
    message.header.stamp = stamp or genpy.Time()
    message.points = [
        JointTrajectoryPoint(positions=[0.1, 0.2], time_from_start=genpy.Duration(0, 500_000_000)),
        JointTrajectoryPoint([0.3, 0.4], [1.0, 2.0], [3.0, 4.0], [5.0, 6.0], genpy.Duration(1)),
    ]
    return message


def test_trajectory_is_read_as_it_is() -> None:
    assert order_of(_trajectory(), genpy.Time(1_700_000_000)) == TrajectoryOrder(
        ("J2", "J1"),
        (Point(0.5, (0.1, 0.2)), Point(1.0, (0.3, 0.4), (1.0, 2.0), (3.0, 4.0), (5.0, 6.0))),
        0.0,
    )


@pytest.mark.parametrize(("nanoseconds", "delay"), [(750_000_001, 0.250000001), (0, -0.5)])
def test_stamp_is_told_from_now_and_exactly(nanoseconds: int, delay: float) -> None:
    stamp = genpy.Time(1_700_000_000, nanoseconds)
    assert order_of(_trajectory(stamp), genpy.Time(1_700_000_000, 500_000_000)).delay == pytest.approx(
        delay, rel=1e-12
    )


def test_tolerances() -> None:
    rows = [SimpleNamespace(name="J1", position=0.1, velocity=-1.0, acceleration=0.0)]
    assert tolerances_of(rows) == [("J1", 0.1, -1.0, 0.0)]


def test_set_points_have_every_field_of_the_message() -> None:
    kind = osrf_msgs().JointCommands
    assert tuple(kind.__slots__) == ("header", "name", *FIELDS)
    fields = set_points_of(kind(name=["J1"], position=[0.5]))
    assert fields == {**dict.fromkeys(FIELDS, ()), "position": (0.5,)}


def test_same_text_is_said_again_after_its_period() -> None:
    sparing = Sparing()
    assert [sparing.due("no", now, 1.0) for now in (0.0, 0.5, 0.9, 1.0, 1.5)] == [True, False, False, True, False]
    assert sparing.due("other", 1.5, 1.0)


def test_texts_are_forgotten() -> None:
    sparing = Sparing()
    for i in range(1000):
        assert sparing.due(f"J1 is {i}", float(i))
    assert len(sparing._said) <= 61
