"""Joints come to rest on any trajectory at its limits, from any place of it, within these limits."""

from __future__ import annotations

import random

import pytest
from tests.few import few
from tests.motion.fastest import fastest, keeps

from hexwire.model.arm import ArmModel
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.model.arms.puma260.kinematics import PUMA260
from hexwire.motion.eased import LONGEST, ease_out
from hexwire.motion.moving import joint_limits
from hexwire.motion.speed_profile import JointLimits
from hexwire.motion.trajectory import Spline, Tail, Waypoint


@few("arm, seed", [(arm, seed) for arm in (HEX7BOT, PUMA260) for seed in range(30)], (HEX7BOT, 0), (PUMA260, 1))
def test_from_every_place_of_a_path_at_its_limits_the_joints_come_to_rest_on_it_within_them(
    arm: ArmModel, seed: int
) -> None:
    draw = random.Random(seed)
    for _ in range(8):
        path = fastest(draw, arm)
        limits = joint_limits(arm, path.names)
        begin = draw.uniform(0.0, path.duration)
        found = ease_out(Tail(path, begin), limits)
        assert found is not None
        assert found.duration <= min(LONGEST, path.duration - begin) + 1e-9
        here = path.sample(begin)
        assert found.at(0.0).position == pytest.approx(here.position)
        assert found.at(0.0).velocity == pytest.approx(here.velocity)
        assert keeps(found, limits, here)
        assert found.at(found.duration).velocity == pytest.approx([0.0] * len(limits), abs=1e-6)


def test_even_motion_comes_to_rest_soon() -> None:
    limits = [JointLimits(2.0, 6.0, 60.0)]
    path = Spline(("J1",), [Waypoint(0.0, (0.0,), (1.0,)), Waypoint(9.0, (9.0,), (1.0,))])
    found = ease_out(path, limits)
    assert found is not None
    assert found.duration <= 0.46
    assert 0.1 < found.goal[0] < 0.3


def test_a_path_that_does_not_lead_to_rest_is_not_followed_to_its_end() -> None:
    limits = [JointLimits(2.0, 6.0, 60.0)]
    path = Spline(("J1",), [Waypoint(0.0, (0.0,), (1.0,)), Waypoint(0.05, (0.05,), (1.0,))])
    assert ease_out(path, limits) is None


def test_where_the_joints_stand_it_is_over_at_once() -> None:
    limits = [JointLimits(2.0, 6.0, 60.0)]
    path = Spline(("J1",), [Waypoint(0.0, (0.3,), (0.0,)), Waypoint(9.0, (0.3,), (0.0,))])
    found = ease_out(path, limits)
    assert found is not None
    assert found.duration <= 0.1
