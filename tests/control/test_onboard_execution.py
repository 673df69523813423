"""Goals whose time the board keeps, with everything of a node but its messages; in simulated time."""

from __future__ import annotations

import math
from contextlib import suppress
from itertools import pairwise, product
from typing import Any

import pytest
from tests.control.arm_bench import CANCELLED, NOT_READY, PREEMPTED, SPLIT, STOPPED, SUCCEEDED, Bench, Told, order
from tests.control.shared_bench import SharedBench
from tests.few import few
from tests.motion.arms import HOME, NAMES

from hexwire.control.loop.outcomes import Outcome, Reason
from hexwire.control.motion.board_path_feeder import PathBrake
from hexwire.control.motion.goals import Point, TrajectoryGoal
from hexwire.control.sharing.lease import Lease
from hexwire.drivers.board2_path import Board2Path
from hexwire.drivers.timed_path import PathState, TimedPoint
from hexwire.epochs import Token
from hexwire.errors import LeaseError, StoppedError
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.model.state import JointState, JointTarget
from hexwire.motion.safety import StopReason
from hexwire.wire.command_frame import Command
from hexwire.wire.commands import LimitRow

J1 = HOME["J1"]


class Timed(Bench):
    """A bench that counts what is sent, and stalls."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**({"check_table": False} | options))
        self.targets: list[tuple[float, JointTarget]] = []
        write = self.owner.robot.write

        def noted(target: JointTarget) -> Any:
            self.targets.append((self.clock.time, target))
            return write(target)

        self.owner.robot.write = noted  # type: ignore[method-assign]  # it watches
        self.ask(lambda: self.arm.enable(True))

    @property
    def state(self) -> PathState:
        return self.board.trajectory.state

    def go(self, by: float = 0.6, seconds: float = 2.0, **options: Any) -> Told:
        return self.command(order((seconds, {"J1": J1 + by}), still=True), **options)

    def commands(self) -> list[int]:
        return self.emulated.commands()

    def stall(self, seconds: float) -> None:
        """The program does nothing meanwhile; the board goes on."""
        self.emulated.wait(seconds)

    def speeds(self, joint: str = "J1") -> list[float]:
        """Of a shaft, between turns."""
        i, scale = HEX7BOT.joint(joint).servo_id, HEX7BOT.joint(joint).scale
        return [(b[1][i] - a[1][i]) * scale / (b[0] - a[0]) for a, b in pairwise(self.track) if b[0] - a[0] > 1e-6]


def at(bench: Timed, joint: str = "J1") -> float:
    return bench.where(joint) - HOME[joint]


def test_a_goal_is_followed_by_the_board_and_no_target_is_sent() -> None:
    bench = Timed()
    told = bench.go(by=0.3, seconds=1.0)
    bench.turn(0.5)
    assert bench.state is PathState.RUNNING
    bench.until(lambda: told.ends)
    assert told.outcome == SUCCEEDED
    assert not bench.targets
    assert at(bench) == pytest.approx(0.3, abs=0.01)
    bench.turn(0.3)
    assert bench.state is PathState.DONE
    assert bench.owner.running() == ()


def test_a_goal_from_rest_begins_at_once() -> None:
    bench = Timed()
    for by in (0.3, -0.1):
        sent = bench.clock.time
        told = bench.go(by, seconds=1.0)
        bench.until(lambda: bench.state is PathState.RUNNING)
        assert bench.clock.time - sent <= 0.03
        (generator,) = (one.generator for one in bench.arm.controllers.values())
        # What the host plans with is what the board does, not when it was asked.
        assert generator.planned[0][1] == pytest.approx(bench.board.trajectory.start_at, abs=0.003)
        bench.until(lambda told=told: told.ends)  # type: ignore[misc]
        assert told.outcome == SUCCEEDED
        assert not bench.targets
        bench.turn(0.3)


def test_the_old_way_is_a_setting() -> None:
    bench = Timed(host_timed=True)
    told = bench.go(by=0.3, seconds=1.0)
    bench.until(lambda: told.ends)
    assert told.outcome == SUCCEEDED
    assert bench.targets
    assert Command.TRAJECTORY_BEGIN not in bench.commands()


def test_a_board_of_the_chapters_dialect_gets_targets() -> None:
    bench = Timed(dialect=1, publish_rate=1.0)
    told = bench.go(seconds=8.0)
    bench.until(lambda: told.ends)
    assert told.outcome == SUCCEEDED
    assert bench.targets


def test_a_stall_of_the_program_does_not_delay_the_goal() -> None:
    bench = Timed()
    told = bench.go()
    began = bench.clock.time
    bench.turn(0.6)
    bench.stall(0.8)
    bench.until(lambda: told.ends)
    assert told.outcome == SUCCEEDED
    assert bench.clock.time - began < 2.4
    assert bench.controller.generator.counters.slips == 0


@pytest.mark.slow
def test_torque_that_is_on_can_be_switched_on_while_the_board_comes_to_rest() -> None:
    bench = Timed()
    told = bench.go(by=1.0, seconds=4.0)
    bench.turn(1.5)
    bench.owner.group.cancel(told)
    bench.turn(0.05)
    assert bench.state is PathState.RUNNING
    assert bench.ask(lambda: bench.arm.enable(True)) == "torque is on"
    bench.turn(1.0)
    assert bench.state is PathState.DONE


def test_a_goal_that_ends_while_the_program_is_suspended_has_succeeded() -> None:
    tolerances = {"goal_time": 0.3, "J1": {"goal": 0.05, "trajectory": 0.1}}
    bench = Timed(constraints=tolerances, watchdog=3.0)
    told = bench.go(seconds=1.0)
    bench.turn(0.5)
    bench.stall(2.0)
    bench.until(lambda: told.ends)
    assert told.outcome == SUCCEEDED


@pytest.mark.slow
def test_a_long_goal_is_sent_while_it_runs() -> None:
    bench = Timed()
    told = bench.go(by=0.5, seconds=5.0)
    bench.until(lambda: told.ends)
    assert told.outcome == SUCCEEDED
    assert bench.board.trajectory.late == 0
    assert not bench.targets


def test_a_new_goal_replaces_the_running_one_without_a_jump() -> None:
    bench = Timed()
    first = bench.go(by=0.8)
    bench.turn(0.9)
    began = bench.commands().count(Command.TRAJECTORY_BEGIN)
    second = bench.go(by=-0.3, seconds=2.5)
    assert first.outcome == PREEMPTED
    bench.until(lambda: second.ends)
    assert second.outcome == SUCCEEDED
    assert at(bench) == pytest.approx(-0.3, abs=0.01)
    assert not bench.targets
    assert bench.commands().count(Command.TRAJECTORY_BEGIN) == began
    assert max(abs(b - a) for a, b in pairwise(bench.speeds())) < 0.4


@pytest.mark.slow
def test_many_goals_one_after_the_other_are_one_path() -> None:
    bench = Timed()
    for i in range(10):
        told = bench.go(by=0.1 * (i + 1), seconds=1.0)
        bench.turn(0.21)
    bench.until(lambda: told.ends)
    assert told.outcome == SUCCEEDED
    assert at(bench) == pytest.approx(1.0, abs=0.01)
    assert bench.commands().count(Command.TRAJECTORY_BEGIN) == 1
    assert not bench.targets


@pytest.mark.slow
def test_a_goal_right_after_the_end_of_another() -> None:
    bench = Timed()
    for i, pause in enumerate((0.0, 0.05, 0.11, 0.2)):
        by = 0.3 if i % 2 else 0.0
        told = bench.go(by=0.3 - by, seconds=0.6)
        began = bench.clock.time
        bench.turn(0.6 + pause)
        after = bench.go(by=by, seconds=0.6)
        bench.until(lambda told=after: told.ends)  # type: ignore[misc]
        assert told.ends
        assert after.outcome == SUCCEEDED
        assert bench.clock.time - began < 2.0
        assert at(bench) == pytest.approx(by, abs=0.01)
    assert not bench.targets


def test_a_cancelled_goal_comes_to_rest_on_its_path() -> None:
    bench = Timed()
    told = bench.go(by=0.8)
    bench.turn(1.0)
    here = at(bench)
    bench.owner.group.cancel(told)
    assert told.outcome == CANCELLED
    bench.turn(0.4)
    stood = at(bench)
    assert here < stood < here + 0.15
    bench.turn(1.0)
    assert at(bench) == pytest.approx(stood, abs=0.003)
    assert bench.state is PathState.DONE
    # From there on everything is as ever.
    told = bench.go(by=0.0, seconds=1.0)
    bench.until(lambda: told.ends)
    assert told.outcome == SUCCEEDED


@pytest.mark.slow
def test_a_pose_that_replaces_a_goal_begins_where_the_joints_come_to_rest() -> None:
    bench = Timed(poses={"home": dict(HOME)})
    told = bench.go(by=0.8)
    bench.turn(1.0)
    assert bench.ask(lambda: bench.arm.go_to("home")) == "at home"
    assert told.outcome == PREEMPTED
    assert at(bench) == pytest.approx(0.0, abs=0.01)
    assert max(abs(b - a) for a, b in pairwise(bench.speeds())) < 0.4
    assert not bench.targets


def test_a_goal_for_later_begins_exactly_then() -> None:
    bench = Timed()
    due = bench.clock.time + 0.7
    points = order((1.0, {"J1": J1 + 0.3})).points
    told = bench.command(TrajectoryGoal(NAMES, points, delay=0.7))
    bench.turn(0.65)
    assert bench.state is PathState.WAITING
    assert bench.board.trajectory.start_at == pytest.approx(due, abs=0.003)
    bench.until(lambda: told.ends)
    assert told.outcome == SUCCEEDED


@pytest.mark.slow
@pytest.mark.parametrize("before", [0.4, 0.1, 0.05])
def test_a_goal_that_is_cancelled_before_its_time_moves_nothing(before: float) -> None:
    bench = Timed()
    points, place = order((1.0, {"J1": J1 + 0.5})).points, at(bench)
    told = bench.command(TrajectoryGoal(NAMES, points, delay=0.7))
    bench.turn(0.7 - before)
    bench.owner.group.cancel(told)
    bench.turn(1.5)
    assert told.outcome == CANCELLED
    assert at(bench) == pytest.approx(place, abs=0.003)
    assert bench.state in (PathState.ABORTED, PathState.NONE)


def test_a_stop_ends_it_and_a_reset_does_not_continue_it() -> None:
    bench = Timed()
    told = bench.go()
    bench.turn(0.7)
    bench.ask(lambda: bench.arm.stop("somebody asks"))
    assert told.outcome == STOPPED
    assert bench.state is PathState.STOPPED
    bench.turn(0.2)
    place = at(bench)
    bench.ask(bench.arm.reset)
    bench.turn(2.0)
    assert at(bench) == pytest.approx(place, abs=0.003)
    told = bench.go(by=0.0, seconds=1.0)
    bench.until(lambda: told.ends)
    assert told.outcome == SUCCEEDED


def test_a_stop_that_a_path_tells_of_is_not_another_one() -> None:
    bench = Timed()
    told = bench.go()
    bench.turn(0.7)
    onboard = bench.owner._output._onboard
    assert onboard is not None
    after: list[Token] = []

    def stopped(state: JointState) -> StopReason | None:
        bench.arm.stop("somebody asks")
        after.append(bench.arm.mark())
        path = onboard.feeder.path
        assert path is not None
        return onboard._see(path.report(), state)

    onboard._follow = stopped  # type: ignore[method-assign]  # from another thread, meanwhile
    bench.until(lambda: told.ends)
    assert told.outcome == STOPPED
    assert bench.arm.mark() == after[0]
    bench.ask(lambda: bench.arm.reset(after[0]))
    assert bench.owner.group.reason is None


@pytest.mark.slow
def test_a_stop_from_elsewhere_that_has_been_cleared_already_ends_it() -> None:
    bench = Timed()
    told = bench.go()
    bench.turn(0.5)
    bench.board.trajectory.stop()
    bench.turn(0.3)
    assert told.outcome == STOPPED
    place = at(bench)
    bench.turn(2.0)
    assert at(bench) == pytest.approx(place, abs=0.003)


def test_a_program_that_is_suspended_for_longer_than_the_watchdog_finds_the_arm_stopped() -> None:
    bench = Timed()
    told = bench.go(by=0.8, seconds=5.0)
    bench.turn(0.5)
    bench.stall(1.6)
    bench.turn(0.2)
    assert told.outcome == STOPPED
    assert "watchdog" in told.text
    place = at(bench)
    bench.turn(2.0)
    assert at(bench) == pytest.approx(place, abs=0.003)


@pytest.mark.slow
def test_without_a_watchdog_a_suspended_program_goes_on_where_the_arm_came_to_rest() -> None:
    bench = Timed(watchdog=0.0)
    told = bench.go(by=0.8, seconds=8.0)
    bench.turn(1.0)
    bench.stall(5.0)
    assert bench.state is PathState.DONE, "the brake that every part of a path ends with"
    rested = at(bench)
    assert 0.05 < rested < 0.7
    bench.until(lambda: told.ends)
    assert told.outcome == SUCCEEDED
    assert bench.controller.generator.counters.slips == 1
    assert min(bench.speeds()) > -0.05
    assert at(bench) == pytest.approx(0.8, abs=0.01)


@pytest.mark.slow
def test_a_goal_whose_time_is_over_when_the_program_goes_on_is_not_taken_for_reached() -> None:
    bench = Timed(watchdog=0.0)
    told = bench.go(by=0.5, seconds=4.0)
    bench.turn(1.0)
    bench.stall(3.5)
    assert bench.state is PathState.DONE, "the brake that every part of a path ends with"
    assert at(bench) < 0.45
    bench.until(lambda: told.ends)
    assert told.outcome == SUCCEEDED
    assert at(bench) == pytest.approx(0.5, abs=0.01)


def test_a_joint_that_falls_silent_stops_the_arm() -> None:
    bench = Timed()
    told = bench.go(seconds=4.0)
    bench.turn(0.7)
    bench.silence("J5")
    bench.until(lambda: told.ends)
    assert told.outcome == STOPPED
    assert "J5 has not answered for" in told.text
    place = at(bench)
    bench.turn(1.0)
    assert at(bench) == pytest.approx(place, abs=0.003)


@pytest.mark.slow
def test_a_joint_that_falls_silent_is_named_also_if_the_newest_state_does_not_show_it() -> None:
    bench = Timed()
    told = bench.go(seconds=4.0)
    bench.turn(0.7)
    # A state from before: what the board says of the path overtakes those after it.
    old = bench.owner.newest()
    onboard = bench.owner._output._onboard
    assert onboard is not None
    see = onboard._see
    onboard._see = lambda report, state: see(report, old)  # type: ignore[method-assign]  # only what it knows differs
    bench.silence("J5")
    bench.until(lambda: told.ends)
    assert told.outcome == STOPPED
    assert "J5 has not answered for" in told.text


def test_torque_that_another_program_takes_away_ends_the_goal() -> None:
    bench = Timed()
    told = bench.go(seconds=4.0)
    bench.turn(0.7)
    bench.ask(lambda: bench.owner.robot.torque(False, ["J5"]))
    bench.until(lambda: told.ends)
    assert told.outcome == NOT_READY
    bench.turn(0.4)
    place = at(bench)
    bench.turn(1.0)
    assert at(bench) == pytest.approx(place, abs=0.003)


@pytest.mark.slow
def test_torque_off_ends_the_goal_and_the_other_joints_come_to_rest() -> None:
    bench = Timed()
    told = bench.go(seconds=4.0)
    bench.turn(0.7)
    bench.ask(lambda: bench.owner.torque(False, ["J5"]))
    assert told.outcome == NOT_READY
    assert "torque was switched off" in told.text
    bench.turn(0.9)
    place = at(bench)
    bench.turn(1.0)
    assert at(bench) == pytest.approx(place, abs=0.003)
    bench.ask(lambda: bench.owner.torque(True, NAMES))
    told = bench.go(by=0.0)
    bench.until(lambda: told.ends)
    assert told.outcome == SUCCEEDED


def test_off_its_path_a_goal_comes_to_rest() -> None:
    bench = Timed(constraints={"J1": {"trajectory": 0.06, "goal": 0.05}}, safety={"following_error": 1.0})
    told = bench.go(seconds=3.0)
    bench.turn(0.7)
    bench.jam("J1")
    bench.until(lambda: told.ends)
    assert told.outcome == (Outcome.ABORTED, Reason.PATH_TOLERANCE)
    bench.turn(0.5)
    assert bench.state is PathState.DONE


@pytest.mark.slow
def test_set_points_replace_a_goal_once_the_joints_are_at_rest() -> None:
    bench = Timed()
    told = bench.go(by=0.8)
    bench.turn(1.0)
    for _ in range(40):
        bench.arm.set_points({"J1": J1 - 0.2})
        bench.turn(0.05)
    assert told.outcome == PREEMPTED
    assert bench.targets
    assert at(bench) == pytest.approx(-0.2, abs=0.02)
    assert bench.owner.group.reason is None
    told = bench.go(by=0.2)
    bench.until(lambda: told.ends)
    assert told.outcome == SUCCEEDED


@pytest.mark.slow
def test_controllers_that_begin_together_share_a_path_and_another_one_gets_targets() -> None:
    bench = Timed(controllers=SPLIT)
    (whole,) = order((2.0, {"J1": J1 + 0.5, "J7": 0.3}), still=True).points

    def goal(names: tuple[str, ...]) -> TrajectoryGoal:
        places = [NAMES.index(name) for name in names]
        positions = tuple(whole.positions[i] for i in places)
        return TrajectoryGoal(names, (Point(2.0, positions, (0.0,) * len(names)),))

    both = [bench.command(goal(NAMES[:6]), "arm"), bench.command(goal(("J7",)), "hand")]
    bench.until(lambda: all(told.ends for told in both))
    assert [told.outcome for told in both] == [SUCCEEDED, SUCCEEDED]
    assert not bench.targets
    bench.turn(0.3)
    back = TrajectoryGoal(NAMES[:6], (Point(2.0, tuple(HOME[name] for name in NAMES[:6])),))
    arm = bench.command(back, "arm")
    bench.turn(0.6)
    hand = bench.command(TrajectoryGoal(("J7",), (Point(0.5, (0.0,), (0.0,)),)), "hand")
    bench.until(lambda: hand.ends and arm.ends)
    assert (arm.outcome, hand.outcome) == (SUCCEEDED, SUCCEEDED)
    assert {name for _, target in bench.targets for name, _ in target.positions} == {"J7"}


@pytest.mark.slow
def test_where_the_board_refuses_a_path_targets_are_sent(caplog: pytest.LogCaptureFixture) -> None:
    bench = Timed()
    limits = list(bench.owner.robot.limits())  # type: ignore[attr-defined]
    slow = LimitRow(limits[0].minimum, limits[0].maximum, 60)
    bench.owner.robot.store_limits([slow if i == 0 else row for i, row in enumerate(limits)])  # type: ignore[attr-defined]
    told = bench.go(by=0.3, seconds=0.5)
    bench.until(lambda: told.ends)
    assert told.outcome == SUCCEEDED
    assert bench.targets
    assert [row.levelname for row in caplog.records] == ["WARNING"]


@pytest.mark.slow
def test_where_the_board_refuses_a_later_part_targets_are_sent_from_there(caplog: pytest.LogCaptureFixture) -> None:
    bench = Timed()
    limits = list(bench.owner.robot.limits())  # type: ignore[attr-defined]
    slow = LimitRow(limits[0].minimum, limits[0].maximum, 150)
    bench.owner.robot.store_limits([slow if i == 0 else row for i, row in enumerate(limits)])  # type: ignore[attr-defined]
    rows = ((3.0, {"J1": J1 + 0.05}), (3.5, {"J1": J1 + 0.4}))
    told = bench.command(order(*rows))
    bench.turn(1.0)
    assert not bench.targets
    bench.until(lambda: told.ends)
    assert told.outcome == SUCCEEDED
    assert bench.targets
    assert "one by one from here" in caplog.text
    assert [row.levelname for row in caplog.records] == ["WARNING"]


def test_a_reset_of_the_board_stops_the_arm() -> None:
    bench = Timed()
    told = bench.go(seconds=4.0)
    bench.turn(0.7)
    bench.board.reset(bench.clock.time)
    bench.turn(0.5)
    assert told.outcome == STOPPED
    place = at(bench)
    bench.turn(1.0)
    assert at(bench) == pytest.approx(place, abs=0.003)


def test_another_program_that_begins_a_path_ends_the_goal() -> None:
    bench = Timed()
    told = bench.go(seconds=4.0)
    bench.turn(0.7)
    board = bench.board.trajectory
    board.number = (board.number + 1) & 0xFF
    bench.turn(0.3)
    assert told.outcome == STOPPED
    assert "another program began another path" in told.text


@pytest.mark.slow
@pytest.mark.parametrize("outlives", [False, True])
def test_a_path_of_another_program_is_left_alone_unless_it_outlives_it(outlives: bool) -> None:
    bench = Timed()
    robot = bench.owner.robot
    here = robot.read().positions["J1"]
    path = robot.path(["J1"], outlives=outlives)
    path.send(
        [TimedPoint(0.2 * i, (here + 0.02 * i,), (0.1 if 0 < i < 10 else 0.0,)) for i in range(11)], last=True
    )
    path.start()
    bench.turn(0.3)
    told = bench.go()
    if outlives:
        bench.until(lambda: told.ends)
        assert told.outcome == SUCCEEDED
        assert path.report().state is not PathState.DONE
        return
    bench.turn(0.3)
    assert told.outcome == NOT_READY
    assert "busy" in told.text
    bench.turn(2.0)
    assert path.report().state is PathState.DONE
    assert bench.where("J1") == pytest.approx(here + 0.2, abs=0.01)


@pytest.mark.slow
def test_a_board_whose_clock_is_slow_is_followed_in_its_own_time(monkeypatch: pytest.MonkeyPatch) -> None:
    # 5 percent over some seconds count as much as a resonator's 0.5 percent over a minute.
    monkeypatch.setattr("hexwire.emulator.board_path.POINT_TIME", 1.05e-4)
    bench = Timed(constraints={"J1": {"trajectory": 0.1, "goal": 0.02}})
    rows = [(0.8 * i, {"J1": J1 + (0.6 if i % 2 else 0.0)}) for i in range(1, 8)]
    told = bench.command(order(*rows, still=True))
    bench.until(lambda: told.ends)
    assert told.outcome == SUCCEEDED
    assert not bench.targets


@pytest.mark.slow
def test_an_unplugged_board_comes_to_rest_and_is_there_again_stopped() -> None:
    bench = Timed()
    told = bench.go(seconds=6.0, by=0.8)
    bench.turn(0.7)
    bench.link.lost = True
    bench.turn(0.5)
    assert told.outcome == STOPPED
    bench.stall(2.0)
    place = at(bench)
    bench.link.lost = False
    bench.until(lambda: bench.owner.connected)
    bench.turn(2.0)
    assert at(bench) == pytest.approx(place, abs=0.003)
    bench.ask(bench.arm.reset)
    bench.ask(lambda: bench.arm.enable(True))
    told = bench.go(by=0.0, seconds=3.0)
    bench.until(lambda: told.ends)
    assert told.outcome == SUCCEEDED


def test_the_end_of_the_program_stops_a_path() -> None:
    bench = Timed()
    bench.go(seconds=6.0, by=0.8)
    bench.turn(0.7)
    bench.arm.shutdown()
    assert bench.state is PathState.STOPPED


def smooth(bench: Timed) -> bool:
    """The speed never jumped, as far as turns show it."""
    changes = [
        abs(b - a)
        for (a, b), (before, after) in zip(
            pairwise(bench.speeds()), pairwise([t for t, _ in bench.track][1:]), strict=False
        )
        if after - before < 0.015
    ]
    return max(changes) < 0.45


@pytest.mark.slow
def test_over_a_slow_network_the_board_is_told_earlier() -> None:
    bench = Timed()
    robot = bench.owner.robot
    begin = robot.path

    def slowly(call: Any) -> Any:
        def late(*given: Any, **more: Any) -> Any:
            bench.stall(0.06)
            answer = call(*given, **more)
            bench.stall(0.06)
            return answer

        return late

    def path(*given: Any, **more: Any) -> Any:
        made = slowly(begin)(*given, **more)
        for name in ("send", "start", "report", "abort"):
            setattr(made, name, slowly(getattr(made, name)))
        return made

    robot.path = path  # type: ignore[method-assign]
    told = bench.go(by=0.3, seconds=2.0)
    bench.turn(1.0)
    for by in (0.5, 0.1):
        told = bench.go(by=by, seconds=3.0)
        bench.turn(1.2)
    bench.until(lambda: told.ends)
    assert told.outcome == SUCCEEDED
    assert at(bench) == pytest.approx(0.1, abs=0.01)
    # It never had to come to rest in between.
    assert bench.controller.generator.counters.slips == 0
    assert bench.commands().count(Command.TRAJECTORY_ABORT) == 0


@pytest.mark.slow
def test_a_goal_right_after_a_hold_begins_at_rest() -> None:
    bench = Timed()
    bench.go(by=0.8)
    bench.turn(1.0)
    bench.arm.hold("", "somebody asks")
    told = bench.go(by=0.2)
    bench.until(lambda: told.ends)
    assert told.outcome == SUCCEEDED
    assert at(bench) == pytest.approx(0.2, abs=0.01)
    assert smooth(bench)
    assert not bench.targets


@pytest.mark.slow
def test_goals_at_once_and_a_stall_before_the_first_began() -> None:
    bench = Timed()
    bench.go(by=0.4)
    bench.go(by=0.8)
    bench.stall(0.4)
    bench.turn(0.5)
    bench.arm.hold("", "somebody asks")
    last = bench.go(by=0.1)
    bench.turn(0.05)
    last = bench.go(by=0.3)
    bench.until(lambda: last.ends)
    assert last.outcome == SUCCEEDED
    assert at(bench) == pytest.approx(0.3, abs=0.01)
    assert smooth(bench)
    assert not bench.targets


def test_a_path_on_which_no_brake_is_possible_begins_with_enough_points_to_start(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(PathBrake, "after", lambda brake, plan, time: [])
    bench = Timed()
    told = bench.go(seconds=3.0)
    bench.until(lambda: told.ends)
    assert told.outcome == SUCCEEDED
    assert not bench.targets


@pytest.mark.slow
def test_a_change_that_comes_too_late_for_the_board_is_made_at_rest() -> None:
    bench = Timed()
    bench.go(by=0.8, seconds=3.0)
    bench.turn(1.0)
    told = bench.go(by=-0.2, seconds=3.0)
    # The board is past the place at which the new goal begins.
    bench.stall(0.3)
    bench.until(lambda: told.ends)
    assert told.outcome == SUCCEEDED
    assert at(bench) == pytest.approx(-0.2, abs=0.01)
    assert bench.controller.generator.counters.slips == 1
    assert not bench.targets


@pytest.mark.slow
def test_settled_it_is_at_rest_when_the_call_returns() -> None:
    bench = Timed()
    told = bench.go(seconds=6.0, by=0.8)
    bench.turn(1.0)
    bench.owner.settle("a jog was begun")
    assert told.outcome == NOT_READY
    assert bench.state is PathState.DONE
    place = at(bench)
    bench.turn(1.0)
    assert at(bench) == pytest.approx(place, abs=0.003)
    # The board takes targets again.
    bench.arm.set_points({"J1": J1})
    bench.turn(0.2)
    assert bench.targets
    assert bench.owner.group.reason is None


# -- a shared arm ------------------------------------------------------------------------------------------


def test_a_lost_lease_brakes_at_once() -> None:
    bench = SharedBench(lease=Lease(timeout=0.5))
    key = bench.take()
    bench.shared.follow(bench.order(key), "", order((5.0, {"J1": J1 + 1.0})), None)
    bench.keep(key, 1.0)
    assert bench.board.trajectory.state is PathState.RUNNING
    bench.turn(0.8)
    assert bench.shared.held
    assert bench.board.trajectory.state is PathState.DONE
    assert bench.owner.group.reason is None
    assert bench.travel("J1") < 0.003
    assert bench.sent == []


@pytest.mark.slow
def test_after_a_halt_a_path_whose_lease_is_lost_is_not_continued() -> None:
    bench = SharedBench(lease=Lease(timeout=0.5))
    key = bench.take()
    bench.shared.follow(bench.order(key), "", order((9.0, {"J1": J1 + 1.0})), None)
    bench.keep(key, 1.0)
    bench.bench.emulated.wait(4.0)
    here = bench.where("J1")
    bench.turn(1.0)
    assert bench.shared.held
    assert abs(bench.where("J1") - here) < 0.01
    assert not bench.owner.group.busy


@few("when, requests", product((0.0, 1.0, 1.05), range(6)), (0.0, 2), (1.0, 1), (1.05, 3))
def test_a_lease_that_ends_between_two_requests_brakes_and_loses_no_connection(when: float, requests: int) -> None:
    bench = SharedBench(lease=Lease(timeout=0.5))
    key = bench.take()
    bench.shared.follow(bench.order(key), "", order((9.0, {"J1": J1 + 1.0})), None)
    bench.keep(key, when)
    check, asked = bench.shared._orders.of_targets, 0

    def halted() -> LeaseError | None:
        # The program is halted right before a request leaves.
        nonlocal asked
        if asked == requests:
            bench.clock.time += 0.6
        asked += 1
        return check()

    assert bench.owner._output.refusal is not None
    bench.owner._output.refusal = halted
    with suppress(LeaseError):
        while not bench.shared.held:
            bench.turn(0.01)
            bench.shared.beat(key, 0.0)
    here = bench.where("J1")
    bench.turn(1.0)
    assert bench.shared.held == "Ann lost the lease after 0.5 s of silence"
    assert (bench.owner.reconnects, bench.owner.group.reason, bench.owner.state.stopped) == (0, None, False)
    assert bench.board.trajectory.state in (PathState.NONE, PathState.LOADING, PathState.DONE, PathState.ABORTED)
    assert abs(bench.where("J1") - here) < 0.03
    assert bench.travel("J1") < 0.003
    assert not bench.owner.group.busy
    assert bench.sent == []


def test_a_target_of_the_holder_replaces_a_path() -> None:
    bench = SharedBench(lease=Lease(timeout=100.0))
    key = bench.take()
    bench.shared.follow(bench.order(key), "", order((5.0, {"J1": J1 + 1.0})), None)
    bench.turn(1.0)
    sent = bench.ask(lambda: bench.move(key, 2.0, J1=-0.1))
    assert dict(sent.positions)["J1"] == pytest.approx(bench.where("J1") - 0.1, abs=0.2)
    bench.turn(2.5)
    assert bench.where("J1") == pytest.approx(dict(sent.positions)["J1"], abs=0.01)
    assert math.isfinite(bench.where("J1"))


# -- at awkward moments ------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_stop_and_a_reset_within_one_turn_end_the_path_and_nothing_after_it() -> None:
    bench = Timed()
    told = bench.go(by=0.8)
    bench.turn(1.0)
    run = bench.owner._calls.run

    def both() -> None:
        bench.owner._calls.run = run  # type: ignore[method-assign]
        bench.arm.stop("somebody asks")
        bench.owner._output.reset(bench.owner.group.epochs.mark())

    bench.owner._calls.run = both  # type: ignore[method-assign]  # the owner has no turn between them
    bench.turn(0.011)
    assert told.outcome == STOPPED
    place = at(bench)
    after = bench.go(by=0.1)
    bench.turn(0.1)
    assert at(bench) == pytest.approx(place, abs=0.01)
    bench.until(lambda: after.ends)
    assert after.outcome == SUCCEEDED
    assert not bench.targets


@pytest.mark.slow
def test_a_goal_right_after_the_motion_was_released_begins_at_rest() -> None:
    bench = Timed()
    told = bench.go(by=0.8)
    bench.turn(1.0)
    bench.owner.group.release("somebody asks")
    after = bench.go(by=0.1)
    assert told.outcome == NOT_READY
    bench.until(lambda: after.ends)
    assert after.outcome == SUCCEEDED
    assert smooth(bench)


@pytest.mark.slow
def test_a_joint_gets_torque_again_while_the_others_come_to_rest() -> None:
    bench = Timed()
    bench.go(by=0.8)
    bench.turn(1.0)
    bench.ask(lambda: bench.owner.torque(False, ["J5"]))
    assert bench.board.trajectory.state in (PathState.RUNNING, PathState.BRAKING)
    assert bench.ask(lambda: bench.arm.enable(True)) == "torque is on"
    assert all(bench.torques())
    place = at(bench)
    bench.turn(0.5)
    assert at(bench) == pytest.approx(place, abs=0.01)
    told = bench.go(by=0.0)
    bench.until(lambda: told.ends)
    assert told.outcome == SUCCEEDED


@pytest.mark.slow
def test_a_target_does_not_revive_what_a_stop_from_elsewhere_has_ended() -> None:
    bench = Timed(controllers=SPLIT)
    arm_goal = TrajectoryGoal(NAMES[:6], (Point(2.0, (J1 + 0.5, *[HOME[name] for name in NAMES[1:6]])),))
    both = [
        bench.command(arm_goal, "arm"),
        bench.command(TrajectoryGoal(("J7",), (Point(2.0, (0.3,)),)), "hand"),
    ]
    bench.turn(0.7)
    assert bench.owner.running() == NAMES
    # Resumed already, so that the board takes targets again.
    bench.board.trajectory.stop()
    target, asked = JointTarget.of({"J7": 0.1}, 0.5), bench.owner.robot.epochs.mark()
    with pytest.raises(StoppedError, match="the arm is stopped"):
        bench.ask(lambda: bench.owner.send(target, asked))
    assert both[0].outcome == STOPPED
    place = at(bench)
    bench.turn(1.5)
    assert at(bench) == pytest.approx(place, abs=0.02)
    assert not bench.targets


@pytest.mark.slow
def test_a_start_that_comes_too_late_is_ordered_again_and_the_board_keeps_the_time(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    start = Board2Path.start
    for stalls in ([0.3], [0.3, 0.2, 0.3]):
        bench, left = Timed(), list(stalls)

        def late(path: Board2Path, at: float | None = None, bench: Timed = bench, left: list[float] = left) -> Any:
            bench.stall(left.pop(0) if left else 0.0)
            return start(path, at)

        monkeypatch.setattr(Board2Path, "start", late)
        caplog.clear()
        points = order((2.0, {"J1": J1 + 0.6}), still=True).points
        told = bench.command(TrajectoryGoal(NAMES, points, delay=0.2))
        bench.until(lambda told=told: told.ends)
        assert told.outcome == SUCCEEDED
        assert not bench.targets, "the host did not time it"
        warned = [row.getMessage() for row in caplog.records if row.levelname == "WARNING"]
        assert len(warned) == len(stalls)
        assert all(text.startswith("an order to start came too late") for text in warned)
        assert smooth(bench)
