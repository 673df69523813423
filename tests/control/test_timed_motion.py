"""A motion of which the board keeps the time, run by a program; in simulated time."""

from __future__ import annotations

import logging
import math
from typing import Any

import pytest
from tests.control.test_motions import Bench, Watched, rest_to_rest

from hexwire.control.motions import MotionOptions, MotionResult, run_motion
from hexwire.drivers.timed_path import PathState
from hexwire.errors import StoppedError
from hexwire.model.state import JointState, JointTarget
from hexwire.motion.waypoints import Trajectory
from hexwire.wire.commands import LimitRow


class Timed(Bench):
    """A bench on which the board keeps the time."""

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


def test_a_program_that_stalls_for_longer_finds_the_arm_at_rest_on_its_path() -> None:
    bench = Timed()
    way = bench.way(by=1.0, seconds=8.0)
    result = bench.run(way, bench.after(0.4, lambda: bench.arm.wait(5.0)), watchdog=0.0)
    assert not result.arrived
    assert result.stopped is not None
    assert "too slow to send the next points" in result.why
    assert bench.state is PathState.DRY
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


def test_where_the_board_refuses_a_path_targets_are_sent(caplog: pytest.LogCaptureFixture) -> None:
    bench = Timed()
    limits = list(bench.robot.limits())
    # A tenth of the speed that the motion takes.
    slow = LimitRow(limits[3].minimum, limits[3].maximum, 60)
    bench.robot.store_limits([slow if i == 3 else row for i, row in enumerate(limits)])
    with caplog.at_level(logging.INFO, "hexwire.control.timed_motion"):
        result = bench.run(bench.way(by=math.radians(40.0), seconds=1.0), grace=8.0)
    assert "one by one" in caplog.text
    assert not result.timed
    assert bench.targets
