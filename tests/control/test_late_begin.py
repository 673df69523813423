"""A motion that begins later than it was planned, while the joints still brake: planning may take long."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest
from tests.control.arm_bench import POSES
from tests.control.test_motion_run import RunBench
from tests.few import few
from tests.motion.arms import HOME

from hexwire.control.loop.outcomes import Outcome
from hexwire.control.motion.motion_run import MotionRun, RunProgress
from hexwire.control.requests.preview import Preview
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.motion.teach import Taught

J1 = HOME["J1"]
SPEED = HEX7BOT.joint("J1").max_speed
SECONDS = 1.3
TIMES = tuple(i / 50 * SECONDS for i in range(51))
SWING = Taught(("J1",), TIMES, tuple((J1 + 0.5 * (1.0 - math.cos(math.tau * t / SECONDS)),) for t in TIMES))
"""J1 turns by 57 degrees and back, at nearly its greatest speed."""

STRAIGHT = {"what": "place", "position": [0.0, 0.0, 0.03], "relative": True, "straight": True}


def planning(
    bench: RunBench,
    monkeypatch: pytest.MonkeyPatch,
    meanwhile: Callable[[], object],
    before: Callable[[], object] = lambda: None,
) -> None:
    """From now on something happens between the plan of a motion and its beginning, and maybe before the plan."""
    plan = bench.motions.plan

    def late(*args: Any, **options: Any) -> Preview:
        before()
        found = plan(*args, **options)
        meanwhile()
        return found

    monkeypatch.setattr(bench.motions, "plan", late)


def swing(bench: RunBench, part: float) -> MotionRun:
    """Begin the swing, and turn until so much of it is over."""
    run = bench.begin({"what": "play"}, taught=SWING)
    bench.turn(run.progress().lead_in + part * SECONDS)
    return run


def pause(bench: RunBench) -> None:
    """End the swing on its way; the joints brake from now on."""
    swing(bench, 0.25).end("paused")


def fastest(bench: RunBench, since: float) -> float:
    """The greatest speed of J1 since a time, radians per second; over 20 ms, since its places are counts."""
    model, i = HEX7BOT.joint("J1"), HEX7BOT.index("J1")
    rows = [(t, model.counts_to_angle(shafts[i])) for t, shafts in bench.bench.track if t >= since]
    speeds = [0.0]
    begin = rows[0]
    for t, angle in rows:
        if t - begin[0] >= 0.02:
            speeds.append(abs(angle - begin[1]) / (t - begin[0]))
            begin = t, angle
    return max(speeds)


def go_on(bench: RunBench, args: dict[str, Any]) -> None:
    """Begin another motion, which succeeds at no more than the joint's speed."""
    began = bench.clock.time
    again = bench.begin(args, taught=SWING if args["what"] == "play" else None)
    bench.until(again)
    assert again.progress().outcome is Outcome.SUCCEEDED, again.progress().text
    assert fastest(bench, began) < 1.1 * SPEED


@pytest.mark.parametrize("host_timed", [False, True])
@pytest.mark.parametrize("args", [{"what": "play"}, STRAIGHT])
def test_a_paused_motion_goes_on_although_its_plan_takes_long(
    monkeypatch: pytest.MonkeyPatch, args: dict[str, Any], *, host_timed: bool
) -> None:
    bench = RunBench(host_timed=host_timed)
    pause(bench)
    planning(bench, monkeypatch, lambda: bench.turn(0.06))
    go_on(bench, args)
    if args["what"] == "play":
        assert bench.where("J1") == pytest.approx(J1, abs=0.02)


@pytest.mark.parametrize("host_timed", [False, True])
def test_a_motion_begins_after_a_stall_of_the_loop(monkeypatch: pytest.MonkeyPatch, *, host_timed: bool) -> None:
    """The loop neither reads nor sends while the motion is planned; its clock goes on, and so does the board."""
    bench = RunBench(host_timed=host_timed)
    pause(bench)
    planning(bench, monkeypatch, lambda: bench.clock.sleep(0.3))
    go_on(bench, {"what": "play"})


@pytest.mark.parametrize("host_timed", [False, True])
def test_a_motion_is_planned_during_a_stall_of_the_loop(*, host_timed: bool) -> None:
    """By its clock the brake is over, but the joints stand where the last target has led them."""
    bench = RunBench(host_timed=host_timed)
    pause(bench)
    bench.clock.sleep(0.3)
    go_on(bench, {"what": "play"})


def replace_in_stalls(
    monkeypatch: pytest.MonkeyPatch, part: float, before: float, checking: float, after: float, *, host_timed: bool
) -> RunProgress:
    """Replace a swing at a part of it by a motion to a pose, while the loop stalls; no joint becomes too fast.

    Args:
        part: Of the swing that is over by then.
        before: Seconds of turns between the end of the swing and the plan.
        checking: Seconds for which the loop stalls during the check of the path.
        after: The same after the beginning.
    """
    bench = RunBench(host_timed=host_timed, poses=POSES)
    controller = bench.bench.controller
    swing(bench, part)
    planning(bench, monkeypatch, lambda: bench.turn(0.02), lambda: bench.turn(before))
    check = controller.check_path

    def late_check(*args: Any, **options: Any) -> None:
        check(*args, **options)
        bench.clock.sleep(checking)
        bench.turn(0.02)

    monkeypatch.setattr(controller, "check_path", late_check)
    began = bench.clock.time
    run = bench.begin({"what": "pose", "name": "side"})
    bench.clock.sleep(after)
    bench.until(run)
    found = run.progress()
    assert fastest(bench, began) < 1.1 * SPEED, (before, checking, after)
    if found.outcome is Outcome.SUCCEEDED:
        assert bench.where("J1") == pytest.approx(POSES["side"]["J1"], abs=0.02)
    return found


@pytest.mark.parametrize("host_timed", [False, pytest.param(True, marks=pytest.mark.slow)])
@few("part", [0.25, 0.4], 0.25)
def test_whatever_stalls_as_a_motion_is_replaced_no_joint_moves_faster_than_it_may(
    monkeypatch: pytest.MonkeyPatch, part: float, *, host_timed: bool
) -> None:
    """A path that its board had run to its end, since it was not told in time to leave it, was begun once more."""
    for before, checking, after in ((0.1, 0.3, 0.0), (0.2, 0.0, 0.5), (0.35, 0.0, 0.2), (0.02, 0.3, 0.5)):
        found = replace_in_stalls(monkeypatch, part, before, checking, after, host_timed=host_timed)
        assert found.outcome is Outcome.SUCCEEDED, found.text


def test_targets_one_by_one_begin_where_the_joints_are(monkeypatch: pytest.MonkeyPatch) -> None:
    """A board refuses a path that begins elsewhere; the first of its targets would let the joints jump."""
    monkeypatch.setattr("hexwire.control.motion.onboard_execution.first_start", lambda planned: planned[0][1])
    replace_in_stalls(monkeypatch, 0.25, 0.1, 0.3, 0.0, host_timed=False)
