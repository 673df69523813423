"""Onboard trajectory execution, begun by a program; in simulated time."""

from __future__ import annotations

import itertools
import logging
import math
from typing import Any

import pytest
from tests.control.test_motions import Bench, Watched
from tests.motion.arms import rest_to_rest

from hexwire.control.motion.motions import MotionOptions, MotionResult, check_path, run_motion
from hexwire.control.motion.path_check import PathCheck
from hexwire.drivers.timed_path import PathState
from hexwire.errors import StoppedError, UsageError
from hexwire.model.state import JointState, JointTarget
from hexwire.motion.path_points import path_points
from hexwire.motion.through import arm_path
from hexwire.motion.trajectory import Spline, Trajectory, Waypoint
from hexwire.wire.command_frame import Command
from hexwire.wire.commands import LimitRow


class Timed(Bench):
    """A bench whose board executes trajectories."""

    def options(self, **given: Any) -> MotionOptions:
        return super().options(host_timed=False, **given)

    def run(
        self, motion: Trajectory, do: Any = lambda state: None, until: Any = None, **given: Any
    ) -> MotionResult:
        return run_motion(self.robot, motion, self.options(**given), observer=Watched(do), until=until)

    @property
    def state(self) -> PathState:
        return self.arm.board.trajectory.state

    def at(self, joint: str = "J4") -> float:
        return self.robot.read()[joint].position

    def after(self, seconds: float, do: Any) -> Any:
        """A function for `seen` that does something once, so long after the first state."""
        begun: list[float] = []
        done: list[bool] = []

        def seen(state: JointState) -> None:
            begun.append(self.arm.clock.time)
            if not done and begun[-1] - begun[0] >= seconds:
                done.append(True)
                do()

        return seen


def test_the_board_follows_it_and_no_target_is_sent() -> None:
    bench = Timed()
    way = bench.way()
    result = bench.run(way)
    assert result.arrived
    assert result.timed
    assert not bench.targets
    assert bench.at() == pytest.approx(way.goal[0], abs=0.01)
    assert bench.state is PathState.DONE
    assert not bench.arm.board.state.stopped


def test_the_old_way_is_there_when_it_is_asked_for() -> None:
    bench = Timed()
    result = run_motion(bench.robot, bench.way(), Bench.options(bench, host_timed=True))
    assert result.arrived
    assert not result.timed
    assert bench.targets


def test_a_board_of_the_chapters_dialect_gets_targets() -> None:
    bench = Timed(dialect=1)
    result = bench.run(bench.way(seconds=8.0))
    assert result.arrived
    assert not result.timed
    assert bench.targets


def test_legs_are_one_path() -> None:
    bench = Timed()
    there = bench.way()
    seen: list[float] = []
    back = rest_to_rest(("J4",), there.goal, there.start, 1.0)
    watched = Watched(lambda state: seen.append(state["J4"].position))
    result = run_motion(bench.robot, [there, back], bench.options(), observer=watched)
    assert result.arrived
    assert max(seen) == pytest.approx(there.goal[0], abs=0.02)
    assert bench.at() == pytest.approx(there.start[0], abs=0.01)


@pytest.mark.slow
def test_a_long_motion_is_sent_while_it_runs() -> None:
    bench = Timed()
    way = bench.way(seconds=9.0)
    result = bench.run(way)
    assert result.arrived
    assert result.timed
    assert bench.at() == pytest.approx(way.goal[0], abs=0.01)


def test_a_stall_of_the_program_does_not_disturb_it() -> None:
    bench = Timed()
    way = bench.way(seconds=2.0)
    began = bench.arm.clock.time
    result = bench.run(way, bench.after(0.5, lambda: bench.arm.wait(0.8)))
    assert result.arrived
    assert bench.arm.clock.time - began < 2.0 + 1.0


