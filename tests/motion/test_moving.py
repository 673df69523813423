"""What begins while joints move: within all limits, for every arm, however it comes."""

from __future__ import annotations

import math
import random
from collections.abc import Sequence
from contextlib import suppress

import numpy as np
import pytest
import ruckig
from tests.few import few
from tests.motion.arms import ARMS, EXCESS, PERIOD, at_rest

from hexwire.control.loop.plan import Plan
from hexwire.control.motion.goals import Point, TrajectoryGoal
from hexwire.errors import LimitError
from hexwire.model.arm import ArmModel
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.model.arms.hex7bot.kinematics import Hex7BotModel
from hexwire.model.arms.puma260.kinematics import PUMA260
from hexwire.model.geometry import make_kinematics
from hexwire.model.pose import Pose
from hexwire.motion.checks import InJoints, check_trajectory
from hexwire.motion.limits import slow_enough
from hexwire.motion.line import Line
from hexwire.motion.moving import Pieces, brake, joint_limits, reach
from hexwire.motion.set_point_generator import SetPointGenerator
from hexwire.motion.speed_profile import JointLimits
from hexwire.motion.takeover import Takeover
from hexwire.motion.through import Through, arm_path
from hexwire.motion.trajectory import Sample, Spline, Trajectory, Waypoint

Chain = Sequence[tuple[Trajectory, float]]


def flat(path: Trajectory, joint: int, begin: float, left: float) -> list[tuple[float, ...]]:
    """Pieces of constant jerk of a joint from a time of a trajectory on for a time; it rests then."""
    if isinstance(path, Takeover):
        head = 0.0 if path.head is None else path.head.duration
        rows = [] if path.head is None else flat(path.head, joint, 0.0, head)
        if path._tail > head:
            body = flat(path._body, joint, path._joined, path._tail - head)
            rows += [(t + head, *row) for t, *row in body]
        if path.tail is not None:
            rows += [(t + path._tail, *row) for t, *row in flat(path.tail, joint, 0.0, path.tail.duration)]
        pieces: Sequence[tuple[float, ...]] = rows
    elif isinstance(path, Pieces):
        pieces = path.pieces[joint]
    else:
        raise AssertionError(f"no pieces of {path!r}")
    found = []
    for i, (t, p, v, a, j) in enumerate(pieces):
        ends = pieces[i + 1][0] if i + 1 < len(pieces) else math.inf
        if ends <= begin or t >= begin + left:
            continue
        u = max(0.0, begin - t)
        now = p + u * (v + u * (0.5 * a + u * j / 6.0)), v + u * (a + 0.5 * u * j), a + u * j
        found.append((max(t, begin) - begin, *now, j))
    end = path.goal[joint] if begin + left >= path.duration else None
    if end is not None:
        found.append((path.duration - begin, end, 0.0, 0.0, 0.0))
    return found


def sampled(chain: Chain, joint: int, until: float) -> np.ndarray:
    """Positions of a joint at 1 kHz."""
    rows: list[tuple[float, ...]] = []
    for i, (path, began) in enumerate(chain):
        ends = chain[i + 1][1] if i + 1 < len(chain) else math.inf
        left = min(path.duration, ends - began)
        rows += [(t + began, *row) for t, *row in flat(path, joint, 0.0, left)]
    begins = np.array([row[0] for row in rows])
    times = np.arange(begins[0], until, PERIOD)
    p, v, a, j = (np.array([row[k] for row in rows]) for k in range(1, 5))
    place = np.searchsorted(begins, times, side="right") - 1
    u = times - begins[place]
    found: np.ndarray = p[place] + u * (v[place] + u * (0.5 * a[place] + u * j[place] / 6.0))
    return found


