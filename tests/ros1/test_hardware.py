"""`Hardware` against emulated robots: in simulated time, where `turn` is called here; with threads at the end."""

from __future__ import annotations

import itertools
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any, TypeVar

import pytest
from tests.drivers.arms import Arm
from tests.ipc.bus_bench import make_bus

from hexwire.drivers.bus_arm import So101Arm
from hexwire.drivers.hex7bot import Hex7BotDriver
from hexwire.drivers.puma260 import Puma260Driver
from hexwire.emulator.board import make_hex7bot_board
from hexwire.emulator.puma import EmulatedPuma
from hexwire.emulator.serve import BoardLink, FakeClock, PtyServer
from hexwire.errors import (
    CommandRefusedError,
    DeviceError,
    GoalError,
    HexwireError,
    LimitError,
    LinkLostError,
    LinkPermissionError,
    PreemptedError,
    ReplyTimeoutError,
    StoppedError,
    UsageError,
)
from hexwire.ipc.handle import IpcHandle
from hexwire.ipc.session import Session
from hexwire.model.arm import ArmModel
from hexwire.model.state import JointState, JointTarget
from hexwire.motion.safety import SafetyLimits
from hexwire.ros1.controller import Ended, Outcome, TrajectoryController
from hexwire.ros1.goals import Point, Tolerance, Tolerances, TrajectoryOrder
from hexwire.ros1.hardware import Hardware
from hexwire.ros1.settings import ControllerSettings
from hexwire.ros1.states import PublishedState
from hexwire.wire.command_frame import Command
from hexwire.wire.modules import ModuleType

_T = TypeVar("_T")


class Told:
    """A goal, and what it was told."""

    def __init__(self) -> None:
        self.ends: list[Ended] = []

    def ended(self, ended: Ended) -> None:
        self.ends.append(ended)

    @property
    def text(self) -> str:
        (end,) = self.ends
        return f"{end.outcome.value}: {end.text}"


def make_controller(model: ArmModel, joints: tuple[str, ...] = (), period: float = 0.05) -> TrajectoryController:
    joints = joints or model.names
    none = {name: Tolerance() for name in joints}
    goal = {name: Tolerance(velocity=0.1) for name in joints}
    settings = ControllerSettings("", joints, True, Tolerances(none, goal, 0.0))
    return TrajectoryController(settings, model, SafetyLimits.at_period(period))


class Bench:
    """A robot, its owner, one controller of all joints, and what was published."""

    def __init__(self, robot: Any, clock: FakeClock, *, period: float = 0.05, split: bool = False, **options: Any):
        self.robot, self.clock = robot, clock
        self.published: list[tuple[float, PublishedState]] = []
        self.writes: list[float] = []
        self.hardware = Hardware(robot, on_state=self.note, clock=clock, sleep=clock.sleep, **options)
        names = robot.model.names
        shares = (names[:3], names[3:]) if split else (names,)
        self.controllers = tuple(make_controller(robot.model, share, period) for share in shares)
        self.controller = self.controllers[0]
        self.hardware.group.members = self.controllers
        write = robot.write

        def watched(target: JointTarget) -> Any:
            self.writes.append(clock.time)
            return write(target)

        robot.write = watched

    def note(self, state: JointState, published: PublishedState) -> None:
        self.published.append((self.clock.time, published))

    def turn(self, seconds: float) -> None:
        end = self.clock.time + seconds
        while self.clock.time < end:
            self.hardware.turn()

    def until(self, condition: Callable[[], object], seconds: float = 20.0) -> None:
        end = self.clock.time + seconds
        while not condition():
            assert self.clock.time < end
            self.hardware.turn()

    def ask(self, call: Callable[[], _T]) -> _T:
        """What another thread asks the owner for, who turns meanwhile."""
        answer: list[_T] = []
        failed: list[HexwireError] = []

        def run() -> None:
            try:
                answer.append(call())
            except HexwireError as error:
                failed.append(error)

        thread = threading.Thread(target=run)
        thread.start()
        while thread.is_alive():
            self.hardware.turn()
            thread.join(0.001)
        if failed:
            raise failed[0]
        return answer[0]

    def enable(self) -> None:
        names = self.robot.model.names
        assert self.ask(lambda: self.hardware.torque(True, names)) == names

    def go(self, joint: str, by: float, seconds: float, controller: TrajectoryController | None = None) -> Told:
        """Have one joint go somewhere; it is on its way when this returns."""
        told, hardware = Told(), self.hardware
        state = hardware.newest()
        order = TrajectoryOrder((joint,), (Point(seconds, (state[joint].position + by,)),))
        chosen = controller or self.controller
        with hardware.locked():
            chosen.check_way(chosen.plan(order, state, hardware.now()), state)
            chosen.accept(order, state, hardware.now(), goal=told)
        hardware.hurry()
        hardware.deliver()
        return told


