"""`RobotOwner` against emulated robots in simulated time: states, targets, torque, jobs."""

from __future__ import annotations

import itertools
import logging
from dataclasses import replace
from typing import Any

import pytest
from tests.bus.bus_bench import make_bus
from tests.control.owner_bench import Bench, BoardBench, moving
from tests.few import few

from hexwire.control.loop.known_state import KnownState
from hexwire.control.loop.outcomes import Outcome
from hexwire.drivers.bus_arm import So101Arm
from hexwire.drivers.hex7bot import Hex7BotDriver
from hexwire.drivers.puma260 import Puma260Driver
from hexwire.emulator.puma import EmulatedPuma
from hexwire.emulator.serve import BoardLink, FakeClock
from hexwire.errors import (
    CommandRefusedError,
    GoalError,
    HexwireError,
    LimitError,
    LinkLostError,
    PreemptedError,
    StoppedError,
    UsageError,
    WrongDeviceError,
)
from hexwire.ipc.handle import IpcHandle
from hexwire.ipc.session import Session
from hexwire.model.state import JointState, JointTarget
from hexwire.wire.command_frame import Command
from hexwire.wire.modules import ModuleType

# -- reading and publishing ---------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("baud", [0, 115200])
def test_states_come_at_the_rate_that_was_asked_for(baud: int) -> None:
    bench = BoardBench(baud=baud, publish_rate=50.0)
    bench.owner.connect()
    bench.turn(5.0)
    # On a slow servo bus now and then no servo was sampled between two reports.
    assert bench.owner.rate == pytest.approx(50, rel=0.05 if baud else 0.01)
    assert bench.owner.state_age < 0.03
    assert bench.board.state.report_period == pytest.approx(0.02)
    stamps = [when for when, _ in bench.published]
    assert stamps == sorted(stamps)


def test_a_hundred_states_come_a_second_unless_another_rate_is_asked_for() -> None:
    bench = BoardBench()
    bench.owner.connect()
    bench.turn(3.0)
    assert bench.board.state.report_period == pytest.approx(0.01)
    assert bench.owner.rate == pytest.approx(100.0, rel=0.005)
    assert bench.owner._latest._period == 0.01


def test_another_robot_is_no_reason_to_wait() -> None:
    clock = FakeClock(1000.0)
    link = BoardLink(EmulatedPuma(start=clock.time).connect(), clock)
    link.url = "tcp://192.0.2.1:15030"
    bench = Bench(Hex7BotDriver(Session(IpcHandle.from_link(link))), clock)
    with pytest.raises(WrongDeviceError, match="use --robot puma260"):
        bench.owner.connect(60.0)
    assert clock.time < 1002.0


def test_observers_have_a_state_before_anything_is_computed_from_it() -> None:
    bench, before = BoardBench(), list[bool]()
    bench.owner.observe(lambda state: before.append(bench.owner.state is not state))
    bench.owner.connect()
    bench.turn(0.2)
    assert before
    assert all(before)


def test_an_observer_that_ends_keeps_no_other_from_a_state() -> None:
    bench, first, second = BoardBench(), list[float](), list[float]()
    bench.owner.connect()

    def once(state: JointState) -> None:
        first.append(state.stamp)
        bench.owner.observe(once, on=False)

    bench.owner.observe(once)
    bench.owner.observe(lambda state: second.append(state.stamp))
    bench.turn(0.2)
    assert first == second[:1]
    assert len(second) > 2


@pytest.mark.slow
def test_a_rate_above_what_a_board_reports_at_is_no_reason_to_lose_it() -> None:
    bench = BoardBench(publish_rate=1000.0)
    bench.owner.connect()
    bench.turn(3.0)
    assert bench.owner.connected
    assert bench.owner.reconnects == 0
    assert bench.owner.rate == pytest.approx(200, rel=0.02)


def test_a_low_rate_of_publishing_leaves_watchdog_and_commands_alone() -> None:
    bench = BoardBench(publish_rate=1.0, watchdog=0.5)
    bench.owner.connect()
    bench.turn(3.0)
    bench.enable()
    told = bench.go("J1", 0.5, 3.0)
    before = len(bench.writes)
    bench.published.clear()
    bench.turn(3.0)
    assert len(bench.writes) - before == pytest.approx(60, abs=2)
    assert 2 <= len(bench.published) <= 4
    assert bench.board.state.watchdog_trips == 0
    bench.until(lambda: told.ends)
    assert told.words.startswith("succeeded: ")