def ratios(arm: ArmModel, generator: SetPointGenerator) -> float:
    """The worst of velocity, acceleration and jerk by its limit, by differences of positions at 1 kHz."""
    chain = generator.planned
    until = max(path.duration + began for path, began in chain) + 0.05
    worst = 0.0
    for i, name in enumerate(chain[0][0].names):
        joint = arm.joint(name)
        positions = sampled(chain, i, until)
        assert positions.min() >= joint.minimum - 1e-9, name
        assert positions.max() <= joint.maximum + 1e-9, name
        limits = (joint.max_speed, joint.max_acceleration, joint.max_jerk)
        for order, most in enumerate(limits, 1):
            change = np.abs(np.diff(positions, order)).max() / PERIOD**order
            # Positions are rounded to 1e-16: the third difference has that by 1e-9.
            worst = max(worst, float(change - (1e-5 if order == 3 else 0.0)) / most)
    return worst


def begun(arm: ArmModel, names: Sequence[str], chance: random.Random) -> tuple[SetPointGenerator, Through]:
    """A generator in a fast motion between two random poses."""
    inside = {name: (arm.joint(name).minimum + 0.02, arm.joint(name).maximum - 0.02) for name in arm.names}
    start = [chance.uniform(*inside[name]) for name in arm.names]
    generator = SetPointGenerator(arm)
    generator.observe(at_rest(arm, start), 0.0)
    here = [start[arm.index(name)] for name in names]
    path = arm_path(arm, names, [here, [chance.uniform(*inside[name]) for name in names]])
    generator.follow(path, 0.0)
    return generator, path


def one_attempt(arm: ArmModel, chance: random.Random, kind: str) -> float:
    names = chance.sample(arm.names, 2)
    generator, path = begun(arm, names, chance)
    now = chance.uniform(0.0, path.duration)
    generator.observe(at_rest(arm, [0.0] * len(arm.names)), now)
    if kind == "cancel":
        generator.hold()
        return ratios(arm, generator)
    goal = [chance.uniform(arm.joint(name).minimum, arm.joint(name).maximum) for name in names]
    if kind == "takeover":
        here = generator.desired(tuple(names), now).position
        body: Trajectory = (
            arm_path(arm, names, [here, goal])
            if chance.random() < 0.5
            else Spline(names, [Waypoint(0.0, here), Waypoint(chance.uniform(0.05, 2.0), tuple(goal))])
        )
        generator.follow(body, now)
        if chance.random() < 0.5:
            generator.observe(at_rest(arm, [0.0] * len(arm.names)), now + chance.uniform(0.0, 0.5))
            generator.hold()
        return ratios(arm, generator)
    horizon, speeds = chance.uniform(0.05, 0.5), [chance.uniform(-0.5, 0.5) for _ in names]
    for i in range(4):
        t = now + 0.02 * i
        here = generator.desired(tuple(names), t).position
        there = tuple(
            min(max(q + v * horizon, arm.joint(n).minimum), arm.joint(n).maximum)
            for n, q, v in zip(names, here, speeds, strict=True)
        )
        point = Point(horizon, there, tuple(speeds) if kind == "stream with velocities" else ())
        plan = Plan(TrajectoryGoal(tuple(names), (point,)), tuple(names), t)
        generator.follow(plan.trajectory(generator.desired(tuple(names), t), t), t, passes=True)
    return ratios(arm, generator)


KINDS = ("takeover", "cancel", "stream", "stream with velocities")


def attempts(arm: ArmModel, count: int) -> None:
    """Pieces of constant jerk are sampled at 1 kHz all at once."""
    chance = random.Random(f"26 {arm.name}")
    for i in range(count):
        kind = KINDS[i % 4]
        worst = one_attempt(arm, chance, kind)
        assert worst <= EXCESS, (i, kind, worst)


@pytest.mark.parametrize("arm", ARMS, ids=lambda arm: arm.name)
def test_takeovers_cancels_and_streams_keep_all_limits(arm: ArmModel) -> None:
    attempts(arm, 200)


@pytest.mark.slow
@pytest.mark.parametrize("arm", ARMS, ids=lambda arm: arm.name)
def test_ten_thousand_takeovers_cancels_and_streams_keep_all_limits(arm: ArmModel) -> None:
    """2500 for each of four arms."""
    attempts(arm, 2500)


