"""Orders as ROS users send them, good, careless and hostile."""

from __future__ import annotations

import math
import pickle
from dataclasses import replace
from itertools import pairwise

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from tests.control.trajectory_goals import HOSTILE, JOINTS, REST, made, order, refusal

from hexwire.control.loop.outcomes import Reason
from hexwire.control.loop.plan import Plan
from hexwire.control.motion.goals import MAX_POINTS, Point, TrajectoryGoal, check_goal
from hexwire.errors import GoalError
from hexwire.motion.trajectory import Spline


def test_the_error_keeps_its_reason_across_a_process_border() -> None:
    copy = pickle.loads(pickle.dumps(GoalError("too late", reason=Reason.TOO_LATE)))
    assert (type(copy), str(copy), copy.reason) == (GoalError, "too late", Reason.TOO_LATE)


# -- names ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("names", "partial", "fault"),
    [
        (("J1", "J2", "J9"), False, "'J9' unknown; J3 missing"),
        (("J1", "J2", "J3", "J9"), False, "'J9' unknown"),
        (("J1", "J2", "j3"), True, "'j3' unknown"),
        (("J1", "J2"), False, "J3 missing"),
        (("J1", "J2", "J3", "J2"), False, "'J2' more than once"),
        (("J2", "J2"), True, "'J2' more than once"),
        ((), False, "J1, J2, J3 missing"),
        ((), True, "J1, J2, J3 missing"),
        (("", "J1", "J2", "J3"), False, "'' unknown"),
        (("a\nb",), True, r"'a\nb' unknown"),
        (("x" * 99,), True, f"'{'x' * 40}...' unknown"),
        (tuple("abcdefgh"), True, "'a', 'b', 'c', 'd', 'e', 3 more unknown"),
    ],
)
def test_wrong_names_are_named_and_so_are_the_right_ones(names: tuple[str, ...], partial: bool, fault: str) -> None:
    sent = order(Point(1.0, (0.0,) * len(names)), names=names)
    text = refusal(sent, Reason.WRONG_JOINTS, partial=partial)
    assert text == f"joint_names: {fault}; this controller has J1, J2, J3"


def test_names_come_in_any_order() -> None:
    spline, begin = made(order(Point(2.0, (3.0, 1.0, 2.0)), names=("J3", "J1", "J2")))
    assert spline.names == JOINTS
    assert spline.goal == (1.0, 2.0, 3.0)
    assert begin == 0.0


def test_a_part_of_the_joints_is_refused_unless_it_is_allowed() -> None:
    sent = order(Point(2.0, (1.0,)), names=("J2",))
    assert "J1, J3 missing" in refusal(sent, Reason.WRONG_JOINTS)
    spline, _ = made(sent, partial=True)
    assert spline.goal == (0.1, 1.0, 0.3)


# -- points -----------------------------------------------------------------------------------------


def test_a_goal_without_points_passes_the_check_but_cannot_be_planned() -> None:
    check_goal(order(), JOINTS, allow_partial=False)
    with pytest.raises(GoalError, match="no points") as caught:
        Plan(order(), JOINTS, 0.0)
    assert caught.value.reason == Reason.MALFORMED


@pytest.mark.parametrize(
    ("point", "text"),
    [
        (Point(2.0, ()), "points[1].positions is empty; positions are needed, for J1, J2, J3"),
        (Point(2.0, (0.0, 0.0)), "points[1].positions has 2 values for the 3 joints J1, J2, J3"),
        (Point(2.0, REST, (0.0,)), "points[1].velocities has 1 values for the 3 joints J1, J2, J3"),
        (Point(2.0, REST, REST, (0.0,) * 4), "points[1].accelerations has 4 values for the 3 joints J1, J2, J3"),
        (Point(2.0, REST, effort=(0.0,)), "points[1].effort has 1 values for the 3 joints J1, J2, J3"),
        (
            Point(2.0, REST, (), REST),
            "points[1] has accelerations but no velocities; send both or neither",
        ),
        (Point(2.0, (0.0, math.nan, 0.0)), "points[1].positions: J2 is nan, not a number"),
        (Point(2.0, (0.0, 0.0, math.inf)), "points[1].positions: J3 is inf, not a number"),
        (Point(2.0, REST, (-math.inf, 0.0, 0.0)), "points[1].velocities: J1 is -inf, not a number"),
        (Point(2.0, REST, REST, (0.0, math.nan, 0.0)), "points[1].accelerations: J2 is nan, not a number"),
        (Point(2.0, REST, effort=(0.0, math.nan, 0.0)), "points[1].effort: J2 is nan, not a number"),
        (
            Point(2.0, (0.0, 1e300, 0.0)),
            "points[1].positions: J2 is 1e+300, which no joint can do; check the unit, it is radians",
        ),
        (
            Point(2.0, REST, effort=(0.0, 0.0, 1.5)),
            "points[1].effort: J3 is 1.5; this arm accepts no feed-forward, leave effort empty",
        ),
        (
            Point(1.0, REST),
            "points[1].time_from_start is 1 s, not after the 1 s of points[0]; times must increase",
        ),
        (
            Point(0.5, REST),
            "points[1].time_from_start is 0.5 s, not after the 1 s of points[0]; times must increase",
        ),
        (Point(math.nan, REST), "points[1].time_from_start is nan, not a time"),
        (Point(math.inf, REST), "points[1].time_from_start is inf, not a time"),
        (
            Point(-1.0, REST),
            "points[1].time_from_start is -1 s; it must be 0 or more, and no more than 2.14748e+09 s",
        ),
        (
            Point(1e300, REST),
            "points[1].time_from_start is 1e+300 s; it must be 0 or more, and no more than 2.14748e+09 s",
        ),
    ],
)
def test_a_wrong_point_is_refused_by_place_and_joint(point: Point, text: str) -> None:
    assert refusal(order(Point(1.0, REST), point), Reason.MALFORMED) == text


