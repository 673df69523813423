"""Motions that a person began, on a shared arm around an emulated board in simulated time."""

from __future__ import annotations

import itertools
import math
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from tests.control.shared_bench import SharedBench
from tests.motion.arms import HOME, state
from tests.waits import PATIENCE

from hexwire.control.loop.outcomes import Ended, Outcome, Reason
from hexwire.control.motion.motion_run import MotionRun
from hexwire.control.requests.motion_service import MotionService
from hexwire.control.requests.pose_file import PoseFile
from hexwire.control.sharing.lease import Lease
from hexwire.control.sharing.shared import Order
from hexwire.drivers.tools import Gripper
from hexwire.errors import GoalError, LeaseError, UsageError
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.motion.teach import Taught

J1 = HOME["J1"]
SPLIT = {"arm": {"joints": ["J1", "J2", "J3", "J4", "J5", "J6"]}, "hand": {"joints": ["J7"]}}


def joints(goals: Mapping[str, float], **how: object) -> dict[str, object]:
    return {"what": "joints", "goals": goals, **how}


class RunBench(SharedBench):
    """Somebody has the lease and begins motions."""

    def __init__(self, folder: Path = Path("nowhere"), **options: Any) -> None:
        super().__init__(lease=Lease(timeout=1000.0), **options)
        self.motions = MotionService(self.shared, PoseFile(HEX7BOT, folder))
        self.key = self.take()
        self.over: list[MotionRun] = []

    def orders(self) -> Order:
        return self.order(self.key)

    def begin(self, args: Mapping[str, object], **options: Any) -> MotionRun:
        return self.motions.begin(self.orders, args, on_end=self.over.append, **options)

    def go(self, joint: str = "J1", by: float = 0.8, **options: Any) -> MotionRun:
        return self.begin(joints({joint: HOME[joint] + by}), **options)

    def until(self, run: MotionRun, seconds: float = 20.0) -> None:
        self.bench.until(lambda: run.over or self._gripping(), seconds)
        # No time passes while the thread is slow that replaces the motion of a gripper which presses.
        for thread in self._gripping():
            self.settle_thread(thread)
        self.bench.until(lambda: run.over, seconds)

    @staticmethod
    def _gripping() -> list[threading.Thread]:
        return [thread for thread in threading.enumerate() if thread.name == "grip"]


@pytest.fixture
def bench() -> RunBench:
    return RunBench()


def test_it_arrives_and_says_so_once(bench: RunBench) -> None:
    run = bench.go()
    assert run.progress().outcome is None
    bench.until(run)
    assert bench.where("J1") == pytest.approx(J1 + 0.8, abs=0.02)
    progress = run.progress()
    assert (progress.outcome, progress.text) == (Outcome.SUCCEEDED, "")
    assert progress.elapsed == progress.duration > 0.5
    bench.turn(1.0)
    assert bench.over == [run]