class BoardBench(Bench):
    """With a board of a Hex7Bot."""

    def __init__(self, dialect: int = 2, baud: int = 0, faults: tuple[str, ...] = (), **options: Any) -> None:
        self.arm = Arm(dialect, baud, faults, attach=False)
        self.board, self.link = self.arm.board, self.arm.link
        super().__init__(self.arm.driver, self.arm.clock, period=0.05 if dialect == 2 else 0.667, **options)


def moving(joint: str = "J1", **options: Any) -> tuple[BoardBench, Told]:
    """A bench with an arm on its way for five seconds."""
    bench = BoardBench(**options)
    bench.hardware.connect()
    bench.turn(0.2)
    bench.enable()
    told = bench.go(joint, 0.5, 5.0)
    bench.turn(1.0)
    assert bench.writes
    assert not told.ends
    return bench, told


# -- reading and publishing ---------------------------------------------------------------------------------


@pytest.mark.parametrize("baud", [0, 115200])
def test_states_come_at_the_rate_that_was_asked_for(baud: int) -> None:
    bench = BoardBench(baud=baud, publish_rate=50.0)
    bench.hardware.connect()
    bench.turn(5.0)
    # On a slow servo bus now and then no servo was sampled between two reports.
    assert bench.hardware.rate == pytest.approx(50, rel=0.05 if baud else 0.01)
    assert bench.hardware.state_age < 0.03
    assert bench.board.state.report_period == pytest.approx(0.02)
    stamps = [when for when, _ in bench.published]
    assert stamps == sorted(stamps)


def test_a_rate_above_what_a_board_reports_at_is_no_reason_to_lose_it() -> None:
    bench = BoardBench(publish_rate=1000.0)
    bench.hardware.connect()
    bench.turn(3.0)
    assert bench.hardware.connected
    assert bench.hardware.reconnects == 0
    assert bench.hardware.rate == pytest.approx(200, rel=0.02)


def test_a_low_rate_of_publishing_leaves_watchdog_and_commands_alone() -> None:
    bench = BoardBench(publish_rate=1.0, watchdog=0.5)
    bench.hardware.connect()
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
    assert told.text == "succeeded: "


def test_where_reports_are_unknown_it_asks_as_fast_as_the_line_goes() -> None:
    bench = BoardBench(dialect=1, baud=115200)
    bench.hardware.connect()
    bench.turn(10.0)
    assert bench.hardware.connected
    assert 1.0 < bench.hardware.rate < 4.0
    assert bench.hardware.watchdog == 0.0
    assert bench.hardware.probe is not None
    assert bench.hardware.probe.dialect == 1


def test_the_board_is_told_to_end_its_reports_whatever_ends_them() -> None:
    bench = BoardBench()
    bench.hardware.connect()
    bench.turn(0.5)
    assert bench.board.state.report_due is not None

    def broken(state: JointState, published: PublishedState) -> None:
        raise RuntimeError("a fault of the program")

    bench.hardware._on_state = broken
    with pytest.raises(RuntimeError, match="a fault"):
        bench.turn(1.0)
    bench.hardware.shutdown()
    assert bench.board.state.report_due is None


def test_reports_that_stay_away_are_asked_for_again() -> None:
    bench = BoardBench()
    bench.hardware.connect()
    bench.turn(0.5)
    bench.board.state.report_due = None
    bench.turn(2.0)
    assert bench.hardware.connected
    assert bench.hardware.reconnects == 0
    assert bench.board.state.report_due is not None


# -- commands -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("dialect", "baud"), [(2, 0), (2, 115200), (1, 115200)])
def test_a_goal_is_reached(dialect: int, baud: int) -> None:
    bench = BoardBench(dialect, baud)
    bench.hardware.connect()
    bench.turn(1.0)
    bench.enable()
    start = bench.hardware.newest()["J1"].position
    told = bench.go("J1", 0.4, 4.0)
    bench.until(lambda: told.ends)
    assert told.text == "succeeded: "
    bench.turn(1.0)
    assert bench.hardware.newest()["J1"].position == pytest.approx(start + 0.4, abs=0.02)


def test_one_target_a_period_however_much_hurry() -> None:
    bench = BoardBench()
    bench.hardware.connect()
    bench.turn(0.3)
    bench.enable()
    told = bench.go("J1", 0.4, 3.0)
    begun = bench.clock.time
    while not told.ends:
        bench.hardware.hurry()
        bench.hardware.turn()
    writes = [when for when in bench.writes if when <= begun + 3.0]
    # The first did not wait for the raster.
    assert writes[0] - begun < 0.011
    gaps = [b - a for a, b in itertools.pairwise(writes)]
    assert min(gaps) > 0.03
    assert len(gaps) == pytest.approx(60, abs=2)


