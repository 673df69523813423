"""What a generator has planned: until when it counts, and what is left of it after a hold."""

from __future__ import annotations

import numpy as np
import pytest
from tests.motion.arms import state
from tests.motion.test_set_point_generator import J1, LEAD, run, started, way

from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.model.state import JointTarget
from hexwire.motion.set_point_generator import SetPointGenerator
from hexwire.motion.through import arm_path


def test_a_plan_counts_until_its_end_although_its_last_command_has_been_given() -> None:
    generator = started()
    generator.onboard, generator.settled = True, 0.12
    path = way(J1, J1 + 0.1)
    generator.follow(path, 0.0)
    run(generator, 0.0, 2.05)
    assert generator.done
    assert generator.desired(("J1",), 2.02) == path.sample(2.02 - 0.12), "not the goal, 0.1 s too early"
    generator.follow(way(J1 + 0.1, J1), 2.03)
    assert generator.desired(("J1",), 2.05) == path.sample(2.05 - 0.12), "nor where the next one begins"


def test_a_plan_that_a_robot_has_but_has_not_begun_has_moved_nothing() -> None:
    generator = started()
    generator.onboard, generator.settled = True, 0.12
    generator.follow(way(J1, J1 + 1.0, 1.5), 0.0)
    for now in (0.02, 0.1):
        generator.cycle(state(), now, LEAD)
    generator.hold()
    assert generator.desired(("J1",), 1.0).position == (J1,)


def test_a_hold_between_the_first_command_and_the_begin_brakes() -> None:
    generator = started()
    generator.set_point({"J1": J1}, 0.0)
    generator.cycle(state(), 0.0, LEAD)
    generator.follow(way(J1, J1 + 0.4, 1.0), 0.02)
    assert generator.planned[0][1] == LEAD
    generator.cycle(state(), 0.04, LEAD)
    generator.hold()
    here = generator.desired(("J1",), 0.04 + LEAD)
    assert here.velocity[0] > 0.0
    assert generator.desired(("J1",), 1.0).position[0] > here.position[0]


@pytest.mark.parametrize("ends", ["hold", "take over"])
@pytest.mark.parametrize("rate", [100, 50, 20])
def test_set_points_in_motion_are_left_within_the_limits(ends: str, rate: int) -> None:
    generator, where, period, speed = started(), J1, 0.01, 0.5
    told: list[tuple[float, float]] = []
    for i in range(300):
        now = i * period
        if now < 1.0 and (i * rate) % 100 == 0:
            generator.set_point({"J1": J1 + speed * now}, now)
        elif i == 100 and ends == "hold":
            generator.hold()
        elif i == 100:
            here = generator.desired(("J1",), generator.next_start(now)).position
            generator.follow(arm_path(HEX7BOT, ("J1",), [here, (J1,)]), now)
        order = generator.cycle(state({"J1": where}, stamp=now), now, 1.5 * period)
        if isinstance(order, JointTarget):
            where = dict(order.positions)["J1"]
            told.append((now + 1.5 * period, where))
    left = np.array([place for due, place in told if due >= 1.0])
    speeds = np.diff(left) / period
    assert speeds[0] == pytest.approx(speed, abs=0.05), "not at once at rest"
    assert np.abs(np.diff(speeds)).max() / period <= 1.001 * 6.0
    assert speeds[-1] == pytest.approx(0.0, abs=0.005)
    assert left[-1] == pytest.approx(J1 if ends == "take over" else J1 + speed * 1.08, abs=0.02)


def test_set_points_that_are_lost_at_rest_move_nothing() -> None:
    generator, where = SetPointGenerator(HEX7BOT, lost_after=0.1), J1
    generator.observe(state(), 0.0)
    for i in range(100):
        now = 0.01 * i
        if i <= 30:
            generator.set_point({"J1": J1 + 0.5 * now}, now)
        order = generator.cycle(state({"J1": where}, stamp=now), now, 0.015)
        where = dict(order.positions)["J1"] if isinstance(order, JointTarget) else where
    assert generator.counters.lost == 1
    assert where == J1 + 0.5 * 0.3


def test_set_points_whose_brake_is_not_allowed_are_held_at_once() -> None:
    generator = SetPointGenerator(HEX7BOT, allowed=lambda path, positions: "no")
    generator.observe(state(), 0.0)
    for i in range(20):
        now = 0.01 * i
        generator.set_point({"J1": J1 + 0.5 * now}, now)
        order = generator.cycle(state({"J1": J1}, stamp=now), now, 0.015)
    generator.hold()
    assert isinstance(order, JointTarget)
    assert generator.cycle(state(), 0.2, 0.015) is None


def test_a_brake_that_a_stall_interrupts_is_over() -> None:
    generator = started()
    generator.follow(way(J1, J1 + 1.0), 0.0)
    run(generator, 0.0, 1.0)
    generator.hold()
    assert generator.braking
    rests = run(generator, 1.0, 1.1)[-1][1]
    assert generator.braking
    assert not [place for _, place in run(generator, 3.0, 3.5) if place != rests]
    assert not generator.braking
    assert generator.desired(("J1",), 3.5).position == (rests,)
    assert not any(generator.desired(("J1",), 3.5).velocity)
