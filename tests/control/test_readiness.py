"""Whether an emulated arm can move, in simulated time."""

from __future__ import annotations

import pytest
from tests.control.arm_bench import Bench
from tests.motion.arms import HOME

from hexwire.control.requests.readiness import Readiness, activate, deactivate, readiness
from hexwire.errors import GoalError, HexwireError, UsageError


@pytest.fixture
def bench() -> Bench:
    return Bench(check_table=False, allow_partial_joints_goal=True)


def _activate(bench: Bench) -> None:
    asked = bench.arm.mark()
    bench.ask(lambda: activate(bench.arm, asked=asked))


def test_an_arm_is_ready_while_all_its_joints_have_torque_and_nothing_stops_it(bench: Bench) -> None:
    assert readiness(bench.arm) is Readiness.NOT_READY
    before = {name: bench.where(name) for name in HOME}
    _activate(bench)
    assert readiness(bench.arm) is Readiness.READY, "at once, not with the next state"
    bench.turn(1.0)
    assert {name: bench.where(name) for name in HOME} == pytest.approx(before, abs=0.01), "nothing moves"
    bench.ask(lambda: bench.owner.torque(False, ["J3"]))
    bench.turn(0.2)
    assert readiness(bench.arm) is Readiness.NOT_READY


def test_a_deactivated_arm_holds_with_torque_until_it_is_activated(bench: Bench) -> None:
    _activate(bench)
    deactivate(bench.arm)
    assert readiness(bench.arm) is Readiness.NOT_READY
    bench.turn(1.0)
    assert all(bench.torques())
    _activate(bench)
    assert readiness(bench.arm) is Readiness.READY


def test_activate_clears_no_stop_of_others(bench: Bench) -> None:
    _activate(bench)
    bench.arm.stop("somebody")
    with pytest.raises(UsageError, match="the arm is stopped: somebody; reset it first"):
        _activate(bench)
    # Neither one that was there before the arm was deactivated,
    deactivate(bench.arm)
    with pytest.raises(UsageError, match="reset it first"):
        _activate(bench)
    bench.ask(bench.arm.reset)
    _activate(bench)
    # nor one that came after it,
    deactivate(bench.arm)
    bench.arm.stop("somebody")
    with pytest.raises(UsageError, match="reset it first"):
        _activate(bench)
    bench.ask(bench.arm.reset)
    _activate(bench)
    # also when it comes after the question was asked.
    deactivate(bench.arm)
    asked = bench.arm.mark()
    bench.arm.stop("somebody")
    with pytest.raises(UsageError, match="reset it first"):
        bench.ask(lambda: activate(bench.arm, asked=asked))
    assert readiness(bench.arm) is Readiness.NOT_READY


def test_what_was_asked_for_before_a_stop_is_void(bench: Bench) -> None:
    asked = bench.arm.mark()
    bench.arm.stop("test")
    bench.ask(bench.arm.reset)
    with pytest.raises(GoalError, match="stopped since"):
        bench.ask(lambda: activate(bench.arm, asked=asked))
    assert not any(bench.torques())


def test_an_arm_that_is_lost_is_unreachable(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    _activate(bench)
    bench.owner.connected = False
    assert readiness(bench.arm) is Readiness.UNREACHABLE
    bench.owner.connected = True
    assert readiness(bench.arm) is Readiness.READY
    monkeypatch.setattr(type(bench.owner), "state", None)
    assert readiness(bench.arm) is Readiness.UNREACHABLE


def test_a_joint_that_does_not_confirm_its_torque_is_named(bench: Bench) -> None:
    bench.silence("J2")
    with pytest.raises(HexwireError, match="J2"):
        _activate(bench)


def test_a_state_must_show_the_torque(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench.arm, "enable", lambda *_: "torque is on")
    times = iter(range(100))
    waits: list[float] = []
    with pytest.raises(UsageError, match="no state of the arm shows it"):
        activate(bench.arm, asked=0, clock=lambda: float(next(times)), sleep=waits.append)
    assert len(waits) == 1