def test_it_says_how_far_off_the_joints_are(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hexwire.control.loop.controller.off_goal", lambda names, *_: f"{names[-1]} 0.6 deg off")
    bench = RunBench(controllers=SPLIT)
    run = bench.begin(joints({"J1": J1 + 0.3, "J7": HOME["J7"] + 0.3}))
    bench.until(run)
    progress = run.progress()
    assert (progress.outcome, progress.text) == (Outcome.SUCCEEDED, "")
    assert set(progress.off.split("; ")) == {"J6 0.6 deg off", "J7 0.6 deg off"}


@pytest.mark.slow
def test_progress_rises_with_the_motion(bench: RunBench) -> None:
    run = bench.begin(joints({"J1": J1 + 0.8}, speed=0.1))
    bench.turn(0.2)
    seen, begin = [run.progress().elapsed], bench.clock.time
    for _ in range(8):
        bench.turn(0.1)
        seen.append(run.progress().elapsed)
    assert seen == sorted(seen)
    assert seen[-1] - seen[0] == pytest.approx(bench.clock.time - begin, abs=0.01)
    assert run.progress().title.startswith("a motion to J1 ")


def test_ended_it_holds_at_once(bench: RunBench) -> None:
    run = bench.go()
    bench.turn(0.6)
    run.end("released")
    assert run.progress().outcome is Outcome.PREEMPTED
    assert run.progress().text == "released"
    assert 0.3 < run.progress().elapsed < 0.8
    bench.turn(0.3)
    stood = bench.where("J1")
    assert J1 + 0.02 < stood < J1 + 0.55
    bench.turn(1.0)
    assert bench.where("J1") == pytest.approx(stood, abs=0.005)
    run.end("again")
    assert run.progress().text == "released"
    assert bench.over == [run]


def test_on_a_slow_line_the_joints_are_told_to_hold_where_they_are() -> None:
    bench = RunBench(dialect=1, publish_rate=1.0)
    run = bench.go()
    bench.bench.until(lambda: bench.where("J1") > J1 + 0.15)
    bench.ask(lambda: run.end("released"))
    stood = bench.where("J1")
    bench.turn(0.5)
    held = bench.where("J1")
    bench.turn(3.0)
    assert bench.where("J1") == pytest.approx(held, abs=0.01)
    assert held - stood < 0.2


def test_without_signs_of_life_it_holds(bench: RunBench) -> None:
    heard = bench.owner.now()
    run = bench.go(age=lambda: bench.owner.now() - heard, silence=0.5)
    bench.turn(0.4)
    assert not run.over
    bench.turn(0.3)
    assert run.progress().text == "whoever held it is heard no more"
    stood = bench.where("J1")
    bench.turn(1.0)
    assert bench.where("J1") == pytest.approx(stood, abs=0.03)
    assert stood < J1 + 0.6


def test_one_that_is_being_ended_waits_a_moment_for_its_reason(bench: RunBench) -> None:
    ending = False
    run = bench.go(age=lambda: math.inf if ending else 0.0)
    bench.turn(0.3)
    ending = True
    bench.turn(0.05)
    assert not run.over
    bench.turn(0.3)
    assert run.over


@pytest.mark.slow
def test_a_new_one_replaces_it(bench: RunBench) -> None:
    first = bench.go()
    bench.turn(0.5)
    second = bench.go(by=-0.3)
    assert first.progress().text == f"replaced by {second.progress().title}"
    bench.until(second)
    assert bench.where("J1") == pytest.approx(J1 - 0.3, abs=0.02)
    assert bench.over == [first, second]


def test_a_stop_ends_it_and_the_reason_is_told(bench: RunBench) -> None:
    run = bench.go()
    bench.turn(0.5)
    bench.ask(lambda: bench.shared.stop("somebody pressed STOP"))
    assert run.progress().outcome is Outcome.ABORTED
    assert "somebody pressed STOP" in run.progress().text
    stood = bench.where("J1")
    bench.turn(1.0)
    assert bench.where("J1") == pytest.approx(stood, abs=0.03)
    with pytest.raises(GoalError, match="the arm is stopped"):
        bench.go()


def test_a_refused_one_moves_nothing_and_says_why(bench: RunBench) -> None:
    with pytest.raises(GoalError, match="outside its limits"):
        bench.go(by=3.0)
    bench.turn(1.0)
    assert bench.where("J1") == pytest.approx(J1, abs=0.01)
    assert bench.over == []


def test_without_the_lease_nothing_begins(bench: RunBench) -> None:
    running = bench.go()
    bench.key += 1
    with pytest.raises(LeaseError):
        bench.go(by=-0.5)
    assert not running.over


def test_one_that_is_no_longer_wanted_does_not_begin(bench: RunBench) -> None:
    with pytest.raises(GoalError, match="released before it began"):
        bench.go(wanted=lambda: False)
    bench.turn(0.5)
    assert bench.where("J1") == pytest.approx(J1, abs=0.01)


def test_a_lost_lease_ends_it(bench: RunBench) -> None:
    run = bench.go()
    bench.turn(0.5)
    bench.shared.leave(bench.key, finish=False)
    assert run.progress().outcome is Outcome.ABORTED
    stood = bench.where("J1")
    bench.turn(1.0)
    assert bench.where("J1") == pytest.approx(stood, abs=0.05)


def test_a_motion_to_where_the_arm_is_succeeds_at_once(bench: RunBench) -> None:
    here = bench.owner.newest().positions["J1"]
    run = bench.begin(joints({"J1": here}))
    assert run.progress().outcome is Outcome.SUCCEEDED
    assert bench.over == [run]


def test_all_controllers_move_and_it_ends_with_the_last() -> None:
    bench = RunBench(controllers=SPLIT)
    goals = {"J1": J1 + 0.6, "J7": HOME["J7"] + 0.2}
    run = bench.begin(joints(goals))
    bench.until(run)
    assert run.progress().outcome is Outcome.SUCCEEDED
    assert (bench.where("J1"), bench.where("J7")) == pytest.approx(tuple(goals.values()), abs=0.02)


def test_if_one_controller_fails_the_others_stop_too() -> None:
    bench = RunBench(controllers=SPLIT)
    run = bench.begin(joints({"J1": J1 + 0.8, "J7": HOME["J7"] + 0.5}))
    bench.turn(0.4)
    bench.bench.arm.hold("hand", "somebody else moves it")
    assert run.progress().text == "somebody else moves it"
    bench.turn(0.3)
    stood = bench.where("J1")
    bench.turn(1.0)
    assert bench.where("J1") == pytest.approx(stood, abs=0.005)
    assert stood < J1 + 0.5


@pytest.mark.slow
def test_a_taught_motion_has_a_lead_in(bench: RunBench) -> None:
    wave = Taught(("J1",), (0.0, 1.0, 2.0), ((J1 + 0.4,), (J1 + 0.7,), (J1 + 0.1,)))
    run = bench.begin({"what": "play"}, taught=wave)
    lead = run.progress().lead_in
    assert lead > 0.3
    bench.turn(lead + 1.0)
    assert bench.where("J1") == pytest.approx(J1 + 0.7, abs=0.1)
    bench.until(run)
    assert bench.where("J1") == pytest.approx(J1 + 0.1, abs=0.02)


# -- whoever waits for it ------------------------------------------------------------------------------------

DONE = Ended(Outcome.SUCCEEDED, Reason.REACHED)
STOPPED = Ended(Outcome.ABORTED, Reason.STOPPED, "stopped: it burns")
REPLACED = Ended(Outcome.PREEMPTED, Reason.REPLACED)


def begun(bench: RunBench, goals: int) -> MotionRun:
    run = MotionRun(bench.owner, bench.bench.arm.controllers.values(), on_end=bench.over.append)
    run.begin(goals, lambda: None)
    return run


def test_all_must_succeed(bench: RunBench) -> None:
    run = begun(bench, 2)
    run.ended(DONE)
    assert not run.over
    run.ended(DONE)
    run.wait(0.0)
    assert bench.over == [run]


def test_what_the_goals_say_that_succeeded(bench: RunBench) -> None:
    run = begun(bench, 3)
    for text in ("J2 0.6 deg off", "", "J7 1.0 deg off"):
        run.ended(Ended(Outcome.SUCCEEDED, Reason.REACHED, text))
    assert run.off == ("J2 0.6 deg off", "J7 1.0 deg off")


def test_the_first_that_fails_ends_the_wait(bench: RunBench) -> None:
    run = begun(bench, 3)
    run.ended(STOPPED)
    with pytest.raises(UsageError, match=r"^stopped: it burns$"):
        run.wait(0.0)
    run.ended(REPLACED)
    run.ended(DONE)
    assert (run.outcome, bench.over) == (Outcome.ABORTED, [run])


def test_an_end_without_words(bench: RunBench) -> None:
    run = begun(bench, 1)
    run.ended(REPLACED)
    with pytest.raises(UsageError, match=r"^preempted$"):
        run.wait(0.0)


def test_one_that_nobody_waits_for_any_longer_holds(bench: RunBench) -> None:
    run = bench.go()
    bench.turn(0.5)
    with pytest.raises(UsageError, match=r"^not arrived after 0 s; the arm holds$"):
        run.wait(0.0)
    assert run.over
    bench.turn(0.3)
    stood = bench.where("J1")
    bench.turn(1.0)
    assert bench.where("J1") == pytest.approx(stood, abs=0.005)
    assert stood < J1 + 0.55


def test_another_thread_ends_the_wait(bench: RunBench) -> None:
    run = begun(bench, 1)
    timer = threading.Timer(0.01, run.ended, (DONE,))
    timer.start()
    run.wait(PATIENCE)
    timer.join()


# -- the gripper ---------------------------------------------------------------------------------------------


def grip(bench: RunBench, share: float) -> MotionRun:
    return bench.begin({"what": "grip", "share": share})


@pytest.mark.slow
def test_a_gripper_opens_and_closes(bench: RunBench) -> None:
    for share in (1.0, 0.0, 0.5):
        run = grip(bench, share)
        bench.until(run)
        assert (run.progress().outcome, run.progress().holds) == (Outcome.SUCCEEDED, False)
        assert Gripper(bench.robot).share(bench.owner.newest()) == pytest.approx(share, abs=0.03)


def test_a_closing_gripper_holds_what_it_meets_with_little_force(bench: RunBench) -> None:
    bench.until(grip(bench, 1.0))
    gripper = Gripper(bench.robot)
    run = grip(bench, 0.0)
    bench.bench.until(lambda: gripper.share(bench.owner.newest()) < 0.55)
    bench.bench.jam("J7")
    bench.until(run)
    assert run.progress().holds
    bench.turn(1.0)
    assert bench.owner.group.reason is None
    (told,) = bench.bench.controller.generator.desired(("J7",), bench.clock.time).position
    # 3 degrees, and what the newest state was late.
    assert 0.0 < told - bench.where("J7") < 0.12


@pytest.mark.slow
def test_the_effort_of_the_start_is_no_object(bench: RunBench) -> None:
    bench.until(grip(bench, 1.0))
    run = grip(bench, 0.0)
    for stamp, holds in ((0.0, False), (0.02, False), (0.04, False), (0.08, False), (0.11, True)):
        run._see(state({"J7": 0.0}, load={"J7": 0.5}, stamp=stamp))
        assert run.progress().holds is holds
    bench.until(run)


@pytest.mark.slow
def test_jaws_that_move_hold_nothing_whatever_velocity_is_reported(bench: RunBench) -> None:
    bench.until(grip(bench, 1.0))
    run = grip(bench, 0.0)
    for i in range(20):
        run._see(state({"J7": -0.7 + 0.02 * i}, load={"J7": 0.5}, stamp=0.02 * i))
        assert not run.progress().holds
    for i in range(20, 27):
        run._see(state({"J7": -0.3}, load={"J7": 0.5}, stamp=0.02 * i))
    assert run.progress().holds
    bench.until(run)


@pytest.mark.slow
def test_an_opening_gripper_does_not_hold_what_it_meets(bench: RunBench) -> None:
    bench.until(grip(bench, 0.0))
    run = grip(bench, 1.0)
    bench.turn(0.3)
    bench.bench.jam("J7")
    with pytest.raises(AssertionError):
        bench.bench.until(lambda: run.progress().holds, 3.0)
    assert list(itertools.islice(bench.owner.observers, 99)).count(run._see) <= 1