@pytest.mark.slow
def test_lines_keep_all_limits() -> None:
    chance, model = random.Random(26), Hex7BotModel()
    ran = slowed = 0
    while ran < 12:
        start = [chance.uniform(r.minimum, r.maximum) for r in model.ranges]
        here = model.forward(start)
        goal = Pose(tuple([x + chance.uniform(-0.15, 0.15) for x in here.position]), here.rotation)  # type: ignore[arg-type]  # three
        try:
            line = Line(model, start, goal, speed=0.25, acceleration=1.0)
        except LimitError:
            continue
        plain = InJoints(line, model)
        path = slow_enough(HEX7BOT, plain)
        if not check_trajectory(path, HEX7BOT, step=0.005).findings:
            ran += 1
            slowed += path is not plain
            samples = np.array([sample[:3] for _, sample in path.samples(PERIOD)][:-1])
            for i, name in enumerate(path.names):
                joint = HEX7BOT.joint(name)
                assert np.abs(samples[:, 2, i]).max() <= EXCESS * joint.max_acceleration
                assert np.abs(np.diff(samples[:, 2, i])).max() / PERIOD <= EXCESS * joint.max_jerk
            assert path.goal == plain.goal
    assert 0 < slowed < ran


def lines(arm: ArmModel, chance: random.Random, count: int) -> list[tuple[dict[str, float], Trajectory]]:
    """Fast lines of the tip that keep what a path check asks, each with the posture in which it begins."""
    model, found = make_kinematics(arm.name, for_motion=True), list[tuple[dict[str, float], Trajectory]]()
    while len(found) < count:
        start = [chance.uniform(r.minimum, r.maximum) for r in model.ranges]
        here, middle = model.forward(start), {j.name: 0.5 * (j.minimum + j.maximum) for j in arm.joints}
        x, y, z = (value + chance.uniform(-0.1, 0.1) for value in here.position)
        try:
            line = Line(model, start, Pose((x, y, z), here.rotation), speed=0.3, acceleration=1.2)
        except LimitError:
            continue
        path = slow_enough(arm, InJoints(line, model))
        if path.duration > 0.2 and not check_trajectory(path, arm, step=0.01).findings:
            found.append((middle | model.to_joints(start), path))
    return found


@few("arm, count", [(arm, count) for count in (1, 5) for arm in ARMS], *((arm, 1) for arm in ARMS))
def test_lines_that_are_taken_over_cancelled_or_streamed_away_keep_all_limits(arm: ArmModel, count: int) -> None:
    chance = random.Random(f"lines {arm.name}")
    for where, path in lines(arm, chance, count):
        names = path.names
        done = np.array([path.sample(i * PERIOD).position for i in range(round(path.duration / PERIOD) + 50)])
        joints = [arm.joint(name) for name in names]
        for kind in ("whole", *(("cancel", "takeover", "stream") * 40)):
            generator, most = SetPointGenerator(arm), len(done)
            generator.observe(at_rest(arm, [where[name] for name in arm.names]), 0.0)
            generator.follow(path, 0.0)
            rows = done
            if kind != "whole":
                # A multiple of the period, so that what is done need not be sampled again.
                most = chance.randrange(1, round(path.duration / PERIOD))
                now = most * PERIOD
                generator.observe(at_rest(arm, [where[name] for name in arm.names]), now)
                here = generator.desired(names, now).position
                goal = tuple([chance.uniform(joint.minimum, joint.maximum) for joint in joints])
                with suppress(LimitError):
                    if kind == "cancel":
                        generator.hold()
                    elif kind == "takeover":
                        generator.follow(arm_path(arm, names, [here, goal]), now)
                    else:
                        generator.follow(
                            Spline(names, [Waypoint(0.0, here), Waypoint(0.2, goal)]), now, passes=True
                        )
                if len(generator.planned) == 1:
                    continue  # no way of it stays inside the limits
                until = max(part.duration + began for part, began in generator.planned[1:]) + 0.05
                rest = [sampled(generator.planned[1:], i, until) for i in range(len(names))]
                rows = np.vstack([done[:most], np.array(rest).T])
            for i, joint in enumerate(joints):
                assert joint.minimum - 1e-9 <= rows[:, i].min()
                assert rows[:, i].max() <= joint.maximum + 1e-9
                for order, limit in enumerate((joint.max_speed, joint.max_acceleration, joint.max_jerk), 1):
                    change = np.abs(np.diff(rows[:, i], order)).max() / PERIOD**order
                    assert change <= EXCESS * limit + (1e-5 if order == 3 else 0.0), (kind, joint.name, order, most)


