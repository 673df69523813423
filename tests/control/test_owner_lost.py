"""`RobotOwner` loses its robot, or the robot its memory; in simulated time."""

from __future__ import annotations

import pytest
from tests.control.owner_bench import BoardBench, moving
from tests.few import few

from hexwire.control.loop.outcomes import Outcome
from hexwire.errors import (
    DeviceError,
    LinkLostError,
    ServoError,
)
from hexwire.model.state import JointTarget


@few("dialect, baud", [(2, 0), (2, 115200), (1, 115200)], (2, 0))
def test_an_unplugged_robot_is_stopped_and_found_again(dialect: int, baud: int) -> None:
    bench, told = moving(dialect=dialect, baud=baud)
    owner = bench.owner
    bench.link.lost = True
    bench.until(lambda: told.ends)
    assert told.ends[0].outcome is Outcome.ABORTED
    assert "was unplugged" in told.words
    assert owner.group.reason is not None
    assert owner.group.reason.kind == "lost"
    assert not owner.connected
    bench.arm.wait(3.0)
    assert bench.board.state.stopped is (dialect == 2)
    for call in (
        owner.newest,
        owner.reset,
        lambda: owner.torque(True, ("J1",)),
        lambda: owner.stop("a test"),
    ):
        with pytest.raises(LinkLostError, match="unplugged"):
            call()
    bench.turn(2.0)
    bench.link.lost = False
    bench.until(lambda: owner.connected)
    bench.turn(1.0)
    assert owner.reconnects == 1
    assert owner.error == ""
    if dialect == 2:
        assert owner.newest().stopped
        assert bench.board.state.watchdog_timeout == 1.0
        assert owner.watchdog == 1.0
    writes = len(bench.writes)
    bench.turn(2.0)
    assert len(bench.writes) == writes
    bench.ask(owner.reset)
    bench.turn(2.0)
    again = bench.go("J1", 0.1, 3.0)
    bench.until(lambda: again.ends)
    assert again.words.startswith("succeeded: ")
    assert bench.board.state.watchdog_trips == (dialect == 2)


def test_a_board_of_another_dialect_is_not_taken_for_the_one_that_was_there() -> None:
    bench, told = moving()
    owner = bench.owner
    bench.link.lost = True
    bench.until(lambda: told.ends)
    bench.link.lost = False
    bench.robot._only_dialect = 1
    bench.until(lambda: "of dialect 1" in owner.error)
    assert "a board of dialect 1 replaced one of dialect 2" in owner.error
    assert not owner.connected
    assert not bench.link.is_open
    bench.robot._only_dialect = None
    bench.until(lambda: owner.connected)
    assert owner.command_period == 0.05


def test_a_board_that_says_nothing_more_is_lost_though_its_port_stays() -> None:
    bench, told = moving()
    dead = {"dead": True}
    out = bench.board.faults.host_out
    bench.board.faults.host_out = lambda data, now: b"" if dead["dead"] else out(data, now)  # type: ignore[method-assign]  # a fault that begins in mid-run
    bench.until(lambda: told.ends)
    assert "no answer to" in told.words
    assert not bench.owner.connected
    bench.turn(8.0)
    assert not bench.owner.connected
    dead["dead"] = False
    bench.until(lambda: bench.owner.connected)
    assert bench.owner.group.reason is not None
    assert bench.owner.group.reason.kind == "lost"


def test_a_robot_that_cannot_be_understood_is_told_to_stop_before_it_is_left() -> None:
    bench, told = moving()

    def garbled(*_: object) -> object:
        raise ServoError("the board reports 3 joints instead of 7")

    bench.robot._board.decode_state = garbled
    bench.until(lambda: told.ends)
    assert "reports 3 joints" in told.text
    assert bench.board.state.stopped
    assert bench.board.state.report_due is None


@pytest.mark.slow
def test_a_board_that_is_reset_during_a_motion_stops_the_arm() -> None:
    bench, told = moving()
    boot = bench.owner.probe.boot_id if bench.owner.probe else None
    bench.board.reset(bench.clock.time)
    bench.until(lambda: told.ends)
    assert told.words == "aborted: stopped: the board was reset"
    bench.turn(2.5)
    assert bench.board.state.stopped
    assert bench.board.state.watchdog_timeout == 1.0
    assert bench.owner.rate == pytest.approx(100, rel=0.05)
    assert bench.owner.probe is not None
    assert bench.owner.probe.boot_id not in {boot, None}
    assert bench.owner.reconnects == 0
    bench.ask(bench.owner.reset)
    bench.turn(0.3)
    again = bench.go("J1", 0.1, 2.0)
    bench.until(lambda: again.ends)
    assert again.words.startswith("succeeded: ")


