from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.motion.arms import HOME, state

import hexwire
from hexwire.control.loop.outcomes import Reason
from hexwire.control.motion import path_check
from hexwire.control.motion.path_check import PathCheck
from hexwire.drivers.arm_file import load_profile
from hexwire.errors import GoalError, LimitError, UsageError
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.model.arms.hex7bot.kinematics import Hex7BotModel
from hexwire.model.geometry import kinematics_for, kinematics_or_none
from hexwire.model.state import JointFlag
from hexwire.motion.safety import StopReason
from hexwire.motion.trajectory import Spline, Waypoint

CHECK = PathCheck(HEX7BOT, Hex7BotModel(), None)
BLIND = PathCheck(HEX7BOT, None, None)
FOLD = {"J2": HOME["J2"] + math.radians(60), "J3": HOME["J3"] + math.radians(40)}
"""Each may be there if the other is at home; together they fold the elbow."""


def way(to: Mapping[str, float], seconds: float = 3.0) -> Spline:
    names = tuple(to)
    return Spline(
        names, [Waypoint(0.0, tuple(HOME[n] for n in names)), Waypoint(seconds, tuple(to[n] for n in names))]
    )


def test_a_path_is_checked_with_the_positions_and_motions_of_other_joints() -> None:
    for joint, other in (("J2", "J3"), ("J3", "J2")):
        mine, theirs = way({joint: FOLD[joint]}), way({other: FOLD[other]})
        CHECK.trajectory(mine, HOME)
        for others, meanwhile in (({**HOME, other: FOLD[other]}, []), (HOME, [theirs])):
            with pytest.raises(GoalError, match=r"elbow folded.*nothing was sent") as caught:
                CHECK.trajectory(mine, others, meanwhile)
            assert caught.value.reason == Reason.PATH_NOT_ALLOWED
    BLIND.trajectory(way(FOLD), HOME)


def test_a_trajectory_that_is_too_long_is_refused() -> None:
    with pytest.raises(GoalError, match="lasts 4000 s; send at most 3600 s at a time"):
        BLIND.trajectory(way({"J1": HOME["J1"] + 0.1}, 4000.0), HOME)


@pytest.mark.parametrize(
    ("late", "reason", "why"),
    [(False, Reason.PATH_NOT_ALLOWED, "the path is no longer allowed"), (True, Reason.TOO_LATE, "too late")],
)
def test_the_path_to_the_first_point_may_have_become_too_fast(late: bool, reason: Reason, why: str) -> None:
    turn = HEX7BOT.joint("J1").max_speed
    CHECK.bridge(way({"J1": HOME["J1"] + 0.5 * turn}, 0.48), HOME, late=late)
    with pytest.raises(GoalError, match=rf"^{why}: before the next point, at .* its limit is") as caught:
        CHECK.bridge(way({"J1": HOME["J1"] + 0.5 * turn}, 0.4), HOME, late=late)
    assert caught.value.reason == reason


def test_a_bridge_is_checked_with_what_others_do_meanwhile_and_not_later() -> None:
    mine = way({"J2": FOLD["J2"]}, 3.0)
    home, fold = (HOME["J3"],), (FOLD["J3"],)
    now = Spline(("J3",), [Waypoint(0.0, home), Waypoint(3.0, fold), Waypoint(6.0, home)])
    later = Spline(("J3",), [Waypoint(0.0, home), Waypoint(3.0, home), Waypoint(6.0, fold)])
    CHECK.bridge(mine, HOME, [later], late=False)
    with pytest.raises(GoalError, match="elbow folded"):
        CHECK.bridge(mine, HOME, [now], late=False)


def test_motion_that_no_check_has_seen_is_checked_as_all_that_has_begun() -> None:
    here = {**HOME, "J3": FOLD["J3"]}

    def to(angle: float) -> Spline:
        return Spline(("J2",), [Waypoint(0.0, (HOME["J2"],)), Waypoint(0.5, (angle,))])

    good, bad = to(HOME["J2"] + math.radians(15)), to(FOLD["J2"])
    assert CHECK.unchecked(good, here) == ""
    assert re.match(r"^0\.\d\d s after it begins, elbow", CHECK.unchecked(bad, here))
    assert BLIND.unchecked(bad, here) == ""
    # Nobody knows where the other joints are: what moves has begun when they were known.
    assert CHECK.unchecked(bad, {**here, "J1": math.nan}) == ""
    # Another controller has unfolded the elbow by then.
    opens = Spline(("J3",), [Waypoint(0.0, (FOLD["J3"],)), Waypoint(0.2, (HOME["J3"],))])
    assert CHECK.unchecked(bad, here, [opens]) == ""


