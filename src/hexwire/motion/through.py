"""The fastest motion through points under limits of speed, acceleration and jerk, without a stop at them.

Owns the choice of the speeds at the points, and the trajectory. Must not know robots.

Between two points each joint moves one way only, so it never leaves the range between their positions; where it
turns back it has no speed while the others go on, and only there it accelerates at a point. Speeds, and the
accelerations of joints that turn back, are improved joint by joint until no small change saves time.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

from hexwire.errors import UsageError
from hexwire.model.arm import ArmModel

from .moving import Pieces, Row
from .speed_profile import JointLimits, Passing, profile, time_window

__all__ = ["MOST_POINTS", "Through", "arm_path"]

MOST_POINTS = 100
"""Points of one motion: more take too long to plan."""
_FIRST_STEP, _LAST_STEP = 0.5, 0.002
"""By how much a value is changed to see whether that saves time, as shares of its limit: from coarse to fine."""
_WORTH = 0.002
"""Share of the time that all such changes must save; otherwise the next ones are finer."""
_OTHERS = 0.02
"""Weight of the times of all joints beside that of the slowest, so that others make way for it."""

_NOTHING = 1e-12
"""Radians."""


def arm_path(
    arm: ArmModel,
    names: Sequence[str],
    points: Sequence[Sequence[float]],
    *,
    speed: float = 1.0,
    acceleration: float = math.inf,
) -> Through:
    """The fastest motion of an arm's joints through points, under the limits of its model.

    Args:
        arm: Limits of speed, acceleration and jerk.
        names: Joint names.
        points: As in `Through`.
        speed: Share of the speed limits.
        acceleration: Most radians per second squared, where the model allows more.

    Raises:
        UsageError: The numbers are invalid, or the arm lacks a joint.
    """
    joints = [arm.joint(name) for name in names]
    return Through(
        names,
        points,
        [speed * joint.max_speed for joint in joints],
        [min(acceleration, joint.max_acceleration) for joint in joints],
        [joint.max_jerk for joint in joints],
    )


class Through(Pieces):
    """From rest at the first point through all others to rest at the last.

    Args:
        names: Joint names.
        points: At least one, at most 100: radians, one per joint. One that equals the point before it is left out.
        max_speed: Radians per second, above 0, one per joint.
        max_acceleration: Radians per second squared, likewise.
        max_jerk: Radians per second cubed, likewise.

    Attributes:
        times: When it is at each point, seconds; without those that are left out.

    Raises:
        UsageError: The numbers are invalid.
    """

    def __init__(
        self,
        names: Sequence[str],
        points: Sequence[Sequence[float]],
        max_speed: Sequence[float],
        max_acceleration: Sequence[float],
        max_jerk: Sequence[float],
    ) -> None:
        _check(names, points, max_speed, max_acceleration, max_jerk)
        rows = [tuple(points[0])]
        rows += [tuple(b) for a, b in pairwise(points) if tuple(a) != tuple(b)]
        limits = [JointLimits(*row) for row in zip(max_speed, max_acceleration, max_jerk, strict=True)]
        plan = _Speeds(rows, limits)
        plan.improve()
        times = [0.0]
        for seconds in plan.times():
            times.append(times[-1] + seconds)
        self.times = tuple(times)
        pieces = [
            _pieces([row[i] for row in rows], [row[i] for row in plan.passing], times, limits[i])
            for i in range(len(names))
        ]
        super().__init__(names, pieces, rows[-1], times[-1])


class _Speeds:
    """How the joints pass the points, and the time windows of each joint between two points.

    Attributes:
        passing: By point and joint; at rest at both ends.
    """

    def __init__(self, rows: Sequence[Sequence[float]], limits: Sequence[JointLimits]) -> None:
        joints = range(len(limits))
        ways = [[_way(a, b) for a, b in zip(one, two, strict=True)] for one, two in pairwise(rows)]
        self._limits = limits
        self._distances = [[abs(way) for way in row] for row in ways]
        # A joint goes on, or turns back; where it has rested or will rest, nothing can be improved.
        self._free = [
            (k, i, _sign(ways[k - 1][i]) == _sign(ways[k][i]))
            for k in range(1, len(ways))
            for i in joints
            if ways[k - 1][i] and ways[k][i]
        ]
        self.passing = [[Passing()] * len(limits) for _ in rows]
        self._windows = [[self._window(k, i) for i in joints] for k in range(len(ways))]
        self._costs = [_cost(row) for row in self._windows]

    def times(self) -> list[float]:
        """Seconds from each point to the next."""
        return [max(low for low, _ in row) for row in self._windows]

    def improve(self) -> None:
        """Change how the joints pass the points as long as that saves time."""
        # Speeds first: a joint that turns back without a pause leaves the others less time.
        for some in ([one for one in self._free if one[2]], self._free):
            step = _FIRST_STEP
            while step >= _LAST_STEP:
                before = sum(self._costs)
                for one in some:
                    _ = self._try(*one, step) or self._try(*one, -step)
                if sum(self._costs) >= (1.0 - _WORTH) * before:
                    step *= 0.5

    def _try(self, k: int, i: int, goes_on: bool, step: float) -> bool:
        """Change how a joint passes a point; undone if it saves no time."""
        old, limits = self.passing[k][i], self._limits[i]
        if goes_on:
            new = Passing(min(limits.speed, max(0.0, old.speed + step * limits.speed)))
        else:
            # It must not need more than the limit of speed to lose this acceleration.
            most = min(limits.acceleration, math.sqrt(2.0 * limits.speed * limits.jerk))
            new = Passing(turn=min(most, max(0.0, old.turn + step * most)))
        if new == old:
            return False
        windows = self._windows[k - 1][i], self._windows[k][i]
        self.passing[k][i] = new
        self._windows[k - 1][i], self._windows[k][i] = self._window(k - 1, i), self._window(k, i)
        costs = _cost(self._windows[k - 1]), _cost(self._windows[k])
        if sum(costs) < self._costs[k - 1] + self._costs[k] - 1e-9:
            self._costs[k - 1 : k + 1] = costs
            return True
        self.passing[k][i] = old
        self._windows[k - 1][i], self._windows[k][i] = windows
        return False

    def _window(self, k: int, i: int) -> tuple[float, float]:
        distance = self._distances[k][i]
        if not distance:
            return 0.0, math.inf
        return time_window(distance, self.passing[k][i], self.passing[k + 1][i], self._limits[i])


def _way(begin: float, end: float) -> float:
    """From one position to another; 0 if that is only a rounding error."""
    return end - begin if abs(end - begin) >= _NOTHING else 0.0


def _sign(value: float) -> int:
    return (value > 0.0) - (value < 0.0)


def _cost(windows: Sequence[tuple[float, float]]) -> float:
    """Seconds between two points, more if other joints are slow too; infinite if no time suits all joints."""
    slowest = max(low for low, _ in windows)
    if slowest > min(high for _, high in windows):
        return math.inf
    return slowest + _OTHERS * math.sqrt(math.sqrt(sum(low**4 for low, _ in windows)))


def _pieces(
    points: Sequence[float], passing: Sequence[Passing], times: Sequence[float], limits: JointLimits
) -> list[Row]:
    rows: list[Row] = [(0.0, points[0], 0.0, 0.0, 0.0)]
    for k in range(len(points) - 1):
        p, way = points[k], _way(points[k], points[k + 1])
        sign = math.copysign(1.0, way)
        t, v, a = times[k], sign * passing[k].speed, sign * passing[k].turn
        if not way:
            rows.append((t, p, 0.0, 0.0, 0.0))
            continue
        for u, jerk in profile(abs(way), passing[k], passing[k + 1], times[k + 1] - t, limits):
            if not u:
                continue
            j = sign * jerk
            rows.append((t, p, v, a, j))
            t, p, v, a = t + u, p + u * (v + u * (0.5 * a + u * j / 6.0)), v + u * (a + 0.5 * u * j), a + u * j
    rows.append((times[-1], points[-1], 0.0, 0.0, 0.0))
    return rows


def _check(names: Sequence[str], points: Sequence[Sequence[float]], *limits: Sequence[float]) -> None:
    if not names or not points:
        raise UsageError("a motion needs a joint and a point")
    if len(points) > MOST_POINTS:
        raise UsageError(f"{len(points)} points are too many for one motion; at most {MOST_POINTS}")
    for column in (*points, *limits):
        if len(column) != len(names):
            raise UsageError(f"{len(column)} values for {len(names)} joints")
        if not all(map(math.isfinite, column)):
            raise UsageError("a value is not a number")
    if min(map(min, limits)) <= 0:
        raise UsageError("limits of speed, acceleration and jerk must be above 0")
