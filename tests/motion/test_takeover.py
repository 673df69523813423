"""How a trajectory begins while joints move, and streams of them: joined within all limits, also at its end."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from tests.few import few
from tests.motion.arms import ARMS, EXCESS, HOME, PERIOD, at_rest, state

from hexwire.control.loop.plan import Plan
from hexwire.control.motion.goals import Point, TrajectoryGoal
from hexwire.errors import LimitError
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.motion.checks import check_trajectory
from hexwire.motion.moving import Pieces, brake, joint_limits
from hexwire.motion.set_point_generator import SetPointGenerator
from hexwire.motion.takeover import Takeover, take_over
from hexwire.motion.through import arm_path
from hexwire.motion.trajectory import Sample, Spline, Trajectory, Waypoint


def test_from_rest_a_goal_of_one_point_is_reached_straight() -> None:
    names, limits = ("J1", "J2", "J3"), joint_limits(HEX7BOT, ("J1", "J2", "J3"))
    rest = (0.0,) * 3
    for seconds in (0.1, 1.0):
        goal = Spline(names, [Waypoint(0.0, rest), Waypoint(seconds, (0.4, -0.2, 0.1))])
        plan = take_over(Sample(rest, rest, rest), goal, limits)
        assert plan.duration == pytest.approx(max(seconds, plan.duration))
        assert (plan.duration > seconds) is (seconds < 0.5)
        for share in (0.1, 0.5, 0.9):
            a, b, c = plan.at(share * plan.duration).position
            assert (b, c) == pytest.approx((-0.5 * a, 0.25 * a), abs=1e-7)


def test_what_keeps_the_limits_itself_is_followed_as_it_is() -> None:
    rest = (0.0,)
    path = Spline(("J1",), [Waypoint(0.0, rest, rest, rest), Waypoint(2.0, (0.5,), rest, rest)])
    assert take_over(Sample(rest, rest, rest), path, joint_limits(HEX7BOT, ("J1",))) is path


def test_a_way_that_is_not_allowed_is_braked_first_and_else_refused() -> None:
    forbidden = [0.35]

    def allowed(path: Trajectory, positions: object) -> str:
        assert isinstance(path, Pieces)
        return "too far" if path.ranges()[0][1] > forbidden[0] else ""

    def moving() -> SetPointGenerator:
        generator = SetPointGenerator(HEX7BOT, allowed=allowed)
        generator.observe(state({"J1": 0.0}), 0.0)
        generator.follow(arm_path(HEX7BOT, ("J1",), [(0.0,), (1.2,)]), 0.0)
        return generator

    generator = moving()
    # A point that is far behind its time: the way to it would catch up at more than is allowed here.
    (place,), (speed,), _ = generator.desired(("J1",), 0.3)
    assert speed > 0.9
    (stop,) = brake(("J1",), generator.desired(("J1",), 0.3), joint_limits(HEX7BOT, ("J1",))).goal
    forbidden[0] = stop + 0.001
    quick = Spline(
        ("J1",), [Waypoint(0.0, (place,)), Waypoint(0.05, (place - 0.2,)), Waypoint(1.0, (place - 0.4,))]
    )
    generator.follow(quick, 0.3)
    assert generator.desired(("J1",), 9.0).position == pytest.approx((place - 0.4,))
    forbidden[0] = stop - 0.01
    generator = moving()
    with pytest.raises(LimitError, match=r"^too far; wait for the end of the running motion, or move elsewhere"):
        generator.follow(quick, 0.3)
    # A hold goes on to the first place from which it may brake; at the end at the latest.
    generator.observe(state(), 0.3)
    generator.hold()
    assert generator.desired(("J1",), 9.0).position == pytest.approx((1.2,))


def test_a_speed_beyond_the_limits_at_the_last_point_is_refused_and_never_searched_for() -> None:
    body = Spline(("J1",), [Waypoint(0.0, (0.0,), (0.0,)), Waypoint(0.01, (0.0,), (100.0,))])
    (found,) = check_trajectory(body, HEX7BOT).findings
    assert found.text == "J1 would turn at 5730 deg/s, its limit is 149 deg/s"
    rest = Sample((0.0,), (0.0,), (0.0,))
    plan = take_over(rest, body, joint_limits(HEX7BOT, ("J1",)), passes=True)
    assert isinstance(plan, Takeover)
    assert plan.head is not None
    most = HEX7BOT.joint("J1").max_speed
    assert plan.head.at(plan.head.duration).velocity == pytest.approx((most,))


def test_the_way_to_a_first_point_is_only_joined_where_it_keeps_the_limits() -> None:
    names, slow = ("shoulder_lift",), -0.0438
    arm = ARMS[2]
    points = tuple(Point(0.12 * i, (0.9575 + 0.12 * i * slow,), (slow,)) for i in (1, 2, 3))
    generator = SetPointGenerator(arm)
    generator.observe(at_rest(arm, [0.9575 if name == names[0] else 0.0 for name in arm.names]), 0.0)
    plan = Plan(TrajectoryGoal(names, points), names, 0.0)
    generator.follow(plan.trajectory(generator.desired(names, 0.0), 0.0), 0.0, passes=True)
    positions = np.array([generator.desired(names, i * PERIOD).position[0] for i in range(800)])
    jerk = np.abs(np.diff(positions, 3)).max() / PERIOD**3
    assert jerk <= EXCESS * arm.joint(names[0]).max_jerk + 1e-5


# -- streams ---------------------------------------------------------------------------------------------

HORIZONS = (0.05, 0.07, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5)


@few("settled, velocities", product((0.0, 0.12), (False, True)), (0.12, False))
def test_a_stream_of_one_point_trajectories_is_followed_smoothly(settled: float, velocities: bool) -> None:
    speed, start = 0.6, HOME["J1"] - 1.0
    for rate in (20.0, 50.0):
        for horizon in HORIZONS:
            generator, names = SetPointGenerator(HEX7BOT), ("J1",)
            generator.observe(state({"J1": start}), 0.0)
            generator.settled, generator.onboard = settled, settled > 0.0
            desired: list[tuple[float, float]] = []
            ends, period = 2.2, 0.005
            for i in range(round((ends + 1.0) / period)):
                t = i * period
                if t < ends and (i * period * rate) % 1.0 < 1e-6:
                    there = (start + speed * (t + horizon),)
                    point = Point(horizon, there, (speed,) if velocities else ())
                    begins = generator.next_start(t)
                    plan = Plan(TrajectoryGoal(names, (point,)), names, t)
                    body = plan.trajectory(generator.desired(names, begins), begins)
                    generator.follow(body, t, passes=True)
                generator.observe(state({"J1": start}), t)
                desired.append((generator.desired(names, t).position[0], generator.desired(names, t).velocity[0]))
            case = f"every {1 / rate:g} s, horizon {horizon} s"
            if horizon * rate < 1.0:
                continue  # it comes to rest between two goals
            steps = np.diff([p for p, _ in desired]) / period
            assert np.abs(np.diff(steps)).max() / period <= 6.01, f"{case}: no jump"
            steady = [v for _, v in desired[round(1.2 / period) : round(ends / period)]]
            assert max(steady) - min(steady) <= 0.1, f"{case}: {min(steady)} to {max(steady)} rad/s"
            assert desired[-1][1] == 0.0, f"{case}: at rest after its end"
            last = start + speed * (ends + horizon)
            assert desired[-1][0] == pytest.approx(last, abs=0.2), case
            assert len(generator.planned) < 150, "what is past is forgotten"
