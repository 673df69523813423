"""The points as which a trajectory is sent to a robot that interpolates with cubics, and those of a brake from it.

Owns how close together they must be, and the points of a brake: within all limits, and as few as possible, since
every request with points of a path ends with them, so that a robot whose host falls silent needs no more than it
has. Pure. Must not know robots or clocks.

A brake is three pieces of constant jerk that begin and end together for all joints, so that each joint moves as a
cubic in each of them, and a straight motion stays straight.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

from hexwire.errors import UsageError

from .speed_profile import JointLimits
from .trajectory import Sample, Trajectory

__all__ = ["RestPoint", "nearest_time", "path_points", "path_rest"]

_TICK = 1e-4
"""Seconds: all times of points are multiples of it."""
_SHARES = ((0.3, 0.4, 0.3), (0.15, 0.45, 0.4), (0.4, 0.25, 0.35), (0.1, 0.3, 0.6), (0.2, 0.6, 0.2))
"""Parts of the time of a brake that its pieces take: with these some brake is found from every state of a plan."""
_SHORTEST, _LONGEST = 0.03, 2.0
"""Seconds that a brake takes."""
_GROWTH = 1.04
_STILL = 1e-9
"""Radians per second, and per second squared, that count as none."""
_NEAR = 0.02
"""Radians by which a joint may leave the path: less than servos lag behind at speed."""
_GRID = 24
"""Places of the path with which a brake is compared."""
_APART = 0.04
"""Seconds between two of them, at most, where a time of the path is looked for."""
_SLACK = 1e-3
_SOON = 0.45
"""Seconds before its end from which on a path itself may be the way to rest."""
_PIECES = 3


class RestPoint(NamedTuple):
    """A point of a brake.

    Attributes:
        time: Seconds of the path.
        position: Radians, in the order of the path's joints.
        velocity: Radians per second.
    """

    time: float
    position: tuple[float, ...]
    velocity: tuple[float, ...]


class _JointMotion(NamedTuple):
    p: float
    v: float
    a: float

    def after(self, seconds: float, jerk: float) -> _JointMotion:
        p = self.p + seconds * (self.v + seconds * (0.5 * self.a + seconds * jerk / 6.0))
        return _JointMotion(p, self.v + seconds * (self.a + 0.5 * seconds * jerk), self.a + seconds * jerk)


def path_rest(
    path: Trajectory, t: float, limits: Sequence[JointLimits], ranges: Sequence[tuple[float, float]]
) -> list[RestPoint] | None:
    """Points after a place of a path that bring all joints to rest.

    Args:
        path: Checked: the brake stays near it.
        t: Seconds of the path; a multiple of 0.1 ms.
        limits: Of the joints, in its order.
        ranges: Least and greatest position of the joints, radians.

    Returns:
        1 to 3 points, the last without velocity; None if a brake would leave the path or a range.
    """
    here = path.sample(t)
    states = [_JointMotion(*row) for row in zip(*here, strict=True)]
    if all(abs(s.v) <= _STILL and abs(s.a) <= _STILL for s in states):
        return [RestPoint(t + _SHORTEST, here.position, (0.0,) * len(states))]
    found = _brake(states, limits)
    if found is None:
        return _ending(path, t, limits)
    points = [RestPoint(t + at, tuple(s.p for s in row), tuple(s.v for s in row)) for at, row in found]
    points[-1] = points[-1]._replace(velocity=(0.0,) * len(states))
    inside = all(
        low - _STILL <= p <= high + _STILL
        for point in points
        for p, (low, high) in zip(point.position, ranges, strict=True)
    )
    return points if inside and _stays(path, t, here, points) else _ending(path, t, limits)


def _ending(path: Trajectory, t: float, limits: Sequence[JointLimits]) -> list[RestPoint] | None:
    """Points of the end of a path itself, if it is near and leads to rest.

    A path above its limits, which relieves joints that press on something, is followed as it is.
    """
    left = math.ceil((path.duration - t) / _TICK) * _TICK
    if not _SHORTEST <= left <= _SOON or any(abs(v) > _STILL for v in path.at(path.duration).velocity):
        return None
    times = [t + round(left * i / _PIECES / _TICK) * _TICK for i in range(_PIECES + 1)]
    points = [RestPoint(at, *path.sample(min(at, path.duration))[:2]) for at in times]
    points[-1] = RestPoint(times[-1], path.goal, (0.0,) * len(limits))
    grid = [path.sample(t + left * i / _GRID).acceleration for i in range(_GRID)]
    most = [(1.0 + _SLACK) * limit.acceleration for limit in limits]
    gives_way = any(abs(a) > limit for row in grid for a, limit in zip(row, most, strict=True))
    for a, b in pairwise(points):
        middle = path.sample(min(0.5 * (a.time + b.time), path.duration)).position
        if any(abs(p - q) > 0.5 * _NEAR for p, q in zip(_middle(a, b), middle, strict=True)):
            return None
        if not gives_way and not _keeps(a, b, limits):
            return None
    return points[1:]


def nearest_time(path: Trajectory, t: float, seconds: float, position: Sequence[float]) -> float:
    """The time of a path at which it is nearest to a place.

    Args:
        path: The path.
        t: It is not before this time.
        seconds: Nor so much later.
        position: Of its joints, radians.
    """
    count = max(_GRID, math.ceil(seconds / _APART))
    times = [min(path.duration, t + seconds * i / count) for i in range(count + 1)]

    def off(time: float) -> float:
        return math.dist(path.sample(time).position, position)

    return min(times, key=off)


def _brake(
    states: Sequence[_JointMotion], limits: Sequence[JointLimits]
) -> list[tuple[float, list[_JointMotion]]] | None:
    """Times and states at the ends of the pieces of the shortest brake that is found."""
    pairs = list(zip(states, limits, strict=True))
    seconds = max(_SHORTEST, *(_least(s, limit) for s, limit in pairs))
    while seconds <= _LONGEST:
        for shares in _SHARES:
            h = [max(1, round(share * seconds / _TICK)) * _TICK for share in shares]
            part = _part(pairs, h)
            if part is not None:
                return _ends(pairs, h, part)
        seconds *= _GROWTH
    return None


def _least(s: _JointMotion, limit: JointLimits) -> float:
    """Seconds that a brake takes at least: the acceleration that there is must end, and the speed too."""
    change = abs(s.v + 0.5 * s.a * abs(s.a) / limit.jerk)
    return max(abs(s.a) / limit.jerk, min(change / limit.acceleration, 2.0 * math.sqrt(change / limit.jerk)))


def _part(pairs: Sequence[tuple[_JointMotion, JointLimits]], h: Sequence[float]) -> float | None:
    """The part of the speed that goes until the middle of the second piece: the same for all joints."""
    low, high = -math.inf, math.inf
    first, second = 0.5 * (h[0] + h[1]), 0.5 * (h[1] + h[2])
    for s, limit in pairs:
        # The acceleration at the end of the first piece is a, that at the end of the second follows from it.
        gone = s.v + 0.5 * h[0] * s.a
        last, jerk = min(limit.acceleration, limit.jerk * h[2]), limit.jerk
        whole = first / second + 1.0
        least = max(
            -limit.acceleration,
            s.a - jerk * h[0],
            (-gone - last * second) / first,
            (-gone / second - jerk * h[1]) / whole,
        )
        most = min(
            limit.acceleration,
            s.a + jerk * h[0],
            (-gone + last * second) / first,
            (-gone / second + jerk * h[1]) / whole,
        )
        if least > most:
            return None
        if abs(gone) <= _STILL:
            if least > 0.0 or most < 0.0:
                return None
            continue
        one, two = sorted((-least * first / gone, -most * first / gone))
        low, high = max(low, one), min(high, two)
        if low > high:
            return None
    if math.isinf(low):
        return 0.5
    part = 0.5 * (low + high)
    return part if all(_slow(s, limit, h, part) for s, limit in pairs) else None


def _jerks(s: _JointMotion, h: Sequence[float], part: float) -> tuple[float, float, float]:
    first, second = 0.5 * (h[0] + h[1]), 0.5 * (h[1] + h[2])
    gone = s.v + 0.5 * h[0] * s.a
    a, b = -part * gone / first, -(1.0 - part) * gone / second
    return (a - s.a) / h[0], (b - a) / h[1], -b / h[2]


def _slow(s: _JointMotion, limit: JointLimits, h: Sequence[float], part: float) -> bool:
    """Whether the speed stays below the limit."""
    for seconds, jerk in zip(h, _jerks(s, h, part), strict=True):
        after = s.after(seconds, jerk)
        fastest = max(abs(s.v), abs(after.v))
        if s.a * after.a < 0.0:
            fastest = max(fastest, abs(s.v - 0.5 * s.a * s.a / jerk))
        if fastest > (1.0 + _SLACK) * limit.speed:
            return False
        s = after
    return True


def _ends(
    pairs: Sequence[tuple[_JointMotion, JointLimits]], h: Sequence[float], part: float
) -> list[tuple[float, list[_JointMotion]]]:
    rows, states, at = [], [s for s, _ in pairs], 0.0
    jerks = [_jerks(s, h, part) for s in states]
    for i, seconds in enumerate(h):
        states = [s.after(seconds, jerk[i]) for s, jerk in zip(states, jerks, strict=True)]
        at += seconds
        rows.append((at, states))
    return rows


def _stays(path: Trajectory, t: float, here: Sample, points: Sequence[RestPoint]) -> bool:
    """Whether a brake stays near the path that is before it."""
    seconds = points[-1].time - t
    places = [path.sample(min(path.duration, t + seconds * i / _GRID)).position for i in range(_GRID + 1)]
    before = RestPoint(t, here.position, here.velocity)
    return all(_near(_middle(a, b), places) and _near(b.position, places) for a, b in pairwise((before, *points)))


def _keeps(a: RestPoint, b: RestPoint, limits: Sequence[JointLimits]) -> bool:
    """Whether the cubic between two points keeps the limits of acceleration and jerk; its speed is the path's."""
    h = b.time - a.time
    for p, q, v, w, limit in zip(a.position, b.position, a.velocity, b.velocity, limits, strict=True):
        mean, change = (q - p) / h, (v + w) / 2.0
        # Its acceleration at both ends.
        one, two = (6.0 * mean - 4.0 * v - 2.0 * w) / h, (4.0 * w + 2.0 * v - 6.0 * mean) / h
        if max(abs(one), abs(two)) > (1.0 + _SLACK) * limit.acceleration:
            return False
        if 12.0 * abs(change - mean) > (1.0 + _SLACK) * limit.jerk * h * h:
            return False
    return True


