from __future__ import annotations

import math
from collections.abc import Mapping

import pytest
from tests.motion.arms import HOME

from hexwire.control.outcomes import Reason
from hexwire.control.path_check import PathCheck
from hexwire.errors import GoalError
from hexwire.model.hex7bot import HEX7BOT
from hexwire.model.hex7bot_kinematics import Hex7BotModel
from hexwire.motion.waypoints import Spline, Waypoint

WAYS = PathCheck(HEX7BOT, Hex7BotModel(), None)
BLIND = PathCheck(HEX7BOT, None, None)
FOLD = {"J2": HOME["J2"] + math.radians(60), "J3": HOME["J3"] + math.radians(40)}
"""Each may be there if the other is at home; together they fold the elbow."""


def way(to: Mapping[str, float], seconds: float = 3.0) -> Spline:
    names = tuple(to)
    return Spline(
        names, [Waypoint(0.0, tuple(HOME[n] for n in names)), Waypoint(seconds, tuple(to[n] for n in names))]
    )


def test_a_way_is_checked_with_where_the_others_are_and_go() -> None:
    for joint, other in (("J2", "J3"), ("J3", "J2")):
        mine, theirs = way({joint: FOLD[joint]}), way({other: FOLD[other]})
        WAYS.trajectory(mine, HOME)
        for others, meanwhile in (({**HOME, other: FOLD[other]}, []), (HOME, [theirs])):
            with pytest.raises(GoalError, match=r"elbow folded.*nothing was sent") as caught:
                WAYS.trajectory(mine, others, meanwhile)
            assert caught.value.reason == Reason.PATH_NOT_ALLOWED
    BLIND.trajectory(way(FOLD), HOME)


def test_a_way_without_end() -> None:
    with pytest.raises(GoalError, match="lasts 4000 s; send at most 3600 s at a time"):
        BLIND.trajectory(way({"J1": HOME["J1"] + 0.1}, 4000.0), HOME)


@pytest.mark.parametrize(
    ("late", "reason", "why"),
    [(False, Reason.PATH_NOT_ALLOWED, "not any more"), (True, Reason.TOO_LATE, "too late")],
)
def test_the_way_to_the_first_point_may_be_too_fast_by_now(late: bool, reason: Reason, why: str) -> None:
    turn = HEX7BOT.joint("J1").max_speed
    WAYS.bridge(way({"J1": HOME["J1"] + 0.5 * turn}, 0.48), HOME, late=late)
    with pytest.raises(GoalError, match=rf"^{why}: on the way to the next point, at .* its limit is") as caught:
        WAYS.bridge(way({"J1": HOME["J1"] + 0.5 * turn}, 0.4), HOME, late=late)
    assert caught.value.reason == reason


def test_a_takeover_that_swings_through_a_gate() -> None:
    here = {**HOME, "J3": FOLD["J3"]}
    good = [(0.1 * i, {"J2": HOME["J2"] + math.radians(5 * i)}) for i in range(4)]
    bad = [*good, (0.4, {"J2": FOLD["J2"]}), (0.5, {"J2": HOME["J2"]})]
    WAYS.takeover(good, here)
    WAYS.takeover([], here)
    with pytest.raises(GoalError, match=r"^0\.40 s after it takes over .*, elbow .*; let that end") as caught:
        WAYS.takeover(bad, here)
    assert caught.value.reason == Reason.PATH_NOT_ALLOWED
    BLIND.takeover(bad, here)
    # Nobody knows where the other joints are: what moves has begun when they were known.
    WAYS.takeover(bad, {**here, "J1": math.nan})
