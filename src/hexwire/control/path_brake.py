"""The points of a path for a robot that keeps the time: those of a plan, and those with which it comes to rest.

The latter are sent with each part of a path, and to end one. Owns both in the units of a `TimedPath`. Must not know
boards, controllers, nor why a path ends.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING

from hexwire.drivers.timed_path import TimedPath, TimedPoint
from hexwire.errors import CommandRefusedError, StoppedError, UsageError
from hexwire.motion.eased import LONGEST, ease_out
from hexwire.motion.moving import joint_limits
from hexwire.motion.path_points import path_points
from hexwire.motion.path_rest import path_rest
from hexwire.motion.trajectory import Tail

if TYPE_CHECKING:
    from hexwire.model.arm import ArmModel
    from hexwire.motion.trajectory import Trajectory

__all__ = ["PathBrake", "plan_points"]

_PLACES = 12
"""Points of a path from which a brake is tried."""
_CLOSE, _FAR = 0.02, 0.1
"""Seconds between two points of a path that slows down. Those of one request must last for longer than the robot
needs to brake by itself: otherwise it does, before the next request has come."""
_SPARE = 16
"""Points of a path that may still be on the robot before those that slow it down."""
_SEARCH, _TRIES = 0.02, 3
"""Seconds that the search for a way to rest may take, at first; if it took longer, twice that in the next try."""
_TICK = 1e-4


def plan_points(
    model: ArmModel, joints: Sequence[str], plan: Trajectory, begin: float, shortest: float, longest: float
) -> Iterator[TimedPoint]:
    """The points of a plan from a time on.

    Args:
        model: The arm.
        joints: Of the path on the robot, in its order.
        plan: Of the same joints, in any order.
        begin: Seconds of the plan.
        shortest: Seconds between two points, at least.
        longest: And at most.
    """
    rows = [(plan.names.index(name), model.joint(name)) for name in joints]
    # Half a count, since the robot rounds to counts anyway.
    error = [model.joint(name).scale / 2.0 for name in plan.names]
    for t, (position, velocity, _) in path_points(Tail(plan, begin), error, longest=longest, shortest=shortest):
        # A plan runs at the limits, and may be above them by a rounding error.
        yield TimedPoint(
            begin + t,
            tuple([min(max(position[i], joint.minimum), joint.maximum) for i, joint in rows]),
            tuple([max(-joint.max_speed, min(joint.max_speed, velocity[i])) for i, joint in rows]),
        )


class PathBrake:
    """Makes a robot come to rest within the limits of its joints.

    Args:
        model: The arm.
        joints: Of the path on the robot, in its order.
    """

    def __init__(self, model: ArmModel, joints: Sequence[str]) -> None:
        self._model, self._joints = model, tuple(joints)
        # Who sends a request asks once whether there is a brake at its end, and once for the brake.
        self._last: tuple[Trajectory, float, list[TimedPoint]] | None = None

    def after(self, plan: Trajectory, time: float) -> list[TimedPoint]:
        """Points that bring the joints to rest after a time of a plan; empty if a brake would leave its path.

        Args:
            plan: Of the same joints, in any order.
            time: Seconds of it; a multiple of 0.1 ms.
        """
        last = self._last
        if last is not None and last[0] is plan and last[1] == time:
            return last[2]
        model, names = self._model, plan.names
        ranges = [(model.joint(name).minimum, model.joint(name).maximum) for name in names]
        found = path_rest(plan, time, joint_limits(model, names), ranges)
        rows = [(names.index(name), model.joint(name)) for name in self._joints]
        points = [
            TimedPoint(
                round(point.time / _TICK) * _TICK,
                tuple([point.position[i] for i, _ in rows]),
                tuple([max(-joint.max_speed, min(joint.max_speed, point.velocity[i])) for i, joint in rows]),
            )
            for point in found or ()
        ]
        self._last = plan, time, points
        return points

    def end(
        self,
        path: TimedPath,
        plan: Trajectory,
        times: Sequence[float],
        oldest: int,
        settled: Callable[[], float],
    ) -> tuple[int, list[TimedPoint]] | None:
        """Replace what is left of a path by a brake, or by the path as it slows down, whichever is over sooner.

        Args:
            path: On the robot, which follows it.
            plan: What it follows.
            times: Of the points that the robot has, from index `oldest` on.
            oldest: Index of the first of them.
            settled: Returns the time of the plan up to which nothing can be changed any more.

        Returns:
            How many points of `times` still count, and those that were sent; None if the robot has taken none.

        Raises:
            StoppedError: A stop ended the path.
        """
        search = _SEARCH
        for _ in range(_TRIES):
            begin = settled()
            found = self._soonest(path, plan, times, bisect_right(times, begin + search))
            if found is None:
                return None
            (n, points), end = found, settled()
            if times[n] <= end:
                search = 2.0 * (end - begin)
                continue
            try:
                if path.send(points, last=True, first=oldest + n + 1) < len(points):
                    return None
            except StoppedError:
                raise
            except (CommandRefusedError, UsageError):
                # Perhaps it came too late.
                continue
            return n + 1, points
        return None

    def _soonest(
        self, path: TimedPath, plan: Trajectory, times: Sequence[float], begin: int
    ) -> tuple[int, list[TimedPoint]] | None:
        """After which point of the plan the joints can come to rest soonest, and how."""
        found = None
        for n in range(begin, min(begin + _PLACES, len(times))):
            if points := self.after(plan, times[n]):
                found = n, points
                break
        if begin == len(times) or (found is not None and found[0] == begin):
            return found
        longest = LONGEST if found is None else min(LONGEST, found[1][-1].time - times[begin])
        slowed = ease_out(Tail(plan, times[begin]), joint_limits(self._model, plan.names), longest)
        if slowed is None:
            return found
        points = [
            point._replace(time=round((times[begin] + point.time) / _TICK) * _TICK)
            for point in plan_points(self._model, self._joints, slowed, 0.0, _CLOSE, _FAR)
        ]
        return (begin, points[1:]) if len(points) <= path.capacity - _SPARE else found
