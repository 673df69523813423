"""Motion through points: limits, exact points and ends, and how much time it takes."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hexwire.errors import UsageError
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.motion.optimal import Trapezoid
from hexwire.motion.through import MOST_POINTS, Through, arm_path

NAMES = ("a", "b", "c")
SPEED, ACCELERATION, JERK = (1.0, 2.0, 0.5), (4.0, 3.0, 6.0), (40.0, 20.0, 90.0)
POINTS = st.lists(st.tuples(*[st.floats(-3.0, 3.0)] * 3), min_size=1, max_size=6)


def path(*points: tuple[float, ...]) -> Through:
    return Through(NAMES, points, SPEED, ACCELERATION, JERK)


@settings(max_examples=60)
@given(POINTS)
def test_limits_points_and_ends_are_kept(points: list[tuple[float, ...]]) -> None:
    way = path(*points)
    rows = [points[0], *(b for a, b in pairwise(points) if a != b)]
    assert len(way.times) == len(rows)
    assert way.goal == points[-1]
    assert way.start == pytest.approx(points[0], abs=1e-9)
    for t, row in zip(way.times, rows, strict=True):
        assert way.at(t).position == pytest.approx(row, abs=1e-9)
        # Only a joint that turns back, and so has no speed, accelerates.
        assert all(abs(a) < 1e-6 or abs(v) < 1e-6 for _, v, a in zip(*way.at(t), strict=True))
        # From before it, too.
        assert way.at(max(0.0, t - 1e-9)).position == pytest.approx(row, abs=1e-8)
    rest = (0.0,) * 3
    assert way.at(0.0).velocity == rest
    assert way.sample(way.duration)[1:] == (rest, rest)
    # Speed and acceleration are greatest between two pieces of constant jerk.
    for i, pieces in enumerate(way.pieces):
        for _, _, v, a, j in pieces:
            assert abs(v) <= SPEED[i] * (1.0 + 1e-9)
            assert abs(a) <= ACCELERATION[i] * (1.0 + 1e-9)
            assert abs(j) <= JERK[i] * (1.0 + 1e-9)
        for (t, p, v, a, j), (s, q, w, b, _) in pairwise(pieces):
            u = s - t
            assert p + u * (v + u * (0.5 * a + u * j / 6.0)) == pytest.approx(q, abs=1e-8)
            assert v + u * (a + 0.5 * u * j) == pytest.approx(w, abs=1e-6)
            assert a + u * j == pytest.approx(b, abs=1e-5)


@settings(max_examples=40)
@given(POINTS)
def test_no_joint_leaves_the_range_between_two_points(points: list[tuple[float, ...]]) -> None:
    way = path(*points)
    rows = [points[0], *(b for a, b in pairwise(points) if a != b)]
    for (t, a), (s, b) in pairwise(zip(way.times, rows, strict=True)):
        for k in range(1, 10):
            for low, high, x in zip(
                map(min, a, b), map(max, a, b), way.at(t + k * (s - t) / 10).position, strict=True
            ):
                assert low - 1e-9 <= x <= high + 1e-9


@settings(max_examples=40)
@given(POINTS)
def test_it_is_never_slower_than_with_a_stop_at_every_point(points: list[tuple[float, ...]]) -> None:
    stops = sum(path(a, b).duration for a, b in pairwise(points))
    assert path(*points).duration <= stops + 1e-6


def test_derivatives() -> None:
    way = path((0.0, 0.0, 0.0), (0.5, -0.4, 0.1), (1.0, 0.3, 0.1), (1.3, 0.4, -0.5))
    h = 1e-6
    for k in range(1, 40):
        t = k * way.duration / 40
        before, here, after = way.at(t - h), way.at(t), way.at(t + h)
        for i in range(3):
            assert here.velocity[i] == pytest.approx((after.position[i] - before.position[i]) / (2 * h), abs=1e-6)
            slope = (after.velocity[i] - before.velocity[i]) / (2 * h)
            assert here.acceleration[i] == pytest.approx(slope, abs=1e-3)


def test_a_point_on_the_way_costs_little_time() -> None:
    direct = path((0.0, 0.0, 0.0), (2.0, 2.0, 0.8)).duration
    assert path((0.0, 0.0, 0.0), (1.0, 1.0, 0.4), (2.0, 2.0, 0.8)).duration < 1.02 * direct
    # Stopping there would cost about 0.35 s: once more gaining and losing the speed of the slowest joint.
    assert 2 * path((0.0, 0.0, 0.0), (1.0, 1.0, 0.4)).duration > 1.1 * direct


def test_without_a_limit_worth_the_name_jerk_costs_nothing() -> None:
    hard = Through(NAMES, ((0, 0, 0), (1, -2, 0.3)), SPEED, ACCELERATION, (1e6,) * 3)
    assert hard.duration == pytest.approx(
        Trapezoid(NAMES, (0, 0, 0), (1, -2, 0.3), SPEED, ACCELERATION).duration, abs=1e-4
    )


def test_a_joint_that_turns_back_rests_while_others_go_on() -> None:
    way = path((0.0, 0.0, 0.0), (0.5, 0.5, 0.0), (0.0, 1.0, 0.0))
    turn = way.at(way.times[1])
    assert turn.velocity[0] == pytest.approx(0.0, abs=1e-9)
    assert turn.velocity[1] > 0.5
    # Without a pause: it brakes and goes back with the same acceleration.
    assert turn.acceleration[0] == pytest.approx(way.at(way.times[1] - 1e-6).acceleration[0], abs=1e-3)
    assert turn.acceleration[0] < -1.0
    # The third does not move at all.
    assert all(way.at(k * way.duration / 20).position[2] == 0.0 for k in range(21))


def test_points_that_repeat_are_no_stops() -> None:
    once, twice = path((0, 0, 0), (1, 1, 0.2), (2, 2, 0.4)), path((0, 0, 0), (1, 1, 0.2), (1, 1, 0.2), (2, 2, 0.4))
    assert twice.duration == once.duration
    still = path((1.0, 2.0, 3.0), (1.0, 2.0, 3.0))
    assert (still.duration, still.goal, still.sample(0.0).velocity) == (0.0, (1.0, 2.0, 3.0), (0.0, 0.0, 0.0))


def test_an_arms_limits_and_shares_of_them() -> None:
    here = [joint.offset for joint in HEX7BOT.joints[:2]]
    there = [here[0] + 1.0, here[1]]
    half = arm_path(HEX7BOT, ("J1", "J2"), [here, there], speed=0.5)
    # Half of 2.6 rad/s; 6 rad/s^2 after a tenth of a second.
    assert half.duration == pytest.approx(1.0 / 1.3 + 1.3 / 6.0 + 0.1)
    gentle = arm_path(HEX7BOT, ("J1", "J2"), [here, there], speed=0.5, acceleration=3.0)
    assert gentle.duration == pytest.approx(1.0 / 1.3 + 1.3 / 3.0 + 0.05)
    with pytest.raises(UsageError, match="no joint 'J9'"):
        arm_path(HEX7BOT, ("J9",), [[0.0]])


@pytest.mark.parametrize(
    ("points", "limits", "words"),
    [
        ([], (1.0, 1.0, 1.0), "needs a joint and a point"),
        ([(0.0,), (1.0, 2.0)], (1.0, 1.0, 1.0), "2 values for 1"),
        ([(0.0,), (math.nan,)], (1.0, 1.0, 1.0), "not a number"),
        ([(0.0,), (1.0,)], (1.0, 1.0, 0.0), "must be above 0"),
        ([(0.0,), (1.0,)], (math.inf, 1.0, 1.0), "not a number"),
        ([(float(i),) for i in range(MOST_POINTS + 1)], (1.0, 1.0, 1.0), "101 points are too many"),
    ],
)
def test_numbers_that_make_no_sense(
    points: list[tuple[float, ...]], limits: tuple[float, float, float], words: str
) -> None:
    with pytest.raises(UsageError, match=words):
        Through(("a",), points, *([limit] for limit in limits))