@pytest.mark.slow
def test_a_program_that_stalls_for_longer_finds_the_arm_at_rest_on_its_path() -> None:
    bench = Timed()
    # Longer than the points that the board has room for.
    way = bench.way(by=1.0, seconds=30.0)
    result = bench.run(way, bench.after(0.4, lambda: bench.arm.wait(25.0)), watchdog=0.0)
    assert not result.arrived
    assert result.stopped is not None
    assert "too slow to send the next points" in result.why
    assert bench.state is PathState.DONE, "the brake that every part of a path ends with"
    assert way.start[0] < bench.at() < way.goal[0]


def test_the_watchdog_stops_it_as_always() -> None:
    bench = Timed()
    result = bench.run(bench.way(seconds=4.0), bench.after(0.4, lambda: bench.arm.wait(1.5)))
    assert result.stopped is not None
    assert "watchdog tripped" in result.why
    assert bench.state is PathState.STOPPED


def test_a_motion_may_outlive_its_program() -> None:
    bench = Timed()
    way = bench.way(seconds=2.0)
    bench.run(way, bench.after(0.9, lambda: bench.arm.wait(1.6)), outlives=True)
    assert bench.state is PathState.DONE
    assert bench.at() == pytest.approx(way.goal[0], abs=0.01)


def test_a_stop_ends_it() -> None:
    bench = Timed()
    way = bench.way(seconds=2.0)
    result = bench.run(way, bench.after(0.5, bench.robot.stop))
    assert result.stopped is not None
    assert bench.state is PathState.STOPPED
    assert bench.at() < way.goal[0] - 0.1


def test_a_path_that_another_program_begins_after_its_end_is_no_stop() -> None:
    bench = Timed()
    board, way, seen = bench.arm.board.trajectory, bench.way(seconds=1.0), list[float]()
    shaft = bench.arm.board.wire.servos[3].motion
    # It has not arrived yet when its time is over.
    shaft.obstacle = (None, bench.robot.model.joint("J4").angle_to_counts(way.goal[0]) - 30)

    def another(state: JointState) -> None:
        since = bench.arm.clock.time - board.start_at
        if board.state is not PathState.NONE and since >= 1.0 and not seen:
            seen.append(since)
            board.number = (board.number + 1) & 0xFF
        if seen and since > 1.3:
            shaft.obstacle = (None, None)

    result = bench.run(way, another)
    assert seen
    assert (result.arrived, result.stopped) == (True, None)


def test_a_stop_before_it_begins_voids_it() -> None:
    bench = Timed()
    way = bench.way()
    torque = bench.robot.torque

    def stopped(*args: Any, **rest: Any) -> tuple[str, ...]:
        confirmed = torque(*args, **rest)
        bench.robot.stop()
        bench.robot.resume()
        return confirmed

    bench.robot.torque = stopped  # type: ignore[method-assign]
    try:
        result = bench.run(way)
    except StoppedError:
        pass
    else:
        assert result.stopped is not None
    assert bench.at() == pytest.approx(way.start[0], abs=0.01)
    assert bench.state is PathState.NONE


@pytest.mark.parametrize("legs", [1, 2])
def test_a_motion_of_no_length_sends_no_path_and_says_nothing(legs: int, caplog: pytest.LogCaptureFixture) -> None:
    bench = Timed()
    stand = Spline(("J4",), [Waypoint(0.0, (bench.at(),))])
    path = check_path(bench.robot, [stand] * legs, bench.options())
    result = run_motion(bench.robot, path, bench.options())
    assert (result.arrived, result.timed) == (True, False)
    assert Command.TRAJECTORY_BEGIN not in bench.arm.commands()
    assert caplog.text == ""


def test_until_ends_it_at_rest() -> None:
    bench = Timed()
    way = bench.way(seconds=2.0)
    middle = (way.start[0] + way.goal[0]) / 2.0
    result = bench.run(way, until=lambda state: state["J4"].position > middle)
    assert result.cut
    assert result.stopped is None
    place = bench.at()
    assert middle < place < way.goal[0]
    bench.arm.wait(0.5)
    assert bench.at() == pytest.approx(place, abs=0.01)


