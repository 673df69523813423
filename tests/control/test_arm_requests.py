"""Requests that wait, streams that begin, settings that change: what an arm makes of them, in simulated time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
from tests.control.arm_bench import PREEMPTED, SUCCEEDED, Bench, free, guide, make_bench, order
from tests.motion.arms import HOME

from hexwire.control.loop.outcomes import Reason
from hexwire.control.motion.goals import TrajectoryGoal
from hexwire.control.motion.path_check import PathCheck
from hexwire.control.requests.setting import Faults
from hexwire.control.requests.settings_reader import reread
from hexwire.errors import GoalError, HexwireError
from hexwire.motion.safety import StopReason

J1 = HOME["J1"]
NEAR = 0.1


def stop_and_reset(bench: Bench) -> None:
    bench.ask(lambda: bench.arm.stop("by the test"))
    bench.ask(bench.arm.reset)


# -- a stop voids what was asked for before it -------------------------------------------------------------


@pytest.mark.parametrize(
    "request_",
    [
        lambda arm, asked: arm.command("", order((1.0, {"J1": J1 + 0.3})), asked=asked),
        lambda arm, asked: arm.set_points({"J1": J1 + 0.3}, asked=asked),
        lambda arm, asked: arm.go_to("side", asked),
        lambda arm, asked: arm.enable(True, asked),
        lambda arm, asked: arm.teach_start(asked),
        lambda arm, asked: arm.teach_play(asked),
        lambda arm, asked: arm.reset(asked),
    ],
    ids=["command", "set_points", "go_to", "enable", "teach_start", "teach_play", "reset"],
)
def test_what_was_asked_for_before_a_stop_is_void_after_it(request_: Callable[[Any, int], object]) -> None:
    bench = make_bench()
    bench.ask(bench.arm.teach_start)
    guide(bench, "J1", 0.2)
    bench.ask(bench.arm.teach_stop)
    asked = bench.arm.mark()
    stop_and_reset(bench)
    with pytest.raises(HexwireError, match=r"was stopped (since|again)"):
        bench.ask(lambda: request_(bench.arm, asked))
    assert not bench.controller.busy
    assert free(bench)
    assert bench.arm.mark() != asked


def test_torque_off_is_never_void() -> None:
    bench = make_bench()
    asked = bench.arm.mark()
    stop_and_reset(bench)
    assert bench.ask(lambda: bench.arm.enable(False, asked)) == "torque is off"


def test_what_gets_its_mark_only_after_the_stop_can_be_voided_too() -> None:
    bench = make_bench()
    bench.ask(lambda: bench.arm.stop("by the test"))
    asked = bench.arm.mark()
    bench.arm.void()
    bench.ask(lambda: bench.arm.reset(bench.arm.mark()))
    with pytest.raises(GoalError, match="was stopped since"):
        bench.arm.command("", order((1.0, {"J1": J1 + 0.3})), asked=asked)
    assert not bench.controller.busy


def test_an_earlier_reset_does_not_end_a_later_stop() -> None:
    bench = make_bench()
    asked = bench.arm.mark()
    bench.ask(lambda: bench.arm.stop("by the test"))
    with pytest.raises(HexwireError, match="stopped again"):
        bench.ask(lambda: bench.arm.reset(asked))
    assert bench.controller.reason is not None
    assert bench.board.state.stopped


def test_a_goal_whose_check_was_under_way_at_a_stop_does_not_begin_after_the_reset(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    bench = make_bench()
    check = PathCheck.trajectory

    def slow(self: PathCheck, *args: Any, **options: Any) -> None:
        check(self, *args, **options)
        stop_and_reset(bench)

    monkeypatch.setattr(PathCheck, "trajectory", slow)
    with pytest.raises(GoalError, match="was stopped since") as caught:
        bench.command(order((1.0, {"J1": J1 + 0.3})))
    assert caught.value.reason == Reason.STOPPED
    assert not bench.controller.busy


def test_a_pose_whose_check_was_under_way_at_a_stop_does_not_begin_after_the_reset(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    bench = make_bench()
    check = PathCheck.trajectory

    def slow(self: PathCheck, *args: Any, **options: Any) -> None:
        check(self, *args, **options)
        bench.owner.group.stop(StopReason("asked", "by the test"))
        bench.owner.group.reset(bench.owner.group.epochs.mark())

    monkeypatch.setattr(PathCheck, "trajectory", slow)
    with pytest.raises(GoalError, match="was stopped since"):
        bench.ask(lambda: bench.arm.go_to("side"))
    assert not bench.controller.busy


# -- streams begin where the arm is -------------------------------------------------------------------------


def test_a_stream_must_begin_near_the_arm_and_may_go_on_anywhere() -> None:
    bench = make_bench()
    with pytest.raises(GoalError, match=r"J1 by 0\.\d+ rad; it must be within 0\.1 rad") as caught:
        bench.arm.set_points({"J1": J1 + 0.5, "J4": HOME["J4"]}, near=NEAR)
    assert caught.value.reason == Reason.PATH_NOT_ALLOWED
    assert not bench.controller.busy
    bench.arm.set_points({"J1": J1 + 0.05}, near=NEAR)
    bench.turn(0.1)
    bench.arm.set_points({"J1": J1 + 0.5}, near=NEAR)
    bench.turn(0.3)
    assert bench.where("J1") > J1 + 0.2
    with pytest.raises(GoalError, match="J4"):
        bench.arm.set_points({"J1": J1 + 0.5, "J4": HOME["J4"] + 0.5}, near=NEAR)
    bench.arm.set_points({"J4": HOME["J4"] + 0.5})
    assert bench.controller.words == "stream"


@pytest.mark.slow
@pytest.mark.parametrize("end", ["silence", "stop", "goal"])
def test_a_stream_that_was_ended_must_begin_again_near_the_arm(end: str) -> None:
    bench = make_bench()
    bench.arm.set_points({"J1": J1}, near=NEAR)
    bench.turn(0.1)
    if end == "silence":
        bench.turn(0.7)
    elif end == "stop":
        stop_and_reset(bench)
    else:
        told = bench.command(order((0.5, {"J1": J1})))
        bench.until(lambda: told.ends)
        assert told.outcome == SUCCEEDED
    with pytest.raises(GoalError, match="away from the arm"):
        bench.arm.set_points({"J1": J1 + 0.5}, near=NEAR)
    bench.arm.set_points({"J1": J1}, near=NEAR)


# -- settings that change -------------------------------------------------------------------------------------


def test_changed_settings_are_those_of_the_next_goal() -> None:
    bench = make_bench(allow_partial_joints_goal=False)
    faults = Faults()
    given = {
        "allow_partial_joints_goal": True,
        "pose_speed": 0.9,
        "constraints": {"goal_time": 2.0, "J1": {"goal": 0.2}},
    }
    bench.arm.adopt(reread(bench.arm.settings, given, faults))
    assert faults.texts == []
    settings = bench.controller.settings
    assert settings.allow_partial
    assert (settings.tolerances.goal_time, settings.tolerances.goal["J1"].position) == (2.0, 0.2)
    assert bench.arm.settings.pose_speed == 0.9
    told = bench.command(order((2.0, {"J1": J1 + 0.3})))
    bench.turn(0.5)
    bench.command(order((1.0, {})))
    assert told.outcome == PREEMPTED


def test_a_goal_must_end_at_rest_where_that_is_the_rule() -> None:
    bench = make_bench()
    goal = order((1.0, {"J1": J1 + 0.2}), still=True)
    last = replace(goal.points[0], velocities=(0.1, *goal.points[0].velocities[1:]))
    moving = TrajectoryGoal(goal.names, (last,))
    bench.command(moving)
    settings = bench.arm.settings
    rows = tuple(replace(row, end_at_rest=True) for row in settings.controllers)
    bench.arm.adopt(replace(settings, controllers=rows))
    with pytest.raises(
        GoalError, match=r"points\[0\]\.velocities: J1 is 0\.1; the last point must have velocity 0"
    ) as caught:
        bench.command(moving)
    assert caught.value.reason == Reason.MALFORMED
    bench.command(goal)
