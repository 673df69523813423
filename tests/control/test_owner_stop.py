"""`RobotOwner` stops the arm, and a stop is reset; in simulated time."""

from __future__ import annotations

import threading

import pytest
from tests.control.owner_bench import Bench, BoardBench, moving, mute

from hexwire.control.loop.outcomes import Outcome
from hexwire.drivers.hex7bot import Hex7BotDriver
from hexwire.errors import (
    GoalError,
    StoppedError,
    UsageError,
)


@pytest.mark.parametrize(("dialect", "baud"), [(2, 115200), (1, 115200)])
def test_a_stop_and_its_reset(dialect: int, baud: int) -> None:
    bench, told = moving(dialect=dialect, baud=baud)
    owner = bench.owner
    assert owner.stop("a test") == bench.robot.model.names
    assert told.words == "aborted: stopped: a test"
    writes = len(bench.writes)
    bench.turn(3.0)
    assert owner.newest().stopped
    assert len(bench.writes) == writes
    with pytest.raises(GoalError, match="a test"):
        bench.go("J1", 0.1, 2.0)
    bench.ask(owner.reset)
    bench.turn(2.0)
    assert not owner.newest().stopped
    again = bench.go("J1", 0.1, 3.0)
    bench.until(lambda: again.ends)
    assert again.words.startswith("succeeded: ")


def test_calls_that_wait_for_the_owner_are_void_after_a_stop() -> None:
    bench, _ = moving()
    owner = bench.owner
    bench.robot.torque(False)
    outcome: list[object] = []

    def enable() -> None:
        try:
            outcome.append(owner.call(lambda: bench.robot.torque(True)))
        except StoppedError as error:
            outcome.append(error)

    thread = threading.Thread(target=enable)
    thread.start()
    while not owner._calls._waiting:
        thread.join(0.001)
    # The robot is stopped and resumed past the owner, who then comes to what had been asked for before.
    bench.robot.stop()
    bench.robot.resume()
    while thread.is_alive():
        owner._calls.run()
        thread.join(0.001)
    assert isinstance(outcome[0], StoppedError)
    assert not bench.robot.read().torque_on


def test_a_fault_that_is_still_there_is_not_reset_away() -> None:
    bench, told = moving()
    servo = bench.board.wire[0]
    servo.protection.forced |= 0x20
    bench.until(lambda: told.ends)
    assert told.words == "aborted: stopped: J1 reports overload"
    assert bench.board.state.stopped
    with pytest.raises(UsageError, match="J1 still reports overload"):
        bench.ask(bench.owner.reset)
    assert bench.board.state.stopped
    servo.protection.forced = 0
    bench.turn(1.0)
    # The servo tells of it until it is told something.
    with pytest.raises(UsageError, match="reset again"):
        bench.ask(bench.owner.reset)
    bench.turn(1.0)
    bench.ask(bench.owner.reset)
    assert bench.owner.group.reason is None


@pytest.mark.slow
def test_a_watchdog_that_tripped_is_seen_and_reset() -> None:
    bench, told = moving()
    bench.arm.wait(1.5)
    bench.until(lambda: told.ends)
    assert told.words.startswith("aborted: stopped: the board has stopped the arm: its watchdog tripped")
    assert bench.board.state.watchdog_trips == 1
    assert bench.owner.connected
    bench.turn(0.5)
    assert bench.owner.newest().stopped
    bench.ask(bench.owner.reset)
    bench.turn(2.0)
    assert not bench.owner.newest().stopped
    assert bench.owner.group.reason is None
    again = bench.go("J1", 0.1, 2.0)
    bench.until(lambda: again.ends)
    assert again.words.startswith("succeeded: ")
    bench.arm.wait(1.5)
    assert bench.board.state.watchdog_trips == 2


def test_after_a_node_that_died_the_next_one_says_why_the_arm_is_stopped() -> None:
    bench, _ = moving()
    # The node dies: nothing more comes, and its port is closed by the system.
    bench.arm.wait(3.0)
    bench.robot.session.close()
    robot = Hex7BotDriver(bench.robot.session)
    again = Bench(robot, bench.clock)
    again.owner.connect()
    again.turn(1.0)
    assert str(again.controller.generator.reason) == (
        "the board has stopped the arm: its watchdog tripped, because the host fell silent"
    )


def test_a_fault_of_a_joint_at_rest_is_no_stop() -> None:
    bench = BoardBench(faults=("overload:5",))
    bench.owner.connect()
    bench.turn(2.0)
    assert bench.owner.group.reason is None
    assert bench.owner.connected


@pytest.mark.parametrize(("dialect", "baud"), [(2, 0), (1, 115200)])
def test_a_servo_that_falls_silent_during_a_motion_stops_the_arm(dialect: int, baud: int) -> None:
    bench, told = moving("J6", dialect=dialect, baud=baud)
    mute(bench, 5)
    bench.until(lambda: told.ends)
    assert told.ends[0].outcome is Outcome.ABORTED
    assert "J6 has not answered for" in told.words
    assert bench.owner.connected
    with pytest.raises(UsageError, match="J6 still reports silent"):
        bench.ask(bench.owner.reset)


def test_a_servo_that_falls_silent_at_rest_is_not_published() -> None:
    bench = BoardBench()
    bench.owner.connect()
    bench.turn(1.0)
    mute(bench, 5)
    bench.turn(2.0)
    assert bench.published[-1][1].names == ("J1", "J2", "J3", "J4", "J5", "J7")
    assert bench.owner.group.reason is None
    assert bench.owner.rate == pytest.approx(100, rel=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("when", ["before", "after"])
def test_a_stop_while_a_reset_is_under_way_stays(when: str) -> None:
    bench, _ = moving()
    owner, robot = bench.owner, bench.robot
    owner.stop("the first")
    resume = robot.resume

    def resume_with_a_stop() -> None:
        # Whoever stops does it from another thread, and in full.
        if when == "before":
            owner.stop("the second")
        resume()
        if when == "after":
            owner.stop("the second")

    robot.resume = resume_with_a_stop
    with pytest.raises(UsageError, match="stopped again"):
        bench.ask(owner.reset)
    assert bench.board.state.stopped
    assert owner.group.reason is not None
    robot.resume = resume
    bench.ask(owner.reset)
    assert not bench.board.state.stopped
    assert owner.group.reason is None
