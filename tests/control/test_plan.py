"""Goals become trajectories, from where the arm is when they begin."""

from __future__ import annotations

import math

import pytest
from tests.control.trajectory_goals import JOINTS, REST, START, STILL, made, order, refusal

from hexwire.control.loop.outcomes import Reason
from hexwire.control.loop.plan import Plan
from hexwire.control.motion.goals import Point
from hexwire.errors import GoalError
from hexwire.motion.trajectory import Sample, Spline

# -- the bridge from where the arm is ---------------------------------------------------------------


def test_positions_only_is_linear_from_the_start_although_the_arm_moves() -> None:
    spline, begin = made(order(Point(2.0, (1.1, 0.2, -0.7)), Point(3.0, REST)))
    assert (begin, spline.duration) == (0.0, 3.0)
    assert spline.start == START.position
    assert spline.sample(1.0).position == pytest.approx((0.6, 0.2, -0.2))
    assert spline.sample(1.0).velocity == pytest.approx((0.5, 0.0, -0.5))
    assert spline.sample(1.0).acceleration == REST


def test_with_velocities_the_bridge_is_cubic_and_takes_up_the_velocity() -> None:
    spline, _ = made(order(Point(2.0, (1.0, 1.0, 1.0), (0.1, 0.2, 0.3)), Point(4.0, REST, REST)))
    assert [point.order for point in spline.waypoints] == [3, 3, 3]
    begin = spline.sample(0.0)
    assert begin.position == START.position
    assert begin.velocity == START.velocity
    # The third derivative of a cubic is constant.
    a = [spline.at(t).acceleration[0] for t in (0.0, 0.9, 1.8)]
    assert a[1] - a[0] == pytest.approx(a[2] - a[1])
    for side in (2.0 - 1e-9, 2.0, 2.0 + 1e-9):
        assert spline.sample(side).position == pytest.approx((1.0, 1.0, 1.0), abs=1e-8)
        assert spline.sample(side).velocity == pytest.approx((0.1, 0.2, 0.3), abs=1e-8)


def test_with_accelerations_the_bridge_is_quintic_and_takes_up_both() -> None:
    bend = (0.5, -0.5, 0.25)
    spline, _ = made(order(Point(2.0, (1.0, 1.0, 1.0), (0.1, 0.2, 0.3), bend), Point(4.0, REST, REST, REST)))
    assert [point.order for point in spline.waypoints] == [5, 5, 5]
    begin = spline.sample(0.0)
    assert begin.position == START.position
    assert begin.velocity == START.velocity
    assert begin.acceleration == pytest.approx(START.acceleration)
    for side in (2.0 - 1e-9, 2.0, 2.0 + 1e-9):
        assert spline.sample(side).velocity == pytest.approx((0.1, 0.2, 0.3), abs=1e-7)
        assert spline.sample(side).acceleration == pytest.approx(bend, abs=1e-6)


def test_points_may_differ_in_what_they_give() -> None:
    spline, _ = made(order(Point(1.0, REST), Point(2.0, REST, REST), Point(3.0, REST, REST, REST)))
    assert [point.order for point in spline.waypoints] == [1, 1, 3, 5]


def test_a_velocity_that_nobody_measured_is_taken_for_rest() -> None:
    start = Sample(START.position, (math.nan, 0.5, math.nan), (math.inf,) * 3)
    spline, _ = made(order(Point(1.0, REST, REST, REST)), start=start)
    assert spline.waypoints[0].velocity == (0.0, 0.5, 0.0)
    assert spline.waypoints[0].acceleration == REST


def test_without_a_position_to_start_from_nothing_begins() -> None:
    start = Sample((0.1, math.nan, 0.3), REST, REST)
    text = refusal(order(Point(1.0, REST)), Reason.NOT_READY, start=start)
    assert text == "the position of J2 is unknown; wait for its state"


