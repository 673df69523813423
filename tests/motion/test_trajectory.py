from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.motion.arms import rest_to_rest

from hexwire.errors import UsageError
from hexwire.motion.quintic import Quintic
from hexwire.motion.trajectory import Sample, Scaled, Spline, Tail, Trajectory, Waypoint

VALUES = st.floats(-3.0, 3.0)


def derivatives_agree(trajectory: Trajectory, t: float, tolerance: float = 1e-4) -> None:
    h = 1e-5
    before, here, after = (trajectory.at(x) for x in (t - h, t, t + h))
    for i in range(len(trajectory.names)):
        assert here.velocity[i] == pytest.approx((after.position[i] - before.position[i]) / (2 * h), abs=tolerance)
        assert here.acceleration[i] == pytest.approx(
            (after.velocity[i] - before.velocity[i]) / (2 * h), abs=tolerance
        )


def test_positions_only_is_linear() -> None:
    spline = Spline(("a", "b"), [Waypoint(0, (0.0, 1.0)), Waypoint(2, (1.0, -1.0)), Waypoint(3, (1.0, 0.0))])
    assert spline.sample(1.0) == Sample((0.5, 0.0), (0.5, -1.0), (0.0, 0.0))
    assert spline.sample(2.5).position == (1.0, -0.5)
    assert spline.sample(9.0) == Sample((1.0, 0.0), (0.0, 0.0), (0.0, 0.0))
    assert spline.sample(-1.0) == Sample((0.0, 1.0), (0.0, 0.0), (0.0, 0.0))


@given(VALUES, VALUES, VALUES, VALUES, st.floats(0.2, 5.0))
def test_velocities_make_it_cubic(q: float, r: float, v: float, w: float, long: float) -> None:
    spline = Spline(("a",), [Waypoint(0, (q,), (v,)), Waypoint(long, (r,), (w,))])
    assert spline.at(0.0).position == (q,)
    assert spline.at(0.0).velocity == (v,)
    assert spline.at(long).position == (r,)
    assert spline.at(long).velocity[0] == pytest.approx(w, abs=1e-9)
    # The third derivative of a cubic is constant.
    a = [spline.at(share * long).acceleration[0] for share in (0.0, 0.5, 1.0)]
    assert a[1] - a[0] == pytest.approx(a[2] - a[1], abs=1e-6)
    derivatives_agree(spline, 0.4 * long, 1e-2)


@given(VALUES, VALUES, VALUES, VALUES, VALUES, VALUES, st.floats(0.2, 5.0))
def test_accelerations_make_it_quintic(
    q: float, r: float, v: float, w: float, c: float, d: float, long: float
) -> None:
    spline = Spline(("a",), [Waypoint(0, (q,), (v,), (c,)), Waypoint(long, (r,), (w,), (d,))])
    begin = spline.at(0.0)
    assert (begin.position, begin.velocity) == ((q,), (v,))
    assert begin.acceleration[0] == pytest.approx(c, abs=1e-300)
    end = spline.at(long)
    assert end.position == (r,)
    assert end.velocity[0] == pytest.approx(w, abs=1e-6)
    assert end.acceleration[0] == pytest.approx(d, abs=1e-5)
    derivatives_agree(spline, 0.3 * long, 1e-1)


def test_the_poorer_neighbour_decides() -> None:
    spline = Spline(("a",), [Waypoint(0, (0.0,), (0.0,), (0.0,)), Waypoint(1, (1.0,), (0.0,)), Waypoint(2, (0.0,))])
    assert spline.at(0.5).position[0] == pytest.approx(0.5)
    assert spline.at(0.25).position[0] == pytest.approx(3 * 0.25**2 - 2 * 0.25**3)
    assert spline.at(1.25).position[0] == pytest.approx(0.75)


def test_every_waypoint_is_met_exactly() -> None:
    points = [Waypoint(0.1 * i, (math.sin(i),), (0.3,)) for i in range(20)]
    points[0] = Waypoint(0.0, (0.0,), (0.3,))
    spline = Spline(("a",), points)
    for point in points:
        assert spline.at(point.time).position[0] == pytest.approx(point.position[0], abs=1e-14)


