"""Trajectories and what became of them as messages, and back.

Owns the conversion, and which order is which call. Must not know Zenoh, nor whether a path is allowed.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING

from hexwire.control.motion.goals import Point, TrajectoryGoal
from hexwire.control.sharing.shared_goals import GoalReport, SharedGoals
from hexwire.errors import UsageError
from hexwire.motion.trajectory import Spline

from . import messages as m

if TYPE_CHECKING:
    from hexwire.control.sharing.shared import Order

__all__ = ["do_goal_order", "follow_message", "goal_row", "trajectory_goal"]


def do_goal_order(goals: SharedGoals, order: Order, what: m.Follow | m.Confirm | m.Cancel) -> float | int | None:
    """Do what a message asks for; raises as the method of `SharedGoals` that does it.

    Returns:
        The duration of a path that was checked, or the number of a trajectory that is followed.
    """
    if isinstance(what, m.Confirm):
        goals.confirm(order, what.number)
        return None
    if isinstance(what, m.Cancel):
        goals.cancel(order, what.number)
        return None
    goal = trajectory_goal(what)
    return goals.check(order, goal) if what.check else goals.follow(order, goal, what.start, confirm=what.confirm)


def goal_row(report: GoalReport) -> m.Goal:
    """The report on a trajectory."""
    ended = {"outcome": report.outcome or "", "reason": report.reason or ""}
    return m.Goal(**asdict(report) | ended)


def follow_message(
    path: Spline, start: float = 0.0, *, check: bool = False, anywhere: bool = False, confirm: bool = False
) -> m.Follow:
    """A trajectory to follow.

    Args:
        path: All its points have velocities, or none has; likewise accelerations.
        start: Owner's clock at its start, seconds.
        check: Only check it.
        anywhere: Leave out its first point: it begins where the joints are.
        confirm: It begins only if that is confirmed.
    """
    points = path.waypoints[1:] if anywhere and len(path.waypoints) > 1 else path.waypoints

    def flat(rows: Sequence[Sequence[float] | None]) -> tuple[float, ...]:
        if any(row is None for row in rows):
            if any(row is not None for row in rows):
                raise UsageError("either all points of a trajectory have velocities and accelerations, or none")
            return ()
        return tuple(value for row in rows for value in row or ())

    return m.Follow(
        path.names,
        tuple(point.time for point in points),
        flat([point.position for point in points]),
        flat([point.velocity for point in points]),
        flat([point.acceleration for point in points]),
        start,
        check,
        confirm,
    )


def trajectory_goal(follow: m.Follow) -> TrajectoryGoal:
    """The trajectory in a message; its values are not checked.

    Raises:
        UsageError: Its rows have wrong lengths.
    """
    count, width = len(follow.times), len(follow.names)

    def rows(flat: tuple[float, ...], what: str) -> Iterator[tuple[float, ...]]:
        if flat and len(flat) != count * width:
            raise UsageError(f"{len(flat)} {what} for {count} points of {width} joints")
        for i in range(count):
            yield flat[i * width : (i + 1) * width]

    columns = zip(
        follow.times,
        rows(follow.positions, "positions"),
        rows(follow.velocities, "velocities"),
        rows(follow.accelerations, "accelerations"),
        strict=True,
    )
    return TrajectoryGoal(follow.names, tuple(Point(*row) for row in columns))
