"""Joints come to rest on the trajectory that they follow, within all limits and soon."""

from __future__ import annotations

import math
import random
from collections.abc import Mapping

import pytest
from tests.motion.arms import EXCESS, HOME, state
from tests.motion.test_set_point_generator import LEAD

from hexwire.errors import LimitError
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.motion.eased import ease_out
from hexwire.motion.moving import joint_limits
from hexwire.motion.set_point_generator import Mode, SetPointGenerator
from hexwire.motion.slowed import Slowed, SpeedStage, slow_down
from hexwire.motion.speed_profile import JointLimits
from hexwire.motion.trajectory import Sample, Trajectory

NAMES = ("J1", "J2")
MIDDLE = (HOME["J1"], HOME["J2"])


class Circle(Trajectory):
    """Two joints that go round, gently at first."""

    def __init__(self, radius: float, rate: float, seconds: float) -> None:
        self.names, self.duration = NAMES, seconds
        self._radius, self._rate = radius, rate

    def at(self, t: float) -> Sample:
        rate, r = self._rate, self._radius
        # The phase speeds up in a second.
        u = min(1.0, t)
        phase = rate * (u * u * u * (1.0 - 0.5 * u) + max(0.0, t - 1.0))
        w, dw = rate * u * u * (3.0 - 2.0 * u), rate * 6.0 * u * (1.0 - u)
        s, c = math.sin(phase), math.cos(phase)
        return Sample(
            (MIDDLE[0] + r * s, MIDDLE[1] + r * (1.0 - c)),
            (r * w * c, r * w * s),
            (r * (dw * c - w * w * s), r * (dw * s + w * w * c)),
        )


def off(position: tuple[float, ...], radius: float) -> float:
    """How far a place is from the circle."""
    return abs(math.hypot(position[0] - MIDDLE[0], position[1] - MIDDLE[1] - radius) - radius)


def test_it_begins_as_the_trajectory_and_ends_at_rest_half_its_time_later() -> None:
    path = Circle(0.3, 2.0, 60.0)
    found = Slowed(path, (SpeedStage(2.0, 1.0, 0.0),))
    for a, b in zip(found.at(0.0), path.at(0.0), strict=True):
        assert a == pytest.approx(b)
    assert found.at(2.0).position == pytest.approx(path.at(1.0).position)
    assert found.at(2.0).velocity == pytest.approx((0.0, 0.0))
    assert found.at(2.0).acceleration == pytest.approx((0.0, 0.0))
    # What it says is what it does.
    for i in range(1, 200):
        t, step = 0.01 * i, 1e-6
        a, b = found.at(t - step), found.at(t + step)
        assert found.at(t).velocity == pytest.approx(
            [(y - x) / (2 * step) for x, y in zip(a.position, b.position, strict=True)], abs=1e-6
        )
        assert found.at(t).acceleration == pytest.approx(
            [(y - x) / (2 * step) for x, y in zip(a.velocity, b.velocity, strict=True)], abs=1e-6
        )


class Hard(Trajectory):
    """It brakes as hard as it may, so that braking harder cannot keep the limits.

    Args:
        acceleration: Radians per second squared.
    """

    names, duration = ("J1",), 60.0

    def __init__(self, acceleration: float) -> None:
        self._a = acceleration

    def at(self, t: float) -> Sample:
        return Sample((2.0 * t - 0.5 * self._a * t * t,), (2.0 - self._a * t,), (-self._a,))


def test_what_brakes_as_hard_as_it_may_comes_to_rest_where_it_turns_back() -> None:
    found = ease_out(Hard(6.0), joint_limits(HEX7BOT, ("J1",)))
    assert found is not None
    assert 0.33 < found.duration < 1.0


def test_what_cannot_come_to_rest_soon_within_its_limits_does_so_in_a_bounded_time() -> None:
    limits = [JointLimits(2.6, 0.4, 60.0)]
    assert ease_out(Hard(0.4), limits) is None
    assert slow_down(Hard(0.4), limits).duration <= 5.0 * 5.1


@pytest.mark.parametrize("seed", range(20))
def test_a_cancel_is_over_soon_on_the_path_where_no_brake_is_allowed(seed: int) -> None:
    random_ = random.Random(seed)
    radius = random_.uniform(0.1, 0.3)
    most = min(1.8 / radius, math.sqrt(5.5 / radius), (50.0 / radius) ** (1 / 3))
    path, asked = Circle(radius, random_.uniform(0.2, 1.0) * most, 300.0), 0
    begun = False

    def allowed(plan: Trajectory, others: Mapping[str, float]) -> str:
        nonlocal asked
        asked += 1
        return "it would leave the circle" if begun else ""

    generator = SetPointGenerator(HEX7BOT, allowed=allowed)
    generator.cycle(state(), 0.0, LEAD)
    generator.follow(path, 0.0)
    now, ends = LEAD, random_.uniform(0.5, 20.0)
    while now < ends:
        generator.cycle(state(dict(zip(NAMES, generator.desired(NAMES, now).position, strict=True))), now, LEAD)
        now += LEAD
    begun, asked = True, 0
    generator.hold()
    assert generator.mode is Mode.HOLD
    assert asked <= 10
    (*_, (last, starts)) = generator.planned
    assert starts + last.duration <= now + LEAD + 0.9 + 5.0 * 0.45
    limits, step = joint_limits(HEX7BOT, NAMES), 1e-3
    before = None
    t = now
    while t <= starts + last.duration:
        found = generator.desired(NAMES, t)
        assert off(found.position, radius) < 1e-9
        for v, a, b, limit in zip(
            found.velocity, found.acceleration, before or found.acceleration, limits, strict=True
        ):
            assert abs(v) <= EXCESS * limit.speed
            assert abs(a) <= EXCESS * limit.acceleration
            assert abs(a - b) <= EXCESS * limit.jerk * step
        before, t = found.acceleration, t + step
    assert generator.desired(NAMES, starts + last.duration).velocity == pytest.approx((0.0, 0.0), abs=1e-9)
    # And it stays there.
    with pytest.raises(LimitError):
        generator.follow(path, now + 10.0)
