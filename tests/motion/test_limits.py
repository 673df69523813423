"""What is refused, and what is slowed, before anything is sent."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexwire.errors import LimitError, UsageError
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.model.state import JointTarget
from hexwire.motion.limits import check_target, needed_duration, rest_duration, resting_inside, smooth_duration

ZERO = dict.fromkeys(HEX7BOT.names, 0.0)


def test_a_target_inside_its_limits_goes_as_it_is() -> None:
    target = JointTarget.of({"J1": 0.1, "J6": -0.2}, 1.0)
    assert check_target(HEX7BOT, target, ZERO) == target


def test_names_come_back_as_the_arm_spells_them() -> None:
    assert check_target(HEX7BOT, JointTarget.of({"j1": 0.1}), ZERO).positions == (("J1", 0.1),)


def test_one_bad_joint_refuses_all() -> None:
    with pytest.raises(LimitError, match="J4="):
        check_target(HEX7BOT, JointTarget.of({"J1": 0.0, "J4": 3.0}), ZERO)
    with pytest.raises(UsageError, match="no joint 'J8'"):
        check_target(HEX7BOT, JointTarget.of({"J8": 0.0}), ZERO)
    with pytest.raises(UsageError, match="names J1 twice"):
        check_target(HEX7BOT, JointTarget.of({"J1": 0.0, "j1": 0.1}), ZERO)


def test_a_motion_that_would_be_too_fast_is_given_more_time() -> None:
    target = check_target(HEX7BOT, JointTarget.of({"J1": 1.3, "J5": 0.1}, 0.1), ZERO)
    assert target.duration == pytest.approx(1.3 / HEX7BOT.joint("J1").max_speed)
    slow = JointTarget.of({"J1": 1.3}, 5.0)
    assert check_target(HEX7BOT, slow, ZERO).duration == 5.0


def test_the_slowest_joint_counts_and_unknown_starts_do_not() -> None:
    goal = {"J1": 1.0, "J2": 2.0, "J5": 1.0}
    assert needed_duration(HEX7BOT, {"J1": 0.0, "J5": 0.0}, goal) == pytest.approx(1.0 / 2.6)
    assert needed_duration(HEX7BOT, {}, goal) == 0.0
    assert needed_duration(HEX7BOT, ZERO, {}) == 0.0
    # A silent servo's position is not a number; the limits of the others still hold.
    for silent in ("J1", "J2", "J5"):
        start = ZERO | {silent: math.nan}
        rest = max(abs(goal[n]) / HEX7BOT.joint(n).max_speed for n in goal if n != silent)
        assert needed_duration(HEX7BOT, start, goal) == pytest.approx(rest)
        assert check_target(HEX7BOT, JointTarget.of({"J1": 1.0}, 0.0), start).duration < math.inf


ANGLES = st.floats(-4, 4)
STARTS = st.dictionaries(st.sampled_from(HEX7BOT.names), ANGLES | st.just(math.nan))
GOALS = st.dictionaries(st.sampled_from(HEX7BOT.names), ANGLES, min_size=1)


@given(GOALS, st.floats(0, 10), STARTS)
def test_whatever_passes_is_inside_and_slow_enough(
    goal: dict[str, float], duration: float, start: dict[str, float]
) -> None:
    try:
        target = check_target(HEX7BOT, JointTarget.of(goal, duration), start)
    except LimitError:
        assert any(not _inside(name, angle) for name, angle in goal.items())
        return
    assert dict(target.positions) == goal
    assert target.duration >= duration
    for name, angle in goal.items():
        assert _inside(name, angle)
        moved = abs(angle - start.get(name, math.nan))
        assert not moved > target.duration * HEX7BOT.joint(name).max_speed * (1 + 1e-9)


def _inside(name: str, angle: float) -> bool:
    joint = HEX7BOT.joint(name)
    return joint.minimum - joint.scale / 2 <= angle <= joint.maximum + joint.scale / 2


def test_a_joint_that_rests_on_its_stop_begins_at_its_limit() -> None:
    joint = HEX7BOT.joint("J1")
    little, much = math.radians(1.0), math.radians(2.0)
    for limit, side in ((joint.minimum, -1.0), (joint.maximum, 1.0)):
        assert resting_inside(HEX7BOT, {"J1": limit + side * little}) == {"J1": limit}
        far = {"J1": limit + side * much}
        assert resting_inside(HEX7BOT, far) == far
    assert resting_inside(HEX7BOT, {"J2": joint.minimum + 0.1}) == {"J2": joint.minimum + 0.1}
    assert math.isnan(resting_inside(HEX7BOT, {"J1": math.nan})["J1"])


@given(GOALS, STARTS)
def test_a_smooth_motion_keeps_every_limit(goal: dict[str, float], start: dict[str, float]) -> None:
    seconds = smooth_duration(HEX7BOT, start, goal)
    tightest = 0.0
    for name, angle in goal.items():
        joint, way = HEX7BOT.joint(name), abs(angle - start.get(name, math.nan))
        if math.isfinite(way) and seconds:
            peaks = (
                15 / 8 * way / seconds / joint.max_speed,
                10 / math.sqrt(3) * way / seconds**2 / joint.max_acceleration,
                60 * way / seconds**3 / joint.max_jerk,
            )
            assert max(peaks) <= 1.0 + 1e-9
            tightest = max(tightest, *peaks)
    assert seconds == 0.0 or tightest == pytest.approx(1.0)


def test_a_board_takes_as_long_to_rest_as_the_fastest_joint_of_the_path_needs() -> None:
    assert rest_duration(HEX7BOT, ("J1", "J4")) == pytest.approx(1.5 * 2.6 / 6.0)
    assert rest_duration(HEX7BOT, ("J1", "J5")) == pytest.approx(1.5 * 3.5 / 6.0)
    joint = HEX7BOT.joint("J1")
    for changed, seconds in (({"max_jerk": 1.0}, math.sqrt(6.0 * 2.6)), ({"max_acceleration": 0.1}, 2.0)):
        arm = replace(HEX7BOT, joints=(replace(joint, **changed),))
        assert rest_duration(arm, ("J1",)) == pytest.approx(min(2.0, seconds))
