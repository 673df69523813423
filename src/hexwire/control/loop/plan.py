"""The plan of a goal: made once when the goal arrives, and started later from the arm's position at that time.

Owns how points become a spline, dropping points in the past, and the bridge to the first remaining one. Must not
know clocks, robots, nor whether the path is allowed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from hexwire.errors import GoalError
from hexwire.motion.trajectory import Sample, Spline, Waypoint

from .outcomes import Reason

if TYPE_CHECKING:
    from ..motion.goals import TrajectoryGoal

__all__ = ["Plan"]

_TICK = 1e-9
"""Seconds; times are whole nanoseconds. Times closer to now count as now."""
_HAIR = 1e-6
"""Seconds; a last point closer to now counts as reached."""
_EARLIEST = 0.3
"""Seconds after its receipt at which the last point of one of a stream is due at the earliest, if without velocity.
So near the next one, joints arrive no sooner anyway; and counted from the receipt, not from when they begin, the
speed is even."""
_SOON = 0.01
"""Seconds to the last point of a stream that is due earlier than that."""
_THERE = 1e-3
"""Radians; greatest distance of the arm from a first point with time 0."""
_NEARLY = math.radians(2.0)
"""The same for a goal that takes no time: as far as a loaded servo rests from where it was told to be."""


class Plan:
    """The motion of a goal without its start position.

    Args:
        goal: Has passed `check_goal`.
        joints: Joints of the controller, in the order of the trajectory.
        received: Time to which `goal.delay` refers, seconds.
        streamed: It is one of a stream: its times count from when it was received, whenever it can begin.

    Attributes:
        goal: The goal, checked.
        due: When it should begin, seconds; ignored for a goal without a delay.

    Raises:
        GoalError: MALFORMED if it has no points.
    """

    def __init__(
        self, goal: TrajectoryGoal, joints: tuple[str, ...], received: float, *, streamed: bool = False
    ) -> None:
        if not goal.points:
            raise GoalError("the trajectory has no points", reason=Reason.MALFORMED)
        self.goal, self.due = goal, received + goal.delay
        self._joints, self._streamed = joints, streamed and not goal.delay
        places = {name: i for i, name in enumerate(goal.names)}
        # Index of each joint in the goal, None if the goal omits it.
        self._picks = [places.get(name) for name in joints]
        self._partial = None in self._picks
        self._start = Waypoint(0.0, self._row(goal.start)) if goal.start else None
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
        """Delay of the start at a time, seconds; 0 for a goal without a delay."""
        return max(0.0, now - self.due) if self.goal.delay else 0.0

    def is_over(self, now: float) -> bool:
        """Whether its last point is due or past at a time."""
        return bool(self.goal.delay) and self._points[-1].time - self.late(now) <= _HAIR

    def end(self, start: Sample) -> Spline:
        """A trajectory for joints that are at the last point already.

        Raises:
            GoalError: PATH_NOT_ALLOWED if they are not.
        """
        last = self._filled(self._points[-1], start).position
        self._check_there(start.position, last)
        return Spline(self._joints, [Waypoint(0.0, last)])

    def trajectory(self, start: Sample, now: float) -> Spline:
        """The remaining trajectory at a time.

        Points that are due or past are dropped. A bridge leads from `start` to the first remaining point in the
        remaining time; it begins with the velocity and acceleration of `start` if that point has its own. A goal
        that knows where it begins keeps that, at rest. Joints that the goal omits stay where they are.

        Args:
            start: State of the joints at that time, in the order of the trajectory; unknown velocities and
                accelerations count as 0.
            now: When it begins, seconds.

        Raises:
            GoalError: TOO_LATE if no point is left, unless the goal takes no time and the arm is there; NOT_READY
                if the position of a joint is unknown; PATH_NOT_ALLOWED if the first point is due at the beginning
                and the arm is elsewhere.
        """
        for name, value in zip(self._joints, start.position, strict=True):
            if not math.isfinite(value):
                raise GoalError(f"the position of {name} is unknown; wait for its state", reason=Reason.NOT_READY)
        since = now - self.due if self.goal.delay or self._streamed else 0.0
        last = self._points[-1]
        one_of_stream = self._streamed and last.time > _TICK
        if one_of_stream and last.velocity is not None and last.time - since < _SOON:
            return self._gone_on(start, since)
        left = tuple(point for point in self._points if point.time - since > _TICK)
        if one_of_stream and last.velocity is None:
            left = self._not_too_soon(start, left, since)
        if not left:
            if self.goal.delay:
                raise self._too_late(since)
            return self._here(start)
        if self._partial:
            left = tuple(self._filled(point, start) for point in left)
        if since > 0.0:
            left = tuple(Waypoint(p.time - since, p.position, p.velocity, p.acceleration) for p in left)
        first = left[0]
        if first.time <= _TICK:
            self._check_there(start.position, first.position)
            begin = Waypoint(0.0, first.position, first.velocity, first.acceleration)
            return Spline(self._joints, (begin, *left[1:]), checked=True)
        if self._start is not None:
            begin = self._filled(self._start, start)
            rest = None if first.velocity is None else (0.0,) * len(self._joints)
            return Spline(self._joints, (Waypoint(0.0, begin.position, rest), *left), checked=True)
        velocity = None if first.velocity is None else self._moving(start.velocity)
        acceleration = None if first.acceleration is None else self._moving(start.acceleration)
        return Spline(self._joints, (Waypoint(0.0, start.position, velocity, acceleration), *left), checked=True)

    def _not_too_soon(self, start: Sample, left: tuple[Waypoint, ...], since: float) -> tuple[Waypoint, ...]:
        """What counts of points without velocities of one of a stream: the last alone, and later, if it is near."""
        last, soonest = self._points[-1], max(_EARLIEST, since + _SOON)
        if last.time >= soonest:
            return left
        rows = [start.position, *(self._filled(point, start).position for point in left or (last,))]
        columns = map(list, zip(*rows, strict=True))
        goes_back = any(row not in (sorted(row), sorted(row, reverse=True)) for row in columns)
        return left if left and goes_back else (Waypoint(soonest, last.position),)

    def _gone_on(self, start: Sample, since: float) -> Spline:
        """To where the last point of a stream, which is past, has gone on to with its velocity."""
        last = self._filled(self._points[-1], start)
        speeds, seconds = last.velocity or (0.0,) * len(self._joints), since + _SOON - last.time
        place = tuple([p + v * seconds for p, v in zip(last.position, speeds, strict=True)])
        begin = Waypoint(0.0, start.position, self._moving(start.velocity))
        return Spline(self._joints, (begin, Waypoint(_SOON, place, speeds)), checked=True)

    def _here(self, start: Sample) -> Spline:
        """A goal that takes no time: planners send it when the arm, as it was measured, is at the goal already."""
        last = self._filled(self._points[-1], start).position
        if max(abs(b - a) for a, b in zip(start.position, last, strict=True)) > _NEARLY:
            raise self._too_late(0.0)
        return Spline(self._joints, [Waypoint(0.0, last)])

    def _row(self, values: Sequence[float]) -> tuple[float, ...]:
        """Values in the order of the joints; 0 for those that the goal omits."""
        return tuple(0.0 if pick is None else values[pick] for pick in self._picks)

    def _filled(self, point: Waypoint, start: Sample) -> Waypoint:
        """Fill in the start positions of joints that the goal omits."""
        rows = zip(self._picks, point.position, start.position, strict=True)
        position = tuple(here if pick is None else value for pick, value, here in rows)
        return Waypoint(point.time, position, point.velocity, point.acceleration)

    def _moving(self, values: Sequence[float]) -> tuple[float, ...]:
        """Velocities or accelerations at the start: 0 for omitted joints, and if unknown."""
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
            text = "the time_from_start of the last point must be above 0: it is the time to get there"
        else:
            ago = max(0.0, since - last)
            text = f"the trajectory ended {ago:.3g} s ago; stamp it later, or with 0 to begin on arrival"
        return GoalError(text, reason=Reason.TOO_LATE)
