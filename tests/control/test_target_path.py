"""A single target as a path; the robot is in tests/control/test_timed_target.py."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise
from typing import Any

import pytest
from tests.drivers.arms import Arm
from tests.motion.arms import HOME, state

from hexwire.control.motion.motions import apart, path_to, sent_as
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.model.state import JointState, JointTarget
from hexwire.motion.limits import smooth_duration
from hexwire.motion.path_points import path_points

ROBOT: Any = Arm().driver


def target(seconds: float = 1.0, **by: float) -> JointTarget:
    return JointTarget.of({name: HOME[name] + angle for name, angle in by.items()}, seconds)


def turning(name: str, speed: float) -> JointState:
    here = state()
    return replace(here, velocity=tuple(speed if joint == name else 0.0 for joint in here.names))


def test_it_leads_from_where_the_joints_are_from_rest_to_rest() -> None:
    path = path_to(ROBOT, target(2.0, J4=0.5, J5=-0.2), state())
    assert path is not None
    assert (path.names, path.duration) == (("J4", "J5"), 2.0)
    assert path.start == pytest.approx((HOME["J4"], HOME["J5"]))
    assert path.goal == pytest.approx((HOME["J4"] + 0.5, HOME["J5"] - 0.2))
    for t in (0.0, 2.0):
        assert path.sample(t).velocity == pytest.approx((0.0, 0.0))
        assert path.at(t).acceleration == pytest.approx((0.0, 0.0))


def test_it_takes_as_long_as_the_limits_need() -> None:
    path = path_to(ROBOT, target(0.1, J4=1.0), state())
    assert path is not None
    assert path.duration == pytest.approx(smooth_duration(HEX7BOT, HOME, {"J4": HOME["J4"] + 1.0}))


def test_a_joint_on_its_stop_begins_at_its_limit() -> None:
    low = HEX7BOT.joint("J4").minimum
    path = path_to(ROBOT, target(J4=0.1), state({"J4": low - math.radians(1.0)}))
    assert path is not None
    assert path.start == pytest.approx((low,))


@pytest.mark.parametrize(
    "here", [state({"J4": math.nan}), turning("J4", 0.5), turning("J4", -0.5)], ids=["unknown", "turning", "back"]
)
def test_from_anywhere_but_rest_it_is_no_path(here: JointState) -> None:
    assert path_to(ROBOT, target(J4=0.5), here) is None
    assert path_to(ROBOT, target(J5=0.5), here) is not None


def test_flicker_and_an_unknown_speed_count_as_rest() -> None:
    assert path_to(ROBOT, target(J4=0.5), turning("J4", math.radians(18.0))) is not None
    assert path_to(ROBOT, target(J4=0.5), turning("J4", math.nan)) is not None


def test_what_is_over_at_once_is_no_path() -> None:
    assert path_to(ROBOT, target(0.0, J4=0.0), state()) is None


@pytest.mark.parametrize("seconds", [0.06, 1.0, 70.0, 100.0, 370.0])
def test_its_points_fit_on_a_board_and_cubics_between_them_stay_on_it(seconds: float) -> None:
    path = path_to(ROBOT, target(seconds, J4=1.2 if seconds > 1.0 else 0.0001), state())
    assert path is not None
    step = apart(path)
    points = list(path_points(path, [1e-4], longest=step, shortest=step))
    assert 12 <= len(points) <= 64
    for (t, a), (u, b) in pairwise(points):
        h = u - t
        assert 0.0 < h < 6.5
        cubic = (a.position[0] + b.position[0]) / 2 + h * (a.velocity[0] - b.velocity[0]) / 8
        assert cubic == pytest.approx(path.sample((t + u) / 2).position[0], abs=1e-4)


def test_what_was_sent_is_in_whole_counts() -> None:
    path = path_to(ROBOT, target(J4=0.5004), state())
    assert path is not None
    sent = sent_as(ROBOT, path)
    joint, angle = HEX7BOT.joint("J4"), dict(sent.positions)["J4"]
    assert angle == joint.counts_to_angle(joint.angle_to_counts(HOME["J4"] + 0.5004))
    assert (sent.duration, sent.clamped, sent.silent) == (1.0, (), ())
