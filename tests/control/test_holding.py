"""Which joints hold when a motion loses who answers for it, and when the arm is stopped instead."""

from __future__ import annotations

import logging
from dataclasses import replace

import pytest
from tests.control.shared_bench import SharedBench

from hexwire.control.loop.holding import hold_moving, stop_or_log
from hexwire.drivers.values import StopMode
from hexwire.errors import ReplyTimeoutError, StoppedError
from hexwire.model.state import JointState, JointTarget, SentTarget


def on_the_way(**by: float) -> SharedBench:
    bench = SharedBench()
    bench.move(bench.take(), **by)
    bench.turn(0.2)
    del bench.sent[:]
    return bench


def test_joints_on_their_way_hold_where_they_are() -> None:
    bench = on_the_way(J1=0.4, J3=0.1)
    hold_moving(bench.owner, "a test")
    (held,) = bench.sent
    assert {name: bench.where(name) for name, _ in held.positions} == pytest.approx(dict(held.positions), abs=0.01)
    assert [name for name, _ in held.positions] == ["J1", "J3"]
    assert not bench.board.state.stopped


def test_nothing_is_sent_to_an_arm_that_rests_or_is_stopped() -> None:
    bench = SharedBench()
    hold_moving(bench.owner, "a test")
    assert not bench.sent
    bench = on_the_way(J1=0.4)
    bench.robot.stop()
    hold_moving(bench.owner, "a test")
    assert not bench.sent


def test_many_holds_in_a_row_do_not_let_a_loaded_arm_sink() -> None:
    bench = on_the_way(J1=0.4, J2=0.2)
    read = bench.robot.read

    def sagging() -> JointState:
        # Under load a servo rests off its target.
        state = read()
        return replace(state, position=tuple(angle - 0.01 for angle in state.position))

    bench.robot.read = sagging  # type: ignore[method-assign]
    for number in range(5):
        bench.take(f"Bob {number}", force=True)
        bench.turn(0.05)
    (held,) = bench.sent
    assert [name for name, _ in held.positions] == ["J1", "J2"]


def test_a_joint_whose_target_was_not_answered_holds_too() -> None:
    bench = SharedBench()
    key, write = bench.take(), bench._write

    def unanswered(target: JointTarget) -> SentTarget:
        write(target)
        raise ReplyTimeoutError("JOINT_MOVE")

    bench._write = unanswered  # type: ignore[method-assign]
    with pytest.raises(ReplyTimeoutError):
        bench.move(key, J1=0.4)
    bench._write = write  # type: ignore[method-assign]
    bench.turn(0.2)
    assert bench.travel("J1", 0.1) > 0.0005
    hold_moving(bench.owner, "a test")
    bench.turn(0.3)
    assert bench.travel("J1") < 0.004


def test_a_joint_that_nobody_knows_of_is_stopped() -> None:
    bench = on_the_way(J1=0.4, J2=0.1)
    bench.bench.silence("J2")
    bench.turn(1.0)
    hold_moving(bench.owner, "a test")
    assert bench.board.state.stopped


def test_a_joint_that_does_not_take_the_target_is_stopped() -> None:
    bench = on_the_way(J1=0.4)
    write = bench._write

    def silent(target: JointTarget) -> object:
        sent = write(target)
        object.__setattr__(sent, "silent", ("J1",))
        return sent

    bench._write = silent  # type: ignore[method-assign,assignment]
    hold_moving(bench.owner, "a test")
    assert bench.board.state.stopped


def test_a_stop_that_comes_meanwhile_is_enough() -> None:
    bench = on_the_way(J1=0.4)

    def stopped(target: JointTarget) -> object:
        raise StoppedError.unsent("a target", 0, "a stop came")

    bench._write = stopped  # type: ignore[method-assign,assignment]
    hold_moving(bench.owner, "a test")
    assert not bench.board.state.stopped


def test_a_stop_that_nobody_confirms_is_logged(caplog: pytest.LogCaptureFixture) -> None:
    bench = on_the_way(J1=0.4)
    with caplog.at_level(logging.ERROR, "hexwire"):
        stop_or_log(bench.owner, "a test", StopMode.HOLD)
        assert not caplog.text
        bench.bench.link.lost = True
        stop_or_log(bench.owner, "a test")
    assert "the stop was not confirmed" in caplog.text