# -- the profile of one joint ----------------------------------------------------------------------------


def any_state(chance: random.Random, limits: JointLimits, *, before: bool) -> tuple[float, float, float]:
    """A state from which, or to which, the limits can be kept."""
    while True:
        v, a = (chance.uniform(-1.0, 1.0) * most for most in limits[:2])
        a = chance.choice((0.0, a, limits.acceleration, -limits.acceleration))
        if abs(v + (0.5 if before else -0.5) * a * abs(a) / limits.jerk) <= limits.speed:
            return chance.uniform(-1.5, 1.5), v, a


def alone(state: tuple[float, float, float]) -> Sample:
    return Sample(*((value,) for value in state))


def test_a_way_from_any_state_to_any_is_nearly_as_fast_as_ruckig_finds() -> None:
    chance, limits = random.Random(26), JointLimits(2.6, 6.0, 60.0)
    ratios = []
    for i in range(1000):
        begin, end = any_state(chance, limits, before=True), any_state(chance, limits, before=False)
        if i % 2:
            end = end[0], 0.0, 0.0
        found = reach(("a",), alone(begin), alone(end), [limits], 0.0, longer=True)
        assert found is not None
        rows = found.pieces[0]
        assert rows[0][1:4] == begin
        assert rows[-1][:4] == pytest.approx((found.duration, *end), abs=1e-6)
        for _, _, v, a, j in rows:
            assert abs(v) <= limits.speed * (1 + 1e-9)
            assert abs(a) <= limits.acceleration * (1 + 1e-9)
            assert abs(j) <= limits.jerk * (1 + 1e-9)
        best = ruckig.InputParameter(1)
        (p, v, a), (q, w, b) = begin, end
        best.current_position, best.current_velocity, best.current_acceleration = [p], [v], [a]
        best.target_position, best.target_velocity, best.target_acceleration = [q], [w], [b]
        best.max_velocity, best.max_acceleration, best.max_jerk = ([most] for most in limits)
        fastest = ruckig.Trajectory(1)
        assert int(ruckig.Ruckig(1).calculate(best, fastest)) >= 0
        ratios.append(found.duration / fastest.duration)
    assert min(ratios) >= 1.0 - 1e-6
    assert sorted(ratios)[500] <= 1.001
    assert sorted(ratios)[950] <= 1.03


def test_a_time_that_the_limits_do_not_allow_is_refused_and_a_longer_one_found() -> None:
    limits = [JointLimits(2.0, 6.0, 60.0)]
    begin, end = alone((0.0, 0.0, 0.0)), alone((1.0, 0.0, 0.0))
    assert reach(("a",), begin, end, limits, 0.5) is None
    found = reach(("a",), begin, end, limits, 2.0)
    assert found is not None
    assert found.duration == 2.0
    assert found.goal == (1.0,)
    # A speed at the end that needs more than the limit before it.
    assert reach(("a",), begin, alone((1.0, 2.0, -6.0)), limits, 2.0) is None