def test_a_slow_line_is_not_made_up_for_in_a_burst() -> None:
    bench = BoardBench()
    bench.hardware.connect()
    bench.turn(0.3)
    bench.enable()
    told = bench.go("J1", 0.4, 3.0)
    bench.turn(0.5)
    bench.writes.clear()
    bench.clock.advance(0.4)
    while not told.ends:
        bench.hardware.turn()
    gaps = [b - a for a, b in itertools.pairwise(bench.writes)]
    assert min(gaps) > 0.03


@pytest.mark.parametrize(
    ("error", "outcome"),
    [
        (
            CommandRefusedError("a move", 9, "J1 has no torque"),
            "aborted: the board refused a move: J1 has no torque",
        ),
        (LimitError("J1 is outside"), "aborted: J1 is outside"),
        (StoppedError("a move", 8, "stopped"), "aborted: stopped: the board has stopped the arm"),
    ],
)
def test_a_target_that_is_refused_ends_the_goal_and_not_the_robot(error: HexwireError, outcome: str) -> None:
    bench, told = moving()

    def refuse(target: JointTarget) -> None:
        raise error

    bench.robot.write = refuse
    bench.turn(0.2)
    assert told.text == outcome
    assert bench.hardware.connected
    assert bench.hardware.reconnects == 0
    assert bool(bench.hardware.group.reason) is isinstance(error, StoppedError)


def test_a_target_that_a_stop_took_the_line_from() -> None:
    bench, told = moving()
    write = bench.robot.write

    def preempted(target: JointTarget) -> None:
        bench.robot.write = write
        raise PreemptedError("a stop took the line")

    bench.robot.write = preempted
    bench.turn(0.2)
    assert bench.hardware.connected
    bench.turn(0.5)
    assert bench.board.state.report_due is not None
    bench.until(lambda: told.ends)
    assert told.text == "succeeded: "


def test_torque_that_somebody_else_took_ends_the_motion() -> None:
    bench, told = moving()
    bench.robot.torque(False)
    bench.turn(0.3)
    assert told.ends[0].outcome is Outcome.ABORTED
    assert "torque" in told.text
    assert bench.hardware.connected
    before = bench.arm.shaft(0)
    bench.turn(1.0)
    assert bench.arm.torques() == [False] * 7
    assert bench.arm.shaft(0) == pytest.approx(before, abs=40)
    with pytest.raises(GoalError, match="no torque on J1"):
        bench.go("J1", 0.1, 1.0)


# -- power ------------------------------------------------------------------------------------------------------


def test_torque_on_in_the_middle_of_a_motion_brakes_nothing() -> None:
    bench, told = moving()
    bench.link.written.clear()
    bench.enable()
    assert Command.TORQUE not in bench.arm.commands()
    bench.until(lambda: told.ends)
    assert told.text == "succeeded: "


def test_torque_on_leaves_other_joints_on_their_way_alone() -> None:
    bench = BoardBench(split=True)
    hardware, (first, second) = bench.hardware, bench.controllers
    hardware.connect()
    bench.turn(0.2)
    bench.enable()
    hold = bench.go("J5", 0.2, 1.0, second)
    bench.until(lambda: hold.ends)
    bench.ask(lambda: hardware.torque(False, second.joints))
    # A hand moves it.
    bench.board.wire[4].motion.position += 400
    moved = bench.go("J1", 0.4, 6.0, first)
    bench.turn(1.0)
    assert bench.ask(lambda: hardware.torque(True, hardware.robot.model.names)) == hardware.robot.model.names
    here = hardware.newest()["J5"].position
    assert second.here(hardware.newest(), hardware.now())[1] == pytest.approx(here, abs=1e-6)
    assert not moved.ends
    bench.until(lambda: moved.ends)
    assert moved.text == "succeeded: "


def test_torque_off_ends_a_motion() -> None:
    bench, told = moving()
    bench.ask(lambda: bench.hardware.torque(False, bench.robot.model.names))
    assert told.text == "aborted: the torque was taken away"
    assert bench.arm.torques() == [False] * 7
    assert bench.hardware.newest().torque_on == ()


def test_torque_is_not_switched_on_while_the_arm_is_stopped() -> None:
    bench = BoardBench()
    bench.hardware.connect()
    bench.turn(0.2)
    bench.hardware.stop("a test")
    with pytest.raises(UsageError, match="reset it first"):
        bench.enable()
    assert bench.arm.torques() == [False] * 7


@pytest.mark.parametrize("baud", [0, 115200])
def test_what_was_just_done_is_not_undone_by_reports_from_before(baud: int) -> None:
    bench = BoardBench(baud=baud)
    hardware = bench.hardware
    hardware.connect()
    bench.turn(0.2)
    for _ in range(20):
        bench.enable()
        assert hardware.newest().torque_on == bench.robot.model.names
        hardware.turn()
        assert hardware.newest().torque_on == bench.robot.model.names
        hardware.stop("a test")
        bench.turn(0.1)
        bench.ask(hardware.reset)
        bench.turn(0.1)
        assert hardware.group.reason is None
        assert not hardware.newest().stopped
        bench.ask(lambda: hardware.torque(False, bench.robot.model.names))
        hardware.turn()
        assert hardware.newest().torque_on == ()


