"""Goals from messages that are made up."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from hexwire.control.loop.outcomes import Reason
from hexwire.control.motion.goal_fields import CODES, ErrorCode, component_rows, tolerance_rows, trajectory_goal
from hexwire.control.motion.goals import ComponentTolerance, Point, TrajectoryGoal


def _point(time: int, *values: list[float]) -> Any:
    fields = ("positions", "velocities", "accelerations", "effort")
    return SimpleNamespace(time_from_start=time, **dict(zip(fields, [*values, [], [], [], []], strict=False)))


def test_a_goal_is_read_as_it_is() -> None:
    points = [_point(500, [0.1, 0.2]), _point(1000, [0.3, 0.4], [1.0, 2.0], [3.0, 4.0], [5.0, 6.0])]
    message = SimpleNamespace(joint_names=["J2", "J1"], points=points)
    assert trajectory_goal(message, -0.5, lambda ms: ms / 1000.0, ["base"]) == TrajectoryGoal(
        ("J2", "J1"),
        (Point(0.5, (0.1, 0.2)), Point(1.0, (0.3, 0.4), (1.0, 2.0), (3.0, 4.0), (5.0, 6.0))),
        -0.5,
        ("base",),
    )


def test_tolerances_are_read_as_they_are() -> None:
    rows = [SimpleNamespace(name="J1", position=0.1, velocity=-1.0, acceleration=0.5)]
    assert tolerance_rows(rows) == [("J1", 0.1, -1.0, 0.5)]


def test_component_tolerances_are_read_as_they_are() -> None:
    rows = [SimpleNamespace(joint_name="J1", component=4, position=0.1, velocity=-1.0, acceleration=0.5)]
    assert component_rows(rows) == [ComponentTolerance("J1", 4, 0.1, -1.0, 0.5)]


def test_every_reason_has_the_code_that_clients_act_on() -> None:
    assert list(CODES) == list(Reason)
    assert {reason: code for reason, code in CODES.items() if code is not ErrorCode.INVALID_GOAL} == {
        Reason.REACHED: 0,
        Reason.REPLACED: 0,
        Reason.CANCELLED: 0,
        Reason.WRONG_JOINTS: -2,
        Reason.TOO_LATE: -3,
        Reason.PATH_TOLERANCE: -4,
        Reason.GOAL_TOLERANCE: -5,
    }
