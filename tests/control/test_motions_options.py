"""Each option of a motion has its effect, and the result describes what happened, in simulated time."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import pytest
from tests.control.test_motions import Bench, Watched
from tests.drivers.arms import Arm

from hexwire.control import run_motion
from hexwire.control.motion.motions import check_path
from hexwire.drivers.values import StopMode
from hexwire.errors import GoalError, PreemptedError
from hexwire.model.state import JointState, JointTarget
from hexwire.motion.safety import SafetyLimits

KINDS = pytest.mark.parametrize("what", ["way", "target"])


def motion(bench: Bench, what: str, *given: Any) -> Any:
    return bench.way(*given) if what == "way" else bench.target(*given)


def block(arm: Arm, joint: int) -> None:
    """Let a joint turn by a few counts only."""
    shaft = arm.board.wire.servos[joint].motion
    shaft.obstacle = (shaft.position - 10, shaft.position + 10)


def mute(arm: Arm, joint: int) -> None:
    """From now on its servo does not answer."""
    answer = arm.board.faults.bus_answer

    def silent(who: int, said: bytes | None) -> tuple[bytes, float]:
        return answer(who, None if who == joint else said)

    arm.board.faults.bus_answer = silent  # type: ignore[method-assign,assignment]  # a fault that begins in mid-run


def test_a_path_is_sent_at_the_rate_that_is_asked_for() -> None:
    bench = Bench()
    result = run_motion(bench.robot, bench.way(), bench.options(rate=10.0))
    assert result.arrived
    times = [when for when, _ in bench.targets]
    assert [b - a for a, b in pairwise(times)] == pytest.approx([0.1] * (len(times) - 1), abs=0.02)
    assert {round(target.duration, 6) for _, target in bench.targets} == {0.15}


def test_a_target_without_a_watchdog_is_sent_in_steps_at_the_rate_that_is_asked_for() -> None:
    bench, watched = Bench(1), Watched()
    options = bench.options(rate=0.5, grace=10.0)
    assert run_motion(bench.robot, bench.target("J4", 0.5, 6.0), options, observer=watched).arrived
    assert {round(target.duration, 6) for _, target in bench.targets} == {2.0, 3.0}
    assert ("unwatched", 3.0) in watched.said


@KINDS
def test_the_watchdog_has_the_timeout_and_the_mode_that_are_asked_for(what: str) -> None:
    bench = Bench()
    armed: set[tuple[float, int]] = set()

    def look(state: JointState) -> None:
        armed.add((bench.arm.board.state.watchdog_timeout, bench.arm.board.state.watchdog_mode))

    options = bench.options(watchdog=2.5, watchdog_mode=StopMode.TORQUE_OFF)
    assert run_motion(bench.robot, motion(bench, what), options, observer=Watched(look)).arrived
    assert armed == {(2.5, StopMode.TORQUE_OFF)}
    armed.clear()
    assert run_motion(bench.robot, motion(bench, what), bench.options(watchdog=0.0), observer=Watched(look)).arrived
    assert {timeout for timeout, _ in armed} == {0.0}


@pytest.mark.slow
def test_thresholds_of_the_caller_stop_a_path_where_the_usual_ones_do_not() -> None:
    for limits, kind in ((None, None), (SafetyLimits(following_error=0.03, lag=0.05), "following")):
        bench = Bench()
        bench.robot.torque(True)
        block(bench.arm, 0)
        result = run_motion(bench.robot, bench.way("J1", 0.15), bench.options(limits=limits))
        assert (result.stopped.kind if result.stopped else None) == kind
        assert not result.arrived


@pytest.mark.parametrize(("rate", "longest"), [(20.0, 0.5), (2.0, 1.5)])
def test_a_joint_may_be_silent_for_three_cycles_of_a_path_but_at_least_half_a_second(
    rate: float, longest: float
) -> None:
    bench = Bench()

    def look(state: JointState) -> None:
        if len(watched.states) == 4:
            mute(bench.arm, 3)

    watched = Watched(look)
    result = run_motion(bench.robot, bench.way(seconds=10.0), bench.options(rate=rate), observer=watched)
    assert result.stopped is not None
    assert (result.stopped.kind, result.stopped.joint) == ("lost", "J4")
    # The age is that of a state which was read a moment before.
    assert longest - 0.05 < watched.states[-1]["J4"].age <= longest + 1.0 / rate + 0.05


@pytest.mark.slow
@KINDS
def test_a_joint_has_the_grace_time_to_arrive_and_the_result_says_how_it_went(what: str) -> None:
    bench, watched = Bench(), Watched()
    bench.robot.torque(True)
    block(bench.arm, 4)
    begin = bench.arm.clock.time
    result = run_motion(bench.robot, motion(bench, what, "J5", 0.06), bench.options(grace=2.0), observer=watched)
    assert bench.arm.clock.time - begin == pytest.approx(3.15, abs=0.2)
    assert (result.arrived, result.cut, result.powered, result.stopped) == (False, False, (), None)
    assert [row.joint for row in result.off] == ["J5"]
    assert result.seconds == pytest.approx(bench.arm.clock.time - begin, abs=0.2)
    assert result.state is watched.states[-1]
    assert result.timing.cycles == len(watched.states)
    wide = bench.options(tolerance=0.2)
    assert run_motion(bench.robot, motion(bench, what, "J5", 0.06), wide).arrived, "that is within the tolerance"


@pytest.mark.parametrize(("given", "least"), [({}, 0.3), ({"standing": 0.05}, 0.9), ({"early": False}, 1.0)])
def test_a_target_counts_as_reached_early_if_wanted_and_if_it_need_not_stand(
    given: dict[str, Any], least: float
) -> None:
    bench = Bench()
    bench.robot.torque(True)
    target, begin = bench.target(), bench.arm.clock.time
    assert run_motion(bench.robot, target, bench.options(tolerance=0.3, **given)).arrived
    assert least < bench.arm.clock.time - begin < least + 0.4


def test_a_target_that_is_not_waited_for_is_described_as_sent() -> None:
    bench = Bench()
    target = bench.target(seconds=2.0)
    result = run_motion(bench.robot, target, bench.options(), wait=False)
    assert result.powered == ("J4",)
    assert result.sent is not None
    assert dict(result.sent.positions)["J4"] == pytest.approx(dict(target.positions)["J4"], abs=0.002)
    assert result.seconds == result.sent.duration == pytest.approx(2.0)


def test_lost_torque_is_named_in_the_result() -> None:
    bench = Bench()

    def look(state: JointState) -> None:
        if len(watched.states) == 5:
            bench.robot.torque(False, ["J4"])

    watched = Watched(look)
    result = run_motion(bench.robot, bench.target(), bench.options(), observer=watched)
    assert (result.arrived, result.without_torque) == (False, ("J4",))
    assert result.why == "J4 lost torque before the arrival"


def test_without_a_table_a_target_may_be_below_its_height() -> None:
    down = {"J2": math.radians(25), "J3": math.radians(62)}
    bench = Bench()
    free = bench.options(table=None)
    assert run_motion(bench.robot, JointTarget.of(down, 3.0), free).arrived


def test_whether_other_joints_move_is_seen_in_two_states_a_tenth_of_a_second_apart() -> None:
    bench = Bench()
    bench.robot.torque(True)
    target, read, times = bench.target(), bench.robot.read, []

    def noted() -> JointState:
        times.append(bench.arm.clock.time)
        return read()

    bench.robot.read = noted  # type: ignore[method-assign]  # it watches
    run_motion(bench.robot, target, bench.options(), wait=False)
    assert [b - a for a, b in pairwise(times)] == [pytest.approx(0.1, abs=0.02)]


def test_a_path_is_checked_from_the_positions_that_are_given() -> None:
    bench = Bench()
    way, options = bench.way("J2", math.radians(55), 3.0), bench.options()
    here = dict(bench.robot.read().positions)
    bent = here | {"J3": here["J3"] + math.radians(40)}
    assert check_path(bench.robot, way, options, start=here) == check_path(bench.robot, way, options)
    with pytest.raises(GoalError, match="elbow folded"):
        check_path(bench.robot, way, options, start=bent)


@KINDS
def test_a_motion_whose_target_a_stop_took_the_line_from_ends_as_stopped(what: str) -> None:
    bench = Bench()
    wanted = motion(bench, what, "J4", 0.5, 1.0)

    def preempted(target: JointTarget) -> Any:
        raise PreemptedError("a stop took the line")

    bench.robot.write = preempted  # type: ignore[method-assign]
    result = run_motion(bench.robot, wanted, bench.options())
    assert result.arrived is False
    assert result.why == "stopped: a stop command has stopped the arm"
