from __future__ import annotations

import math

import pytest
from tests.motion.arms import HOME, state

from hexwire.errors import UsageError
from hexwire.model.state import JointFlag
from hexwire.motion.safety import SafetyGuard, SafetyLimits, StopReason

LIMITS = SafetyLimits()


def judged(
    guard: SafetyGuard, seconds: float, step: float = 0.05, start: float = 0.0, **options: object
) -> StopReason | None:
    """Judge the same state again and again; the first reason."""
    for i in range(round(seconds / step) + 1):
        found = guard.judge(state(**options), start + i * step)  # type: ignore[arg-type]
        if found is not None:
            return found
    return None


def commanded(**positions: float) -> SafetyGuard:
    guard = SafetyGuard(LIMITS)
    guard.commanded({**HOME, **positions}, 0.0)
    return guard


def test_all_well() -> None:
    assert judged(commanded(), 5.0) is None


def test_following_error_must_last() -> None:
    away = {"J2": HOME["J2"] + math.radians(13)}
    assert judged(commanded(), 0.35, positions=away) is None
    found = judged(commanded(), 1.0, positions=away)
    assert found is not None
    assert (found.kind, found.joint) == ("following", "J2")
    assert "13.0 deg off its path" in str(found)


def test_a_delay_is_not_a_following_error() -> None:
    guard = SafetyGuard(LIMITS)
    # 90 deg/s: a servo 0.2 s behind is 18 deg off the newest command, and well.
    speed, t = math.radians(90), 0.0
    while t < 2.0:
        guard.commanded({"J1": HOME["J1"] + speed * t}, t)
        late = {"J1": HOME["J1"] + speed * max(0.0, t - 0.2)}
        assert guard.judge(state(late), t) is None
        t += 0.05


def test_not_moving_on_command_is_a_following_error() -> None:
    guard = SafetyGuard(LIMITS)
    t = 0.0
    while t < 3.0:
        guard.commanded({"J1": HOME["J1"] + math.radians(30) * t}, t)
        found = guard.judge(state(), t)
        if found:
            break
        t += 0.05
    assert found is not None
    assert found.kind == "following"
    assert t < 1.3


def test_load_alone_is_overload_only_when_it_lasts() -> None:
    assert judged(commanded(), 0.5, load={"J2": 0.95}) is None
    found = judged(commanded(), 1.0, load={"J2": -0.95})
    assert found is not None
    assert (found.kind, found.joint) == ("overload", "J2")


def test_load_and_error_together_are_a_collision_at_once() -> None:
    off = {"J3": HOME["J3"] - math.radians(5)}
    found = judged(commanded(), 0.2, positions=off, load={"J3": 0.6})
    assert found is not None
    assert (found.kind, found.joint) == ("collision", "J3")
    assert "load 60%" in str(found)
    assert judged(commanded(), 2.0, positions=off) is None
    assert judged(commanded(), 2.0, load={"J3": 0.6}) is None


def test_an_ended_deviation_does_not_keep_counting() -> None:
    guard = commanded()
    for start in (0.0, 1.0, 2.0):
        assert judged(guard, 0.5, start=start, load={"J2": 0.95}) is None
        assert guard.judge(state(), start + 0.6) is None


def test_time_without_measurements_does_not_count_as_a_fault() -> None:
    guard = commanded()
    off, push = {"J5": HOME["J5"] + math.radians(6)}, {"J5": 0.8}
    assert guard.judge(state(off, load=push), 0.0) is None
    # The host stalled for a second; two looks are not a second of pressing.
    assert guard.judge(state(off, load=push), 1.0) is None
    assert judged(guard, 0.5, start=1.05, positions=off, load=push) is not None


@pytest.mark.parametrize(
    "flag", [JointFlag.OVERLOAD, JointFlag.TEMPERATURE, JointFlag.ENCODER, JointFlag.CURRENT, JointFlag.VOLTAGE]
)
def test_a_servos_own_fault_stops_at_once(flag: JointFlag) -> None:
    found = commanded().judge(state(flags={"J5": flag}), 0.0)
    assert found is not None
    assert (found.kind, found.joint) == ("fault", "J5")


