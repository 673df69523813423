"""Far targets of a shared arm without a watchdog are sent in short steps, and end with the lease."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import product
from typing import Any

import pytest
from tests.control.arm_bench import order
from tests.control.shared_bench import SharedBench
from tests.control.test_every_end import sample_steps, worst
from tests.few import few
from tests.motion.arms import EXCESS, HOME

from hexwire.control.loop.target import SteppedWay, straight
from hexwire.control.sharing.shared_steps import JointSteps, SteppedTargets
from hexwire.errors import LeaseError, LimitError, StoppedError
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.model.state import JointTarget, SentTarget
from hexwire.motion.quintic import PEAK_SPEED, quintic_share
from hexwire.motion.safety import StopReason

AWAY = 0.8
LEAD = 1.0
"""Duration of a step's target with dialect 1, seconds."""
STILL = 0.01


def goals(bench: SharedBench, joint: str = "J1") -> list[float]:
    return [dict(target.positions)[joint] for target in bench.sent if joint in dict(target.positions)]


def make(dialect: int = 1) -> tuple[SharedBench, int]:
    bench = SharedBench(dialect=dialect)
    return bench, bench.take()


def test_a_far_target_goes_out_in_short_steps_and_arrives() -> None:
    bench, key = make()
    goal = bench.where("J1") + AWAY
    sent = bench.move(key, 8.0, J1=AWAY)
    assert sent.duration == 8.0
    assert dict(sent.positions) == pytest.approx({"J1": goal})
    bench.keep(key, 4.0)
    assert abs(bench.where("J1") - goal) > 0.3 * AWAY, "in its time"
    bench.keep(key, 7.0)
    assert bench.where("J1") == pytest.approx(goal, abs=0.02)
    assert all(target.duration <= LEAD + 0.01 for target in bench.sent)
    steps = goals(bench)
    assert steps == sorted(steps)
    assert len(steps) > 8
    assert steps[-1] == pytest.approx(goal)
    assert not bench.owner.group.busy


def test_only_a_step_and_a_half_remains_when_this_program_dies() -> None:
    bench, key = make()
    bench.move(key, 8.0, J1=AWAY)
    bench.keep(key, 3.0)
    here = bench.where("J1")
    # Nobody turns any more: time passes for the servos alone.
    bench.bench.emulated.wait(10.0)
    assert 0.0 <= bench.where("J1") - here < 1.7 * LEAD * AWAY / 8.0 + STILL


def test_a_far_target_that_is_meant_to_be_short_takes_steps_too() -> None:
    bench = SharedBench(dialect=1, command_rate=5.0)
    key = bench.take()
    sent = bench.move(key, 0.05, J1=-1.2)
    # Not faster than the acceleration of 6 rad/s^2 allows.
    assert sent.duration == pytest.approx(math.sqrt(10 / math.sqrt(3) * 1.2 / 6.0), rel=0.01)
    assert goals(bench)[0] > bench.where("J1") - 0.7
    assert bench.sent[0].duration == pytest.approx(0.3)


def test_a_robot_with_a_watchdog_gets_it_whole() -> None:
    bench, key = make(dialect=2)
    bench.move(key, 8.0, J1=AWAY)
    bench.keep(key, 1.0)
    (whole,) = bench.sent
    assert whole.duration == 8.0


def test_a_stream_of_set_points_is_sent_as_it_comes() -> None:
    bench, key = make()
    given = []
    for _ in range(5):
        target = JointTarget.of({"J1": bench.where("J1") + 0.05}, LEAD)
        given.append(target)
        assert isinstance(bench.shared.write(bench.order(key, age=0.0), target), SentTarget)
        bench.keep(key, 0.7)
    assert bench.sent == given


def test_a_target_outside_the_limits_is_refused_as_a_whole() -> None:
    bench, key = make()
    with pytest.raises(LimitError):
        bench.move(key, 8.0, J1=20.0)
    bench.keep(key, 1.0)
    assert not bench.sent


ENDS: dict[str, Callable[[SharedBench, int], object]] = {
    "a stop": lambda bench, key: bench.shared.stop("a test"),
    "a stop of somebody else": lambda bench, key: bench.robot.stop(),
    "silence": lambda bench, key: bench.turn(1.0),
    "pre-emption": lambda bench, key: bench.take("Eve", force=True),
    "giving back": lambda bench, key: bench.shared.leave(key, finish=False),
    "torque off": lambda bench, key: bench.ask(lambda: bench.shared.torque(bench.order(key), False, ["J1"])),
    "the end of the server": lambda bench, key: bench.shared.shutdown(),
}


