from __future__ import annotations

import itertools
import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexwire.emulator.board_path import MEMORY, BoardPath, _Braking
from hexwire.emulator.gate import RefusedError
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.motion.limits import rest_duration
from hexwire.motion.moving import joint_limits, reach
from hexwire.motion.trajectory import Sample
from hexwire.wire.board_trajectory import POINT_TIME, PathPoint, point_size
from hexwire.wire.command_frame import Status
from hexwire.wire.commands import LimitRow

LIMIT = LimitRow(1000, 3000, 2000)
LIMITS = (LIMIT,)
STEP = 0.011


def path(*points: tuple[int, int] | tuple[int, int, int], last: bool = True, brake: float = 0.2) -> BoardPath:
    """A path of one joint; each point is ticks and position, with a velocity on a cubic path."""
    made = BoardPath(1, hermite=len(points[0]) > 2, brake=brake)
    made.put(0, [point(*each) for each in points], LIMITS, last=last)
    return made


def point(ticks: int, place: int, *speed: int) -> PathPoint:
    return PathPoint(ticks, (place,), speed)


def refused(made: BoardPath, first: int, *points: PathPoint, last: bool = False) -> Status:
    before = (made.next, made.free, made.whole)
    with pytest.raises(RefusedError) as caught:
        made.put(first, points, LIMITS, last=last)
    assert (made.next, made.free, made.whole) == before
    return caught.value.status


def test_a_straight_path_is_even() -> None:
    made = path((0, 2000), (1000, 2100), (500, 2000))
    made.start(5.0)
    moments = (5.0, 5.025, 5.1, 5.125, 5.15, 5.2)
    assert [made.positions(at)[0] for at in moments] == [2000, 2025, 2100, 2050, 2000, 2000]
    assert made.rest_at == pytest.approx(5.15)


def test_a_cubic_path_has_the_given_velocities() -> None:
    made = path((0, 2000, 0), (10000, 2400, 800), (10000, 2400, 0))
    made.start(0.0)
    # Worked out by hand: halfway of the first part 2000 + 200 - 800/8, of the second 2400 + 800/8.
    assert [made.positions(at)[0] for at in (0.5, 1.0, 1.5, 2.0)] == [2100, 2400, 2500, 2400]


def test_room_is_for_64_points_of_seven_joints_with_velocities() -> None:
    assert BoardPath(7, hermite=True, brake=1.0).capacity == 64
    assert BoardPath(1, hermite=False, brake=1.0).capacity == MEMORY // point_size(1, hermite=False)


@pytest.mark.parametrize(
    "bad",
    [
        point(0, 2000),
        point(1000, 999),
        point(1000, 3001),
        point(1000, 2202),
        point(1, 2002),
    ],
)
def test_a_bad_point_changes_nothing(bad: PathPoint) -> None:
    made = path((0, 2000), (1000, 2000), last=False)
    assert refused(made, 2, point(1000, 2000), bad) == Status.BAD_RANGE


def test_the_first_point_has_no_time_and_every_other_has_one() -> None:
    assert refused(BoardPath(1, hermite=False, brake=1.0), 0, point(5, 2000)) == Status.BAD_RANGE
    made = path((0, 2000), (1000, 2201))  # 2000 counts/s, and one count by rounding
    assert made.next == 2
    with_speed = BoardPath(1, hermite=True, brake=1.0)
    assert refused(with_speed, 0, point(0, 2000, 2001)) == Status.BAD_RANGE
    assert refused(with_speed, 0, point(0, 2000, -32768)) == Status.BAD_RANGE
    with_speed.put(0, [point(0, 2000, -2000)], LIMITS, last=False)


def test_only_what_lies_ahead_can_be_replaced() -> None:
    made = path((0, 2000), *[(1000, 2000 + n) for n in range(1, 7)])
    made.start(0.0)
    made.advance(0.25)
    assert (made.towards, made.next, made.capacity - made.free) == (3, 7, 5)
    for first in (0, 1, 2, 3, 8, 7):
        assert refused(made, first, point(1000, 2000)) == Status.BAD_RANGE, first
    made.put(4, [point(1000, 2100)], LIMITS, last=True)
    assert (made.next, made.capacity - made.free) == (5, 3)
    assert made.positions(0.4) == (2100,)
    assert made.rest_at == pytest.approx(0.4)


def test_points_that_do_not_fit_change_nothing() -> None:
    made = path((0, 2000), last=False)
    room = made.free
    assert refused(made, 1, *[point(9, 2000)] * (room + 1)) == Status.BUSY
    made.put(1, [point(9, 2000)] * room, LIMITS, last=False)
    assert made.free == 0
    made.put(3, [point(9, 2000)], LIMITS, last=False)
    assert made.free == room - 3