def test_omitted_joints_stay_where_they_are() -> None:
    sent = order(
        Point(1.0, (1.0, 2.0), (0.1, 0.2), (0.3, 0.4)),
        Point(2.0, (0.0, 0.0), (0.0, 0.0), (0.0, 0.0)),
        names=("J3", "J1"),
    )
    spline, _ = made(sent, partial=True)
    assert spline.waypoints[1].position == (2.0, 0.2, 1.0)
    assert spline.waypoints[1].velocity == (0.2, 0.0, 0.1)
    assert spline.waypoints[1].acceleration == (0.4, 0.0, 0.3)
    # START moves J2; the order does not.
    assert spline.sample(0.0).velocity == (0.4, 0.0, 0.6)
    for i in range(21):
        sample = spline.sample(0.1 * i)
        assert (sample.position[1], sample.velocity[1], sample.acceleration[1]) == (0.2, 0.0, 0.0)


# -- stamps -----------------------------------------------------------------------------------------


def test_points_of_the_past_are_dropped_and_the_bridge_has_the_time_that_is_left() -> None:
    rows = [Point(t, (t, t, t)) for t in (1.0, 2.0, 3.0, 4.0)]
    spline, begin = made(order(*rows, delay=-2.5))
    assert begin == 0.0
    assert [point.time for point in spline.waypoints] == [0.0, 0.5, 1.5]
    assert spline.waypoints[0].position == START.position
    assert spline.waypoints[1].position == (3.0, 3.0, 3.0)


def test_points_that_are_left_keep_their_velocities_and_accelerations() -> None:
    fast, bend = (0.1, 0.2, 0.3), (0.5, -0.5, 0.25)
    rows = [Point(t, (t, t, t), fast, bend) for t in (1.0, 2.0, 3.0)]
    spline, _ = made(order(*rows, delay=-1.5))
    assert [point.time for point in spline.waypoints] == [0.0, 0.5, 1.5]
    assert [point.order for point in spline.waypoints] == [5, 5, 5]
    for point in spline.waypoints[1:]:
        assert (point.velocity, point.acceleration) == (fast, bend)


def test_a_point_that_is_due_now_is_past() -> None:
    spline, _ = made(order(Point(1.0, (9.0, 9.0, 9.0)), Point(2.0, REST), delay=-1.0))
    assert [point.position for point in spline.waypoints] == [START.position, REST]
    # The bridge's order is that of the first point that is left.
    spline, _ = made(order(Point(1.0, REST, REST, REST), Point(2.0, REST), delay=-1.0))
    assert [point.order for point in spline.waypoints] == [1, 1]


@pytest.mark.parametrize(("delay", "ago"), [(-4.3, "2.3"), (-2.0, "0"), (-2.0 + 1e-10, "0"), (-1e9, "1e+09")])
def test_a_trajectory_of_the_past_is_refused_with_how_late_it_is(delay: float, ago: str) -> None:
    text = refusal(order(Point(1.0, REST), Point(2.0, REST), delay=delay), Reason.TOO_LATE)
    assert text == f"the trajectory ended {ago} s ago; stamp it later, or with 0 to begin on arrival"


@pytest.mark.parametrize("time", [0.0, 1e-9])  # a nanosecond is as good as nothing
@pytest.mark.parametrize("delay", [0.0, -3.0])
def test_a_single_point_without_time_is_refused_with_advice(delay: float, time: float) -> None:
    text = refusal(order(Point(time, REST), delay=delay), Reason.TOO_LATE)
    assert text.startswith("the time_from_start of the last point must be above 0")


def test_a_single_point_without_time_is_no_motion_where_the_arm_is() -> None:
    near = tuple(angle + math.radians(1.5) for angle in START.position)
    spline, _ = made(order(Point(0.0, near)))
    assert spline.duration == 0.0
    assert spline.goal == near
    # With a stamp it would have ended in the past.
    refusal(order(Point(0.0, near), delay=-3.0), Reason.TOO_LATE)


