"""Joint angles between the knots of a path of the tip."""

from __future__ import annotations

import math

import pytest

from hexwire.errors import LimitError
from hexwire.model.arms.hex7bot.kinematics import Hex7BotModel
from hexwire.model.pose import Pose
from hexwire.motion.line import Knots

A = Hex7BotModel()
START = tuple(math.radians(d) for d in (90, 100, 90, 90, 45, 90))
HERE = A.forward(START)


def circle(share: float) -> Pose:
    x, y, z = HERE.position
    turn = 2 * math.pi * share
    return Pose((x + 0.03 * math.sin(turn), y, z + 0.03 * (math.cos(turn) - 1.0)), HERE.rotation)


def test_the_tip_stays_on_any_path() -> None:
    knots = Knots(A, circle, START, 90)
    for k in range(301):
        tip = A.forward(knots.at(k * knots.steps / 300, 0.0, 0.0).position).position
        assert math.dist(tip, circle(k / 300).position) < 1e-6
    assert knots.at(knots.steps, 0.0, 0.0).position == pytest.approx(START, abs=1e-9)


def test_few_steps_are_halved_until_the_joints_turn_evenly() -> None:
    assert Knots(A, circle, START, 20).steps > 20
    # Differences of a higher order are small at once.
    assert Knots(A, circle, START, 90, order=4).steps == 90


def test_velocity_and_acceleration_follow_from_place_and_speed() -> None:
    knots = Knots(A, circle, START, 90)
    h, place, speed, more = 1e-4, 0.37 * knots.steps, 50.0, 20.0

    def at(t: float) -> tuple[float, ...]:
        return knots.at(place + speed * t + 0.5 * more * t * t, 0.0, 0.0).position

    here = knots.at(place, speed, more)
    for v, a, b, m, c in zip(here.velocity, here.acceleration, at(-h), at(0.0), at(h), strict=True):
        assert v == pytest.approx((c - b) / (2 * h), abs=1e-4)
        assert a == pytest.approx((c - 2 * m + b) / h**2, abs=1e-2)


def test_a_path_out_of_reach_says_where() -> None:
    def away(share: float) -> Pose:
        x, y, z = HERE.position
        return Pose((x, y + 0.5 * share, z), HERE.rotation)

    with pytest.raises(LimitError, match=r"at \d+% of the line: "):
        Knots(A, away, START, 50)