# -- stop and reset ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("dialect", "baud"), [(2, 115200), (1, 115200)])
def test_a_stop_and_its_reset(dialect: int, baud: int) -> None:
    bench, told = moving(dialect=dialect, baud=baud)
    hardware = bench.hardware
    assert hardware.stop("a test") == bench.robot.model.names
    assert told.text == "aborted: stopped: a test"
    writes = len(bench.writes)
    bench.turn(3.0)
    assert hardware.newest().stopped
    assert len(bench.writes) == writes
    with pytest.raises(GoalError, match="a test"):
        bench.go("J1", 0.1, 2.0)
    bench.ask(hardware.reset)
    bench.turn(2.0)
    assert not hardware.newest().stopped
    again = bench.go("J1", 0.1, 3.0)
    bench.until(lambda: again.ends)
    assert again.text == "succeeded: "


def test_a_fault_that_is_still_there_is_not_reset_away() -> None:
    bench, told = moving()
    servo = bench.board.wire[0]
    servo.protection.forced |= 0x20
    bench.until(lambda: told.ends)
    assert told.text == "aborted: stopped: J1 reports overload"
    assert bench.board.state.stopped
    with pytest.raises(UsageError, match="J1 still reports overload"):
        bench.ask(bench.hardware.reset)
    assert bench.board.state.stopped
    servo.protection.forced = 0
    bench.turn(1.0)
    # The servo tells of it until it is told something.
    with pytest.raises(UsageError, match="reset again"):
        bench.ask(bench.hardware.reset)
    bench.turn(1.0)
    bench.ask(bench.hardware.reset)
    assert bench.hardware.group.reason is None


def test_a_watchdog_that_tripped_is_seen_and_reset() -> None:
    bench, told = moving()
    bench.arm.wait(1.5)
    bench.until(lambda: told.ends)
    assert told.text.startswith("aborted: stopped: the board has stopped the arm")
    assert bench.board.state.watchdog_trips == 1
    assert bench.hardware.connected
    bench.turn(0.5)
    assert bench.hardware.newest().stopped
    bench.ask(bench.hardware.reset)
    bench.turn(2.0)
    assert not bench.hardware.newest().stopped
    assert bench.hardware.group.reason is None
    again = bench.go("J1", 0.1, 2.0)
    bench.until(lambda: again.ends)
    assert again.text == "succeeded: "
    bench.arm.wait(1.5)
    assert bench.board.state.watchdog_trips == 2


def test_after_a_node_that_died_the_next_one_says_why_the_arm_is_stopped() -> None:
    bench, _ = moving()
    # The node dies: nothing more comes, and its port is closed by the system.
    bench.arm.wait(3.0)
    bench.robot.session.close()
    robot = Hex7BotDriver(bench.robot.session)
    again = Bench(robot, bench.clock)
    again.hardware.connect()
    again.turn(1.0)
    assert str(again.controller.follower.reason) == "the board has stopped the arm: the host fell silent"


def test_a_fault_of_a_joint_at_rest_is_no_stop() -> None:
    bench = BoardBench(faults=("overload:5",))
    bench.hardware.connect()
    bench.turn(2.0)
    assert bench.hardware.group.reason is None
    assert bench.hardware.connected


@pytest.mark.parametrize(("dialect", "baud"), [(2, 0), (1, 115200)])
def test_a_servo_that_falls_silent_on_its_way_stops_the_arm(dialect: int, baud: int) -> None:
    bench, told = moving("J6", dialect=dialect, baud=baud)
    mute(bench, 5)
    bench.until(lambda: told.ends)
    assert told.ends[0].outcome is Outcome.ABORTED
    assert "J6 has not been heard of" in told.text
    assert bench.hardware.connected
    with pytest.raises(UsageError, match="J6 still reports silent"):
        bench.ask(bench.hardware.reset)


def test_a_servo_that_falls_silent_at_rest_is_not_published() -> None:
    bench = BoardBench()
    bench.hardware.connect()
    bench.turn(1.0)
    mute(bench, 5)
    bench.turn(2.0)
    assert bench.published[-1][1].names == ("J1", "J2", "J3", "J4", "J5", "J7")
    assert bench.hardware.group.reason is None
    assert bench.hardware.rate == pytest.approx(100, rel=0.05)


def mute(bench: BoardBench, servo_id: int) -> None:
    answer = bench.board.faults.bus_answer

    def silent(who: int, said: bytes | None) -> tuple[bytes, float]:
        return (b"", 0.0) if who == servo_id else answer(who, said)

    bench.board.faults.bus_answer = silent  # type: ignore[method-assign,assignment]  # a fault that begins in mid-run