def test_values_are_named_by_the_sender_s_order_of_joints() -> None:
    sent = order(Point(1.0, (0.0, 0.0, math.nan)), names=("J3", "J1", "J2"))
    assert "J2 is nan" in refusal(sent, Reason.MALFORMED)


def test_a_first_point_may_be_at_0_but_not_before() -> None:
    check_goal(order(Point(0.0, REST), Point(1.0, REST)), JOINTS, allow_partial=False)
    text = refusal(order(Point(-1e-9, REST)), Reason.MALFORMED)
    assert text.startswith("points[0].time_from_start is -1e-09 s;")


def test_the_nearest_times_that_ros_knows_are_different_times() -> None:
    seconds = 1000.0
    ticks = [Point(seconds + 1e-9 * i, REST) for i in range(1, 6)]
    check_goal(order(*ticks), JOINTS, allow_partial=False)


def test_an_effort_of_zeros_is_no_feed_forward() -> None:
    spline, _ = made(order(Point(1.0, REST, effort=(0.0, -0.0, 0.0))))
    assert spline.goal == REST


@pytest.mark.parametrize("end_at_rest", [False, True])
def test_the_arm_must_rest_at_the_end_if_that_is_the_rule(end_at_rest: bool) -> None:
    moving = Point(2.0, (0.0, 0.0, 0.0), (0.0, 0.0, -0.1))
    sent = order(Point(1.0, (0.1, 0.2, 0.3), (0.5, 0.0, 0.0)), moving)
    if end_at_rest:
        with pytest.raises(GoalError) as refused:
            check_goal(sent, JOINTS, allow_partial=False, end_at_rest=True)
        assert refused.value.reason == Reason.MALFORMED
        assert str(refused.value) == "points[1].velocities: J3 is -0.1; the last point must have velocity 0"
    else:
        check_goal(sent, JOINTS, allow_partial=False)
    for velocities in ((), (0.0, 0.0, 0.0), (1e-7, -1e-7, 0.0)):
        rests = replace(sent, points=(*sent.points[:-1], replace(moving, velocities=velocities)))
        check_goal(rests, JOINTS, allow_partial=False, end_at_rest=end_at_rest)
    check_goal(order(), JOINTS, allow_partial=False, end_at_rest=end_at_rest)


def test_joints_with_several_axes_are_refused_before_anything_else() -> None:
    text = refusal(replace(order(), free=("base", "b\n")), Reason.MALFORMED)
    assert text == r"multi_dof_trajectory is for 'base', 'b\n'; every joint of this arm has one axis"


@pytest.mark.parametrize("delay", HOSTILE)
def test_a_stamp_must_be_a_time(delay: float) -> None:
    text = refusal(order(Point(1.0, REST), delay=delay), Reason.MALFORMED)
    assert text == f"header.stamp is {delay} s from now, not a time"


def test_too_many_points_are_refused_before_any_is_looked_at() -> None:
    point = Point(math.nan, ())
    text = refusal(order(*[point] * (MAX_POINTS + 1)), Reason.MALFORMED)
    assert text == "the trajectory has 10001 points; send at most 10000 at a time"


# -- orders of any shape ----------------------------------------------------------------------------

ANYTHING = st.floats(allow_nan=True, allow_infinity=True) | st.floats(-4.0, 4.0)
ROWS = st.lists(ANYTHING, max_size=4).map(tuple) | st.lists(st.floats(-4.0, 4.0), min_size=3, max_size=3).map(tuple)
ANY_POINTS = st.builds(Point, ANYTHING | st.floats(0.0, 9.0), ROWS, ROWS, ROWS, st.just(()) | ROWS)
ANY_NAMES = st.permutations(JOINTS).map(tuple) | st.lists(st.sampled_from([*JOINTS, "J9", "\n"]), max_size=4).map(
    tuple
)
ANY_ORDERS = st.builds(
    TrajectoryGoal, ANY_NAMES, st.lists(ANY_POINTS, max_size=4).map(tuple), ANYTHING | st.just(0.0)
)