def test_a_silent_joint_is_lost_after_a_while() -> None:
    guard = commanded()
    assert guard.judge(state(), 0.0) is None
    silent = {"J4": JointFlag.SILENT}
    assert judged(guard, 0.4, start=0.05, flags=silent) is None
    found = judged(guard, 1.0, start=0.45, flags=silent)
    assert found is not None
    assert (found.kind, found.joint) == ("lost", "J4")


def test_old_values_are_as_bad_as_silence() -> None:
    guard = commanded()
    found = judged(guard, 2.0, age={"J1": math.inf})
    assert found is not None
    assert found.kind == "lost"


def test_joints_that_nobody_commanded_do_not_stop_the_arm() -> None:
    guard = SafetyGuard(LIMITS)
    guard.commanded({"J1": HOME["J1"]}, 0.0)
    assert judged(guard, 3.0, load={"J2": 1.0}, flags={"J7": JointFlag.SILENT | JointFlag.OVERLOAD}) is None


def test_a_stop_of_the_board_is_taken_over() -> None:
    found = commanded().judge(state(stopped=True, watchdog_tripped=True), 0.0)
    assert found is not None
    assert found.kind == "board"
    assert "fell silent" in str(found)


def test_forget_starts_afresh() -> None:
    guard = commanded()
    assert judged(guard, 0.3, positions={"J2": 2.0}) is None
    guard.forget()
    assert judged(guard, 3.0, positions={"J2": 2.0}) is None


def test_thresholds_must_be_above_zero() -> None:
    with pytest.raises(UsageError, match="load_time = 0"):
        SafetyLimits(load_time=0.0)


def test_a_slow_line_makes_states_old_and_commands_late() -> None:
    assert SafetyLimits.at_period(0.05) == SafetyLimits()
    slow = SafetyLimits.at_period(1.0)
    assert (slow.lag, slow.max_age) == (2.5, 3.0)
    assert slow.following_error == LIMITS.following_error


def test_given_thresholds_are_not_widened() -> None:
    limits = SafetyLimits.at_period(1.0, max_age=0.7, load=0.6)
    assert (limits.lag, limits.max_age, limits.load) == (2.5, 0.7, 0.6)


@pytest.mark.parametrize("period", [0.0, -1.0, math.inf, math.nan])
def test_a_period_must_be_above_zero(period: float) -> None:
    with pytest.raises(UsageError, match=r"a period must be finite and above 0 s, not"):
        SafetyLimits.at_period(period)


def test_a_chosen_threshold_must_be_above_zero_too() -> None:
    with pytest.raises(UsageError, match="load = -1"):
        SafetyLimits.at_period(0.05, load=-1)


def test_a_joint_without_a_position_counts_as_silent() -> None:
    found = judged(commanded(), 5.0, positions={"J2": math.nan})
    assert found is not None
    assert (found.kind, found.joint) == ("lost", "J2")


@pytest.mark.parametrize(
    ("kind", "seconds", "options"),
    [
        ("following", 0.4, {"positions": {"J2": HOME["J2"] + math.radians(12.1)}}),
        ("overload", 0.6, {"load": {"J2": 0.91}}),
        ("collision", 0.15, {"positions": {"J2": HOME["J2"] - math.radians(4.1)}, "load": {"J2": -0.51}}),
    ],
)
def test_a_condition_counts_when_its_time_is_full(kind: str, seconds: float, options: dict[str, object]) -> None:
    guard = commanded()
    # An offset far from 0, in steps that a binary number holds exactly.
    step = 1 / 64
    found, i = None, 0
    while found is None:
        found = guard.judge(state(**options), 8.0 + i * step)  # type: ignore[arg-type]
        i += 1
    assert (found.kind, found.joint) == (kind, "J2")
    assert (i - 2) * step < seconds <= (i - 1) * step


@pytest.mark.parametrize(
    "options",
    [
        {"positions": {"J2": HOME["J2"] + math.radians(11.9)}},
        {"load": {"J2": 0.9}},
        {"positions": {"J2": HOME["J2"] + math.radians(3.9)}, "load": {"J2": 0.6}},
        {"positions": {"J2": HOME["J2"] + math.radians(5)}, "load": {"J2": 0.5}},
        {"load": {"J2": math.nan}},
    ],
)
def test_thresholds_themselves_are_allowed(options: dict[str, object]) -> None:
    assert judged(commanded(), 5.0, **options) is None


