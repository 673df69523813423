"""A goal in the joints of its controller: planned once when it comes, and begun from where the arm is then.

Owns how points become a spline, which of them are past, and the bridge to the first one that is left. Must not know
clocks, robots, nor whether the path is allowed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from hexwire.errors import GoalError
from hexwire.motion.waypoints import Sample, Spline, Waypoint

from .outcomes import Reason

if TYPE_CHECKING:
    from .goals import TrajectoryGoal

__all__ = ["Plan"]

_TICK = 1e-9
"""Seconds; times are whole nanoseconds. Less than this from now is now."""
_HAIR = 1e-6
"""Seconds: as good as now."""
_THERE = 1e-3
"""Radians; a first point that is due at once may be so far from where the arm is."""


class Plan:
    """What a goal makes its joints do, but for where they begin.

    Args:
        goal: Has passed `check_goal`.
        joints: Joints of the controller, in the order of the trajectory.
        received: When `goal.delay` was true, seconds.

    Attributes:
        goal: As given.
        due: When it is to begin, seconds; a goal without a delay begins whenever it begins.

    Raises:
        GoalError: MALFORMED if it has no points.
    """

    def __init__(self, goal: TrajectoryGoal, joints: tuple[str, ...], received: float) -> None:
        if not goal.points:
            raise GoalError("the trajectory has no points", reason=Reason.MALFORMED)
        self.goal, self.due = goal, received + goal.delay
        self._joints = joints
        places = {name: i for i, name in enumerate(goal.names)}
        # Place of each joint in the goal, None if it is left out.
        self._picks = [places.get(name) for name in joints]
        self._partial = None in self._picks
        self._points = tuple(
            Waypoint(
                point.time,
                self._row(point.positions),
                self._row(point.velocities) if point.velocities else None,
                self._row(point.accelerations) if point.accelerations else None,
            )
            for point in goal.points
        )

    def late(self, now: float) -> float:
        """Seconds by which it is late at a time; 0 for a goal without a delay."""
        return max(0.0, now - self.due) if self.goal.delay else 0.0

    def is_over(self, now: float) -> bool:
        """Its last point is past at a time, or due."""
        return bool(self.goal.delay) and self._points[-1].time - self.late(now) <= _HAIR

    def end(self, start: Sample) -> Spline:
        """The trajectory of joints that are at the last point already.

        Raises:
            GoalError: PATH_NOT_ALLOWED if they are not.
        """
        last = self._filled(self._points[-1], start).position
        self._check_there(start.position, last)
        return Spline(self._joints, [Waypoint(0.0, last)], checked=True)

    def trajectory(self, start: Sample, now: float) -> Spline:
        """What is left of it at a time.

        Points whose time has come are dropped. A bridge leads from `start` to the first one that is left, in the
        time that is left, and takes up the velocity and acceleration of `start` as far as that point has its own.
        Joints that the goal leaves out stand still where they are.

        Args:
            start: Where the joints are then, in the order of the trajectory; unknown velocities and accelerations
                are taken for 0.
            now: When it begins, seconds.

        Raises:
            GoalError: TOO_LATE if no point is left; NOT_READY if the position of a joint is unknown;
                PATH_NOT_ALLOWED if the first point is due at the beginning and the arm is elsewhere.
        """
        for name, value in zip(self._joints, start.position, strict=True):
            if not math.isfinite(value):
                raise GoalError(f"it is not known yet where {name} is; wait for its state", reason=Reason.NOT_READY)
        since = now - self.due if self.goal.delay else 0.0
        left = tuple(point for point in self._points if point.time - since > _TICK)
        if not left:
            raise self._too_late(since)
        if self._partial:
            left = tuple(self._filled(point, start) for point in left)
        if since > 0.0:
            left = tuple(Waypoint(p.time - since, p.position, p.velocity, p.acceleration) for p in left)
        first = left[0]
        if first.time <= _TICK:
            self._check_there(start.position, first.position)
            begin = Waypoint(0.0, first.position, first.velocity, first.acceleration)
            return Spline(self._joints, (begin, *left[1:]), checked=True)
        velocity = None if first.velocity is None else self._moving(start.velocity)
        acceleration = None if first.acceleration is None else self._moving(start.acceleration)
        return Spline(self._joints, (Waypoint(0.0, start.position, velocity, acceleration), *left), checked=True)

    def _row(self, values: Sequence[float]) -> tuple[float, ...]:
        """In the order of the joints; 0 for those that the goal leaves out."""
        return tuple(0.0 if pick is None else values[pick] for pick in self._picks)

    def _filled(self, point: Waypoint, start: Sample) -> Waypoint:
        """Joints that the goal leaves out stand where they are."""
        rows = zip(self._picks, point.position, start.position, strict=True)
        position = tuple(here if pick is None else value for pick, value, here in rows)
        return Waypoint(point.time, position, point.velocity, point.acceleration)

    def _moving(self, values: Sequence[float]) -> tuple[float, ...]:
        """Velocities or accelerations to start with: none for joints left out, nor where it is not known."""
        return tuple(
            0.0 if pick is None or not math.isfinite(value) else value
            for pick, value in zip(self._picks, values, strict=True)
        )

    def _check_there(self, here: Sequence[float], first: Sequence[float]) -> None:
        gap, name = max((abs(b - a), name) for name, a, b in zip(self._joints, here, first, strict=True))
        if gap > _THERE:
            raise GoalError(
                f"the trajectory begins {math.degrees(gap):.3g} deg from where {name} is; "
                "give its first point a time_from_start above 0, or move there first",
                reason=Reason.PATH_NOT_ALLOWED,
            )

    def _too_late(self, since: float) -> GoalError:
        last = self.goal.points[-1].time
        if last <= _TICK:
            text = "the time_from_start of the last point must be above 0: it is the time the arm has to get there"
        else:
            ago = max(0.0, since - last)
            text = f"the trajectory ended {ago:.3g} s ago; stamp it later, or with 0 to begin on arrival"
        return GoalError(text, reason=Reason.TOO_LATE)