# -- a robot that goes away ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(("dialect", "baud"), [(2, 0), (2, 115200), (1, 115200)])
def test_an_unplugged_robot_is_stopped_and_found_again(dialect: int, baud: int) -> None:
    bench, told = moving(dialect=dialect, baud=baud)
    hardware = bench.hardware
    bench.link.lost = True
    bench.until(lambda: told.ends)
    assert told.ends[0].outcome is Outcome.ABORTED
    assert "was unplugged" in told.text
    assert hardware.group.reason is not None
    assert hardware.group.reason.kind == "lost"
    assert not hardware.connected
    bench.arm.wait(3.0)
    assert bench.board.state.stopped is (dialect == 2)
    for call in (
        hardware.newest,
        hardware.reset,
        lambda: hardware.torque(True, ("J1",)),
        lambda: hardware.stop("a test"),
    ):
        with pytest.raises(LinkLostError, match="unplugged"):
            call()
    bench.turn(2.0)
    bench.link.lost = False
    bench.until(lambda: hardware.connected)
    bench.turn(1.0)
    assert hardware.reconnects == 1
    assert hardware.error == ""
    if dialect == 2:
        assert hardware.newest().stopped
        assert bench.board.state.watchdog_timeout == 1.0
        assert hardware.watchdog == 1.0
    writes = len(bench.writes)
    bench.turn(2.0)
    assert len(bench.writes) == writes
    bench.ask(hardware.reset)
    bench.turn(2.0)
    again = bench.go("J1", 0.1, 3.0)
    bench.until(lambda: again.ends)
    assert again.text == "succeeded: "
    assert bench.board.state.watchdog_trips == (dialect == 2)


def test_a_board_that_says_nothing_more_is_lost_though_its_port_stays() -> None:
    bench, told = moving()
    dead = {"dead": True}
    out = bench.board.faults.host_out
    bench.board.faults.host_out = lambda data, now: b"" if dead["dead"] else out(data, now)  # type: ignore[method-assign]  # a fault that begins in mid-run
    bench.until(lambda: told.ends)
    assert "no answer to" in told.text
    assert not bench.hardware.connected
    bench.turn(8.0)
    assert not bench.hardware.connected
    dead["dead"] = False
    bench.until(lambda: bench.hardware.connected)
    assert bench.hardware.group.reason is not None
    assert bench.hardware.group.reason.kind == "lost"


def test_a_board_that_is_reset_on_its_way_stops_the_arm() -> None:
    bench, told = moving()
    boot = bench.hardware.probe.boot_id if bench.hardware.probe else None
    bench.board.reset(bench.clock.time)
    bench.until(lambda: told.ends)
    assert told.text == "aborted: stopped: the board was reset"
    bench.turn(2.5)
    assert bench.board.state.stopped
    assert bench.board.state.watchdog_timeout == 1.0
    assert bench.hardware.rate == pytest.approx(100, rel=0.05)
    assert bench.hardware.probe is not None
    assert bench.hardware.probe.boot_id not in {boot, None}
    assert bench.hardware.reconnects == 0
    bench.ask(bench.hardware.reset)
    bench.turn(0.3)
    again = bench.go("J1", 0.1, 2.0)
    bench.until(lambda: again.ends)
    assert again.text == "succeeded: "


def test_a_board_that_is_reset_while_stopped_is_stopped_again() -> None:
    bench = BoardBench()
    bench.hardware.connect()
    bench.turn(0.5)
    bench.hardware.stop("a test")
    bench.turn(0.5)
    bench.board.reset(bench.clock.time)
    bench.turn(2.0)
    assert bench.board.state.stopped
    assert str(bench.hardware.group.reason) == "a test"


def test_a_board_that_is_reset_at_rest_is_only_told_its_watchdog() -> None:
    bench = BoardBench()
    bench.hardware.connect()
    bench.turn(0.5)
    bench.enable()
    bench.board.reset(bench.clock.time)
    bench.turn(2.0)
    assert bench.hardware.group.reason is None
    assert not bench.board.state.stopped
    assert bench.board.state.watchdog_timeout == 1.0
    assert bench.board.state.report_due is not None


def test_power_that_fails_on_the_way() -> None:
    bench, told = moving(faults=("brownout:2.5:1.0",))
    bench.until(lambda: told.ends)
    assert told.ends[0].outcome is Outcome.ABORTED
    bench.until(lambda: bench.hardware.connected and bench.clock.time > 1006.0)
    bench.turn(1.0)
    assert bench.hardware.group.reason is not None
    assert bench.arm.torques() == [False] * 7
    assert bench.board.state.watchdog_timeout == 1.0