def test_until_may_name_another_target() -> None:
    bench = Timed()
    way = bench.way(seconds=2.0)
    back = JointTarget.of({"J4": way.start[0]}, 1.0)
    middle = (way.start[0] + way.goal[0]) / 2.0
    result = bench.run(way, until=lambda state: back if state["J4"].position > middle else None)
    assert result.cut
    bench.arm.wait(1.5)
    assert bench.at() == pytest.approx(way.start[0], abs=0.02)


def test_an_error_in_between_stops_the_arm() -> None:
    bench = Timed()

    def fail() -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        bench.run(bench.way(seconds=2.0), bench.after(0.5, fail))
    assert bench.arm.board.state.stopped
    assert bench.state is PathState.STOPPED


def test_another_program_that_switches_torque_off_ends_it() -> None:
    bench = Timed()
    result = bench.run(bench.way(seconds=2.0), bench.after(0.5, lambda: bench.robot.torque(False, ["J4"])))
    assert not result.arrived
    assert bench.state in (PathState.FAULT, PathState.BRAKING)


def test_a_joint_that_falls_silent_ends_it_and_is_named() -> None:
    bench = Timed()
    faults = bench.arm.board.faults
    answer = faults.bus_answer

    def bus_answer(who: int, said: bytes | None) -> tuple[bytes, float]:
        return answer(who, None if who == 3 else said)

    def silence() -> None:
        faults.bus_answer = bus_answer  # type: ignore[method-assign,assignment]  # a fault that begins in mid-run

    result = bench.run(bench.way(seconds=3.0), bench.after(0.5, silence))
    assert result.timed
    assert "J4 has not answered for" in result.why
    place = bench.arm.shaft(3)
    bench.arm.wait(2.0)
    assert bench.arm.shaft(3) == pytest.approx(place, abs=2)


def test_where_the_board_refuses_a_path_targets_are_sent(caplog: pytest.LogCaptureFixture) -> None:
    bench = Timed()
    limits = list(bench.robot.limits())
    # A tenth of the speed that the motion takes.
    slow = LimitRow(limits[3].minimum, limits[3].maximum, 60)
    told: list[str] = []
    bench.robot.store_limits([slow if i == 3 else row for i, row in enumerate(limits)])
    watched = Watched()
    watched.refused = told.append  # type: ignore[method-assign, assignment]
    way = bench.way(by=math.radians(40.0), seconds=1.0)
    result = run_motion(bench.robot, way, bench.options(grace=8.0), observer=watched)
    assert told == ["bad range"]
    assert not caplog.records
    assert not result.timed
    assert bench.targets


def test_who_listens_to_nothing_has_it_in_the_log_that_the_board_refuses_a_path(
    caplog: pytest.LogCaptureFixture,
) -> None:
    bench = Timed()
    limits = list(bench.robot.limits())
    slow = LimitRow(limits[3].minimum, limits[3].maximum, 60)
    bench.robot.store_limits([slow if i == 3 else row for i, row in enumerate(limits)])
    with caplog.at_level(logging.WARNING, "hexwire"):
        run_motion(bench.robot, bench.way(by=math.radians(40.0), seconds=1.0), bench.options(grace=8.0))
    (row,) = caplog.records
    assert row.getMessage().endswith("the board does not follow this path itself: bad range")


def straight(bench: Timed, rows: list[tuple[float, float]]) -> Spline:
    """Straight lines of J4 through angles beside its position."""
    here = bench.at()
    return Spline(("J4",), [Waypoint(t, (here + x,)) for t, x in rows])


def test_a_motion_at_its_speed_limit_is_followed_by_the_board() -> None:
    # The path check allows a thousandth more, for rounding.
    for seconds in (0.3003, 0.30077, 0.317777):
        bench = Timed()
        most = bench.robot.model.joint("J4").max_speed * 1.0005
        rows = [(seconds * i / 7, most * seconds * i / 7) for i in range(8)]
        result = bench.run(straight(bench, rows))
        assert result.arrived
        assert result.timed