def test_a_point_at_0_before_others_is_dropped() -> None:
    spline, _ = made(order(Point(0.0, (9.0, 9.0, 9.0)), Point(1.0, REST)))
    assert [point.position for point in spline.waypoints] == [START.position, REST]


def test_a_later_stamp_begins_later_and_keeps_its_times() -> None:
    spline, begin = made(order(Point(1.0, REST), Point(2.0, (1.0, 1.0, 1.0)), delay=5.0))
    assert begin == 5.0
    assert [point.time for point in spline.waypoints] == [0.0, 1.0, 2.0]


def test_a_later_stamp_may_begin_where_the_arm_is() -> None:
    near = tuple(angle + 0.0009 for angle in STILL.position)
    sent = order(Point(0.0, near, REST), Point(1.0, REST, REST), delay=5.0)
    spline, begin = made(sent, start=STILL)
    assert begin == 5.0
    assert [(point.time, point.position) for point in spline.waypoints] == [(0.0, near), (1.0, REST)]
    # One point, and nothing to do.
    spline, begin = made(order(Point(0.0, near), delay=5.0), start=STILL)
    assert (spline.duration, spline.goal, begin) == (0.0, near, 5.0)


def test_a_later_stamp_cannot_begin_elsewhere_in_no_time() -> None:
    elsewhere = (0.1, 0.2 + math.radians(3.0), 0.3 - math.radians(12.0))
    text = refusal(order(Point(0.0, elsewhere), Point(1.0, REST), delay=5.0), Reason.PATH_NOT_ALLOWED, start=STILL)
    assert text == (
        "the trajectory begins 12 deg from where J3 is; "
        "give its first point a time_from_start above 0, or move there first"
    )
    near = (0.1, 0.2 + 0.0011, 0.3)
    text = refusal(order(Point(0.0, near), Point(1.0, REST), delay=5.0), Reason.PATH_NOT_ALLOWED, start=STILL)
    assert text.startswith("the trajectory begins 0.063 deg from where J2 is")


# -- planned once, begun later ----------------------------------------------------------------------


def test_a_plan_begins_from_where_the_joints_are_then() -> None:
    plan = Plan(order(Point(1.0, REST, REST), Point(2.0, (1.0, 1.0, 1.0), REST)), JOINTS, 100.0)
    for start in (START, STILL):
        trajectory = plan.trajectory(start, 105.0)
        assert trajectory.start == start.position
        assert trajectory.at(0.0).velocity == start.velocity
        assert trajectory.goal == (1.0, 1.0, 1.0)
    assert (plan.late(105.0), plan.is_over(105.0)) == (0.0, False), "without a stamp it begins whenever it begins"


@pytest.mark.parametrize("first", [0.0, 1.0])
def test_points_that_are_checked_already_are_not_looked_at_again(
    first: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It would take long for many."""
    plan = Plan(order(Point(first, STILL.position), Point(2.0, REST), delay=0.5), JOINTS, 100.0)
    monkeypatch.setattr(Spline, "_check", lambda *given: pytest.fail("looked at again"))
    assert plan.trajectory(STILL, 100.0).duration == 2.0


def test_a_plan_with_a_stamp_is_late_and_over_by_the_clock() -> None:
    plan = Plan(order(Point(1.0, REST), Point(2.0, (1.0, 1.0, 1.0)), delay=0.5), JOINTS, 100.0)
    assert plan.due == 100.5
    assert (plan.late(100.0), plan.late(101.0)) == (0.0, 0.5)
    assert plan.trajectory(STILL, 100.5).duration == 2.0
    assert plan.trajectory(STILL, 102.0).duration == pytest.approx(0.5)
    assert (plan.is_over(102.4), plan.is_over(102.5)) == (False, True)
    there = Sample((1.0, 1.0, 1.0), REST, REST)
    assert plan.end(there).duration == 0.0
    with pytest.raises(GoalError, match=r"begins 51\.6 deg from where J1 is"):
        plan.end(STILL)