def test_the_end_of_a_segment_of_no_length_is_met_exactly() -> None:
    rest = (0.0,)
    points = [Waypoint(0.0, (1.0,), rest), Waypoint(5e-10, (1.4e-55,), rest)]
    assert Spline(("a",), points).at(5e-10).position == (1.4e-55,)


def test_one_point_is_a_pose_to_hold() -> None:
    spline = Spline(("a",), [Waypoint(0.0, (0.7,))])
    assert spline.duration == 0
    assert spline.sample(5.0).position == (0.7,)
    assert [t for t, _ in spline.samples(0.1)] == [0.0]


@pytest.mark.parametrize(
    ("points", "words"),
    [
        ([], "without a point"),
        ([Waypoint(1.0, (0.0,))], "first point is at 1 s"),
        ([Waypoint(0.0, (0.0,)), Waypoint(0.0, (1.0,))], "point 2 is at 0 s, not after"),
        ([Waypoint(0.0, (0.0,)), Waypoint(math.inf, (1.0,))], "point 2 is at inf s"),
        ([Waypoint(0.0, (0.0, 1.0))], "point 1 has 2 values for 1 joints"),
        ([Waypoint(0.0, (math.nan,))], "point 1 has a value that is not a number"),
        ([Waypoint(0.0, (0.0,), None, (0.0,))], "point 1 has accelerations but no velocities"),
    ],
)
def test_invalid_waypoints_are_refused(points: list[Waypoint], words: str) -> None:
    with pytest.raises(UsageError, match=words):
        Spline(("a",), points)


@given(st.floats(0.05, 4.0), st.floats(0.003, 0.5))
def test_samples_are_multiples_of_the_period_and_end_at_the_end(duration: float, period: float) -> None:
    spline = Spline(("a",), [Waypoint(0.0, (0.0,)), Waypoint(duration, (1.0,))])
    taken = list(spline.samples(period))
    for i, (t, sample) in enumerate(taken[:-1]):
        # No sum of periods: the raster is exact however long it runs.
        assert t == i * period
        assert sample == spline.sample(t)
    assert taken[-1] == (duration, spline.sample(duration))
    assert 0 < taken[-1][0] - taken[-2][0] <= period * 1.001
    assert taken[-1][1].position == (1.0,)


def test_samples_want_a_period() -> None:
    with pytest.raises(UsageError, match="period must be finite and above 0 s, not 0"):
        next(Spline(("a",), [Waypoint(0.0, (0.0,))]).samples(0.0))


def test_from_rest_to_rest_is_the_quintic() -> None:
    quintic = Quintic((0.0, 1.0), (1.0, -2.0), 2.0)
    way = rest_to_rest(("a", "b"), (0.0, 1.0), (1.0, -2.0), 2.0)
    for t in (0.0, 0.3, 1.0, 1.7, 2.0):
        assert way.at(t).position == pytest.approx(quintic.position(t), abs=1e-12)
    assert way.goal == (1.0, -2.0)
    derivatives_agree(way, 0.7)


def test_a_scaled_trajectory_follows_the_same_path_faster() -> None:
    way = rest_to_rest(("a",), (0.0,), (1.0,), 2.0)
    fast = Scaled(way, 2.0)
    assert fast.duration == 1.0
    assert fast.at(0.5).position == way.at(1.0).position
    assert fast.start == (0.0,)
    assert fast.goal == (1.0,)
    derivatives_agree(fast, 0.3)
    with pytest.raises(UsageError, match="speed factor must be finite and above 0, not 0"):
        Scaled(way, 0.0)


def test_what_is_left_of_a_trajectory() -> None:
    whole = Spline(("a",), [Waypoint(0, (0.0,)), Waypoint(2, (1.0,))])
    rest = Tail(whole, 0.5)
    assert rest.duration == 1.5
    assert rest.sample(0.5) == whole.sample(1.0)
    assert rest.sample(9.0) == whole.sample(9.0)
    later = Tail(whole, -1.0)
    assert later.duration == 3.0
    assert later.sample(0.5) == whole.sample(-1.0)
    over = Tail(whole, 3.0)
    assert over.duration == 0.0
    assert over.sample(1.0).position == (1.0,)


