from __future__ import annotations

import math
from itertools import pairwise

import pytest
import ruckig
from hypothesis import given
from hypothesis import strategies as st

from hexwire.errors import UsageError
from hexwire.motion.optimal import Trapezoid, time_optimal

WAYS = st.lists(st.floats(-3.0, 3.0), min_size=3, max_size=3)
NAMES = ("a", "b", "c")
SPEED, ACCELERATION = (1.0, 2.0, 0.5), (4.0, 3.0, 6.0)


@given(WAYS, WAYS)
def test_trapezoid_arrives_within_its_limits(start: list[float], goal: list[float]) -> None:
    way = Trapezoid(NAMES, start, goal, SPEED, ACCELERATION)
    assert way.start == pytest.approx(start, abs=1e-12)
    assert way.goal == tuple(goal)
    last = None
    for t, sample in way.samples(way.duration / 50 if way.duration > 1e-6 else 1.0):
        for v, limit in zip(sample.velocity, SPEED, strict=True):
            assert abs(v) <= limit * (1 + 1e-9)
        for a, limit in zip(sample.acceleration, ACCELERATION, strict=True):
            assert abs(a) <= limit * (1 + 1e-9)
        if last is not None:
            step = t - last[0]
            for now, was, limit in zip(sample.position, last[1].position, SPEED, strict=True):
                assert abs(now - was) <= limit * step * (1 + 1e-6) + 1e-12
        last = (t, sample)


@given(WAYS, WAYS)
def test_a_motion_from_rest_takes_the_time_that_ruckig_finds(start: list[float], goal: list[float]) -> None:
    jerk = (20.0, 40.0, 30.0)
    for limit in (None, jerk):
        way = time_optimal(NAMES, start, goal, SPEED, ACCELERATION, max_jerk=limit)
        assert way.duration == pytest.approx(fastest(start, goal, limit), abs=1e-4)
        assert way.goal == tuple(goal)


def fastest(start: list[float], goal: list[float], jerk: tuple[float, ...] | None) -> float:
    request = ruckig.InputParameter(len(NAMES))
    request.current_position, request.target_position = start, goal
    request.max_velocity, request.max_acceleration = list(SPEED), list(ACCELERATION)
    request.max_jerk = list(jerk or [math.inf] * len(NAMES))
    found = ruckig.Trajectory(len(NAMES))
    assert int(ruckig.Ruckig(len(NAMES)).calculate(request, found)) >= 0
    return float(found.duration)


def test_jerk_is_limited() -> None:
    way = time_optimal(NAMES, (0, 0, 0), (1, 1, 1), SPEED, ACCELERATION, max_jerk=(20.0, 20.0, 20.0))
    assert way.duration > Trapezoid(NAMES, (0, 0, 0), (1, 1, 1), SPEED, ACCELERATION).duration
    steps = [way.at(i * way.duration / 500).acceleration for i in range(500)]
    jerk = max(abs(b[i] - a[i]) / (way.duration / 500) for a, b in pairwise(steps) for i in range(3))
    assert jerk <= 20.0 * 1.01


@given(WAYS, WAYS, st.lists(st.floats(-1.0, 1.0), min_size=3, max_size=3))
def test_a_start_in_motion_keeps_the_limits(start: list[float], goal: list[float], shares: list[float]) -> None:
    jerk = (20.0, 40.0, 30.0)
    moving = tuple(share * most for share, most in zip(shares, SPEED, strict=True))
    way = time_optimal(NAMES, start, goal, SPEED, ACCELERATION, max_jerk=jerk, velocity=moving)
    assert way.at(0.0).position == pytest.approx(start, abs=1e-9)
    assert way.at(0.0).velocity == pytest.approx(moving, abs=1e-9)
    assert way.goal == tuple(goal)
    assert way.at(way.duration - 1e-9).position == pytest.approx(goal, abs=1e-6)
    step = max(way.duration / 200, 1e-6)
    for before, after in pairwise(way.at(i * step) for i in range(201)):
        for i in range(3):
            assert abs(after.velocity[i]) <= SPEED[i] * 1.001
            assert abs(after.acceleration[i]) <= ACCELERATION[i] * 1.001
            assert abs(after.acceleration[i] - before.acceleration[i]) <= jerk[i] * step * 1.001 + 1e-6


def test_a_start_in_motion_needs_a_limit_of_jerk() -> None:
    with pytest.raises(UsageError, match="needs max_jerk"):
        time_optimal(("a",), (0.0,), (1.0,), (1.0,), (2.0,), velocity=(0.5,))
    for bad in (0.0, -1.0, math.nan):
        with pytest.raises(UsageError, match=r"above 0|not a number"):
            time_optimal(("a",), (0.0,), (1.0,), (1.0,), (2.0,), max_jerk=(bad,), velocity=(0.5,))


def test_known_times() -> None:
    # 1 rad at 1 rad/s and 4 rad/s^2: 1 s, and a quarter for speeding up.
    assert Trapezoid(("a",), (0.0,), (1.0,), (1.0,), (4.0,)).duration == pytest.approx(1.25)
    # Too short for the full speed: a triangle.
    assert Trapezoid(("a",), (0.0,), (0.04,), (1.0,), (4.0,)).duration == pytest.approx(0.2)
    assert Trapezoid(("a",), (1.0,), (1.0,), (1.0,), (4.0,)).duration == 0.0