@pytest.mark.slow
def test_a_motion_through_points_at_full_speed_is_refilled_and_passes_them() -> None:
    bench = Timed()
    names = bench.robot.model.names
    here = [bench.at(name) for name in names]
    points = [here]
    for k in range(1, 7):
        moved = {"J1": here[0] + 0.9 * (k % 2), "J4": 0.35 * k - 0.9, "J6": 0.3 - 0.3 * (k % 3)}
        points.append([moved.get(name, angle) for name, angle in zip(names, here, strict=True)])
    way = arm_path(bench.robot.model, names, points)
    path = bench.robot.path(names, brake=0.2, outlives=False)
    assert len(list(path_points(way, [1e-3] * len(names)))) > path.capacity
    path.abort()
    nearest = [math.inf] * len(points)

    def seen(state: JointState) -> None:
        there = [state[name].position for name in names]
        nearest[:] = [min(old, math.dist(there, point)) for old, point in zip(nearest, points, strict=True)]

    result = bench.run(way, seen)
    assert (result.arrived, result.timed, bench.targets) == (True, True, [])
    # Between two states a joint turns by 0.13 rad; where it turns back it is seen nearer.
    assert max(nearest) < 0.1


def test_a_duration_between_two_ticks_is_possible() -> None:
    bench = Timed()
    assert bench.run(bench.way(seconds=1.00003)).arrived


def test_where_the_board_refuses_a_later_point_the_arm_is_at_rest_at_the_end() -> None:
    bench = Timed()
    limits = list(bench.robot.limits())
    slow = LimitRow(limits[3].minimum, limits[3].maximum, 100)
    bench.robot.store_limits([slow if i == 3 else row for i, row in enumerate(limits)])
    result = bench.run(straight(bench, [(0.0, 0.0), (3.0, 0.05), (3.5, 0.5), (6.0, 0.6)]))
    assert not result.arrived
    assert result.stopped is not None
    assert "bad range" in result.why
    assert bench.state is PathState.DONE
    place = bench.at()
    bench.arm.wait(4.0)
    assert bench.at() == pytest.approx(place, abs=0.002)


def test_an_interrupt_while_the_start_is_under_way_stops_the_arm() -> None:
    bench = Timed()
    way, path = bench.way(), bench.robot.path

    def interrupted(*given: Any, **rest: Any) -> Any:
        begun = path(*given, **rest)
        start = begun.start

        def lost(at: float | None = None) -> None:
            start(at)
            raise KeyboardInterrupt

        begun.start = lost  # type: ignore[method-assign, assignment]
        return begun

    bench.robot.path = interrupted  # type: ignore[method-assign]
    with pytest.raises(KeyboardInterrupt):
        bench.run(way)
    bench.arm.wait(2.0)
    assert bench.arm.board.state.stopped
    assert bench.at() == pytest.approx(way.start[0], abs=0.02)


def test_a_motion_that_begins_beside_the_arm_is_blended_in() -> None:
    bench = Timed()
    here, beside = bench.at(), math.radians(5.0)
    seen: list[tuple[float, float]] = []
    way = rest_to_rest(("J4",), (here + beside,), (here + beside + 0.3,), 2.0)
    result = bench.run(way, lambda state: seen.append((state.stamp, state["J4"].position)))
    assert result.arrived
    fastest = max((b - a) / (t - s) for (s, a), (t, b) in itertools.pairwise(seen))
    # All at once, it would be above 70 deg/s.
    assert fastest < math.radians(50.0)