def test_commands_within_the_lag_count_and_older_ones_do_not() -> None:
    limits = SafetyLimits(lag=0.25, following_error=0.1, following_time=1e-9)
    # The command of 0.5 s is in force until 1 s, and counts for as long as the lag after that.
    for when, good in ((1.125, True), (1.247, True), (1.25, False)):
        guard = SafetyGuard(limits)
        for due, angle in ((0.0, 0.0), (0.5, 1.0), (1.0, 2.0), (2.0, 3.0)):
            guard.commanded({"J1": angle}, due)
        found = [guard.judge(state({"J1": 0.95}), when + k / 1024) for k in range(2)]
        assert (found[1] is None) is good
    # A position is as old as it says.
    guard = SafetyGuard(limits)
    for due, angle in ((0.0, 0.0), (1.0, 2.0)):
        guard.commanded({"J1": angle}, due)
    for now in (1.375, 1.4375):
        assert guard.judge(state({"J1": 0.05}, age={"J1": 0.25}), now) is None
    # Before anything is due, the first command counts.
    guard = SafetyGuard(limits)
    guard.commanded({"J1": 1.0}, 5.0)
    guard.commanded({"J1": 2.0}, 6.0)
    assert guard.judge(state({"J1": 1.05}), 1.0) is None
    assert guard.judge(state({"J1": 1.05}), 1.05) is None
    assert guard.judge(state({"J1": 1.2}), 1.1) is None
    assert guard.judge(state({"J1": 1.2}), 1.15) is not None


def test_old_commands_are_dropped_but_the_one_in_force_is_not() -> None:
    guard = SafetyGuard(SafetyLimits(lag=0.25, max_age=0.25))
    for i in range(1000):
        guard.commanded({"J1": float(i)}, 0.25 * i)
    # Lag and twice the age: 0.75 s, and the command before them.
    assert list(guard._commands["J1"]) == [(0.25 * i, float(i)) for i in range(995, 1000)]
    guard.commanded({"J1": 0.0}, 1000.0)
    guard.commanded({"J1": 1.0}, 2000.0)
    assert [due for due, _ in guard._commands["J1"]] == [1000.0, 2000.0]


def test_a_joint_is_lost_after_its_age_and_not_at_it() -> None:
    guard = commanded()
    assert guard.judge(state(age={"J4": 0.25}), 1.0) is None
    silent = state(flags={"J4": JointFlag.SILENT})
    assert guard.judge(silent, 1.25) is None, "its last position is half a second old"
    found = guard.judge(silent, 1.375)
    assert found is not None
    assert str(found) == "J4 has not answered for 0.62 s"
    # A value that is just not too old is a value.
    guard = commanded()
    for i in range(20):
        assert guard.judge(state(age={"J4": 0.5}), 0.125 * i) is None


def test_every_joint_that_was_commanded_is_judged() -> None:
    for name in HOME:
        guard = SafetyGuard(LIMITS)
        guard.commanded({name: HOME[name]}, 0.0)
        found = guard.judge(state(flags={name: JointFlag.CURRENT}), 0.0)
        assert found is not None
        assert found.joint == name


def test_a_stall_counts_as_one_cycle_for_every_condition() -> None:
    guard = SafetyGuard(SafetyLimits(lag=0.25))
    guard.commanded(HOME, 0.0)
    push = {"J1": 0.95, "J2": 0.95}
    assert guard.judge(state(load=push), 0.0) is None
    # Of each second, 0.1 s count: 0.4 of the lag. The overload must last 0.6 s.
    for i in range(1, 6):
        assert guard.judge(state(load=push), float(i)) is None
    assert guard.judge(state(load=push), 6.0) is None
    found = guard.judge(state(load=push), 7.0)
    assert found is not None
    assert found.kind == "overload"


def test_a_board_that_was_told_to_stop() -> None:
    found = commanded().judge(state(stopped=True), 0.0)
    assert found is not None
    assert found.text == "a stop command has stopped the arm"
    assert commanded().judge(state(watchdog_tripped=True), 0.0) is None


@pytest.mark.parametrize("period", [0.12, 0.1201, 0.1666, 0.1667, 0.2])
def test_thresholds_widen_with_the_period_only_where_they_must(period: float) -> None:
    limits = SafetyLimits.at_period(period)
    assert limits.lag == max(0.3, 2.5 * period)
    assert limits.max_age == max(0.5, 3 * period)
