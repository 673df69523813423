"""A single target as a path of the board, run by a program; in simulated time."""

from __future__ import annotations

from contextlib import suppress
from itertools import pairwise
from typing import Any

import pytest
from tests.control.test_motions import Bench, Watched
from tests.control.test_timed_motion import Timed

from hexwire.control.motion.motions import MotionResult, run_motion
from hexwire.drivers.timed_path import PathState
from hexwire.errors import StoppedError, UsageError
from hexwire.model.state import JointTarget
from hexwire.motion.quintic import PEAK_SPEED, quintic_share
from hexwire.wire.commands import LimitRow


def move(bench: Timed, target: JointTarget, do: Any = lambda state: None, **given: Any) -> MotionResult:
    wait, until = given.pop("wait", True), given.pop("until", None)
    return run_motion(bench.robot, target, bench.options(**given), wait=wait, until=until, observer=Watched(do))


def test_the_board_follows_a_smooth_path_and_no_target_is_sent() -> None:
    bench = Timed()
    begin, rows = bench.at(), list[tuple[float, float]]()
    target = bench.target(by=0.8, seconds=2.0)
    result = move(bench, target, lambda state: rows.append((state.stamp - state["J4"].age, state["J4"].position)))
    assert result.arrived
    assert result.timed
    assert result.sent is not None
    assert result.sent.duration == pytest.approx(2.0)
    assert dict(result.sent.positions)["J4"] == pytest.approx(begin + 0.8, abs=0.003)
    assert not bench.targets
    assert bench.state is PathState.DONE
    # From the state in its middle on, it is where a quintic is.
    middle = min(rows, key=lambda row: abs(row[1] - begin - 0.4))[0]
    off = [x - begin - 0.8 * quintic_share(0.5 + (t - middle) / 2.0) for t, x in rows if t > rows[0][0] + 0.1]
    assert max(map(abs, off)) < 0.02
    fastest = max((b - a) / (t - s) for (s, a), (t, b) in pairwise(rows) if t > s)
    assert fastest == pytest.approx(PEAK_SPEED * 0.4, rel=0.25)


def test_a_long_one_fits_on_the_board_as_a_whole() -> None:
    bench = Timed()
    result = move(bench, bench.target(by=0.3, seconds=100.0), wait=False)
    assert (result.timed, result.seconds) == (True, 100.0)
    bench.arm.wait(0.5)
    assert bench.state is PathState.RUNNING


def test_one_that_does_not_fit_is_sent_as_a_target() -> None:
    bench = Timed()
    result = move(bench, bench.target(by=0.3, seconds=3000.0), wait=False)
    assert not result.timed
    assert len(bench.targets) == 1


def test_without_waiting_it_goes_on_whatever_becomes_of_the_program() -> None:
    bench = Timed()
    target = bench.target(seconds=2.0)
    result = move(bench, target, wait=False)
    assert (result.arrived, result.timed, result.why) == (None, True, "")
    assert bench.arm.board.state.watchdog_timeout == 0.0
    # Another one that watches the arm for a moment, and is killed.
    bench.robot.watchdog(0.5)
    bench.arm.wait(2.2)
    assert bench.at() == pytest.approx(target.positions[0][1], abs=0.01)
    assert not bench.targets


def test_with_waiting_the_watchdog_stops_it_when_the_program_stalls() -> None:
    bench = Timed()
    result = move(bench, bench.target(seconds=4.0), bench.after(0.4, lambda: bench.arm.wait(1.5)))
    assert result.stopped is not None
    assert "watchdog tripped" in result.why
    assert bench.state is PathState.STOPPED


def test_a_short_stall_does_not_disturb_it() -> None:
    bench = Timed()
    began = bench.arm.clock.time
    result = move(bench, bench.target(seconds=2.0), bench.after(0.5, lambda: bench.arm.wait(0.8)))
    assert result.arrived
    assert bench.arm.clock.time - began < 2.8


def test_the_old_way_is_there_when_it_is_asked_for_and_for_the_chapters_dialect() -> None:
    bench = Timed()
    old = Bench.options(bench, host_timed=True)
    assert not run_motion(bench.robot, bench.target(), old).timed
    assert len(bench.targets) == 1
    bench = Timed(dialect=1)
    assert not move(bench, bench.target(), grace=9.0).timed
    assert bench.targets


def test_what_may_be_replaced_is_no_path() -> None:
    bench = Timed()
    assert move(bench, bench.target(), until=lambda state: None).arrived
    assert len(bench.targets) == 1


def test_where_the_boards_limits_are_tighter_it_clamps_the_target_and_says_so() -> None:
    bench = Timed()
    limits = list(bench.robot.limits())
    here = bench.robot.model.joint("J4").angle_to_counts(bench.at())
    limits[3] = LimitRow(here - 100, here + 100, limits[3].speed)
    bench.robot.store_limits(limits)
    result = move(bench, bench.target(by=0.8))
    assert result.sent is not None
    assert result.sent.clamped == ("J4",)
    assert not result.timed


def test_an_object_in_the_jaws_ends_it_without_a_stop() -> None:
    bench = Timed()
    jaws = bench.arm.board.wire.servos[6].motion
    jaws.obstacle = (jaws.position - 20, jaws.position + 20)
    result = move(bench, bench.target("J7", 0.5), grace=1.0)
    assert result.arrived is False
    assert (result.stopped, [row.joint for row in result.off]) == (None, ["J7"])
    assert not bench.arm.board.state.stopped