def test_joints_answer_and_have_torque() -> None:
    without_torque, silent = {"J2": JointFlag(0)}, {"J3": JointFlag.SILENT | JointFlag.TORQUE_ON}
    CHECK.ready(("J1", "J3"), state(flags=without_torque), 0.5)
    with pytest.raises(GoalError, match=r"^no torque on J2; enable it first$") as caught:
        CHECK.ready(("J1", "J2"), state(flags=without_torque), 0.5)
    assert caught.value.reason == Reason.NOT_READY
    CHECK.ready(("J3",), state(flags=silent, age={"J3": 0.5}), 0.5)
    CHECK.ready(("J1",), state(flags=silent, age={"J3": 9.0}), 0.5)
    CHECK.ready(("J1",), state(age={"J1": 9.0}), 0.5)
    with pytest.raises(GoalError, match=r"^no answer from J3 .* 0\.5 s") as caught:
        CHECK.ready(("J1", "J3"), state(flags=silent, age={"J3": 0.51}), 0.5)
    assert caught.value.reason == Reason.NOT_READY


def test_a_latched_stop_forbids_everything() -> None:
    CHECK.stop_latch(None)
    with pytest.raises(GoalError, match=r"stopped \(enough\); reset first") as caught:
        CHECK.stop_latch(StopReason("asked", "enough"))
    assert caught.value.reason == Reason.STOPPED


def test_targets_and_postures_are_checked_at_limits_and_coupling() -> None:
    beyond = {"J1": HEX7BOT.joint("J1").maximum + 0.01}
    folded = {**HOME, "J3": FOLD["J3"]}
    for check in (CHECK.target, CHECK.posture, BLIND.target, BLIND.posture):
        check(HOME, {"J1": HOME["J1"] + 0.1})
        with pytest.raises(LimitError, match="J1="):
            check(HOME, beyond)
        with pytest.raises(UsageError, match="J9"):
            check(HOME, {"J9": 0.0})
    for check in (CHECK.target, CHECK.posture):
        with pytest.raises(LimitError, match=r"elbow folded.*nothing was sent$"):
            check(folded, {"J2": FOLD["J2"]})
        check(HOME, {"J2": FOLD["J2"]})
    for check in (BLIND.target, BLIND.posture):
        check(folded, {"J2": FOLD["J2"]})
    # A joint outside the kinematics needs no other joint's position.
    unknown = {**HOME, "J2": math.nan}
    CHECK.posture(unknown, {"J7": 0.1})
    CHECK.target(unknown, {"J7": 0.1})
    with pytest.raises(UsageError, match="the position of J2 is unknown"):
        CHECK.posture(unknown, {"J1": 0.1})


def test_an_arm_without_a_coupling_limit_is_checked_at_its_table_only() -> None:
    arm = load_profile("so101").model
    here = dict.fromkeys(arm.names, 0.0) | {"shoulder_lift": math.radians(-45)}
    low = here | {"shoulder_lift": math.radians(60)}
    model = kinematics_or_none("so101")
    assert model is not None
    assert not model.has_coupling
    assert Hex7BotModel().has_coupling
    PathCheck(arm, model, None).posture(here, low)
    with pytest.raises(LimitError, match="below the table"):
        PathCheck(arm, model, 0.0).posture(here, low)
    with pytest.raises(LimitError, match="outside its limits"):
        PathCheck(arm, model, None).posture(here, here | {"elbow_flex": 3.0})


def test_the_table_counts_where_there_is_one() -> None:
    high = PathCheck(HEX7BOT, Hex7BotModel(), 0.5)
    reach = way({"J2": HOME["J2"] + 0.1, "J3": HOME["J3"]})
    assert CHECK.trajectory(reach, HOME).lowest > 0.0
    start = Hex7BotModel().to_joints([math.radians(d) for d in (90, 60, 155, 90, 90, 90)])
    low = PathCheck(HEX7BOT, Hex7BotModel(), 0.05)
    for check in (low.target, low.posture):
        with pytest.raises(LimitError, match="below the table at 50 mm"):
            check(HOME, start)
    with pytest.raises(GoalError, match="below the table"):
        low.trajectory(way(start), HOME)
    with pytest.raises(GoalError, match="below the table"):
        low.bridge(way(start), HOME, late=False)
    assert high.trajectory(way({"J7": 0.1}), HOME).findings == ()


def test_a_bridge_may_be_a_tenth_faster_and_its_first_segment_alone_is_looked_at() -> None:
    turn = HEX7BOT.joint("J1").max_speed
    for share, good in ((1.099, True), (1.102, False)):
        bridge = way({"J1": HOME["J1"] + 0.4}, 0.4 / (turn * share))
        if good:
            BLIND.bridge(bridge, HOME, late=False)
        else:
            with pytest.raises(GoalError, match="its limit is"):
                BLIND.bridge(bridge, HOME, late=False)
    points = [Waypoint(0.0, (HOME["J1"],)), Waypoint(1.0, (HOME["J1"] + 0.1,)), Waypoint(1.01, (9.0,))]
    BLIND.bridge(Spline(("J1",), points), HOME, late=False)