def test_indexes_go_on_beyond_65536() -> None:
    made = path((0, 2000), (10, 2000), (10, 2000), last=False, brake=0.002)
    made.start(0.0)
    for n in range(3, 66000):
        made.advance((n - 2.5) * 0.001)
        made.put(n & 0xFFFF, [point(10, 2000 + n % 2)], LIMITS, last=False)
    assert not made.dry
    assert made.towards == made.next - 3 == 65997
    made.put((made.next - 1) & 0xFFFF, [point(10, 2000)], LIMITS, last=True)
    assert refused(made, 65997 & 0xFFFF, point(10, 2000)) == Status.BAD_RANGE
    assert made.rest_at == pytest.approx(65.999)


def test_braking_takes_its_time_and_half_of_it_in_path() -> None:
    made = path((0, 2000), (10000, 3000), brake=0.4)
    made.start(0.0)
    made.brake(0.3)
    # Worked out by hand: u - u^3 + u^4 / 2 of 0.4 s, for u = 1/4, 1/2, 3/4 and 1.
    assert [made.positions(at)[0] for at in (0.3, 0.4, 0.5, 0.6, 0.7, 0.8)] == [2300, 2395, 2462, 2495, 2500, 2500]
    assert made.rest_at == pytest.approx(0.7)
    made.brake(0.75)
    assert made.rest_at == pytest.approx(0.7), "it brakes once"


def test_a_path_that_ends_sooner_than_braking_is_followed_to_its_end() -> None:
    made = path((0, 2000), (10000, 3000), brake=0.4)
    made.start(0.0)
    made.brake(0.9)
    assert [made.positions(at)[0] for at in (0.95, 1.0, 1.5)] == [2950, 3000, 3000]
    assert made.rest_at == pytest.approx(1.0)


@pytest.mark.parametrize("step", [0.001, 0.011, 0.05])
def test_a_path_without_its_last_point_ends_at_rest_at_its_newest(step: float) -> None:
    made = path((0, 2000), (10000, 3000), last=False, brake=0.4)
    assert made.can_start
    made.start(0.0)
    places = [made.positions(n * step)[0] for n in range(round(1.3 / step))]
    assert made.dry
    assert made.rest_at == pytest.approx(1.2)
    assert places[-1] == 3000
    assert not path((0, 2000), (1999, 2000), last=False, brake=0.4).can_start
    assert not path((0, 2000)).can_start


def test_a_path_cut_short_brakes_in_what_is_left() -> None:
    made = path((0, 2000), (1000, 2100), (1000, 2200), (10000, 3000), last=False, brake=0.4)
    made.start(0.0)
    made.advance(0.15)
    made.put(3, [point(100, 2210)], LIMITS, last=False)
    assert made.positions(0.15) == (2150,)
    assert made.dry
    assert made.positions(1.0) == (2210,)
    assert made.rest_at == pytest.approx(0.15 + 2 * 0.06)


@pytest.mark.parametrize("name", HEX7BOT.names)
def test_the_boards_own_brake_keeps_the_limits_in_even_motion_and_else_what_the_pages_say(name: str) -> None:
    """The law over the time that hexwire's host asks for, also on motions that are at their limits themselves."""
    draw, seconds = random.Random(3), rest_duration(HEX7BOT, HEX7BOT.names)
    (limits,) = joint_limits(HEX7BOT, [name])
    worst = [0.0, 0.0, 0.0]
    braking = _Braking(0.0, 0.0, seconds / POINT_TIME)

    def way(t: float) -> float:
        return braking.way(t) * POINT_TIME

    # What begins and ends braking is smooth, and so is all of it between.
    assert way(seconds) == pytest.approx(seconds / 2)
    h = 1e-3
    rates = [(way(n * h + h) - way(n * h)) / h for n in range(round(seconds / h))]
    changes = [(b - a) / h for a, b in itertools.pairwise(rates)]
    assert rates[0] == pytest.approx(1.0, abs=1e-4)
    assert max(changes) < 0.0
    assert abs(changes[0]) < 0.05
    assert abs(changes[-1]) < 0.05
    assert limits.speed * -min(changes) <= 1.001 * limits.acceleration
    assert limits.speed * max(abs(b - a) / h for a, b in itertools.pairwise(changes)) <= 1.001 * limits.jerk
    rest = (0.0,)
    for _ in range(60):
        begin, end = draw.uniform(-2.0, 2.0), draw.uniform(-2.0, 2.0)
        plan = reach(("a",), Sample((begin,), rest, rest), Sample((end,), rest, rest), [limits], 0.01, longer=True)
        assert plan is not None
        start = draw.uniform(0.0, plan.duration)
        if plan.duration - start <= seconds / 2:
            continue  # it is followed to its end
        for n in range(1, 100):
            u = n / 100
            rate = 1 - 3 * u**2 + 2 * u**3
            slower, change = (6 * u**2 - 6 * u) / seconds, (12 * u - 6) / seconds**2
            s = start + way(u * seconds)
            _, (v,), (a,) = plan.sample(s)
            jerk = (plan.sample(min(s + 1e-5, plan.duration)).acceleration[0] - a) / 1e-5
            worst[0] = max(worst[0], abs(v * rate) / limits.speed)
            worst[1] = max(worst[1], abs(a * rate**2 + v * slower) / limits.acceleration)
            worst[2] = max(worst[2], abs(jerk * rate**3 + 3 * a * rate * slower + v * change) / limits.jerk)
    assert worst[0] <= 1.001
    assert worst[1] <= 1.4
    assert worst[2] <= 1.5


