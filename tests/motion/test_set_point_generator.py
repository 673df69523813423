from __future__ import annotations

import math
from itertools import pairwise

import pytest
from tests.motion.arms import HOME, rest_to_rest, state

from hexwire.errors import LimitError, UsageError
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.model.state import JointTarget
from hexwire.motion.safety import StopReason
from hexwire.motion.set_point_generator import Mode, SetPointGenerator
from hexwire.motion.trajectory import Spline, Waypoint

LEAD = 0.05
J1 = HOME["J1"]


def started() -> SetPointGenerator:
    generator = SetPointGenerator(HEX7BOT)
    assert generator.cycle(state(), 0.0, LEAD) is None
    return generator


def way(start: float, goal: float, seconds: float = 2.0) -> Spline:
    return rest_to_rest(("J1",), (start,), (goal,), seconds)


def rest_at(angle: float, seconds: float) -> Spline:
    """A trajectory that stays where it starts."""
    return Spline(("J1",), [Waypoint(t, (angle,)) for t in sorted({0.0, seconds})])


def sent(generator: SetPointGenerator, now: float, **positions: float) -> float:
    order = generator.cycle(state(positions), now, LEAD)
    assert isinstance(order, JointTarget)
    assert order.duration == LEAD
    return dict(order.positions)["J1"]


def run(generator: SetPointGenerator, begin: float, end: float, step: float = 0.05) -> list[tuple[float, float]]:
    """Cycle with an arm that is where it was told to be; pairs of the time a command is for, and the command."""
    commands = []
    where = J1
    for i in range(round((end - begin) / step)):
        now = begin + i * step
        order = generator.cycle(state({"J1": where}), now, LEAD)
        if isinstance(order, JointTarget):
            where = dict(order.positions)["J1"]
            commands.append((now + LEAD, where))
    return commands


def speeds(commands: list[tuple[float, float]]) -> list[float]:
    return [(b - a) / (t - s) for (s, a), (t, b) in pairwise(commands)]


def test_trajectory_is_sent_ahead_by_the_lead_and_ends_on_its_goal() -> None:
    generator = started()
    path = way(J1, J1 + 1.0)
    generator.follow(path, 0.0)
    commands = run(generator, 0.0, 3.0)
    for due, angle in commands:
        assert angle == pytest.approx(path.sample(due).position[0], abs=1e-9)
    assert commands[-1][1] == J1 + 1.0
    assert generator.mode is Mode.HOLD
    assert generator.done


def test_replacing_a_trajectory_blends_without_a_jump() -> None:
    generator = started()
    generator.follow(way(J1, J1 + 1.0), 0.0)
    first = run(generator, 0.0, 1.0, 0.02)
    here = first[-1][1]
    generator.follow(way(here, J1 - 0.5), 1.0)
    both = first + run(generator, 1.0, 4.0, 0.02)
    assert generator.counters.blends == 1
    change = [abs(b - a) for a, b in pairwise(speeds(both))]
    # Without blending the speed would fall from over 0.9 rad/s to zero in one cycle.
    assert max(change) < 0.3
    assert both[-1][1] == J1 - 0.5


def test_after_a_stall_the_trajectory_continues_where_it_was() -> None:
    generator = started()
    generator.follow(way(J1, J1 + 1.0), 0.0)
    before = run(generator, 0.0, 1.0)
    after = run(generator, 1.8, 4.5)
    assert generator.counters.slips == 1
    assert after[0][1] - before[-1][1] < 0.08, "no leap over the 0.8 s that were missed"
    assert max(abs(v) for v in speeds(after)) < 1.0
    assert after[-1][1] == J1 + 1.0
    smooth = started()
    smooth.follow(way(J1, J1 + 1.0), 0.0)
    run(smooth, 0.0, 3.0)
    assert smooth.counters.slips == 0


def test_desired_is_the_trajectory_while_it_runs_and_the_last_command_after() -> None:
    generator = started()
    assert generator.desired(("J1",), 5.0).position == (J1,)
    path = way(J1, J1 + 1.0)
    generator.follow(path, 0.0)
    assert generator.next_start(0.0) == 0.0
    run(generator, 0.0, 1.0)
    assert generator.desired(("J1",), 0.7) == path.sample(0.7)
    assert generator.next_start(0.95) == pytest.approx(1.0), "what was sent already is not taken back"
    assert generator.desired(("J2",), 0.7).velocity == (0.0,), "a joint that the trajectory leaves alone rests"
    run(generator, 1.0, 3.0)
    assert generator.desired(("J1",), 3.0).position == (J1 + 1.0,)
    assert generator.desired(("J1",), 3.0).velocity == (0.0,)


