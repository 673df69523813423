"""How far an arm may be off its path and its goal, and what a goal may ask for of that."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from hexwire.control.loop.outcomes import Reason
from hexwire.control.motion.arrival import Tolerance, deviations, in_words
from hexwire.control.motion.goals import Component, ComponentTolerance, Tolerances
from hexwire.errors import GoalError
from hexwire.motion.trajectory import Sample

JOINTS = ("J1", "J2", "J3")
REST = (0.0, 0.0, 0.0)
START = Sample((0.1, 0.2, 0.3), (0.4, -0.5, 0.6), (0.7, 0.8, -0.9))
STILL = Sample((0.1, 0.2, 0.3), REST, REST)

WRONG = Reason.WRONG_JOINTS
DEFAULTS = Tolerances(
    path={name: Tolerance(0.1) for name in JOINTS},
    goal={name: Tolerance(0.05, 0.01) for name in JOINTS},
    goal_time=2.0,
)


def test_zero_keeps_a_negative_number_switches_off_and_others_set() -> None:
    path = [("J1", 0.0, 0.0, 0.0), ("J2", -1.0, 0.5, -3.0)]
    goal = [("J3", 0.2, -1.0, 0.3)]
    result = DEFAULTS.overridden(path, goal, 0.0)
    assert result.path == {"J1": Tolerance(0.1), "J2": Tolerance(0.0, 0.5), "J3": Tolerance(0.1)}
    assert result.goal["J3"] == Tolerance(0.2, 0.0, 0.3)
    assert result.goal["J1"] == Tolerance(0.05, 0.01)
    assert result.goal_time == 2.0
    assert DEFAULTS.path["J2"] == Tolerance(0.1)


@pytest.mark.parametrize(("asked", "goal_time"), [(0.0, 2.0), (-0.0, 2.0), (-1.0, 0.0), (-0.5, 0.0), (7.0, 7.0)])
def test_the_goal_time_follows_the_same_rule(asked: float, goal_time: float) -> None:
    assert DEFAULTS.overridden([], [], asked).goal_time == goal_time


def test_the_rotation_of_a_joint_is_its_angle() -> None:
    rows = [ComponentTolerance("J2", 5, -1.0, 0.5, -3.0)]
    result = DEFAULTS.overridden([("J1", 0.2, 0.0, 0.0)], [], 0.0, rows, [ComponentTolerance("J3", 5, 0.2)])
    assert result.path == {"J1": Tolerance(0.2), "J2": Tolerance(0.0, 0.5), "J3": Tolerance(0.1)}
    assert result.goal == {**DEFAULTS.goal, "J3": Tolerance(0.2, 0.01)}


@pytest.mark.parametrize("value", [0.0, -0.0, 0.2, -1.0, -1.0000001])
def test_zero_and_minus_one_are_always_allowed(value: float) -> None:
    row = ("J1", value, value, value)
    component = ComponentTolerance("J2", 5, value, value, value)
    for asked in ([row], [row], value, [component], [component]), ([], [], value):
        strict, usual = DEFAULTS.overridden(*asked, only_minus_one=True), DEFAULTS.overridden(*asked)
        assert strict == usual


@pytest.mark.parametrize(
    ("fields", "what"),
    [
        ({"goal_time": -0.5}, "goal_time_tolerance"),
        ({"path": [("J1", 0.1, -0.5, 0.0)]}, "path_tolerance for the velocity of J1"),
        ({"goal": [("J1", 0.1, 0.0, -0.5)]}, "goal_tolerance for the acceleration of J1"),
        ({"path_components": [ComponentTolerance("J2", 5, -0.5)]}, "path_tolerance for the position of J2"),
    ],
)
def test_another_negative_number_disables_a_check_only_where_that_is_the_rule(
    fields: dict[str, Any], what: str
) -> None:
    asked: dict[str, Any] = {"path": [], "goal": [], "goal_time": 0.0} | fields
    DEFAULTS.overridden(**asked)
    with pytest.raises(GoalError) as refused:
        DEFAULTS.overridden(**asked, only_minus_one=True)
    assert str(refused.value) == f"{what} is -0.5; 0 means the default, and only -1 disables the check"
    assert refused.value.reason == Reason.MALFORMED


@pytest.mark.parametrize(
    ("component", "words"),
    [
        (Component.X_AXIS, "X_AXIS"),
        (2, "Y_AXIS"),
        (3, "Z_AXIS"),
        (4, "TRANSLATION"),
        (0, "the unknown component 0"),
        (65535, "the unknown component 65535"),
    ],
)
def test_a_component_that_no_joint_has_is_refused_whatever_its_tolerance(component: int, words: str) -> None:
    rows = [ComponentTolerance("J2", component)]
    for field, sent in (("path", {"path_components": rows}), ("goal", {"goal_components": rows})):
        with pytest.raises(GoalError) as refused:
            DEFAULTS.overridden([], [], 0.0, **sent)
        text = f"component_{field}_tolerance of 'J2' is for {words}; joints of this arm have only ROTATION"
        assert (str(refused.value), refused.value.reason) == (text, Reason.MALFORMED)


@pytest.mark.parametrize(
    ("row", "reason", "text"),
    [
        (ComponentTolerance("J9", 5, 0.1), WRONG, "'J9'"),
        (ComponentTolerance("J1", 5, 0.1), WRONG, "given twice for J1"),
        (ComponentTolerance("J2", 5, math.nan), Reason.MALFORMED, "position of J2 is nan"),
    ],
)
def test_component_tolerances_follow_the_rules_of_the_others(
    row: ComponentTolerance, reason: Reason, text: str
) -> None:
    with pytest.raises(GoalError, match=text) as refused:
        DEFAULTS.overridden([("J1", 0.1, 0.0, 0.0)], [], 0.0, [row])
    assert refused.value.reason == reason


@pytest.mark.parametrize(
    ("path", "goal", "goal_time", "reason", "text"),
    [
        (
            [("J9", 0.1, 0.0, 0.0)],
            [],
            0.0,
            WRONG,
            "path_tolerance is for 'J9'; this controller has J1, J2, J3",
        ),
        (
            [],
            [("\n", 0.1, 0.0, 0.0)],
            0.0,
            WRONG,
            r"goal_tolerance is for '\n'; this controller has J1, J2, J3",
        ),
        (
            [("J1", 0.1, 0.0, 0.0)] * 2,
            [],
            0.0,
            WRONG,
            "path_tolerance is given twice for J1; give it once",
        ),
        (
            [("J1", math.nan, 0.0, 0.0)],
            [],
            0.0,
            Reason.MALFORMED,
            "path_tolerance for the position of J1 is nan, not a number; -1 disables the check",
        ),
        (
            [],
            [("J1", 0.0, 0.0, math.inf)],
            0.0,
            Reason.MALFORMED,
            "goal_tolerance for the acceleration of J1 is inf, not a number; -1 disables the check",
        ),
        ([], [], math.nan, Reason.MALFORMED, "goal_time_tolerance is nan, not a number"),
    ],
)
def test_wrong_tolerances_are_refused(
    path: list[tuple[str, float, float, float]],
    goal: list[tuple[str, float, float, float]],
    goal_time: float,
    reason: Reason,
    text: str,
) -> None:
    with pytest.raises(GoalError) as caught:
        DEFAULTS.overridden(path, goal, goal_time)
    assert (caught.value.reason, str(caught.value)) == (reason, text)


AT_ZERO = Sample(REST, REST, REST)


def at_goal(names: tuple[str, ...], desired: Sample, position: tuple[float, ...], speed: tuple[float, ...]) -> str:
    return in_words(deviations(DEFAULTS.goal, names, desired, position, speed), "goal")


def test_inside_the_tolerances_nothing_is_said() -> None:
    assert DEFAULTS.path_violation(JOINTS, AT_ZERO, (0.1, -0.1, 0.0), (9.0, 9.0, 9.0)) == ""
    assert at_goal(JOINTS, AT_ZERO, (0.05, -0.05, 0.0), (0.01, -0.01, 0.0)) == ""


def test_off_the_path_is_said_in_radians_and_degrees_worst_first() -> None:
    assert DEFAULTS.path_violation(JOINTS, AT_ZERO, (0.0, -0.12, 0.0), REST) == (
        "J2 is 0.12 rad (6.88 deg) off its path, tolerance 0.1 rad (5.73 deg)"
    )
    text = DEFAULTS.path_violation(JOINTS, AT_ZERO, (0.2, 0.3, -0.4), REST)
    assert [part[:2] for part in text.split("; ")] == ["J3", "J2", "J1"]


def test_worst_is_measured_by_what_is_allowed() -> None:
    tolerances = replace(DEFAULTS, path={"J1": Tolerance(1.0), "J2": Tolerance(0.01), "J3": Tolerance()})
    text = tolerances.path_violation(JOINTS, AT_ZERO, (2.0, 0.1, 99.0), REST)
    assert [part[:2] for part in text.split("; ")] == ["J2", "J1"]


def test_values_belong_to_the_names_that_come_with_them() -> None:
    text = DEFAULTS.path_violation(("J3", "J1"), Sample((1.0, 2.0), (0.0, 0.0), (0.0, 0.0)), (1.0, 2.5), (0.0, 0.0))
    assert text.startswith("J1 is 0.5 rad")


def test_at_the_goal_the_arm_must_stand() -> None:
    assert at_goal(JOINTS, AT_ZERO, REST, (0.0, 0.0, -0.02)) == (
        "the velocity of J3 is 0.02 rad/s (1.15 deg/s) off its goal, tolerance 0.01 rad/s (0.573 deg/s)"
    )
    assert at_goal(JOINTS, AT_ZERO, (0.06, 0.0, 0.0), REST).startswith("J1 is 0.06 rad (3.44 deg) off its goal")


def test_a_speed_may_be_worse_than_a_position() -> None:
    text = at_goal(JOINTS, AT_ZERO, (0.06, 0.0, 0.0), (0.0, 0.02, 0.05))
    assert [part[:18] for part in text.split("; ")] == [
        "the velocity of J3",
        "the velocity of J2",
        "J1 is 0.06 rad (3.",
    ]


def test_a_position_that_is_not_known_is_in_no_tolerance_a_velocity_is_not_judged() -> None:
    lost = (0.5, math.nan, 0.0)
    text = DEFAULTS.path_violation(JOINTS, AT_ZERO, lost, (math.nan,) * 3)
    assert text.startswith("the position of J2 is unknown; J1 is 0.5 rad")
    unchecked = DEFAULTS.overridden([("J1", -1.0, 0.0, 0.0), ("J2", -1.0, 0.0, 0.0)], [], 0.0)
    assert unchecked.path_violation(JOINTS, AT_ZERO, lost, (math.nan,) * 3) == ""
    assert at_goal(JOINTS, AT_ZERO, REST, (math.nan,) * 3) == ""


def test_a_long_list_is_cut() -> None:
    names = tuple(f"A{i}" for i in range(9))
    zeros = (0.0,) * 9
    tolerances = Tolerances({name: Tolerance(0.1) for name in names}, {}, 0.0)
    text = tolerances.path_violation(names, Sample(zeros, zeros, zeros), (1.0,) * 9, zeros)
    assert text.startswith("A0 is ")
    assert text.endswith("; 4 more")