@st.composite
def points(draw: st.DrawFn) -> tuple[list[PathPoint], bool]:
    """A sound path and whether it is cubic."""
    hermite = draw(st.booleans())
    place, found = draw(st.integers(LIMIT.minimum, LIMIT.maximum)), []
    for n in range(draw(st.integers(2, 12))):
        ticks = draw(st.integers(1, 8000)) if n else 0
        most = LIMIT.speed * ticks // 10000
        place = min(max(place + draw(st.integers(-most, most)), LIMIT.minimum), LIMIT.maximum)
        found.append(point(ticks, place, *([draw(st.integers(-2000, 2000))] if hermite else [])))
    return found, hermite


@given(points(), st.sampled_from((0.02, 0.2, 2.0)), st.floats(0.0, 1.5))
def test_braking_always_ends_at_rest_on_the_path(
    made_of: tuple[list[PathPoint], bool], brake: float, share: float
) -> None:
    knots, hermite = made_of
    whole = BoardPath(1, hermite=hermite, brake=brake)
    braking = BoardPath(1, hermite=hermite, brake=brake)
    for each in (whole, braking):
        each.put(0, knots, LIMITS, last=True)
        each.start(0.0)
    length = sum(each.ticks for each in knots) / 10000
    begin = share * length
    for n in range(30):
        assert braking.positions(begin * n / 30) == whole.positions(begin * n / 30)
    braking.brake(begin)
    rest_at = braking.rest_at
    assert rest_at is not None
    assert rest_at <= begin + brake + 1e-9
    places = [braking.positions(rest_at + n * STEP) for n in range(4)]
    assert len(set(places)) == 1, "at rest"
    # On the path: where it is half of the braking time further on.
    final = whole.positions(min(begin + brake / 2, length))
    assert abs(places[0][0] - final[0]) <= 1


@given(points(), st.sampled_from((0.02, 0.2, 2.0)))
def test_a_path_that_runs_dry_never_jumps_and_ends_at_rest(
    made_of: tuple[list[PathPoint], bool], brake: float
) -> None:
    knots, hermite = made_of
    made = BoardPath(1, hermite=hermite, brake=brake)
    made.put(0, knots, LIMITS, last=False)
    if not made.can_start:
        return
    made.start(0.0)
    length = sum(each.ticks for each in knots) / 10000
    steps = round((length + brake) / STEP) + 2
    places = [made.positions(n * STEP)[0] for n in range(steps)]
    assert made.dry
    assert made.rest_at == pytest.approx(length + brake / 2)
    assert places[-1] == knots[-1].positions[0]
    if not hermite:
        assert all(LIMIT.minimum <= place <= LIMIT.maximum for place in places)
        assert all(abs(b - a) <= LIMIT.speed * STEP + 2 for a, b in itertools.pairwise(places))