def _middle(a: RestPoint, b: RestPoint) -> tuple[float, ...]:
    """Half way in time on the cubic between two points."""
    rows = zip(a.position, b.position, a.velocity, b.velocity, strict=True)
    return tuple(0.5 * (p + q) + 0.125 * (b.time - a.time) * (v - w) for p, q, v, w in rows)


def _near(place: Sequence[float], places: Sequence[Sequence[float]]) -> bool:
    return any(_distance(place, a, b) <= _NEAR for a, b in pairwise(places))


def _distance(place: Sequence[float], a: Sequence[float], b: Sequence[float]) -> float:
    """Greatest distance of a joint from the nearest place of a straight way."""
    way = [q - p for p, q in zip(a, b, strict=True)]
    length = sum(x * x for x in way)
    along = sum((c - p) * x for c, p, x in zip(place, a, way, strict=True)) / length if length else 0.0
    share = min(max(along, 0.0), 1.0)
    return max(abs(p + share * x - c) for p, x, c in zip(a, way, place, strict=True))


_PLACES = (0.25, 0.5, 0.75)
"""Where the cubic is compared with the trajectory, as parts of its time."""


def path_points(
    trajectory: Trajectory, error: Sequence[float], *, longest: float = 0.05, shortest: float = 0.01
) -> Iterator[tuple[float, Sample]]:
    """Times and samples from start to end, between which cubics with the same velocities follow the trajectory.

    Args:
        trajectory: The trajectory.
        error: Greatest distance from it between two points, radians by joint. At a corner, where the velocity
            jumps, it may be greater.
        longest: Most seconds between two points.
        shortest: Least seconds; only a trajectory that is shorter has closer ones. All times are multiples of
            0.1 ms; the last is not before the end.

    Raises:
        UsageError: The times are not above 0, or in the wrong order.
    """
    if not 0.0 < shortest <= longest < math.inf:
        raise UsageError(f"points cannot be {shortest:g} to {longest:g} s apart")
    here = trajectory.sample(0.0)
    yield 0.0, here
    most, least = max(1, round(longest / _TICK)), max(1, round(shortest / _TICK))
    # Slightly less, so that rounding adds no tick.
    done, end = 0, math.ceil(trajectory.duration / _TICK - 1e-6)
    while done < end:
        left = end - done
        # What is left at the end must not be too short for a point of its own.
        step = left if left <= most or left < 2 * least else min(most, left - least)
        there = _at(trajectory, done + step, end)
        while step > least and left >= 2 * least:
            if _fits(trajectory, done * _TICK, step * _TICK, here, there, error):
                break
            step = max(least, step // 2)
            there = _at(trajectory, done + step, end)
        done += step
        here = there
        yield done * _TICK, here


def _at(trajectory: Trajectory, ticks: int, end: int) -> Sample:
    return trajectory.sample(trajectory.duration if ticks == end else min(ticks * _TICK, trajectory.duration))


def _fits(trajectory: Trajectory, t: float, step: float, a: Sample, b: Sample, error: Sequence[float]) -> bool:
    rows = list(zip(a.position, b.position, a.velocity, b.velocity, error, strict=True))
    for u in _PLACES:
        exact = trajectory.sample(t + u * step).position
        for (p, q, v, w, most), m in zip(rows, exact, strict=True):
            # The cubic with these ends.
            c2, c3 = 3.0 * (q - p) - step * (2.0 * v + w), step * (v + w) - 2.0 * (q - p)
            if not abs(p + u * (step * v + u * (c2 + u * c3)) - m) <= most:
                return False
    return True