def test_a_replacement_motion_counts_only_from_its_beginning() -> None:
    generator = started()
    old = way(J1, J1 + 1.0)
    generator.follow(old, 0.0)
    run(generator, 0.0, 1.0)
    begin = generator.next_start(0.95)
    here = generator.desired(("J1",), begin).position[0]
    generator.follow(way(here, J1 - 0.5), 0.95)
    for t in (0.9, 0.95, begin - 0.01):
        assert generator.desired(("J1",), t) == old.sample(t), "what was sent before goes on until then"
    assert generator.desired(("J1",), begin).position == pytest.approx((here,))


def test_halting_before_a_limit_does_not_swing_beyond_it() -> None:
    generator = started()
    limit = HEX7BOT.joint("J1").maximum
    generator.follow(Spline(("J1",), [Waypoint(0.0, (J1,)), Waypoint(0.6, (limit,))]), 0.0)
    before = run(generator, 0.0, 0.7)
    here = generator.desired(("J1",), generator.next_start(0.7)).position[0]
    generator.follow(Spline(("J1",), [Waypoint(0.0, (here,)), Waypoint(1.0, (here,))]), 0.7)
    after = run(generator, 0.7, 2.9)
    assert limit - 0.4 < max(angle for _, angle in before) < limit
    assert limit - 0.05 < max(angle for _, angle in after) <= limit, "it needs nearly all of the way to rest"
    assert after[-1][1] == pytest.approx(here)


def test_a_joint_that_rests_just_outside_a_limit_begins_at_the_limit() -> None:
    generator, end = SetPointGenerator(HEX7BOT), HEX7BOT.joint("J1").maximum
    generator.cycle(state({"J1": end + 0.02}), 0.0, LEAD)
    generator.follow(way(end, end - 0.5), 0.0)
    commands = run(generator, 0.0, 2.0)
    assert max(angle for _, angle in commands) == pytest.approx(end, abs=0.001)
    assert all(angle <= end for _, angle in commands)
    assert commands[-1][1] == pytest.approx(end - 0.5)


def test_after_forgetting_motion_starts_where_a_hand_has_led_the_arm() -> None:
    generator = started()
    generator.follow(way(J1, J1 + 1.0), 0.0)
    run(generator, 0.0, 3.0)
    generator.forget()
    assert generator.mode is Mode.HOLD
    with pytest.raises(UsageError, match="is still unknown"):
        generator.desired(("J1",), 3.0)
    generator.observe(state({"J1": J1 - 0.2}))
    assert generator.desired(("J1",), 3.0).position == (J1 - 0.2,)
    generator.follow(way(J1 - 0.2, J1), 3.0)
    assert sent(generator, 3.0, J1=J1 - 0.2) < J1


def test_a_trajectory_from_elsewhere_is_refused() -> None:
    generator = started()
    with pytest.raises(LimitError, match=r"starts 57\.3 deg from the position of J1; move there first"):
        generator.follow(way(J1 + 1.0, J1), 0.0)
    assert generator.done


def test_latest_set_point_wins_and_the_overtaken_are_counted() -> None:
    generator = started()
    for offset in (0.01, 0.02, 0.03):
        generator.set_point({"J1": J1 + offset}, 0.0)
    assert sent(generator, 0.0) == pytest.approx(J1 + 0.03)
    assert (generator.counters.set_points, generator.counters.replaced) == (3, 2)


def test_set_points_are_followed_within_the_speed_limit() -> None:
    generator = started()
    last, speed = J1, HEX7BOT.joint("J1").max_speed
    for i in range(20):
        generator.set_point({"j1": J1 + 1.0}, 0.05 * i)
        now = sent(generator, 0.05 * i, J1=last)
        assert abs(now - last) <= speed * 0.05 + 1e-9
        last = now
    assert last == J1 + 1.0


def test_lost_set_points_mean_hold() -> None:
    generator = started()
    generator.set_point({"J1": J1 + 0.1}, 0.0)
    commands = run(generator, 0.0, 2.0)
    assert generator.mode is Mode.HOLD
    assert generator.counters.lost == 1
    assert commands[-1][0] < 0.25 + LEAD + 0.06


