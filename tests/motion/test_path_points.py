"""Points that stand for a trajectory: cubics through them stay on it, and they are as few as that allows."""

from __future__ import annotations

import itertools
import math

import pytest

from hexwire.errors import UsageError
from hexwire.motion.optimal import Trapezoid
from hexwire.motion.path_points import path_points
from hexwire.motion.trajectory import Sample, Spline, Trajectory, Waypoint

COUNT = math.radians(360 / 4096)


class Wave(Trajectory):
    """A sine of some frequency."""

    def __init__(self, hertz: float, seconds: float) -> None:
        self.names, self.duration, self._w = ("J1",), seconds, 2.0 * math.pi * hertz

    def at(self, t: float) -> Sample:
        w = self._w
        return Sample((math.sin(w * t),), (w * math.cos(w * t),), (-w * w * math.sin(w * t),))


def off(trajectory: Trajectory, points: list[tuple[float, Sample]]) -> float:
    """Greatest distance of the cubics from the trajectory."""
    worst = 0.0
    for (t, a), (s, b) in itertools.pairwise(points):
        h = s - t
        for i in range(1, 10):
            u = i / 10
            for p, q, v, w, exact in zip(
                a.position, b.position, a.velocity, b.velocity, trajectory.sample(t + u * h).position, strict=True
            ):
                c2, c3 = 3 * (q - p) - h * (2 * v + w), h * (v + w) - 2 * (q - p)
                worst = max(worst, abs(p + u * (h * v + u * (c2 + u * c3)) - exact))
    return worst


def test_a_smooth_motion_needs_few_points() -> None:
    trajectory = Wave(0.25, 2.0)
    points = list(path_points(trajectory, [COUNT / 2]))
    assert [t for t, _ in points[:3]] == pytest.approx([0.0, 0.05, 0.1])
    assert points[-1][0] == 2.0
    assert points[-1][1] == trajectory.sample(2.0)
    assert len(points) <= 48
    # It ends in full motion, which is a corner.
    assert off(trajectory, points[:-1]) <= COUNT


def test_a_fast_one_needs_more() -> None:
    trajectory = Wave(4.0, 1.0)
    points = list(path_points(trajectory, [COUNT / 2]))
    steps = [s - t for (t, _), (s, _) in itertools.pairwise(points)]
    assert min(steps) < 0.03
    assert off(trajectory, points[:-3]) <= COUNT


def test_corners_get_the_closest_points() -> None:
    corner = Spline(("J1",), [Waypoint(0.0, (0.0,)), Waypoint(0.52, (0.5,)), Waypoint(1.0, (0.0,))])
    points = list(path_points(corner, [COUNT / 2]))
    near = [t for t, _ in points if abs(t - 0.52) < 0.03]
    assert len(near) >= 3
    assert off(corner, points) < 0.004


def test_a_motion_from_rest_to_rest_keeps_its_ends() -> None:
    trajectory = Trapezoid(("J1", "J2"), (0.0, 0.0), (1.0, -0.2), (1.0, 1.0), (4.0, 4.0))
    points = list(path_points(trajectory, [COUNT / 2] * 2))
    assert points[0][1].position == (0.0, 0.0)
    assert points[-1][1].position == (1.0, -0.2)
    assert points[-1][1].velocity == (0.0, 0.0)
    assert off(trajectory, points) <= 2 * COUNT


def test_one_without_duration_is_one_point() -> None:
    still = Trapezoid(("J1",), (0.3,), (0.3,), (1.0,), (1.0,))
    assert [t for t, _ in path_points(still, [COUNT])] == [0.0]


@pytest.mark.parametrize(("longest", "shortest"), [(0.01, 0.02), (0.05, 0.0), (math.inf, 0.1)])
def test_times_in_the_wrong_order_are_refused(longest: float, shortest: float) -> None:
    with pytest.raises(UsageError, match="apart"):
        list(path_points(Wave(1.0, 1.0), [COUNT], longest=longest, shortest=shortest))


@pytest.mark.parametrize("seconds", [1.00003, 0.99997, 0.05004, 0.0601, 0.00003, 0.0149])
def test_times_are_whole_ticks_and_never_too_close(seconds: float) -> None:
    rest = (0.0,)
    trajectory = Spline(("J1",), [Waypoint(0.0, (0.0,), rest), Waypoint(seconds, (0.01,), rest)])
    points = list(path_points(trajectory, [COUNT / 2]))
    ticks = [t / 1e-4 for t, _ in points]
    assert ticks == pytest.approx([round(tick) for tick in ticks], abs=1e-6)
    assert min(b - a for a, b in itertools.pairwise(ticks)) >= min(100, round(ticks[-1])) - 1e-6
    assert points[-1][0] >= seconds - 1e-9
    assert points[-1][1].position == (0.01,)


def test_a_corner_beside_the_middle_is_seen() -> None:
    # In the middle of the first 50 ms it is where it would be without the two corners.
    rows = [(0.0, 0.0), (0.0125, 0.03), (0.0375, -0.03), (0.05, 0.0), (1.0, 0.0)]
    trajectory = Spline(("J1",), [Waypoint(t, (x,)) for t, x in rows])
    points = list(path_points(trajectory, [COUNT / 2]))
    assert points[1][0] < 0.04
