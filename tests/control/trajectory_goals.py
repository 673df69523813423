"""Trajectory goals of three joints, and what checking and planning make of them."""

from __future__ import annotations

import math

import pytest

from hexwire.control.loop.outcomes import Reason
from hexwire.control.loop.plan import Plan
from hexwire.control.motion.goals import Point, TrajectoryGoal, check_goal
from hexwire.errors import GoalError
from hexwire.motion.trajectory import Sample, Spline

JOINTS = ("J1", "J2", "J3")
REST = (0.0, 0.0, 0.0)
START = Sample((0.1, 0.2, 0.3), (0.4, -0.5, 0.6), (0.7, 0.8, -0.9))
STILL = Sample((0.1, 0.2, 0.3), REST, REST)
HOSTILE = [math.nan, math.inf, -math.inf]


def order(*points: Point, names: tuple[str, ...] = JOINTS, delay: float = 0.0) -> TrajectoryGoal:
    return TrajectoryGoal(names, points, delay)


def refusal(sent: TrajectoryGoal, reason: Reason, *, partial: bool = False, start: Sample = START) -> str:
    """Text with which an order is refused, by the check or later."""
    with pytest.raises(GoalError) as caught:
        made(sent, partial=partial, start=start)
    assert caught.value.reason == reason
    text = str(caught.value)
    assert "\n" not in text
    return text


def made(sent: TrajectoryGoal, *, partial: bool = False, start: Sample = START) -> tuple[Spline, float]:
    check_goal(sent, JOINTS, allow_partial=partial)
    return Plan(sent, JOINTS, 0.0).trajectory(start, 0.0), max(0.0, sent.delay)