def test_set_points_that_stop_coming_end_at_the_last_one_and_never_beyond_it() -> None:
    generator, last = started(), J1
    commands: list[tuple[float, float]] = []
    for number in range(25):
        last += 0.018
        generator.set_point({"J1": last}, 0.02 * number)
        commands += run(generator, 0.02 * number, 0.02 * (number + 1))
    commands += run(generator, 0.5, 1.5)
    assert generator.mode is Mode.HOLD
    assert max(place for _, place in commands) == last
    assert commands[-1][1] == last


def test_set_point_replaces_a_trajectory_and_the_other_way_round() -> None:
    generator = started()
    generator.follow(way(J1, J1 + 1.0), 0.0)
    run(generator, 0.0, 0.5)
    generator.set_point({"J1": J1}, 0.5)
    assert generator.mode is Mode.STREAM
    commands = run(generator, 0.5, 0.7)
    generator.follow(way(commands[-1][1], J1 + 0.2), 0.7)
    assert generator.mode is Mode.TRAJECTORY
    assert generator.remaining(0.7) == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("positions", "error", "words"),
    [
        ({"J1": 3.0}, LimitError, "outside its limits"),
        ({"J1": math.nan}, UsageError, "not a number"),
        ({"J9": 0.0}, UsageError, "no joint 'J9'"),
    ],
)
def test_a_bad_set_point_leaves_the_one_before_in_force(
    positions: dict[str, float], error: type[Exception], words: str
) -> None:
    generator = started()
    generator.set_point({"J1": J1 + 0.02}, 0.0)
    with pytest.raises(error, match=words):
        generator.set_point(positions, 0.0)
    assert sent(generator, 0.0) == pytest.approx(J1 + 0.02)


def test_stop_is_latched_until_reset() -> None:
    generator = started()
    generator.follow(way(J1, J1 + 1.0), 0.0)
    run(generator, 0.0, 0.5)
    generator.stop("a person said so")
    generator.stop("too late")
    assert str(generator.reason) == "a person said so"
    assert run(generator, 0.5, 2.0) == []
    with pytest.raises(LimitError, match=r"the arm is stopped \(a person said so\); reset first"):
        generator.set_point({"J1": J1}, 2.0)
    with pytest.raises(LimitError, match="stopped"):
        generator.follow(way(J1, J1 + 0.1), 2.0)
    generator.hold()
    assert generator.mode is Mode.STOPPED
    generator.reset()
    assert run(generator, 2.0, 2.2) == []
    generator.follow(way(J1, J1 + 0.1), 2.2)
    assert run(generator, 2.2, 2.3) != []
    assert generator.counters.stops == 1


def test_after_reset_motion_starts_where_the_arm_is() -> None:
    generator = started()
    generator.follow(way(J1, J1 + 1.0), 0.0)
    run(generator, 0.0, 1.0)
    generator.stop("x")
    generator.reset()
    with pytest.raises(UsageError, match="is still unknown: it has not answered yet"):
        generator.set_point({"J1": J1}, 1.0)
    generator.cycle(state({"J1": J1 - 0.2}), 1.0, LEAD)
    generator.set_point({"J1": J1 - 0.2}, 1.0)
    assert sent(generator, 1.0, J1=J1 - 0.2) == pytest.approx(J1 - 0.2)


def test_a_jam_stops_the_motion_once() -> None:
    generator = started()
    generator.follow(way(J1, J1 + 1.0, 1.0), 0.0)
    orders = [generator.cycle(state({"J1": J1}, load={"J1": 0.7}), 0.05 * i, LEAD) for i in range(40)]
    stops = [order for order in orders if isinstance(order, StopReason)]
    assert [stop.kind for stop in stops] == ["collision"]
    assert orders[-1] is None
    assert generator.mode is Mode.STOPPED


def test_nothing_is_known_before_the_first_cycle() -> None:
    with pytest.raises(UsageError, match="the position of J1 is still unknown"):
        SetPointGenerator(HEX7BOT).follow(way(J1, J1 + 0.1), 0.0)
    for name in ("lost_after", "jump"):
        for value in (0.0, math.inf, math.nan):
            with pytest.raises(UsageError, match="must be above 0"):
                SetPointGenerator(HEX7BOT, **{name: value})