@few("end", ENDS, "a stop", "silence", "the end of the server")
def test_the_steps_end_with_who_answers_for_them(end: str) -> None:
    bench, key = make()
    bench.move(key, 20.0, J1=AWAY)
    bench.keep(key, 3.0)
    ENDS[end](bench, key)
    bench.turn(1.5)
    del bench.sent[:]
    assert bench.travel("J1", 3.0) < STILL
    assert not bench.sent
    assert not bench.owner.group.busy


@pytest.mark.slow
def test_a_resume_does_not_continue_them() -> None:
    bench, key = make()
    bench.move(key, 20.0, J1=AWAY)
    bench.keep(key, 3.0)
    bench.shared.stop("a test")
    bench.ask(lambda: bench.shared.resume(bench.order(key)))
    bench.keep(key, 1.5)
    del bench.sent[:]
    here = bench.where("J1")
    bench.keep(key, 3.0)
    assert bench.where("J1") == pytest.approx(here, abs=STILL)
    assert not bench.sent


@pytest.mark.slow
def test_a_new_target_ends_the_steps_of_its_joints_only_and_begins_where_they_were_led() -> None:
    bench, key = make()
    bench.move(key, 20.0, J1=AWAY, J4=AWAY)
    bench.keep(key, 3.0)
    last = goals(bench)[-1]
    del bench.sent[:]
    bench.move(key, 20.0, J1=-AWAY)
    assert goals(bench)[0] == pytest.approx(last, abs=0.1 * AWAY), "no jump"
    bench.keep(key, 5.0)
    one, four = goals(bench, "J1"), goals(bench, "J4")
    assert one == sorted(one, reverse=True)
    assert four == sorted(four)
    assert len(four) > 3


@pytest.mark.slow
def test_a_trajectory_takes_over_from_the_steps() -> None:
    bench, key = make()
    bench.move(key, 20.0, J1=AWAY)
    bench.keep(key, 3.0)
    del bench.sent[:]
    bench.shared.follow(bench.order(key), "", order((8.0, {"J1": HOME["J1"]})), None)
    bench.keep(key, 12.0)
    assert all(len(dict(target.positions)) == len(target.positions) for target in bench.sent), "no joint twice"
    assert bench.where("J1") == pytest.approx(HOME["J1"], abs=0.03)
    assert bench.owner.group.reason is None


@pytest.mark.slow
def test_the_steps_continue_after_a_holder_that_leaves_its_motion_running() -> None:
    bench, key = make()
    goal = bench.where("J1") + AWAY
    bench.move(key, 8.0, J1=AWAY)
    bench.keep(key, 1.0)
    bench.shared.leave(key, finish=True)
    assert bench.shared.holder is not None
    bench.turn(12.0)
    assert bench.where("J1") == pytest.approx(goal, abs=0.02)
    assert bench.shared.holder is None


def test_which_joints_take_the_first_step_otherwise_is_told() -> None:
    bench, key = make()
    write = bench._write
    bench._write = lambda target: replace(write(target), clamped=("J2",), silent=("J1",))  # type: ignore[method-assign]
    sent = bench.move(key, 8.0, J1=AWAY, J2=0.1)
    assert (sent.clamped, sent.silent) == (("J2",), ("J1",))


def test_a_stop_between_the_first_step_and_the_next_leaves_no_steps() -> None:
    for resumed in (False, True):
        bench, key = make()
        write = bench._write

        def stopped(
            target: JointTarget, bench: SharedBench = bench, write: Any = write, again: bool = resumed
        ) -> Any:
            sent = write(target)
            bench.owner.group.stop(StopReason("asked", "a test"))
            bench.robot.stop()
            if again:
                bench.robot.resume()
                bench.owner.group.reset(bench.owner.group.epochs.mark())
            return sent

        bench._write = stopped  # type: ignore[method-assign]
        with pytest.raises(StoppedError):
            bench.move(key, 8.0, J1=AWAY)
        assert not bench.owner.group.busy