@given(
    st.lists(
        st.tuples(
            st.integers(0, 65535),
            st.integers(0, 65535),
            st.integers(-32768, 32767),
            st.integers(-32768, 32767),
            st.booleans(),
            st.floats(0, 2),
        ),
        max_size=30,
    ),
    st.booleans(),
)
def test_whatever_is_put_the_rules_hold(
    orders: list[tuple[int, int, int, int, bool, float]], hermite: bool
) -> None:
    made = BoardPath(1, hermite=hermite, brake=0.1)
    made.put(0, [point(0, 2000, *([0] if hermite else []))], LIMITS, last=False)
    made.put(1, [point(3000, 2100, *([0] if hermite else []))], LIMITS, last=False)
    made.start(0.0)
    now, before = 0.0, made.positions(0.0)[0]
    for first, ticks, place, speed, last, wait in orders:
        near = made.next + first % 7 - 5
        bad = point(ticks, place % 4096, *([speed] if hermite else []))
        try:
            made.put(near & 0xFFFF, [bad], LIMITS, last=last)
        except RefusedError:
            pass
        else:
            assert LIMIT.minimum <= bad.positions[0] <= LIMIT.maximum
        end = now + wait
        while now < end:
            now += STEP
            at = made.positions(now)[0]
            # A cubic may be up to 1.5 times as fast between two points as its mean, and its ends add to that.
            assert abs(at - before) <= (1.5 if not hermite else 4.0) * LIMIT.speed * STEP + 2
            before = at
        assert 0 <= made.free <= made.capacity


# -- eighths of a count, and points that come one after the other --------------------------------------------------


def test_fine_positions_are_rounded_once_when_they_are_sent() -> None:
    made = BoardPath(1, hermite=False, brake=0.2, fine=True)
    made.put(0, [point(0, 16003), point(10000, 16043)], LIMITS, last=True)
    assert made.first_positions == (2000,)
    made.start(0.0)
    # 2000.375 to 2005.375 in a second.
    assert [made.positions(at)[0] for at in (0.0, 0.02, 0.03, 0.5, 1.0)] == [2000, 2000, 2001, 2003, 2005]


def test_a_fine_cubic_has_the_given_velocities_in_counts() -> None:
    made = BoardPath(1, hermite=True, brake=0.2, fine=True)
    made.put(0, [point(0, 16000, 0), point(10000, 19200, 800), point(10000, 19200, 0)], LIMITS, last=True)
    made.start(0.0)
    assert [made.positions(at)[0] for at in (0.5, 1.0, 1.5, 2.0)] == [2100, 2400, 2500, 2400]


@pytest.mark.parametrize(
    ("place", "rounded"), [(16003, 2000), (16004, 2001), (15996, 2000), (15995, 1999), (8000, 1000)]
)
def test_point_0_is_rounded_to_the_nearest_count_and_halves_upwards(place: int, rounded: int) -> None:
    made = BoardPath(1, hermite=False, brake=0.2, fine=True)
    made.put(0, [point(0, place)], LIMITS, last=False)
    assert made.first_positions == (rounded,)


def test_fine_limits_and_speeds_are_exact_to_an_eighth() -> None:
    made = BoardPath(1, hermite=False, brake=0.2, fine=True)
    for place in (7999, 24001):
        assert refused(made, 0, point(0, place)) == Status.BAD_RANGE
    made.put(0, [point(0, 8000)], LIMITS, last=False)
    # 2000 counts/s for 10 ms are 20 counts: 160 eighths, and one more for the rounding.
    assert refused(made, 1, point(100, 8162)) == Status.BAD_RANGE
    made.put(1, [point(100, 8161)], LIMITS, last=False)


def test_points_that_come_one_by_one_count_together() -> None:
    made = path((0, 2000), (1000, 2010), last=False)
    free = made.free
    made.begin_coming(2, 2)
    made.come([point(1000, 2020)], LIMITS)
    assert (made.next, made.free, made.whole) == (2, free, False)
    assert refused(made, 2, point(1000, 2020)) == Status.BUSY
    assert refused(made, 5, point(1000, 2020)) == Status.BAD_RANGE, "busy comes last"
    made.come([point(1000, 2030)], LIMITS)
    made.end_coming(last=True)
    assert (made.next, made.free, made.whole) == (4, free - 2, True)


def test_points_that_come_are_checked_against_the_one_before() -> None:
    made = path((0, 2000), (1000, 2010), last=False)
    for first, count, status in ((1, 1, Status.BAD_RANGE), (3, 1, Status.BAD_RANGE), (2, 481, Status.BUSY)):
        with pytest.raises(RefusedError) as caught:
            made.begin_coming(first, count)
        assert caught.value.status == status
    made.begin_coming(2, 2)
    with pytest.raises(RefusedError):
        made.come([point(100, 2900)], LIMITS)
    made.drop_coming()
    made.put(2, [point(1000, 2020)], LIMITS, last=True)
    with pytest.raises(RefusedError):
        made.begin_coming(3, 1)