@st.composite
def good_orders(draw: st.DrawFn, most: float = 1e6) -> TrajectoryGoal:
    """Orders that pass the check; values up to what it lets through, times as near as ROS can tell."""
    names = tuple(draw(st.permutations(JOINTS)))
    names = names[: draw(st.integers(1, 3))]
    row = st.tuples(*[st.floats(-most, most)] * len(names))
    gaps = st.integers(1, 10) | st.integers(1, 10**10)
    ticks = [draw(st.integers(0, 10**9))]
    ticks += draw(st.lists(gaps, max_size=4))
    points = []
    elapsed = 0
    for tick in ticks:
        elapsed += tick
        kind = draw(st.integers(0, 2))
        points.append(Point(elapsed / 1e9, draw(row), draw(row) if kind else (), draw(row) if kind == 2 else ()))
    delay = draw(
        st.just(0.0) | st.floats(-elapsed / 1e9 - 1.0, 10.0) | st.integers(-elapsed, 10).map(lambda n: n / 1e9)
    )
    return TrajectoryGoal(names, tuple(points), delay)


def through_the_future_points(sent: TrajectoryGoal, spline: Spline, begin: float) -> None:
    future = [point for point in sent.points if sent.delay + point.time > 1e-9]
    assert begin == max(sent.delay, 0.0)
    assert len(spline.waypoints) - len(future) in {0, 1}
    assert all(a.time < b.time for a, b in pairwise(spline.waypoints))
    kept = spline.waypoints[-len(future) :]
    for point, waypoint in zip(future, kept, strict=True):
        assert begin + waypoint.time == pytest.approx(sent.delay + point.time, abs=2e-9)
        sample = spline.at(waypoint.time)
        for name, value in zip(sent.names, point.positions, strict=True):
            # Exactly, but for numbers too small to be kept exactly in a sum.
            assert sample.position[JOINTS.index(name)] == pytest.approx(value, rel=0.0, abs=1e-300)
    for i in range(101):
        sample = spline.sample(i / 100 * spline.duration)
        assert all(map(math.isfinite, [*sample.position, *sample.velocity, *sample.acceleration]))


def outcome(sent: TrajectoryGoal, partial: bool) -> tuple[Spline, float] | GoalError:
    try:
        return made(sent, partial=partial)
    except GoalError as error:
        return error


@given(ANY_ORDERS, st.booleans())
def test_a_goal_of_any_shape_is_refused_for_a_reason_or_followed(sent: TrajectoryGoal, partial: bool) -> None:
    result = outcome(sent, partial)
    if isinstance(result, GoalError):
        assert result.reason in {
            Reason.MALFORMED,
            Reason.WRONG_JOINTS,
            Reason.TOO_LATE,
            Reason.PATH_NOT_ALLOWED,
        }
        assert "\n" not in str(result)
    else:
        through_the_future_points(sent, *result)


@given(good_orders())
def test_a_good_order_is_followed_through_exactly_its_future_points(sent: TrajectoryGoal) -> None:
    check_goal(sent, JOINTS, allow_partial=True)
    result = outcome(sent, partial=True)
    if sent.delay + sent.points[-1].time <= 1e-9:
        assert isinstance(result, GoalError)
        assert result.reason == Reason.TOO_LATE
    elif isinstance(result, GoalError):
        # It begins elsewhere in no time.
        assert result.reason == Reason.PATH_NOT_ALLOWED
        assert sent.delay > 0.0
        assert sent.points[0].time <= 1e-9
    else:
        through_the_future_points(sent, *result)


@given(good_orders(most=4.0), st.data())
def test_the_order_of_names_does_not_matter(sent: TrajectoryGoal, data: st.DataObject) -> None:
    assume(sent.delay + sent.points[-1].time > 1e-9)
    assume(sent.points[0].time > 1e-9)
    turn = data.draw(st.permutations(range(len(sent.names))))

    def turned(values: tuple[float, ...]) -> tuple[float, ...]:
        return tuple(values[i] for i in turn) if values else ()

    points = tuple(
        replace(
            point,
            positions=turned(point.positions),
            velocities=turned(point.velocities),
            accelerations=turned(point.accelerations),
        )
        for point in sent.points
    )
    other = TrajectoryGoal(tuple(sent.names[i] for i in turn), points, sent.delay)
    spline, begin = made(sent, partial=True)
    again, begin_again = made(other, partial=True)
    assert begin == begin_again
    assert spline.waypoints == again.waypoints


def test_values_and_times_at_their_bounds_pass() -> None:
    most = (1e6, -1e6, 0.0)
    check_goal(order(Point(0.0, most, most, most), Point(2.0**31, REST)), JOINTS, allow_partial=False)
    check_goal(order(*[Point(1.0 + i, REST) for i in range(MAX_POINTS)]), JOINTS, allow_partial=False)
    for point in (
        Point(1.0, (1.001e6, 0.0, 0.0)),
        Point(1.0, REST, (0.0, -1.001e6, 0.0)),
        Point(1.0, REST, REST, (0.0, 0.0, 1.001e6)),
        Point(1.0, REST, effort=(1e-9, 0.0, 0.0)),
        Point(2.0**31 + 1, REST),
    ):
        refusal(order(point), Reason.MALFORMED)
    near = 1.0 + 0.4e-9
    refusal(order(Point(1.0, REST), Point(near, REST)), Reason.MALFORMED)