def test_a_first_step_that_is_refused_leaves_no_steps() -> None:
    bench, key = make()

    def refused(target: JointTarget) -> Any:
        raise LeaseError("too old", lost=False)

    bench._write = refused  # type: ignore[method-assign]
    with pytest.raises(LeaseError):
        bench.move(key, 8.0, J1=AWAY)
    assert not bench.owner.group.busy
    assert SteppedTargets(bench.owner).time_left() == 0.0


def test_a_joint_of_unknown_position_is_sent_to_its_target() -> None:
    bench, key = make()
    newest = bench.owner.newest()
    unknown = {name: math.nan if name == "J1" else angle for name, angle in newest.positions.items()}
    bench.shared._steps._told = lambda here, joints, now: unknown  # type: ignore[method-assign]
    bench.move(key, 8.0, J1=0.1)
    assert goals(bench)[0] == pytest.approx(bench.where("J1") + 0.1, abs=0.01)


def test_the_controller_of_steps_reports_no_goals() -> None:
    def line() -> SteppedWay:
        made = SteppedWay(straight({"J1": 0.0}, {"J1": 1.0}, 2.0), 10.0, 0.5)
        assert made.next(10.0) == JointTarget.of({"J1": quintic_share(0.25)}, 0.75)
        return made

    way = JointSteps("J1", HEX7BOT)
    assert not way.busy
    assert way.cycle(None, 0.0, 0.1) is None  # type: ignore[arg-type]
    way.begin(line())
    assert way.moving
    assert way.aim(10.0) == quintic_share(0.25)
    assert way.left(11.0) > 1.0
    assert way.cycle(None, 10.5, 0.75) == JointTarget.of({"J1": 0.5}, 0.75)  # type: ignore[arg-type]
    for now in (11.0, 11.5):
        assert way.cycle(None, now, 0.75) is not None  # type: ignore[arg-type]
    assert way.cycle(None, 12.0, 0.75) == JointTarget.of({"J1": 1.0}, 0.5)  # type: ignore[arg-type]
    assert not way.busy
    assert way.aim(12.6) == 1.0
    assert way.aim(13.0) is None
    assert way.take_ended() == []
    way.begin(line())
    way.stop(StopReason("asked", "a test"))
    way.reset()
    assert (way.busy, way.reason, way.aim(10.0)) == (False, None, None)


def test_however_late_a_step_is_it_needs_no_more_speed_than_was_asked_for() -> None:
    fastest = 1.01 * PEAK_SPEED / 2.0
    for late in (0.0, 0.02, 0.05, 0.3, 1.0):
        way = SteppedWay(straight({"J1": 0.0}, {"J1": 1.0}, 2.0), 10.0, 0.05)
        now, here, steps = 10.0, 0.0, 0
        while not way.over:
            step = way.next(now)
            ((_, goal),) = step.positions
            assert abs(goal - here) / step.duration <= fastest, late
            steps += 1
            later = 0.05 + late * (steps % 5 == 0)
            # A joint that goes to its target at the speed it was told.
            here += (goal - here) * min(1.0, later / step.duration)
            now += later
        assert goal == 1.0


CHANGES: dict[str, Callable[[SharedBench, int], object]] = {
    "another target": lambda bench, key: bench.move(key, 0.5, J1=0.3),
    "another target further on": lambda bench, key: bench.move(key, 0.5, J1=-0.3),
    "giving back": lambda bench, key: bench.shared.leave(key, finish=False),
    "pre-emption": lambda bench, key: bench.take("Eve", force=True),
}


@few("how, after", product(CHANGES, (0.2, 0.4, 0.6)), *((how, 0.4) for how in CHANGES))
def test_what_changes_a_far_target_on_its_way_keeps_all_limits(
    how: str, after: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench = SharedBench(dialect=1, command_rate=20.0)
    key = bench.take()
    rows = sample_steps(monkeypatch)
    bench.move(key, 1.0, J1=-1.0)
    bench.keep(key, after)
    CHANGES[how](bench, key)
    here = rows[-1][0]
    bench.turn(3.0)
    assert worst(rows, [HEX7BOT.joint("J1")]) <= EXCESS
    assert len(rows) > 400
    assert rows[-1] == pytest.approx(rows[-2], abs=1e-6)
    if "target" not in how:
        assert 0.0 < here - rows[-1][0] < 0.6
    assert bench.where("J1") == pytest.approx(rows[-1][0], abs=0.02)