def test_without_reports_states_are_requested_as_fast_as_the_line_allows() -> None:
    bench = BoardBench(dialect=1, baud=115200)
    bench.owner.connect()
    bench.turn(10.0)
    assert bench.owner.connected
    assert 1.0 < bench.owner.rate < 4.0
    assert bench.owner.watchdog == 0.0
    assert bench.owner.probe is not None
    assert bench.owner.probe.dialect == 1


def test_the_board_is_told_to_end_its_reports_whatever_ends_them() -> None:
    bench = BoardBench()
    bench.owner.connect()
    bench.turn(0.5)
    assert bench.board.state.report_due is not None

    def broken(state: JointState, published: KnownState) -> None:
        raise RuntimeError("a fault of the program")

    bench.owner._on_state = broken
    with pytest.raises(RuntimeError, match="a fault"):
        bench.turn(1.0)
    bench.owner.shutdown()
    assert bench.board.state.report_due is None


def test_missing_reports_are_requested_again() -> None:
    bench = BoardBench()
    bench.owner.connect()
    bench.turn(0.5)
    bench.board.state.report_due = None
    bench.turn(2.0)
    assert bench.owner.connected
    assert bench.owner.reconnects == 0
    assert bench.board.state.report_due is not None


# -- commands -------------------------------------------------------------------------------------------------


@few("dialect, baud", [(2, 0), (2, 115200), (1, 115200)], (2, 115200))
def test_a_goal_is_reached(dialect: int, baud: int) -> None:
    bench = BoardBench(dialect, baud)
    bench.owner.connect()
    bench.turn(1.0)
    bench.enable()
    start = bench.owner.newest()["J1"].position
    told = bench.go("J1", 0.4, 4.0)
    bench.until(lambda: told.ends)
    assert told.words.startswith("succeeded: ")
    bench.turn(1.0)
    assert bench.owner.newest()["J1"].position == pytest.approx(start + 0.4, abs=0.02)


def test_one_target_a_period_however_much_hurry() -> None:
    bench = BoardBench()
    bench.owner.connect()
    bench.turn(0.3)
    bench.enable()
    told = bench.go("J1", 0.4, 3.0)
    begun = bench.clock.time
    while not told.ends:
        bench.owner.hurry()
        bench.owner.turn()
    writes = [when for when in bench.writes if when <= begun + 3.0]
    # The first did not wait for the periodic.
    assert writes[0] - begun < 0.011
    gaps = [b - a for a, b in itertools.pairwise(writes)]
    assert min(gaps) > 0.03
    assert len(gaps) == pytest.approx(60, abs=2)


@pytest.mark.slow
def test_a_target_lasts_beyond_the_next_one_or_a_late_cycle_would_be_a_pause() -> None:
    bench, told = moving()
    write, rows = bench.robot.write, []

    def noted(target: JointTarget) -> Any:
        rows.append((bench.clock.time, bench.clock.time + target.duration))
        return write(target)

    bench.robot.write = noted
    bench.until(lambda: told.ends)
    spare = [end - following for (_, end), (following, _) in itertools.pairwise(rows)]
    assert min(spare) > 0.2 * bench.owner.command_period


@pytest.mark.slow
def test_a_slow_line_is_not_made_up_for_in_a_burst() -> None:
    bench = BoardBench()
    bench.owner.connect()
    bench.turn(0.3)
    bench.enable()
    told = bench.go("J1", 0.4, 3.0)
    bench.turn(0.5)
    bench.writes.clear()
    bench.clock.advance(0.4)
    while not told.ends:
        bench.owner.turn()
    gaps = [b - a for a, b in itertools.pairwise(bench.writes)]
    assert min(gaps) > 0.03


@pytest.mark.slow
@pytest.mark.parametrize(
    ("error", "outcome"),
    [
        (
            CommandRefusedError("a move", 9, "J1 has no torque"),
            "aborted: the board refused a move: J1 has no torque",
        ),
        (LimitError("J1 is outside"), "aborted: J1 is outside"),
        (StoppedError("a move", 8, "stopped"), "aborted: stopped: a stop command has stopped the arm"),
    ],
)
def test_a_target_that_is_refused_ends_the_goal_and_not_the_robot(error: HexwireError, outcome: str) -> None:
    bench, told = moving()

    def refuse(target: JointTarget) -> None:
        raise error

    bench.robot.write = refuse
    bench.turn(0.2)
    assert told.words == outcome
    assert bench.owner.connected
    assert bench.owner.reconnects == 0
    assert bool(bench.owner.group.reason) is isinstance(error, StoppedError)