def test_longer_if_asked() -> None:
    way = Trapezoid(("a",), (0.0,), (1.0,), (1.0,), (4.0,), duration=5.0)
    assert way.duration == 5.0
    assert way.at(2.5).position[0] == pytest.approx(0.5)
    assert max(abs(way.at(0.1 * i).velocity[0]) for i in range(50)) < 0.22


@pytest.mark.parametrize(
    ("goal", "speed", "words"),
    [
        ((1.0, 2.0), (1.0,), "2 values for 1"),
        ((math.inf,), (1.0,), "not a number"),
        ((1.0,), (0.0,), "must be above 0"),
    ],
)
def test_numbers_that_make_no_sense(goal: tuple[float, ...], speed: tuple[float, ...], words: str) -> None:
    for build in (Trapezoid, time_optimal):
        with pytest.raises(UsageError, match=words):
            build(("a",), (0.0,), goal, speed, (1.0,))


@given(WAYS, WAYS, st.floats(0.05, 0.95))
def test_a_trapezoids_speed_and_acceleration_are_derivatives(
    start: list[float], goal: list[float], share: float
) -> None:
    way = Trapezoid(NAMES, start, goal, SPEED, ACCELERATION)
    t, h = share * way.duration, 1e-6
    before, here, after = way.at(t - h), way.at(t), way.at(t + h)
    for i in range(3):
        assert here.velocity[i] == pytest.approx((after.position[i] - before.position[i]) / (2 * h), abs=1e-4)
        slope = (after.velocity[i] - before.velocity[i]) / (2 * h)
        # At a corner the slope is that of one side or between both.
        assert abs(slope - here.acceleration[i]) < 1e-4 or before.acceleration[i] != after.acceleration[i]


def test_a_trapezoid_at_known_times() -> None:
    # 1 s at 1 rad/s, and a quarter of a second each for gaining and losing it at 4 rad/s^2.
    way = Trapezoid(("a", "b"), (0.0, 1.0), (1.0, 1.0), (1.0, 1.0), (4.0, 4.0))
    assert way.at(0.125) == ((0.03125, 1.0), (0.5, 0.0), (4.0, 0.0))
    assert way.at(0.625) == ((0.5, 1.0), (1.0, 0.0), (0.0, 0.0))
    assert way.at(1.125) == ((0.96875, 1.0), (0.5, 0.0), (-4.0, 0.0))
    assert way.at(1.25) == ((1.0, 1.0), (0.0, 0.0), (0.0, 0.0))
    back = Trapezoid(("a",), (1.0,), (0.0,), (1.0,), (4.0,))
    assert back.at(0.125) == ((0.96875,), (-0.5,), (-4.0,))
    # 0.25 rad is where full speed is just reached.
    assert Trapezoid(("a",), (0.0,), (0.25,), (1.0,), (4.0,)).duration == pytest.approx(0.5)
    assert Trapezoid(("a",), (0.0,), (0.5,), (1.0,), (4.0,)).duration == pytest.approx(0.75)
    # The slowest joint sets the time of all.
    assert Trapezoid(("a", "b"), (0, 0), (0.5, 1.0), (1.0, 1.0), (4.0, 4.0)).duration == pytest.approx(1.25)


def test_a_start_in_motion_at_the_goal_brakes_and_comes_back() -> None:
    still = time_optimal(NAMES, (1, 1, 1), (1, 1, 1), SPEED, ACCELERATION, velocity=(0, 0, 0))
    assert isinstance(still, Trapezoid)
    assert still.duration == 0.0
    assert still.goal == (1, 1, 1)
    back = time_optimal(("a",), (1.0,), (1.0,), (1.0,), (2.0,), max_jerk=(2000.0,), velocity=(0.5,))
    assert back.duration > 0.25
    farthest = max(back.at(0.01 * i).position[0] for i in range(100))
    assert farthest == pytest.approx(1.0 + 0.5**2 / (2 * 2.0), abs=1e-3)


@pytest.mark.parametrize("column", range(4))
@pytest.mark.parametrize("bad", [(math.nan,), (math.inf,), (), (1.0, 1.0)])
def test_every_column_is_checked(column: int, bad: tuple[float, ...]) -> None:
    columns: list[tuple[float, ...]] = [(0.0,), (1.0,), (1.0,), (1.0,)]
    columns[column] = bad
    for build in (Trapezoid, time_optimal):
        with pytest.raises(UsageError, match=r"is not a number|values for 1 joints"):
            build(("a",), *columns)


def test_limits_of_zero_and_no_joints_are_refused() -> None:
    for limits in (((0.0,), (1.0,)), ((1.0,), (0.0,)), ((-1.0,), (1.0,))):
        with pytest.raises(UsageError, match="must be above 0"):
            Trapezoid(("a",), (0.0,), (1.0,), *limits)
    with pytest.raises(UsageError):
        Trapezoid((), (), (), (), ())
