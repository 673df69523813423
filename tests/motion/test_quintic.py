from __future__ import annotations

import itertools
import math
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexwire.errors import UsageError
from hexwire.motion.quintic import PEAK_ACCELERATION, PEAK_JERK, PEAK_SPEED, Quintic, quintic_share

ANGLES = st.lists(st.floats(-4, 4), min_size=1, max_size=7).map(tuple)


@given(ANGLES, st.floats(0.01, 60))
def test_it_starts_at_the_start_and_ends_exactly_at_the_goal(start: tuple[float, ...], duration: float) -> None:
    goal = tuple(-a + 0.1 for a in start)
    way = Quintic(start, goal, duration)
    assert way.position(0.0) == pytest.approx(start)
    assert way.position(-1.0) == pytest.approx(start)
    assert way.position(duration) == goal
    assert way.position(duration + 1e9) == goal


def test_half_the_path_takes_half_the_time() -> None:
    assert Quintic((0.0, 10.0), (1.0, -10.0), 4.0).position(2.0) == pytest.approx((0.5, 0.0))


@given(st.floats(-4, 4), st.floats(-4, 4), st.lists(st.floats(0, 1), min_size=2, max_size=50))
def test_it_never_turns_back_nor_leaves_the_path(a: float, b: float, shares: list[float]) -> None:
    way = Quintic((a,), (b,), 1.0)
    places = [way.position(t)[0] for t in sorted(shares)]
    assert all(min(a, b) - 1e-9 <= place <= max(a, b) + 1e-9 for place in places)
    steps = [math.copysign(1.0, b - a) * (after - before) for before, after in itertools.pairwise(places)]
    assert all(step >= -1e-9 for step in steps)


def test_it_is_at_rest_at_both_ends_and_fastest_in_the_middle() -> None:
    way, h = Quintic((0.0,), (1.0,), 1.0), 1e-4

    def speed(t: float) -> float:
        return (way.position(t + h)[0] - way.position(t - h)[0]) / (2 * h)

    assert speed(2 * h) < 1e-4
    assert speed(1 - 2 * h) < 1e-4
    assert speed(0.5) == pytest.approx(PEAK_SPEED, rel=1e-4)
    assert max(speed(k / 100) for k in range(1, 100)) == pytest.approx(PEAK_SPEED, rel=1e-4)


def test_the_shortest_duration_just_keeps_the_speed_limit() -> None:
    start, goal, limits = (0.0, 1.0), (1.0, 0.5), (2.0, 0.5)
    duration = Quintic.shortest_duration(start, goal, limits)
    assert duration == pytest.approx(PEAK_SPEED)
    way, h = Quintic(start, goal, duration), 1e-5
    a, b = way.position(duration / 2 - h), way.position(duration / 2 + h)
    speeds = [abs(y - x) / (2 * h) for x, y in zip(a, b, strict=True)]
    assert speeds[0] < limits[0]
    assert speeds[1] == pytest.approx(limits[1], rel=1e-6)
    assert Quintic.shortest_duration((), (), ()) == 0.0


def test_no_time_is_a_step() -> None:
    way = Quintic((0.0,), (1.0,), 0.0)
    assert way.position(0.0) == (1.0,)
    assert way.position(-1.0) == (0.0,)


def test_poses_of_two_arms_are_refused() -> None:
    with pytest.raises(UsageError, match="from 2 joints to 1"):
        Quintic((0.0, 1.0), (1.0,), 1.0)


@pytest.mark.parametrize("duration", [-1.0, math.nan, math.inf])
def test_a_duration_that_is_none_is_refused(duration: float) -> None:
    with pytest.raises(UsageError, match="must be finite and not negative"):
        Quintic((0.0,), (1.0,), duration)


def test_the_peaks_are_those_of_the_polynomial() -> None:
    h = 1e-4

    def change(u: float, order: int) -> float:
        rows = [quintic_share(u + (k - order / 2) * h) for k in range(order + 1)]
        for _ in range(order):
            rows = [(b - a) / h for a, b in pairwise(rows)]
        return abs(rows[0])

    inside = [k / 1000 for k in range(1, 1000)]
    assert max(change(u, 1) for u in inside) == pytest.approx(PEAK_SPEED, rel=1e-4)
    assert max(change(u, 2) for u in inside) == pytest.approx(PEAK_ACCELERATION, rel=1e-4)
    assert max(change(u, 3) for u in inside) == pytest.approx(PEAK_JERK, rel=1e-2)
    assert [quintic_share(u) for u in (-1.0, 0.0, 0.5, 1.0, 2.0)] == [0.0, 0.0, 0.5, 1.0, 1.0]