@pytest.mark.parametrize(("seconds", "step"), [(0.1, 0.01), (2.0, 0.1), (3600.0, 180.0)])
def test_a_bridge_is_looked_at_in_few_places_however_long_it_is(
    seconds: float, step: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The thread that owns the robot does it between two states."""
    steps: list[float] = []
    real = path_check.check_trajectory

    def noted(*args: Any, **options: Any) -> Any:
        steps.append(options["step"])
        return real(*args, **options)

    monkeypatch.setattr(path_check, "check_trajectory", noted)
    CHECK.bridge(way({"J1": HOME["J1"] + 0.01}, seconds), HOME, late=False)
    assert steps == [pytest.approx(step)]


def test_a_trajectory_may_last_an_hour() -> None:
    BLIND.trajectory(Spline(("J1",), [Waypoint(0.0, (0.0,))]), HOME)
    with pytest.raises(GoalError, match="at most 3600 s") as caught:
        BLIND.trajectory(way({"J1": HOME["J1"]}, 3600.1), HOME)
    assert caught.value.reason == Reason.MALFORMED


def test_the_combined_target_of_all_controllers_is_checked_during_the_motion() -> None:
    check, half = PathCheck(HEX7BOT, Hex7BotModel(), None), {"J2": 0.5 * (HOME["J2"] + FOLD["J2"])}
    assert check.running(HOME, {"J3": FOLD["J3"]}) == ""
    assert check.running(HOME, half) == ""
    # The other joint counts as where it was sent, not where it sags.
    assert "elbow folded" in check.running(HOME, {"J2": FOLD["J2"]})
    check.forget()
    assert check.running(HOME, {"J2": FOLD["J2"]}) == "", "by hand it may have gone anywhere"
    assert BLIND.running(HOME, FOLD) == ""
    BLIND.forget()


def test_the_list_of_checks_is_the_only_one() -> None:
    source = Path(hexwire.__file__).parent
    files = [file for room in ("control", "setup") for file in (source / room).rglob("*.py")]
    assert [file.name for file in files if "motion.fence" in file.read_text(encoding="utf-8")] == ["path_check.py"]


@given(st.lists(st.tuples(*[st.floats(-1.6, 1.6)] * 3), min_size=1, max_size=12), st.booleans())
def test_a_stream_of_set_points_is_checked_as_each_of_them_is(rows: list[tuple[float, ...]], hex7: bool) -> None:
    """Whether it goes on from where it was allowed to or from elsewhere, above the table and below it."""
    arm = HEX7BOT if hex7 else load_profile("so101").model
    check = PathCheck(arm, kinematics_for(arm), 0.0)
    names = [each.name for each in arm.joints][1:4]
    here = {each.name: each.inside(each.offset) for each in arm.joints}
    guided = check.guided()

    def stream(here: Mapping[str, float], goal: Mapping[str, float]) -> None:
        check.limits(goal)
        guided(here, goal)

    def refusal(of: Callable[[Mapping[str, float], Mapping[str, float]], object]) -> str:
        try:
            of(here, goal)
        except LimitError as error:
            return str(error)
        return ""

    for row in rows:
        goal = here | {name: here[name] + angle for name, angle in zip(names, row, strict=True)}
        found = refusal(stream)
        assert found == refusal(check.posture)
        if not found or row[0] > 1.0:
            here = goal


def test_a_stream_in_small_steps_stops_at_the_table_where_each_of_them_would() -> None:
    """Near the last end that was looked at, the stream does not look again."""
    arm = load_profile("so101").model
    looking, counting = kinematics_for(arm), kinematics_for(arm)
    assert looking is not None
    assert counting is not None
    looks, lowest = list[float](), counting.lowest

    def counted(angles: Sequence[float]) -> tuple[str, float]:
        name, height = lowest(angles)
        looks.append(height)
        return name, height

    counting.lowest = counted  # type: ignore[method-assign]  # tells how often it looks
    posture, stream = PathCheck(arm, looking, 0.0).posture, PathCheck(arm, counting, 0.0).guided()
    here, refused = dict.fromkeys(arm.names, 0.0), ""
    for _ in range(1000):
        goal = here | {"shoulder_lift": here["shoulder_lift"] + 0.002}
        try:
            posture(here, goal)
        except LimitError as error:
            refused = str(error)
            break
        stream(here, goal)
        here = goal
    assert "below the table" in refused
    with pytest.raises(LimitError, match=re.escape(refused)):
        stream(here, goal)
    assert len(looks) < 200