def test_a_state_that_is_old_is_nothing_to_begin_at() -> None:
    bench = BoardBench()
    bench.hardware.connect()
    bench.turn(0.5)
    bench.hardware.newest()
    bench.clock.advance(1.01)
    with pytest.raises(DeviceError, match=r"told nothing for 1\.0 s"):
        bench.hardware.newest()
    bench.hardware.turn()
    bench.hardware.newest()


def test_on_a_slow_line_states_are_good_for_longer() -> None:
    bench = BoardBench(command_rate=1.5)
    bench.hardware.connect()
    bench.clock.advance(1.9)
    bench.hardware.newest()
    bench.clock.advance(0.2)
    with pytest.raises(DeviceError, match="told nothing"):
        bench.hardware.newest()


# -- jobs ---------------------------------------------------------------------------------------------------------


def test_a_job_that_finds_the_link_lost_tells_both() -> None:
    bench = BoardBench()
    bench.hardware.connect()
    bench.turn(0.3)

    def job() -> None:
        bench.link.lost = True
        bench.robot.read()

    with pytest.raises(LinkLostError, match="unplugged"):
        bench.ask(lambda: bench.hardware.call(job))
    assert not bench.hardware.connected


def test_a_job_that_is_refused_tells_only_the_one_who_asked() -> None:
    bench = BoardBench()
    bench.hardware.connect()
    bench.turn(0.3)

    def job() -> None:
        raise UsageError("not like this")

    with pytest.raises(UsageError, match="not like this"):
        bench.ask(lambda: bench.hardware.call(job))
    assert bench.hardware.connected


def test_nobody_waits_for_a_robot_that_was_lost_that_moment() -> None:
    bench = BoardBench()
    hardware = bench.hardware
    hardware.connect()
    bench.turn(0.3)
    bench.link.lost = True
    # As if the loss came between the look at `connected` and the queue.
    with pytest.raises(LinkLostError, match="cannot be reached"):
        bench.ask(lambda: hardware._jobs.call(lambda: None))
    assert not hardware.connected


# -- coming -------------------------------------------------------------------------------------------------------


def test_a_port_that_comes_in_time() -> None:
    bench = BoardBench()
    bench.link.lost = True
    begun = bench.clock.time

    def sleep(seconds: float) -> None:
        bench.clock.advance(seconds)
        bench.link.lost = bench.clock.time < begun + 3.0

    bench.hardware._sleep = sleep
    bench.hardware.connect(10.0)
    assert bench.hardware.connected
    assert 3.0 <= bench.clock.time - begun < 4.5


@pytest.mark.parametrize("timeout", [0.0, 10.0])
def test_a_port_that_does_not_come(timeout: float) -> None:
    bench = BoardBench()
    bench.link.lost = True
    begun = bench.clock.time
    with pytest.raises(LinkLostError, match="is unplugged"):
        bench.hardware.connect(timeout)
    assert timeout <= bench.clock.time - begun <= timeout + 0.5
    assert not bench.hardware.connected
    bench.hardware.shutdown()


def test_a_port_that_is_not_ours_is_not_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = BoardBench()
    begun = bench.clock.time

    def refuse() -> None:
        raise LinkPermissionError("not for you")

    monkeypatch.setattr(bench.link, "open", refuse)
    with pytest.raises(LinkPermissionError):
        bench.hardware.connect(10.0)
    assert bench.clock.time == begun


def test_nobody_answers() -> None:
    bench = BoardBench(faults=("boot:1000",))
    bench.robot._boot_window = 2.0
    begun = bench.clock.time
    with pytest.raises(ReplyTimeoutError, match="IDENTIFY"):
        bench.hardware.connect(10.0)
    assert 10.0 <= bench.clock.time - begun < 16.0
    assert not bench.link.is_open


def test_no_watchdog_runs_before_somebody_feeds_it() -> None:
    bench = BoardBench()
    bench.hardware.connect()
    bench.arm.wait(5.0)
    bench.turn(2.0)
    assert bench.board.state.watchdog_trips == 0
    assert bench.hardware.watchdog == 1.0


# -- going --------------------------------------------------------------------------------------------------------


def test_the_end_at_rest_leaves_the_board_as_it_was() -> None:
    bench = BoardBench()
    bench.hardware.connect()
    bench.turn(0.3)
    bench.enable()
    bench.hardware.shutdown()
    state = bench.board.state
    assert (state.stopped, state.watchdog_timeout, state.report_due) == (False, 0.0, None)
    assert bench.arm.torques() == [True] * 7
    assert not bench.link.is_open
    assert not bench.hardware.connected
    bench.hardware.shutdown()
    with pytest.raises(LinkLostError, match="has ended"):
        bench.hardware.call(lambda: None)