@pytest.mark.parametrize("host_timed", [False, True])
def test_a_motion_that_begins_far_from_the_arm_is_refused(host_timed: bool) -> None:
    bench = Timed()
    here = bench.at()
    way = rest_to_rest(("J4",), (here - 0.5,), (here - 0.8,), 2.0)
    with pytest.raises(
        UsageError, match=r"^the trajectory starts 28\.6\d* deg from the position of J4; move there first"
    ):
        run_motion(bench.robot, way, Bench.options(bench, host_timed=host_timed))
    assert bench.at() == pytest.approx(here, abs=0.01)
    assert bench.state is PathState.NONE


@pytest.mark.parametrize("host_timed", [False, True])
def test_the_way_to_a_motion_that_begins_beside_the_arm_is_checked_too(
    host_timed: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench = Timed()
    here, checked = bench.at(), list[Trajectory]()

    def wrong(check: PathCheck, path: Trajectory, *given: object) -> str:
        checked.append(path)
        return "0.10 s after it begins, the tip would be below the table"

    way = rest_to_rest(("J4",), (here + 0.09,), (here + 0.3,), 2.0)
    monkeypatch.setattr(PathCheck, "unchecked", wrong)
    with pytest.raises(UsageError, match="below the table"):
        run_motion(bench.robot, way, Bench.options(bench, host_timed=host_timed))
    assert [path.start[0] for path in checked] == pytest.approx([here] * len(checked), abs=0.01)
    assert bench.at() == pytest.approx(here, abs=0.01)


def test_a_stop_that_another_program_has_already_cleared_ends_it() -> None:
    bench = Timed()
    board = bench.arm.board.trajectory

    def stop() -> None:
        board.stop()

    began = bench.arm.clock.time
    result = bench.run(bench.way(seconds=6.0, by=0.1), bench.after(0.5, stop))
    assert result.stopped is not None
    assert bench.arm.clock.time - began < 2.0


@pytest.mark.slow
def test_a_board_whose_clock_is_slow_is_watched_in_its_own_time(monkeypatch: pytest.MonkeyPatch) -> None:
    # 5 percent over 16 s count as much as a resonator's 0.5 percent over some minutes.
    monkeypatch.setattr("hexwire.emulator.board_path.POINT_TIME", 1.05e-4)
    bench = Timed()
    here, rest = bench.at(), (0.0,)
    rows = [Waypoint(0.8 * i, (here + (0.7 if i % 2 else 0.0),), rest) for i in range(21)]
    result = bench.run(Spline(("J4",), rows))
    assert result.arrived, result.why
    assert bench.state is PathState.DONE


@pytest.mark.slow
def test_the_board_is_done_when_the_call_returns(monkeypatch: pytest.MonkeyPatch) -> None:
    # Behind the program's clock, and near enough to have arrived: another motion would be refused.
    monkeypatch.setattr("hexwire.emulator.board_path.POINT_TIME", 1.2e-4)
    bench = Timed()
    for i in range(6):
        by = -0.3 if i % 2 else 0.3
        assert bench.run(bench.way(by=by, seconds=0.5 + 0.013 * i), tolerance=math.radians(20.0)).arrived
        assert bench.state is PathState.DONE


@pytest.mark.slow
def test_a_slow_program_sends_enough_of_a_motion_with_corners() -> None:
    rows = [(0.02 * i, 0.2 * math.sin(0.02 * i) + (0.003 if i % 2 else 0.0)) for i in range(300)]
    rows[0] = (0.0, 0.0)
    for rate in (20.0, 2.0):
        bench = Timed()
        result = bench.run(straight(bench, rows), rate=rate)
        assert result.arrived, result.why
        assert result.timed


def test_a_reset_of_the_board_ends_it() -> None:
    bench = Timed()
    board = bench.arm.board
    result = bench.run(bench.way(seconds=2.0), bench.after(0.5, lambda: board.reset(bench.arm.clock.time)))
    assert not result.arrived
    assert result.stopped is not None
    place = bench.at()
    bench.arm.wait(2.0)
    assert bench.at() == pytest.approx(place, abs=0.002)
