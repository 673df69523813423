"""Points that bring joints to rest from any place of a path: their cubics against the limits."""

from __future__ import annotations

import math
import random
from itertools import pairwise

import pytest
from tests.few import few
from tests.motion.arms import cubic_at

from hexwire.motion.moving import reach
from hexwire.motion.path_points import RestPoint, nearest_time, path_rest
from hexwire.motion.speed_profile import JointLimits
from hexwire.motion.trajectory import Sample, Spline, Trajectory, Waypoint

MOST = 1.001
FREE = (-math.inf, math.inf)


def plan(draw: random.Random, joints: int, *, curved: bool) -> tuple[Trajectory, list[JointLimits]]:
    """A motion that runs at the limits of its joints."""
    names = tuple(f"J{i}" for i in range(joints))
    limits = [
        JointLimits(draw.uniform(0.5, 4.0), draw.uniform(2.0, 12.0), draw.uniform(20.0, 200.0)) for _ in names
    ]
    rest = (0.0,) * joints
    begin, end = (tuple(draw.uniform(-2.0, 2.0) for _ in names) for _ in range(2))
    speeds = tuple(draw.uniform(-0.7, 0.7) * limit.speed for limit in limits) if curved else rest
    found = reach(names, Sample(begin, rest, rest), Sample(end, speeds, rest), limits, 0.01, longer=True)
    assert found is not None
    return found, limits


def cubics(
    path: Trajectory, t: float, points: list[RestPoint], step: float = 0.001
) -> list[list[tuple[float, ...]]]:
    """Position, velocity, acceleration and jerk of each joint between the points, every millisecond."""
    here = path.sample(t)
    rows = []
    for a, b in pairwise((RestPoint(t, here.position, here.velocity), *points)):
        h = b.time - a.time
        for n in range(math.ceil(h / step) + 1):
            u, row = min(n * step, h), []
            for p, q, v, w in zip(a.position, b.position, a.velocity, b.velocity, strict=True):
                row.append(cubic_at(p, q, v, w, h, u))
            rows.append(row)
    return rows


@few("curved", [False, True], True)
def test_from_every_place_of_a_path_a_brake_keeps_all_limits(curved: bool) -> None:
    draw, found = random.Random(17), 0
    for _ in range(300):
        path, limits = plan(draw, draw.choice((1, 3, 7)), curved=curved)
        t = round(draw.uniform(0.0, path.duration), 4)
        points = path_rest(path, t, limits, [FREE] * len(limits))
        if points is None:
            continue
        found += 1
        assert len(points) <= 3
        assert not any(points[-1].velocity)
        assert all(b.time - a.time >= 0.0019 for a, b in pairwise(points))
        before = path.sample(t)
        for row in cubics(path, t, points):
            for (_, v, a, j), limit in zip(row, limits, strict=True):
                assert abs(v) <= MOST * limit.speed
                assert abs(a) <= MOST * limit.acceleration
                assert abs(j) <= MOST * limit.jerk
            # No step of the acceleration either, but at the very end of a path that ends with speed.
            step = 1.02 * 0.001
            for (_, _, a, _), b, limit in zip(row, before.acceleration, limits, strict=True):
                assert abs(a - b) <= limit.jerk * step + 1e-6
            before = Sample(*(tuple(column) for column in list(zip(*row, strict=True))[:3]))
        assert max(abs(a) for a in before.acceleration) < 1e-6, "at rest"
    assert found > (100 if curved else 250), "elsewhere the board brakes on its path by its own law"


@pytest.mark.slow
def test_a_straight_motion_stays_straight_and_a_brake_near_its_path() -> None:
    draw, found = random.Random(5), 0
    for _ in range(100):
        path, limits = plan(draw, 4, curved=False)
        t = round(draw.uniform(0.1, 0.6) * path.duration, 4)
        points = path_rest(path, t, limits, [FREE] * 4)
        if points is None:
            continue
        found += 1
        way = [b - a for a, b in zip(path.start, path.goal, strict=True)]
        for row in cubics(path, t, points):
            shares = [(p[0] - a) / w for p, a, w in zip(row, path.start, way, strict=True)]
            assert max(shares) - min(shares) < 1e-6
        near = nearest_time(path, t, 2.0, points[-1].position)
        assert max(abs(a - b) for a, b in zip(path.sample(near).position, points[-1].position, strict=True)) < 0.2
    assert found > 90


def test_what_would_leave_the_path_or_a_range_is_none() -> None:
    limits = [JointLimits(2.0, 6.0, 60.0)] * 2
    # A corner in no time: whoever brakes leaves it.
    rows = ((0.0, (0.0, 0.0), (1.0, 0.0)), (0.05, (0.05, 0.0), (1.0, 0.0)), (0.35, (0.05, 0.2), (0.0, 1.0)))
    path = Spline(("J1", "J2"), [Waypoint(*row) for row in rows])
    assert path_rest(path, 0.0, limits, [FREE] * 2) is None
    even = Spline(("J1", "J2"), [Waypoint(0.0, (0.0, 0.0), (1.0, 0.0)), Waypoint(2.0, (2.0, 0.0), (1.0, 0.0))])
    assert path_rest(even, 1.0, limits, [FREE] * 2) is not None
    assert path_rest(even, 1.0, limits, [(0.0, 1.05), FREE]) is None
    assert path_rest(even, 1.0, limits, [(0.0, 1.5), FREE]) is not None


def test_at_rest_the_joints_stay() -> None:
    path = Spline(("J1",), [Waypoint(0.0, (0.3,), (0.0,)), Waypoint(1.0, (0.3,), (0.0,))])
    (point,) = path_rest(path, 0.5, [JointLimits(2.0, 6.0, 60.0)], [FREE]) or ()
    assert point.position == (0.3,)
    assert point.velocity == (0.0,)
    assert point.time > 0.5


def test_joints_that_are_relieved_come_to_rest_as_their_path_does() -> None:
    """From the speed of closing jaws back to what they press on, far above the limits: no brake would stay near."""
    limits = [JointLimits(4.0, 6.0, 60.0)]
    relief = Spline(("J7",), [Waypoint(0.0, (0.4,), (1.0,), (0.0,)), Waypoint(0.35, (0.08,), (0.0,), (0.0,))])
    for t in (0.15, 0.2, 0.25):
        points = path_rest(relief, t, limits, [(0.0, 0.8)])
        assert points is not None
        assert points[-1] == RestPoint(pytest.approx(0.35, abs=2e-4), relief.goal, (0.0,))
        assert len(points) <= 3
        for place, *_ in (row[0] for row in cubics(relief, t, points)):
            assert 0.0 <= place <= 0.6
