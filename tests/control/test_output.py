from __future__ import annotations

import logging
from typing import Any

import pytest
from tests.control.arm_bench import LEAD, PERIOD
from tests.control.owner_bench import make_controller
from tests.drivers.arms import Arm
from tests.motion.arms import rest_to_rest

from hexwire.control.loop.group import ControllerGroup
from hexwire.control.loop.output import Output
from hexwire.epochs import Token
from hexwire.errors import CommandRefusedError, LeaseError, StoppedError, UsageError
from hexwire.model.state import JointTarget, SentTarget
from hexwire.motion.safety import StopReason


class Bench:
    """A board, one controller under way, and what sends for it."""

    def __init__(self, *, borrowed: bool = True) -> None:
        self.arm = Arm(2)
        self.robot = self.arm.driver
        self.robot.torque(True)
        self.controller = make_controller(self.robot.model)
        self.group = ControllerGroup((self.controller,), epochs=self.robot.epochs)
        self.sent: list[SentTarget] = []
        self.looks = 0
        self.armed_after: list[int] = []
        self.output = Output(
            self.robot,
            self.group,
            borrowed=borrowed,
            on_sent=self.sent.append,
            look_again=self.look_again,
            arm_watchdog=self.arm_watchdog,
        )
        state = self.robot.read()
        goal = [angle + 0.2 for angle in state.position]
        way = rest_to_rest(state.names, state.position, goal, 2.0)
        self.controller.follow(way, state, self.arm.clock())

    def look_again(self) -> None:
        self.looks += 1

    def arm_watchdog(self) -> None:
        self.armed_after.append(len(self.sent))

    def update(self, wait: float = 0.0) -> None:
        self.arm.wait(wait)
        state = self.robot.read()
        self.output.update(state, (0.0,) * 7, self.arm.clock(), PERIOD, LEAD)


def refuse(target: JointTarget) -> SentTarget:
    raise CommandRefusedError("JOINT_MOVE", 4, "a joint has no torque")


def test_a_target_goes_out_once_a_period_or_with_every_state_of_a_borrowed_robot() -> None:
    for borrowed, count in ((True, 3), (False, 1)):
        bench = Bench(borrowed=borrowed)
        for _ in range(3):
            bench.update(0.01)
        assert len(bench.sent) == count
        assert bench.armed_after == list(range(count)), "before each of them"


def test_a_stop_since_the_last_state_voids_what_is_followed_though_it_is_resumed() -> None:
    bench = Bench()
    bench.update()
    bench.robot.stop()
    bench.robot.resume()
    bench.update(PERIOD)
    assert len(bench.sent) == 1
    assert str(bench.group.reason) == "a stop command has stopped the arm"


@pytest.mark.parametrize("before", ["the watchdog", "the target", "another target"])
def test_a_stop_meanwhile_voids_the_watchdog_and_the_target_even_after_a_resume(before: str) -> None:
    bench = Bench()
    write = bench.robot.write

    def stop() -> None:
        bench.robot.stop()
        bench.robot.resume()

    def arm_watchdog() -> None:
        if before == "the watchdog":
            stop()
        bench.robot.watchdog(1.0)

    def stopped_write(target: JointTarget) -> SentTarget:
        if before != "the watchdog":
            stop()
        return write(target)

    bench.output._arm_watchdog = arm_watchdog
    bench.robot.write = stopped_write  # type: ignore[method-assign]  # a stop from another thread, right before
    if before == "another target":
        with pytest.raises(StoppedError):
            bench.output.send(JointTarget.of({"J1": 0.1}, 1.0), bench.robot.epochs.mark())
    else:
        bench.update()
        assert bench.group.reason is not None
    assert not bench.sent
    assert (bench.arm.board.state.watchdog_timeout > 0.0) == (before == "the target"), "armed before the stop"


def test_a_refused_target_ends_the_motion_or_comes_out() -> None:
    bench = Bench(borrowed=False)
    bench.robot.write = refuse  # type: ignore[method-assign]
    bench.update()
    assert not bench.controller.busy
    bench = Bench()
    bench.robot.write = refuse  # type: ignore[method-assign]
    with pytest.raises(CommandRefusedError):
        bench.update()


def test_joints_that_have_torque_are_not_braked_while_they_move() -> None:
    bench = Bench()
    asked: list[Any] = []
    torque = bench.robot.torque

    def noted(on: bool, joints: Any = None) -> tuple[str, ...]:
        asked.append(joints)
        return torque(on, joints)

    bench.robot.torque = noted  # type: ignore[method-assign]
    names = bench.robot.model.names
    assert bench.output.torque(True, names) == names
    assert asked == []
    bench.controller.hold("enough")
    bench.robot.torque(False, ["J2"])
    assert bench.output.torque(True, ("J1", "J2")) == ("J1", "J2")
    assert bench.looks == 2


def test_a_stop_is_ended_unless_another_one_came(caplog: pytest.LogCaptureFixture) -> None:
    bench = Bench(borrowed=False)
    with caplog.at_level(logging.ERROR):
        bench.output.stop(StopReason("asked", "the test"))
    assert caplog.messages == ["stopped: the test"]
    before = bench.robot.epochs.mark()
    bench.group.stop(StopReason("asked", "again"))
    with pytest.raises(UsageError, match="stopped again"):
        bench.output.reset(before)
    assert bench.arm.board.state.stopped
    bench.output.reset(bench.robot.epochs.mark())
    assert not bench.arm.board.state.stopped
    assert bench.group.reason is None
    bench.output.stop(StopReason("asked", "the test"))
    with pytest.raises(UsageError, match="the arm is stopped"):
        bench.output.torque(True, ["J1"])


def test_a_target_that_meets_a_stop_does_not_make_it_another_one() -> None:
    bench = Bench(borrowed=False)
    write, after = bench.robot.write, list[Token]()

    def stopped_write(target: JointTarget) -> SentTarget:
        bench.output.stop(StopReason("asked", "the test"))
        after.append(bench.robot.epochs.mark())
        return write(target)

    bench.robot.write = stopped_write  # type: ignore[method-assign]  # a stop from another thread, right before
    bench.update()
    assert not bench.sent
    (asked,) = after
    assert bench.robot.epochs.holds(asked)
    bench.output.reset(asked)
    assert bench.group.reason is None


def test_joints_run_until_their_last_target_is_over() -> None:
    bench = Bench()
    output, clock = bench.output, bench.arm.clock
    assert output.running() == ()
    state = bench.robot.read()
    output.send(JointTarget.of({"J1": state["J1"].position + 0.1}, 2.0), bench.robot.epochs.mark())
    output.send(JointTarget.of({"J2": state["J2"].position}, 0.1), bench.robot.epochs.mark())
    assert output.running() == ("J1", "J2")
    assert output.time_left() == pytest.approx(2.2, abs=0.01)
    clock.time += 1.0
    assert output.running() == ("J1",)
    clock.time += 1.2
    assert output.running() == ()
    assert output.time_left() == 0.0


def test_an_authority_is_asked_before_the_decision_and_right_before_the_bytes_leave() -> None:
    bench = Bench(borrowed=False)
    asked: list[str] = []

    def refusal() -> LeaseError:
        asked.append("refusal")
        return LeaseError("Ann lost the lease")

    bench.output.before = lambda: asked.append("before")
    bench.output.refusal = refusal
    bench.update()
    assert asked[:2] == ["before", "refusal"]
    assert not bench.sent
    assert not bench.group.busy
    assert bench.group.reason is None, "it is no stop"