def test_every_event_is_counted() -> None:
    generator = started()
    for goal in (1.0, 0.5, 0.2):
        here = generator.desired(("J1",), generator.next_start(0.0)).position[0]
        generator.follow(way(here, J1 + goal), 0.0)
    assert generator.counters.blends == 2
    now = 0.0
    for _ in range(2):
        generator.stop("a test")
        generator.reset()
        generator.observe(state())
        for _ in range(2):
            generator.set_point({"J1": J1}, now)
        generator.cycle(state(), now, LEAD)
        now += 1.0
        assert generator.cycle(state(), now, LEAD) is None
    counters = generator.counters
    assert (counters.set_points, counters.replaced, counters.lost, counters.stops) == (4, 2, 2, 2)
    assert counters.cycles == 5
    for _ in range(2):
        generator.follow(way(J1, J1 + 0.2), now)
        run(generator, now, now + 0.5)
        run(generator, now + 1.0, now + 4.0)
        generator.forget()
        generator.observe(state())
        now += 4.0
    assert counters.slips == 2


def test_a_set_point_is_lost_after_its_time_and_not_at_it() -> None:
    generator = SetPointGenerator(HEX7BOT, lost_after=0.25)
    generator.observe(state())
    generator.set_point({"J1": J1 + 0.01}, 1.0)
    assert isinstance(generator.cycle(state(), 1.25, LEAD), JointTarget)
    assert generator.cycle(state(), 1.26, LEAD) is None
    assert generator.mode is Mode.HOLD


def test_a_target_moves_no_further_than_the_time_since_the_last_command_allows() -> None:
    generator, speed = started(), HEX7BOT.joint("J1").max_speed
    for i, (now, most) in enumerate(((0.0, LEAD), (0.02, 0.02), (0.02, 0.0), (0.5, LEAD))):
        before = generator.desired(("J1",), now).position[0]
        generator.set_point({"J1": J1 + (-1.0 if i == 3 else 1.0)}, now)
        moved = sent(generator, now, J1=before) - before
        assert moved == pytest.approx(-speed * most if i == 3 else speed * most)


@pytest.mark.parametrize(("seconds", "blend"), [(2.0, 0.3), (0.1, 0.1), (0.01, 0.05), (0.0, 0.05)])
@pytest.mark.parametrize("jump", [0.5, 1.0])
def test_a_start_may_be_as_far_away_as_a_blend_can_close(seconds: float, blend: float, jump: float) -> None:
    gap = jump * HEX7BOT.joint("J1").max_speed * blend / (15 / 8)
    for share in (0.999, 1.001, -0.999, -1.001):
        generator = SetPointGenerator(HEX7BOT, jump=jump)
        generator.observe(state())
        there = J1 + share * gap
        if abs(share) < 1:
            generator.follow(rest_at(there, seconds), 0.0)
            assert generator.mode is Mode.TRAJECTORY
        else:
            with pytest.raises(LimitError, match="move there first"):
                generator.follow(rest_at(there, seconds), 0.0)


def test_what_remains_of_a_trajectory() -> None:
    generator = started()
    assert generator.remaining(0.0) == 0.0
    generator.follow(way(J1, J1 + 0.2), 10.0)
    assert [generator.remaining(t) for t in (10.0, 10.5, 12.0, 13.0)] == pytest.approx([2.0, 1.5, 0.0, 0.0])
    assert not generator.done
    generator.hold()
    assert generator.remaining(10.0) == 0.0
    assert generator.done
    generator.set_point({"J1": J1}, 10.0)
    assert not generator.done
    generator.stop("a test")
    assert generator.done


def test_a_loop_that_is_late_goes_on_as_planned_and_after_a_lead_from_rest() -> None:
    for late in (0.09, 0.11, 0.99, 1.01):
        generator = started()
        path = way(J1, J1 + 0.2)
        generator.follow(path, 0.0)
        sent(generator, 0.0)
        now = LEAD + late * LEAD
        angle = sent(generator, now)
        assert generator.counters.slips == (late > 0.1)
        if late < 0.1:
            assert angle == path.at(now + LEAD).position[0]
        elif late < 1.0:
            assert angle == pytest.approx(path.at(2 * LEAD).position[0])
            assert generator.ends == pytest.approx(path.duration + late * LEAD)
        else:
            assert path.at(LEAD).position[0] < angle < path.at(2 * LEAD).position[0], "it begins from rest"


