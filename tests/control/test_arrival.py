from __future__ import annotations

import math

import pytest

from hexwire.control.motion.arrival import Arrival, Deviation, Tolerance, Verdict, deviations, in_words, off_goal
from hexwire.motion.trajectory import Sample

JOINTS = ("J1", "J2")
REST = (0.0, 0.0)
GOAL = Sample((1.0, 2.0), REST, REST)
NEAR = {name: Tolerance(0.1, 0.05) for name in JOINTS}
THERE, SHORT = (1.05, 2.0), (1.0, 1.5)


def arrival(grace: float = 0.5, **options: bool) -> Arrival:
    return Arrival(NEAR, 10.0, grace, **options)


def judge(judged: Arrival, now: float, position: tuple[float, ...], sampled: float = math.inf) -> Verdict:
    return judged.judge(now, JOINTS, GOAL, position, REST, sampled)


def test_nothing_is_judged_before_the_end_unless_asked_for() -> None:
    assert judge(arrival(), 9.9, THERE) is Verdict.NOT_YET
    assert judge(arrival(early=True), 9.9, THERE) is Verdict.ARRIVED
    assert judge(arrival(early=True), 9.9, SHORT) is Verdict.NOT_YET
    assert judge(arrival(), 10.0, THERE) is Verdict.ARRIVED


def test_the_grace_time_counts_from_the_first_look_after_the_end() -> None:
    judged = arrival()
    # Nobody has looked for three seconds, which is not the arm's fault.
    assert judge(judged, 13.0, SHORT) is Verdict.NOT_YET
    assert judge(judged, 13.5, SHORT) is Verdict.NOT_YET
    assert judge(judged, 13.6, SHORT) is Verdict.MISSED
    assert judged.why == "J2 is 0.5 rad (28.6 deg) off its goal, tolerance 0.1 rad (5.73 deg)"
    assert judged.off == (Deviation("J2", 0.5, 0.1),)


def test_within_the_grace_time_it_may_still_arrive() -> None:
    judged = arrival()
    assert judge(judged, 10.0, SHORT) is Verdict.NOT_YET
    assert judge(judged, 10.4, THERE) is Verdict.ARRIVED
    assert judged.why == ""


def test_without_a_grace_time_it_waits_forever() -> None:
    judged = arrival(0.0)
    assert [judge(judged, now, SHORT) for now in (10.0, 1e6)] == [Verdict.NOT_YET] * 2


def test_an_arm_that_moves_has_not_arrived() -> None:
    judged = arrival()
    assert judged.judge(10.0, JOINTS, GOAL, THERE, (0.06, 0.0)) is Verdict.NOT_YET
    assert judged.why.startswith("the velocity of J1 is 0.06 rad/s")
    assert judged.judge(10.1, JOINTS, GOAL, THERE, (math.nan, math.nan)) is Verdict.ARRIVED, "not judged if unknown"


def test_positions_from_before_the_end_say_nothing() -> None:
    judged = arrival()
    assert judge(judged, 10.1, THERE, sampled=9.9) is Verdict.NOT_YET
    assert judged.why == "some joints have not reported since the end"
    assert judge(judged, 10.7, THERE, sampled=9.9) is Verdict.MISSED
    assert judge(arrival(), 10.1, THERE, sampled=10.05) is Verdict.ARRIVED


def test_the_end_may_be_moved() -> None:
    judged = arrival()
    judged.ends = 11.0
    assert judge(judged, 10.5, THERE) is Verdict.NOT_YET
    assert judge(judged, 11.0, THERE) is Verdict.ARRIVED


@pytest.mark.parametrize("early", [False, True])
def test_an_unknown_position_is_no_arrival(early: bool) -> None:
    judged = arrival(early=early)
    assert judge(judged, 10.0, (math.nan, 2.0)) is Verdict.NOT_YET
    assert judged.off == (Deviation("J1", math.inf, 0.1),)
    assert judge(judged, 11.0, (math.nan, 2.0)) is Verdict.MISSED
    assert judged.why == "the position of J1 is unknown"


def test_a_tolerance_of_zero_is_not_checked() -> None:
    none = {name: Tolerance() for name in JOINTS}
    assert deviations(none, JOINTS, GOAL, (math.nan, 9.0), (9.0, 9.0)) == []
    assert in_words([], "goal") == ""


def test_tolerances_themselves_are_allowed() -> None:
    none = Sample((0.0,), (0.0,), (0.0,))
    row = {"J1": Tolerance(0.25, 0.5)}
    for position, speed, off in (
        (0.25, 0.5, []),
        (-0.25, -0.5, []),
        (0.26, 0.5, [Deviation("J1", 0.26, 0.25)]),
        (0.25, -0.51, [Deviation("J1", 0.51, 0.5, of_speed=True)]),
    ):
        assert deviations(row, ("J1",), none, (position,), (speed,)) == off
    moving = Sample((1.0,), (2.0,), (0.0,))
    assert deviations(row, ("J1",), moving, (1.1,), (2.2,)) == []
    # An unknown position is the worst; of two equally bad the first comes first.
    both = {"J1": Tolerance(0.1), "J2": Tolerance(0.1), "J3": Tolerance(0.1)}
    rest = Sample((0.0,) * 3, (0.0,) * 3, (0.0,) * 3)
    found = deviations(both, ("J1", "J2", "J3"), rest, (0.2, 0.2, math.nan), (9.0,) * 3)
    assert [row.joint for row in found] == ["J3", "J1", "J2"]
    assert in_words(found * 2, "path").endswith("; 1 more")
    assert "more" not in in_words(found[:1] * 5, "path")


def test_an_early_arrival_may_rest_on_a_sample_of_before() -> None:
    assert judge(arrival(early=True), 10.1, THERE, sampled=9.0) is Verdict.ARRIVED
    assert judge(arrival(), 10.1, THERE, sampled=10.0) is Verdict.ARRIVED


def test_the_grace_time_is_over_after_it_and_not_at_it() -> None:
    judged = arrival(0.5)
    assert [judge(judged, now, SHORT) for now in (10.0, 10.25, 10.5)] == [Verdict.NOT_YET] * 3
    assert judge(judged, 10.5625, SHORT) is Verdict.MISSED
    early = arrival(0.5, early=True)
    assert [judge(early, now, SHORT) for now in (8.0, 9.0, 10.0, 10.5)] == [Verdict.NOT_YET] * 4
    assert judge(early, 10.5625, SHORT) is Verdict.MISSED


def test_how_far_off_the_worst_joint_is() -> None:
    assert off_goal(JOINTS, (1.0, 2.0), (1.0 + math.radians(0.6), 2.0 - math.radians(1.24))) == "J2 1.2 deg off"
    assert off_goal(JOINTS, (1.0, 2.0), (1.0 + math.radians(0.09), 2.0)) == ""
    assert off_goal(JOINTS, (1.0, 2.0), (math.nan, 2.0)) == ""
    assert off_goal((), (), ()) == ""