def test_the_end_on_the_way_stops_the_arm() -> None:
    bench, told = moving()
    bench.hardware.shutdown()
    assert told.text == "aborted: stopped: the node ends"
    state = bench.board.state
    assert (state.stopped, state.watchdog_timeout, state.report_due) == (True, 0.0, None)
    assert bench.arm.torques() == [True] * 7


def test_the_end_with_torque_off() -> None:
    bench = BoardBench()
    bench.hardware.connect()
    bench.turn(0.3)
    bench.enable()
    bench.hardware.shutdown(torque_off=True)
    assert bench.arm.torques() == [False] * 7


def test_the_end_without_a_robot() -> None:
    bench, told = moving()
    bench.link.lost = True
    bench.turn(2.0)
    bench.hardware.shutdown(torque_off=True)
    bench.hardware.shutdown()
    assert len(told.ends) == 1
    Hardware(bench.robot).shutdown()


# -- other robots -------------------------------------------------------------------------------------------------


@pytest.fixture
def bus_bench(monkeypatch: pytest.MonkeyPatch) -> Bench:
    bus, _ = make_bus(tuple(range(1, 7)), baud=1_000_000)
    bus.close()
    monkeypatch.setattr("hexwire.ipc.handle.make_link", lambda url: bus.link, raising=False)
    from hexwire.ipc import open as ipc_open

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


@pytest.mark.parametrize("which", ["bus_bench", "puma_bench"])
def test_robots_without_a_watchdog(which: str, request: pytest.FixtureRequest) -> None:
    bench: Bench = request.getfixturevalue(which)
    hardware = bench.hardware
    hardware.connect()
    bench.turn(2.0)
    assert hardware.rate == pytest.approx(100, rel=0.03)
    assert hardware.watchdog == 0.0
    bench.enable()
    joint = bench.robot.model.names[0]
    start = hardware.newest()[joint].position
    told = bench.go(joint, 0.3, 3.0)
    bench.until(lambda: told.ends)
    assert told.text == "succeeded: "
    bench.turn(0.5)
    assert hardware.newest()[joint].position == pytest.approx(start + 0.3, abs=0.03)
    told = bench.go(joint, -0.3, 3.0)
    bench.turn(1.0)
    assert hardware.stop("a test") == bench.robot.model.names
    assert told.text == "aborted: stopped: a test"
    bench.turn(0.5)
    bench.ask(hardware.reset)
    bench.turn(0.5)
    assert hardware.group.reason is None
    told = bench.go(joint, -0.1, 3.0)
    bench.turn(1.0)
    link = bench.robot.session.ipc.link
    link.lost = True
    bench.until(lambda: told.ends)
    assert "unplugged" in told.text
    link.lost = False
    bench.until(lambda: hardware.connected)
    bench.turn(0.5)
    assert hardware.reconnects == 1
    hardware.shutdown()
    assert not link.is_open


# -- with threads, over a real line -------------------------------------------------------------------------------


class Served:
    """A board behind a pseudo-terminal, served by a thread; `mute` has it hear everything and say nothing."""

    def __init__(self, baud: int = 0, dialect: int = 2) -> None:
        self.board = make_hex7bot_board(dialect=dialect, baud=baud, start=time.monotonic())
        out = self.board.faults.host_out
        self.muted = threading.Event()
        self.board.faults.host_out = (  # type: ignore[method-assign]  # a fault that begins in mid-run
            lambda data, now: b"" if self.muted.is_set() else out(data, now)
        )
        self._server = PtyServer(self.board)
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._serve)

    def _serve(self) -> None:
        while not self._end.is_set():
            self._server.run_once(0.02)

    def __enter__(self) -> Served:
        self.url = self._server.open()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._end.set()
        self._thread.join(10)
        self._server.close()


def wait_for(condition: Callable[[], object]) -> None:
    deadline = time.monotonic() + 30
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.01)


class Threaded:
    """A node's hardware with its thread, on a served board. Its watchdog is long: these machines stall."""

    def __init__(self, served: Served, **options: Any) -> None:
        self.driver = Hex7BotDriver.from_url(served.url)
        self.hardware = Hardware(self.driver, **({"watchdog": 20.0} | options))
        self.hardware.connect(10.0)
        self.controller = make_controller(self.driver.model, period=0.5)
        self.hardware.start((self.controller,))

    def go(self, joint: str, by: float, seconds: float) -> Told:
        told, hardware = Told(), self.hardware
        state = hardware.newest()
        order = TrajectoryOrder((joint,), (Point(seconds, (state[joint].position + by,)),))
        with hardware.locked():
            self.controller.accept(order, state, hardware.now(), goal=told)
        hardware.hurry()
        return told


@pytest.fixture
def served() -> Iterator[Served]:
    with Served() as board:
        yield board