@pytest.mark.slow
def test_a_target_that_a_stop_took_the_line_from() -> None:
    bench, told = moving()
    write = bench.robot.write

    def preempted(target: JointTarget) -> None:
        bench.robot.write = write
        raise PreemptedError("a stop took the line")

    bench.robot.write = preempted
    bench.turn(0.2)
    assert bench.owner.connected
    bench.turn(0.5)
    assert bench.board.state.report_due is not None
    bench.until(lambda: told.ends)
    assert told.words.startswith("succeeded: ")


def test_torque_that_somebody_else_took_ends_the_motion() -> None:
    bench, told = moving()
    bench.robot.torque(False)
    bench.turn(0.3)
    assert told.ends[0].outcome is Outcome.ABORTED
    assert "torque" in told.words
    assert bench.owner.connected
    before = bench.arm.shaft(0)
    bench.turn(1.0)
    assert bench.arm.torques() == [False] * 7
    assert bench.arm.shaft(0) == pytest.approx(before, abs=40)
    with pytest.raises(GoalError, match="no torque on J1"):
        bench.go("J1", 0.1, 1.0)


# -- power ------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_torque_on_in_the_middle_of_a_motion_brakes_nothing() -> None:
    bench, told = moving()
    bench.link.written.clear()
    bench.enable()
    assert Command.TORQUE not in bench.arm.commands()
    bench.until(lambda: told.ends)
    assert told.words.startswith("succeeded: ")


@pytest.mark.slow
def test_torque_on_does_not_stop_other_joints_that_move() -> None:
    bench = BoardBench(split=True)
    owner, (first, second) = bench.owner, bench.controllers
    owner.connect()
    bench.turn(0.2)
    bench.enable()
    hold = bench.go("J5", 0.2, 1.0, second)
    bench.until(lambda: hold.ends)
    bench.ask(lambda: owner.torque(False, second.joints))
    # A hand moves it.
    bench.board.wire[4].motion.position += 400
    moved = bench.go("J1", 0.4, 6.0, first)
    bench.turn(1.0)
    assert bench.ask(lambda: owner.torque(True, owner.robot.model.names)) == owner.robot.model.names
    here = owner.newest()["J5"].position
    assert second.start(0.0, owner.newest(), owner.now()).position[1] == pytest.approx(here, abs=1e-6)
    assert not moved.ends
    bench.until(lambda: moved.ends)
    assert moved.words.startswith("succeeded: ")


def test_torque_off_ends_a_motion() -> None:
    bench, told = moving()
    bench.ask(lambda: bench.owner.torque(False, bench.robot.model.names))
    assert told.words == "aborted: torque was switched off"
    assert bench.arm.torques() == [False] * 7
    assert bench.owner.newest().torque_on == ()


def test_torque_off_ends_what_was_accepted_that_moment() -> None:
    bench, first = moving()
    torque, late = bench.robot.torque, []

    def torque_and_a_goal(*args: Any) -> Any:
        # Of another thread, which has not seen yet that the torque goes.
        late.append(bench.go("J2", -0.1, 2.0))
        return torque(*args)

    bench.robot.torque = torque_and_a_goal
    bench.ask(lambda: bench.owner.torque(False, bench.robot.model.names))
    assert first.words == late[0].words == "aborted: torque was switched off"
    writes = len(bench.writes)
    bench.turn(1.0)
    assert len(bench.writes) == writes


@pytest.mark.slow
def test_a_target_that_the_board_clamped_is_reported_once(caplog: pytest.LogCaptureFixture) -> None:
    bench, told = moving()
    write = bench.robot.write
    bench.robot.write = lambda target: replace(write(target), clamped=("J1",))
    bench.turn(1.0)
    bench.robot.write = write
    bench.until(lambda: told.ends)
    texts = [r.message for r in caplog.records if r.levelno == logging.WARNING]
    assert texts == ["the board's own limits are tighter: it clamped J1"]


def test_torque_is_not_switched_on_while_the_arm_is_stopped() -> None:
    bench = BoardBench()
    bench.owner.connect()
    bench.turn(0.2)
    bench.owner.stop("a test")
    with pytest.raises(UsageError, match=r"stopped \(a test\); reset it first"):
        bench.enable()
    assert bench.arm.torques() == [False] * 7