def test_a_board_that_is_reset_while_stopped_is_stopped_again() -> None:
    bench = BoardBench()
    bench.owner.connect()
    bench.turn(0.5)
    bench.owner.stop("a test")
    bench.turn(0.5)
    bench.board.reset(bench.clock.time)
    bench.turn(2.0)
    assert bench.board.state.stopped
    assert str(bench.owner.group.reason) == "a test"


def test_a_board_that_is_reset_at_rest_is_only_told_its_watchdog() -> None:
    bench = BoardBench()
    bench.owner.connect()
    bench.turn(0.5)
    bench.enable()
    told = bench.go("J1", 0.2, 1.0)
    bench.until(lambda: told.ends)
    # Its power was gone for a moment, and the arm has sunk.
    bench.board.wire[0].motion.position -= 200.0
    bench.board.reset(bench.clock.time)
    bench.turn(2.0)
    assert bench.owner.group.reason is None
    assert not bench.board.state.stopped
    state = bench.owner.newest()
    here = bench.controller.start(0.0, state, bench.owner.now()).position
    assert here == state.position, "what was commanded before means nothing now"
    assert bench.board.state.watchdog_timeout == 1.0
    assert bench.board.state.report_due is not None


@pytest.mark.slow
def test_a_supply_that_fails_during_a_motion() -> None:
    bench, told = moving(faults=("brownout:2.5:1.0",))
    bench.until(lambda: told.ends)
    assert told.ends[0].outcome is Outcome.ABORTED
    bench.until(lambda: bench.owner.connected and bench.clock.time > 1006.0)
    bench.turn(1.0)
    assert bench.owner.group.reason is not None
    assert bench.arm.torques() == [False] * 7
    assert bench.board.state.watchdog_timeout == 1.0


def test_a_state_that_is_old_is_nothing_to_begin_at() -> None:
    bench = BoardBench()
    bench.owner.connect()
    bench.turn(0.5)
    bench.owner.newest()
    bench.clock.advance(1.01)
    with pytest.raises(DeviceError, match=r"no state from the robot for 1\.0 s"):
        bench.owner.newest()
    bench.owner.turn()
    bench.owner.newest()


def test_on_a_slow_line_states_are_good_for_longer() -> None:
    bench = BoardBench(command_rate=1.5)
    bench.owner.connect()
    bench.clock.advance(1.9)
    bench.owner.newest()
    bench.clock.advance(0.2)
    with pytest.raises(DeviceError, match="no state from the robot"):
        bench.owner.newest()


@pytest.mark.parametrize("stopped_meanwhile", [False, True])
def test_a_stop_that_could_not_be_sent_is_sent_when_the_robot_is_back(stopped_meanwhile: bool) -> None:
    """A single target may be far away, and without a watchdog the board goes on to it."""
    bench = BoardBench(watchdog=0.0)
    owner = bench.owner
    owner.connect()
    bench.turn(0.2)
    bench.enable()
    if not stopped_meanwhile:
        goal = {"J1": owner.newest()["J1"].position + 0.5}
        owner.send(JointTarget.of(goal, 20.0), bench.robot.epochs.mark())
        bench.turn(0.3)
    bench.link.lost = True
    bench.until(lambda: not owner.connected)
    if stopped_meanwhile:
        with pytest.raises(LinkLostError, match="cannot be sent"):
            owner.stop("a test")
    assert not bench.board.state.stopped
    bench.link.lost = False
    bench.until(lambda: owner.connected)
    assert bench.board.state.stopped
    bench.turn(0.2)
    # Once: after a resume it is not sent again.
    bench.ask(owner.reset)
    bench.turn(0.5)
    assert not bench.board.state.stopped


def test_at_rest_a_lost_robot_comes_back_as_it_was() -> None:
    bench = BoardBench(watchdog=0.0)
    bench.owner.connect()
    bench.turn(0.2)
    bench.link.lost = True
    bench.until(lambda: not bench.owner.connected)
    bench.link.lost = False
    bench.until(lambda: bench.owner.connected)
    assert not bench.board.state.stopped


def test_a_shutdown_stops_the_motion_of_a_single_target() -> None:
    bench = BoardBench()
    bench.owner.connect()
    bench.turn(0.2)
    bench.enable()
    goal = {"J1": bench.owner.newest()["J1"].position + 0.5}
    bench.owner.send(JointTarget.of(goal, 20.0), bench.robot.epochs.mark())
    bench.turn(0.3)
    bench.owner.shutdown()
    assert bench.board.state.stopped
