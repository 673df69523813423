"""Trajectories as messages, and back."""

from __future__ import annotations

from typing import Any

import pytest

from hexwire.control.loop.outcomes import Outcome, Reason
from hexwire.control.motion.goals import TrajectoryGoal
from hexwire.control.sharing.shared_goals import GoalReport
from hexwire.errors import UsageError
from hexwire.fleet import messages as m
from hexwire.fleet.trajectories import do_goal_order, follow_message, goal_row, trajectory_goal
from hexwire.motion.trajectory import Spline, Waypoint

PATH = Spline(
    ("J1", "J2"),
    [
        Waypoint(0.0, (0.1, 0.2), (0.0, 0.0)),
        Waypoint(1.0, (0.3, 0.4), (0.5, 0.6)),
        Waypoint(2.0, (0.5, 0.6), (0, 0)),
    ],
)


def test_a_trajectory_arrives_as_it_was_sent() -> None:
    sent = m.Envelope(7, 1, 0.0, 0.0, follow_message(PATH, 12.5))
    order = m.decode(m.encode(sent), m.Envelope).order
    assert isinstance(order, m.Follow)
    assert (order.start, order.check) == (12.5, False)
    goal = trajectory_goal(order)
    assert goal.names == PATH.names
    assert [(p.time, p.positions, p.velocities, p.accelerations) for p in goal.points] == [
        (w.time, w.position, w.velocity, ()) for w in PATH.waypoints
    ]


def test_one_that_begins_anywhere_has_no_first_point() -> None:
    assert follow_message(PATH, anywhere=True).times == (1.0, 2.0)
    alone = Spline(("J1",), [Waypoint(0.0, (0.1,))])
    assert follow_message(alone, anywhere=True).times == (0.0,)


def test_a_long_trajectory_fits_into_a_message() -> None:
    row = (0.123456789,) * 7
    points = [Waypoint(0.01 * i, row, row) for i in range(10_000)]
    payload = m.encode(m.Envelope(7, 1, 0.0, 0.0, follow_message(Spline(tuple("ABCDEFG"), points))))
    assert len(m.decode(payload, m.Envelope).order.times) == 10_000  # type: ignore[union-attr]  # a Follow


def test_rows_of_wrong_length_are_refused() -> None:
    with pytest.raises(UsageError, match="3 velocities for 2 points of 2 joints"):
        trajectory_goal(m.Follow(("J1", "J2"), (0.0, 1.0), (0.0,) * 4, (0.0,) * 3))
    some = Spline(("J1",), [Waypoint(0.0, (0.0,), (0.0,)), Waypoint(1.0, (0.1,))])
    with pytest.raises(UsageError, match="either all points"):
        follow_message(some)


def test_a_report_arrives_as_it_was() -> None:
    report = GoalReport(3, 1.5, Outcome.ABORTED, Reason.STOPPED, "stopped by Ann", 1.6, 2, "board", 0.25)
    row = m.decode(m.encode(goal_row(report)), m.Goal)
    assert (row.number, row.outcome, row.text, row.moved, row.slips) == (3, "aborted", "stopped by Ann", 1.6, 2)
    assert (row.ready, row.doubt) == ("board", 0.25)
    active = m.decode(m.encode(goal_row(GoalReport(4, 1.5))), m.Goal)
    assert (active.outcome, active.reason) == ("", "")


def test_each_order_is_its_call() -> None:
    class Goals:
        """Notes its calls."""

        def __init__(self) -> None:
            self.calls: list[tuple[Any, ...]] = []

        def check(self, order: object, goal: TrajectoryGoal) -> float:
            self.calls.append(("check", goal.names))
            return 2.0

        def follow(self, order: object, goal: TrajectoryGoal, start: float, *, confirm: bool) -> int:
            self.calls.append(("follow", start, confirm))
            return 7

        def confirm(self, order: object, number: int) -> None:
            self.calls.append(("confirm", number))

        def cancel(self, order: object, number: int) -> None:
            self.calls.append(("cancel", number))

    goals: Any = Goals()
    orders = (
        follow_message(PATH, check=True),
        follow_message(PATH, 3.0),
        follow_message(PATH, 3.0, confirm=True),
        m.Confirm(7),
        m.Cancel(7),
    )
    proof: Any = None
    assert [do_goal_order(goals, proof, what) for what in orders] == [2.0, 7, 7, None, None]
    assert goals.calls == [
        ("check", PATH.names),
        ("follow", 3.0, False),
        ("follow", 3.0, True),
        ("confirm", 7),
        ("cancel", 7),
    ]
