"""Trajectories and what became of them as messages, and back.

Owns the conversion. Must not know Zenoh, nor whether a path is allowed.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import astuple

from hexwire.control.goals import Point, TrajectoryGoal
from hexwire.control.shared_goals import GoalReport
from hexwire.errors import UsageError
from hexwire.motion.waypoints import Spline

from . import messages as m

__all__ = ["follow_message", "goal_row", "trajectory_goal"]


def goal_row(report: GoalReport) -> m.Goal:
    """The report on a trajectory."""
    return m.Goal(*astuple(report))


def follow_message(path: Spline, start: float = 0.0, *, check: bool = False, anywhere: bool = False) -> m.Follow:
    """A trajectory to follow.

    Args:
        path: All its points have velocities, or none has; likewise accelerations.
        start: Owner's clock at its start, seconds.
        check: Only check it.
        anywhere: Leave out its first point: it begins where the joints are.
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