def test_a_stop_ends_it_and_nothing_goes_on_after_it() -> None:
    bench = Timed()

    def stop() -> None:
        bench.robot.stop()
        bench.robot.resume()

    result = move(bench, bench.target(seconds=3.0), bench.after(0.8, stop))
    assert result.stopped is not None
    assert bench.state is PathState.STOPPED
    place = bench.at()
    bench.arm.wait(3.0)
    assert bench.at() == pytest.approx(place, abs=0.01)


def test_a_stop_that_another_program_has_already_cleared_is_told_as_a_stop() -> None:
    bench = Timed()
    stop = bench.after(0.5, bench.arm.board.trajectory.stop)
    result = move(bench, bench.target(seconds=6.0, by=0.1), stop, tolerance=0.01)
    assert result.stopped is not None
    assert result.ended == ""


def test_a_stop_ends_one_that_nobody_waits_for() -> None:
    bench = Timed()
    move(bench, bench.target(seconds=3.0), wait=False)
    bench.arm.wait(1.0)
    bench.robot.stop()
    place = bench.at()
    bench.robot.resume()
    bench.arm.wait(3.0)
    assert bench.at() == pytest.approx(place, abs=0.01)


@pytest.mark.parametrize("wait", [True, False])
def test_a_stop_before_it_begins_voids_it(wait: bool) -> None:
    bench = Timed()
    torque, begin = bench.robot.torque, bench.at()

    def stopped(*args: Any, **rest: Any) -> tuple[str, ...]:
        confirmed = torque(*args, **rest)
        bench.robot.stop()
        bench.robot.resume()
        return confirmed

    bench.robot.torque = stopped  # type: ignore[method-assign]
    with suppress(StoppedError):
        assert move(bench, bench.target(), wait=wait).stopped is not None
    bench.arm.wait(1.5)
    assert bench.at() == pytest.approx(begin, abs=0.01)


def test_an_interrupt_stops_the_arm() -> None:
    bench = Timed()

    def fail() -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        move(bench, bench.target(seconds=2.0), bench.after(0.5, fail))
    assert bench.state is PathState.STOPPED


def test_a_joint_that_loses_its_torque_ends_it_at_rest_and_is_named() -> None:
    bench = Timed()
    both = JointTarget.of({"J4": bench.at() + 0.8, "J5": bench.at("J5") + 0.5}, 3.0)
    result = move(bench, both, bench.after(0.8, lambda: bench.robot.torque(False, ["J5"])))
    assert (result.arrived, result.without_torque, result.stopped) == (False, ("J5",), None)
    place = bench.at()
    bench.arm.wait(3.0)
    assert bench.at() == pytest.approx(place, abs=0.01)
    assert not bench.arm.board.state.stopped


def test_a_reset_of_the_board_is_told_at_once() -> None:
    bench = Timed()
    board = bench.arm.board
    began = bench.arm.clock.time
    reset = bench.after(0.8, lambda: board.reset(bench.arm.clock.time))
    result = move(bench, bench.target(seconds=9.0), reset)
    assert (result.arrived, result.stopped) == (False, None)
    assert "the board was reset" in result.why or result.without_torque
    assert bench.arm.clock.time - began < 4.0
    assert not board.state.stopped


# --- a motion that the board still makes -------------------------------------------------------------------


def test_a_second_one_begins_where_the_first_came_to_rest() -> None:
    bench = Timed()
    begin = bench.at()
    move(bench, bench.target(by=1.0, seconds=2.0), wait=False)
    bench.arm.wait(1.1)
    seen: list[float] = []
    back = JointTarget.of({"J4": begin}, 1.0)
    result = move(bench, back, lambda state: seen.append(state["J4"].position))
    assert result.arrived
    assert result.timed
    assert not bench.targets
    assert seen[0] > begin + 0.4
    assert max(seen) < seen[0] + 0.02, "it was at rest"


def test_one_that_would_leave_another_joint_short_is_refused() -> None:
    bench = Timed()
    goal = {"J4": bench.at() + 0.5, "J7": bench.at("J7") + 0.3}
    move(bench, JointTarget.of(goal, 3.0), wait=False)
    bench.arm.wait(0.5)
    with pytest.raises(UsageError, match=r"^still moving: J7, .*; nothing was sent$"):
        move(bench, bench.target(by=0.0), wait=False)
    bench.arm.wait(3.0)
    assert (bench.at(), bench.at("J7")) == pytest.approx(tuple(goal.values()), abs=0.01)


def test_a_joint_at_the_slow_start_of_its_path_counts_as_moving() -> None:
    bench = Timed()
    far = bench.target("J2", 0.3, 6.0)
    bench.robot.torque(True)
    move(bench, far, wait=False)
    with pytest.raises(UsageError, match=r"^still moving: J2; wait"):
        move(bench, bench.target("J4", 0.1), wait=False)
    assert bench.state is PathState.RUNNING


def test_another_joint_moves_beside_it() -> None:
    bench = Timed()
    first, second = bench.target(seconds=2.0), bench.target("J7", 0.3, 1.0)
    move(bench, first, wait=False)
    bench.arm.wait(0.5)
    result = move(bench, second)
    assert (result.arrived, result.timed) == (True, False)
    bench.arm.wait(2.0)
    assert bench.at() == pytest.approx(first.positions[0][1], abs=0.01)


def test_a_joint_that_turns_on_a_target_is_replaced_by_a_target() -> None:
    bench = Timed()
    begin = bench.at()
    bench.robot.torque(True)
    bench.robot.write(JointTarget.of({"J4": begin + 1.2}, 1.2))
    bench.arm.wait(0.6)
    result = move(bench, JointTarget.of({"J4": begin}, 1.0))
    assert result.arrived
    assert len(bench.targets) == 2