def test_a_curve_of_two_joints_is_that_of_each() -> None:
    points = [
        Waypoint(0.0, (0.0, 1.0), (0.5, 0.0), (0.25, -1.0)),
        Waypoint(2.0, (1.0, -1.0), (0.0, 0.5), (0.0, 1.0)),
        Waypoint(3.0, (2.0, 0.0), (1.0, 0.0)),
        Waypoint(3.5, (0.0, 0.0)),
    ]
    both = Spline(("a", "b"), points)
    for i in range(2):
        single = [
            Waypoint(
                p.time,
                (p.position[i],),
                None if p.velocity is None else (p.velocity[i],),
                None if p.acceleration is None else (p.acceleration[i],),
            )
            for p in points
        ]
        one = Spline(("a",), single)
        for k in range(29):
            t = 0.125 * k
            assert [column[i] for column in both.at(t)] == [column[0] for column in one.at(t)]
    for t in (0.3, 1.9, 2.1, 2.9):
        derivatives_agree(both, t, 1e-3)
    assert both.at(3.25) == Sample((1.0, 0.0), (-4.0, 0.0), (0.0, 0.0))


def test_a_pose_keeps_the_values_it_is_given() -> None:
    assert Spline(("a",), [Waypoint(0.0, (0.7,), (0.5,), (0.25,))]).at(0.0) == Sample((0.7,), (0.5,), (0.25,))
    assert Spline(("a",), [Waypoint(0.0, (0.7,))]).at(0.0) == Sample((0.7,), (0.0,), (0.0,))


@pytest.mark.parametrize("rest", [None, (0.0,)])
def test_a_segment_too_short_for_a_curve_is_a_straight_line(rest: tuple[float] | None) -> None:
    spline = Spline(
        ("a",), [Waypoint(0.0, (1.0,), rest), Waypoint(5e-10, (3.0,), rest), Waypoint(1.0, (3.0,), rest)]
    )
    position, velocity, acceleration = spline.at(2.5e-10)
    assert position == pytest.approx((2.0,))
    assert velocity == pytest.approx((2.0 / 5e-10,))
    assert acceleration == (0.0,)
    assert spline.at(5e-10).position == (3.0,)


def test_a_motion_has_at_most_ten_million_samples() -> None:
    spline = Spline(("a",), [Waypoint(0.0, (0.0,)), Waypoint(1.0, (1.0,))])
    assert next(spline.samples(1e-7))[0] == 0.0
    with pytest.raises(UsageError, match="too many samples"):
        next(spline.samples(0.99e-7))
    for period in (-1.0, math.inf, math.nan):
        with pytest.raises(UsageError, match="period must be"):
            next(spline.samples(period))
    assert [t for t, _ in spline.samples(1.0)] == [0.0, 1.0]
    assert [t for t, _ in spline.samples(0.5)] == [0.0, 0.5, 1.0]
    assert [t for t, _ in spline.samples(5.0)] == [0.0, 1.0]


def test_a_slow_motion_may_last_an_hour() -> None:
    line = Spline(("a",), [Waypoint(0.0, (0.0,)), Waypoint(3600.0, (1.0,))])
    assert Scaled(line, 1.0).duration == 3600.0
    with pytest.raises(UsageError, match="is too long for a motion"):
        Scaled(line, 0.999)
    for speed in (-1.0, math.inf, math.nan):
        with pytest.raises(UsageError, match="speed factor"):
            Scaled(line, speed)
    slow = Scaled(rest_to_rest(("a",), (0.0,), (1.0,), 2.0), 0.5)
    assert slow.duration == 4.0
    derivatives_agree(slow, 1.3)
    assert slow.at(5.0).position == (1.0,)


def test_a_tail_may_be_cut() -> None:
    whole = Spline(("a",), [Waypoint(0, (0.0,)), Waypoint(2, (1.0,))])
    assert Tail(whole, 0.5, 1.0).duration == 1.0
    assert Tail(whole, 0.5, 9.0).duration == 1.5
    assert Tail(whole, 0.5, 1.0).goal == (0.75,)