def test_however_late_the_loop_is_no_target_needs_a_tenth_more_speed_than_was_planned() -> None:
    for late in (0.09, 0.2, 0.5, 0.9, 1.0, 1.5, 4.0):
        generator = started()
        path = way(J1, J1 + 1.0)
        generator.follow(path, 0.0)
        now, angles = 0.0, [J1]
        while not generator.done:
            angles.append(sent(generator, now, J1=angles[-1]))
            now += LEAD * (1.0 + late * (len(angles) % 3 == 0))
        fastest = max(abs(path.sample(0.01 * i).velocity[0]) for i in range(int(100 * path.duration)))
        assert max(abs(b - a) for a, b in pairwise(angles)) <= 1.1 * fastest * LEAD, late
        assert angles[-1] == pytest.approx(path.goal[0])


@pytest.mark.parametrize("keeps_to", [0.05, 0.4, 0.9, 1.6])
def test_after_a_stall_the_joints_go_on_from_rest_within_all_limits(keeps_to: float) -> None:
    generator = started()
    path = way(J1, J1 + 1.0)
    generator.follow(path, 0.0)
    before = run(generator, 0.0, keeps_to)
    angle = sent(generator, keeps_to + 0.7)
    assert generator.counters.slips == 1
    ((rest, begins),) = generator.planned
    assert rest.sample(0.0).position[0] == pytest.approx(before[-1][1])
    assert rest.sample(0.0).velocity == (0.0,)
    assert angle == rest.sample(keeps_to + 0.7 + LEAD - begins).position[0]
    assert rest.goal == path.goal
    joint, step = HEX7BOT.joint("J1"), 1e-3
    samples = [rest.sample(step * i) for i in range(int(rest.duration / step) + 2)]
    for a, b in pairwise(samples):
        assert abs(b.velocity[0]) < joint.max_speed
        assert abs(b.acceleration[0]) < 1.001 * joint.max_acceleration
        assert abs(b.acceleration[0] - a.acceleration[0]) < 1.001 * joint.max_jerk * step


def test_a_motion_that_stalls_a_thousand_times_still_ends_at_its_goal() -> None:
    generator = started()
    path = way(J1, J1 + 1.0)
    generator.follow(path, 0.0)
    angles, now = [J1], 0.0
    while not generator.done:
        order = generator.cycle(state({"J1": angles[-1]}), now, LEAD)
        if isinstance(order, JointTarget):
            angles.append(dict(order.positions)["J1"])
        # Each stall rests the joints, mostly while they still set out again.
        now += 3 * LEAD if generator.counters.slips < 1000 and len(angles) % 2 else LEAD / 2
    assert generator.counters.slips == 1000
    assert angles[-1] == path.goal[0]
    assert all(a <= b for a, b in pairwise(angles))


def test_a_robot_that_keeps_the_time_is_where_it_was_sent_although_this_loop_is_late() -> None:
    generator = started()
    generator.waits = False
    path = way(J1, J1 + 1.0)
    generator.follow(path, 0.0)
    times = [0.05 * i for i in range(12)] + [0.6, 0.95, 1.3, 1.65, 2.0, 2.1]
    for now in times:
        here = path.sample(now).position[0]
        order = generator.cycle(state({"J1": here}, load={"J1": 0.9}), now, LEAD)
        assert not isinstance(order, StopReason), f"{order} at {now}"
    assert generator.counters.slips == 0


def test_a_jam_is_seen_although_this_loop_is_late() -> None:
    generator = started()
    generator.waits = False
    generator.follow(way(J1, J1 + 1.0), 0.0)
    times = [0.05 * i for i in range(12)] + [0.6 + 0.1 * i for i in range(15)]
    orders = [generator.cycle(state({"J1": J1}, load={"J1": 0.7}), now, LEAD) for now in times]
    assert [order.kind for order in orders if isinstance(order, StopReason)] == ["collision"]


def ahead() -> SetPointGenerator:
    """A generator in the middle of a trajectory that the robot has."""
    generator = started()
    generator.settled, generator.onboard = 0.12, True
    generator.follow(way(J1, J1 + 1.0), 0.0)
    for i in range(20):
        generator.cycle(state({"J1": J1}), 0.05 * i, LEAD)
    return generator