def test_a_life_with_its_own_thread(served: Served) -> None:
    node = Threaded(served)
    hardware, names = node.hardware, node.driver.model.names
    assert hardware.torque(True, names) == names
    told = node.go("J1", 0.05, 1.0)
    wait_for(lambda: told.ends)
    assert told.text == "succeeded: "
    told = node.go("J1", 0.4, 20.0)
    time.sleep(0.3)
    assert hardware.stop("a test") == names
    assert told.text == "aborted: stopped: a test"
    hardware.reset()
    assert hardware.group.reason is None
    assert hardware.call(threading.current_thread) is not threading.current_thread()
    assert hardware.call(lambda: hardware.call(lambda: 7)) == 7
    told = node.go("J1", 0.4, 20.0)
    time.sleep(0.3)
    hardware.shutdown()
    assert not hardware.alive
    assert told.text == "aborted: stopped: the node ends"
    state = served.board.state
    assert (state.stopped, state.watchdog_timeout, state.report_due) == (True, 0.0, None)


@pytest.mark.parametrize("publish_rate", [100.0, 4.0])
def test_stops_from_several_threads_while_the_owner_waits(served: Served, publish_rate: float) -> None:
    node = Threaded(served, publish_rate=publish_rate)
    hardware, names = node.hardware, node.driver.model.names
    answers: list[tuple[str, ...]] = []

    def keep_stopping() -> None:
        answers.extend(hardware.stop("a test") for _ in range(30))

    threads = [threading.Thread(target=keep_stopping) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60)
    assert answers == [names] * 90
    assert hardware.connected
    assert hardware.reconnects == 0
    # Reports go on, or soon again.
    before = hardware.newest()
    wait_for(lambda: hardware.newest() is not before)
    hardware.reset()
    assert hardware.torque(True, names) == names
    hardware.shutdown()
    assert served.board.state.report_due is None


def test_a_stop_of_a_board_that_says_nothing_fails_in_time_and_all_is_stopped(served: Served) -> None:
    node = Threaded(served)
    node.hardware.torque(True, node.driver.model.names)
    told = node.go("J1", 0.4, 20.0)
    served.muted.set()
    with pytest.raises(HexwireError):
        node.hardware.stop("a test")
    assert told.text == "aborted: stopped: a test"
    wait_for(lambda: not node.hardware.connected)
    with pytest.raises(LinkLostError):
        node.hardware.reset()
    node.hardware.shutdown()
    assert not node.hardware.alive


def test_nobody_waits_for_ever_for_a_board_that_falls_silent(served: Served) -> None:
    node = Threaded(served)
    served.muted.set()
    with pytest.raises(HexwireError):
        node.hardware.torque(True, node.driver.model.names)
    node.hardware.shutdown()
    assert not node.hardware.alive


def test_the_end_while_the_owner_looks_for_a_robot(served: Served) -> None:
    node = Threaded(served)
    node.driver._boot_window = 600.0
    served.muted.set()
    wait_for(lambda: not node.hardware.connected and node.driver.session.is_open)
    node.hardware.shutdown(torque_off=True)
    assert not node.hardware.alive
    assert node.hardware.crash is None
    assert not node.driver.session.is_open


def test_a_fault_of_the_program_is_told_and_stops_the_arm(served: Served) -> None:
    broken = threading.Event()

    def on_state(state: JointState, published: PublishedState) -> None:
        if broken.is_set():
            raise RuntimeError("a fault of the program")

    node = Threaded(served, on_state=on_state)
    hardware = node.hardware
    hardware.torque(True, node.driver.model.names)
    told = node.go("J1", 0.4, 20.0)
    broken.set()
    wait_for(lambda: not hardware.alive)
    assert isinstance(hardware.crash, RuntimeError)
    assert told.text == "aborted: stopped: the node failed: a fault of the program"
    assert served.board.state.stopped
    for call in (hardware.newest, hardware.reset):
        with pytest.raises(DeviceError, match="the node failed: a fault"):
            call()
    hardware.shutdown()
    state = served.board.state
    assert (state.watchdog_timeout, state.report_due) == (0.0, None)


def test_an_owner_who_does_not_come_back_keeps_nobody_from_ending(
    served: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hexwire.ros1.hardware._PATIENCE", 1.0)
    stick, stuck, free = threading.Event(), threading.Event(), threading.Event()

    def on_state(state: JointState, published: PublishedState) -> None:
        if stick.is_set():
            stuck.set()
            free.wait(60)

    node = Threaded(served, on_state=on_state)
    node.hardware.torque(True, node.driver.model.names)
    told = node.go("J1", 0.4, 20.0)
    time.sleep(0.2)
    stick.set()
    assert stuck.wait(30)
    node.hardware.shutdown()
    assert told.text == "aborted: stopped: the node ends"
    # It was told before anybody waited for the thread.
    assert served.board.state.stopped
    assert node.hardware.alive
    free.set()
    wait_for(lambda: not node.hardware.alive)
    assert not node.driver.session.is_open