@pytest.mark.slow
@pytest.mark.parametrize("baud", [0, 115200])
def test_older_reports_do_not_override_a_new_change(baud: int) -> None:
    bench = BoardBench(baud=baud)
    owner = bench.owner
    owner.connect()
    bench.turn(0.2)
    for _ in range(20):
        bench.enable()
        assert owner.newest().torque_on == bench.robot.model.names
        owner.turn()
        assert owner.newest().torque_on == bench.robot.model.names
        owner.stop("a test")
        bench.turn(0.1)
        bench.ask(owner.reset)
        bench.turn(0.1)
        assert owner.group.reason is None
        assert not owner.newest().stopped
        bench.ask(lambda: owner.torque(False, bench.robot.model.names))
        owner.turn()
        assert owner.newest().torque_on == ()


# -- jobs ---------------------------------------------------------------------------------------------------------


def test_a_job_that_finds_the_link_lost_tells_both() -> None:
    bench = BoardBench()
    bench.owner.connect()
    bench.turn(0.3)

    def job() -> None:
        bench.link.lost = True
        bench.robot.read()

    with pytest.raises(LinkLostError, match="unplugged"):
        bench.ask(lambda: bench.owner.call(job))
    assert not bench.owner.connected


def test_a_job_that_is_refused_tells_only_the_one_who_asked() -> None:
    bench = BoardBench()
    bench.owner.connect()
    bench.turn(0.3)

    def job() -> None:
        raise UsageError("not like this")

    with pytest.raises(UsageError, match="not like this"):
        bench.ask(lambda: bench.owner.call(job))
    assert bench.owner.connected


def test_nobody_waits_for_a_robot_that_was_lost_that_moment() -> None:
    bench = BoardBench()
    owner = bench.owner
    owner.connect()
    bench.turn(0.3)
    bench.link.lost = True
    # As if the loss came between the look at `connected` and the queue.
    with pytest.raises(LinkLostError, match="cannot be reached"):
        bench.ask(lambda: owner._calls.call(lambda: None))
    assert not owner.connected


# -- other robots -------------------------------------------------------------------------------------------------


@pytest.fixture
def bus_bench(monkeypatch: pytest.MonkeyPatch) -> Bench:
    bus, _ = make_bus(tuple(range(1, 7)), baud=1_000_000)
    bus.close()
    from hexwire.link import open as ipc_open

    monkeypatch.setattr(ipc_open, "make_link", lambda url: bus.link)
    link = bus.link
    assert isinstance(link, BoardLink)
    return Bench(So101Arm.from_url("/dev/ttyTEST"), link.clock)


@pytest.fixture
def puma_bench() -> Bench:
    clock = FakeClock(1000.0)
    link = BoardLink(EmulatedPuma(start=clock.time).connect(253), clock)
    handle = IpcHandle.from_link(link, ModuleType.PUMA260_HOST_IO_TRX, ModuleType.PUMA260_RBT_IO_SVR)
    return Bench(Puma260Driver(Session(handle)), clock)


@pytest.mark.slow
@pytest.mark.parametrize("which", ["bus_bench", "puma_bench"])
def test_robots_without_a_watchdog(which: str, request: pytest.FixtureRequest) -> None:
    bench: Bench = request.getfixturevalue(which)
    owner = bench.owner
    owner.connect()
    bench.turn(2.0)
    assert owner.rate == pytest.approx(100, rel=0.03)
    assert owner.watchdog == 0.0
    bench.enable()
    joint = bench.robot.model.names[0]
    start = owner.newest()[joint].position
    told = bench.go(joint, 0.3, 3.0)
    bench.until(lambda: told.ends)
    assert told.words.startswith("succeeded: ")
    bench.turn(0.5)
    assert owner.newest()[joint].position == pytest.approx(start + 0.3, abs=0.03)
    told = bench.go(joint, -0.3, 3.0)
    bench.turn(1.0)
    assert owner.stop("a test") == bench.robot.model.names
    assert told.words == "aborted: stopped: a test"
    bench.turn(0.5)
    bench.ask(owner.reset)
    bench.turn(0.5)
    assert owner.group.reason is None
    told = bench.go(joint, -0.1, 3.0)
    bench.turn(1.0)
    robot = bench.robot
    link = robot.bus.link if isinstance(robot, So101Arm) else robot.session.ipc.link
    link.lost = True
    bench.until(lambda: told.ends)
    assert "unplugged" in told.words
    link.lost = False
    bench.until(lambda: owner.connected)
    bench.turn(0.5)
    assert owner.reconnects == 1
    owner.shutdown()
    assert not link.is_open