def test_what_a_robot_has_begins_when_it_can_know_it() -> None:
    generator = ahead()
    ((_, begins),) = generator.planned
    assert begins == pytest.approx(0.12)
    assert generator.take_change() == pytest.approx(0.12)
    assert generator.take_change() == math.inf
    assert generator.next_start(1.0) == pytest.approx(1.12)


def test_a_hold_brakes_from_what_the_robot_has() -> None:
    generator = ahead()
    ((whole, begins),) = generator.planned
    generator.take_change()
    generator.hold()
    assert generator.mode is Mode.HOLD
    assert generator.remaining(1.0) == 0.0
    switch = generator.take_change()
    assert switch == pytest.approx(0.95 + 0.12)
    (_, (stop, _)) = generator.planned
    rest = switch + stop.duration
    before, place = whole.sample(switch - begins), generator.desired(("J1",), rest)
    assert generator.desired(("J1",), switch).velocity == pytest.approx(before.velocity)
    assert before.velocity[0] > 0.3
    assert place.velocity == pytest.approx((0.0,), abs=1e-9)
    assert generator.next_start(1.0) == pytest.approx(1.12), "what comes next need not wait for the rest"
    # Until it is at rest, set-points wait.
    told = []
    for i in range(12):
        generator.set_point({"J1": J1}, 1.0 + 0.05 * i)
        told.append(generator.cycle(state(), 1.0 + 0.05 * i, LEAD))
    silent = [i for i, order in enumerate(told) if order is None]
    assert silent
    assert max(silent) * 0.05 + 1.0 < rest
    last = told[-1]
    assert isinstance(last, JointTarget)
    assert dict(last.positions)["J1"] < place.position[0]


def test_a_hold_before_the_robot_began_leaves_nothing() -> None:
    generator = started()
    generator.settled, generator.onboard = 0.12, True
    generator.follow(way(J1, J1 + 1.0), 0.0, 5.0)
    generator.hold()
    assert generator.planned == ()
    assert generator.desired(("J1",), 9.0).position == (J1,)


def test_after_an_unwanted_rest_it_goes_on_from_there() -> None:
    generator = ahead()
    ((whole, begins),) = generator.planned
    left = begins + 0.9
    here = whole.sample(0.9).position[0]
    generator.rejoin({"J1": here}, left, 4.0)
    assert generator.counters.slips == 1
    ((rest, again),) = generator.planned
    assert again == pytest.approx(4.12)
    assert rest.sample(0.0).position[0] == pytest.approx(here)
    assert rest.sample(0.0).velocity == (0.0,)
    assert rest.duration == pytest.approx(1.1)
    assert rest.goal == pytest.approx(whole.goal)
    generator.hold()
    generator.rejoin({"J1": here}, left, 5.0)
    assert generator.planned == ()
    assert generator.desired(("J1",), 9.0).position == pytest.approx((here,))


def test_a_stall_does_not_delay_what_the_robot_has() -> None:
    generator = ahead()
    generator.cycle(state({"J1": J1}), 1.5, LEAD)
    assert generator.counters.slips == 0
    assert generator.planned[0][1] == pytest.approx(0.12)
    generator.shift(0.3)
    assert generator.planned[0][1] == pytest.approx(0.42)


def test_a_joint_that_rests_half_a_count_outside_follows_a_motion_that_begins_there() -> None:
    joint = HEX7BOT.joint("J7")
    for limit, outwards in ((joint.maximum, 1.0), (joint.minimum, -1.0)):
        outside = limit + outwards * 0.4 * joint.scale
        generator = SetPointGenerator(HEX7BOT)
        at_stop = {"J1": J1, "J7": outside}
        assert generator.cycle(state(at_stop), 0.0, LEAD) is None
        generator.follow(rest_to_rest(("J1", "J7"), (J1, outside), (J1 + 0.5, outside), 2.0), 0.1)
        for i in range(80):
            order = generator.cycle(state(at_stop), 0.1 + 0.05 * i, LEAD)
            if isinstance(order, JointTarget):
                at_stop = dict(order.positions)
            assert at_stop["J7"] == pytest.approx(limit, abs=joint.scale)
        assert at_stop["J1"] == pytest.approx(J1 + 0.5)
        # Further outside than any goal may be.
        with pytest.raises(LimitError):
            joint.check(limit + outwards * 0.6 * joint.scale)
        assert joint.inside(outside) == limit
        assert joint.inside(limit + outwards) == limit + outwards