@pytest.mark.parametrize("what", [math.nan, math.inf])
@pytest.mark.parametrize("place", range(6))
def test_a_way_that_there_is_not_is_refused_and_not_searched_for_ever(place: int, what: float) -> None:
    limits = [JointLimits(2.0, 6.0, 60.0)]
    row = [0.1, 0.5, 0.0, 1.0, 0.0, 0.0]
    row[place] = what
    begin, end = (Sample(*((x,) for x in some)) for some in (row[:3], row[3:]))
    assert reach(("a",), begin, end, limits, 1.0) is None
    with pytest.raises(LimitError, match="no motion within the limits leads a"):
        reach(("a",), begin, end, limits, 0.0, longer=True)


@pytest.mark.parametrize(("speed", "seconds", "way"), [(2.0, 0.433, 0.433), (1.0, 0.267, 0.133), (0.6, 0.2, 0.06)])
def test_a_brake_takes_what_the_safety_page_says(speed: float, seconds: float, way: float) -> None:
    limits = joint_limits(HEX7BOT, ("J1", "J2"))
    found = brake(("J1", "J2"), Sample((0.0, 0.0), (speed, 0.5 * speed), (0.0, 0.0)), limits)
    assert found.duration == pytest.approx(seconds, abs=1e-3)
    assert found.goal == pytest.approx((way, 0.5 * way), abs=1e-3)
    # The slower joint brakes as long as the faster one: a straight motion stays straight.
    for share in (0.2, 0.5, 0.8):
        first, second = found.at(share * found.duration).position
        assert second == pytest.approx(0.5 * first, abs=1e-6)


def test_a_brake_beside_a_longer_one_does_not_first_go_beyond_the_speed_limit() -> None:
    names, limits = ("J3", "J2"), joint_limits(PUMA260, ("J3", "J2"))
    # The second joint is nearly as fast as it may be and still gets faster; with less jerk it would overshoot.
    begin = Sample((0.0, 0.0), (-0.658, 0.8612), (-4.95, 1.174))
    found = brake(names, begin, limits)
    fastest = max(abs(found.at(i * 1e-3).velocity[1]) for i in range(round(found.duration * 1000)))
    assert fastest <= EXCESS * limits[1].speed
    assert found.duration == pytest.approx(brake(names[:1], Sample(*(x[:1] for x in begin)), limits[:1]).duration)
    assert found.at(found.duration).velocity == pytest.approx((0.0, 0.0), abs=1e-9)


@pytest.mark.parametrize("arm", ARMS, ids=lambda arm: arm.name)
def test_joints_with_next_to_nothing_to_go_move_with_the_others(arm: ArmModel) -> None:
    """As a client's single precision leaves them: no goal is refused for it, nor takes longer."""
    some = random.Random(f"next to nothing, {arm.name}")
    limits, rest = joint_limits(arm, arm.names), (0.0,) * len(arm.names)
    for number in range(200):
        ways = [some.choice((-1.0, 1.0)) * 10.0 ** some.uniform(-14.0, 0.0) for _ in arm.names]
        goal = tuple(some.choice((0.0, way, way)) for way in ways)
        begin, end = Sample(rest, rest, rest), Sample(goal, rest, rest)
        path = reach(arm.names, begin, end, limits, some.uniform(0.0, 1.0), longer=True)
        assert path is not None, number
        lone = [
            reach((name,), Sample((0.0,), (0.0,), (0.0,)), Sample((way,), (0.0,), (0.0,)), [most], 0.0, longer=True)
            for name, way, most in zip(arm.names, goal, limits, strict=True)
        ]
        assert path.duration <= 1.0 + 1e-3 + 1.3 * sum(one.duration for one in lone if one is not None), number
        for part in (0.0, 0.21, 0.5, 0.83, 1.0):
            at = path.at(part * path.duration)
            far = max(range(len(goal)), key=lambda i: abs(goal[i]))
            share = at.position[far] / goal[far] if goal[far] else 0.0
            assert at.position == pytest.approx([share * way for way in goal], rel=1e-6, abs=1e-11), number
            for most, v, a in zip(limits, at.velocity, at.acceleration, strict=True):
                assert abs(v) <= EXCESS * most.speed, number
                assert abs(a) <= EXCESS * most.acceleration, number
