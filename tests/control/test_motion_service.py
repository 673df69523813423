"""Motions asked for in values from outside, on a shared arm around an emulated board in simulated time."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest
from tests.control.arm_bench import POSES, guide
from tests.control.test_motion_run import RunBench
from tests.motion.arms import HOME

from hexwire.control.loop.outcomes import Outcome
from hexwire.errors import ConfigError, GoalError, HexwireError, LeaseError, UsageError
from hexwire.model.arms.hex7bot.joints import HEX7BOT

J1 = HOME["J1"]


class DeskBench(RunBench):
    def __init__(self, folder: Path, **options: Any) -> None:
        super().__init__(folder, poses=POSES, **options)

    def do(self, **args: Any) -> Outcome | None:
        """Begin a motion, wait for its end; returns its outcome."""
        run = self.motions.begin(self.orders, args)
        self.until(run)
        return run.progress().outcome


@pytest.fixture
def bench(tmp_path: Path) -> DeskBench:
    return DeskBench(tmp_path)


def test_steps_are_exact_and_add_up(bench: DeskBench) -> None:
    """Each begins where the arm was sent before, not where it came to rest, and is checked like every motion."""
    stay = {"what": "step", "joint": "J1", "by": 0.0}
    start = bench.motions.preview(stay).goal["J1"]
    for _ in range(3):
        assert bench.do(what="step", joint="J1", by=math.radians(0.1)) is Outcome.SUCCEEDED
    assert bench.motions.progress is not None
    assert bench.motions.progress.title == "a step of J1 by 0.1 deg"
    begin = bench.motions.preview(stay)
    assert begin.goal["J1"] == pytest.approx(start + math.radians(0.3), abs=1e-9)
    tip = begin.tip
    assert tip is not None
    for what in (
        {"move": [0.0, 0.0, 0.01]},
        {"turn": [0.0, 0.0, 0.1]},
        {"turn": [0.0, 0.0, -0.1]},
        {"move": [0, 0, -0.01]},
    ):
        assert bench.do(what="step", **what) is Outcome.SUCCEEDED, what
    end = bench.motions.preview(stay).tip
    assert end is not None
    assert end.position == pytest.approx(tip.position, abs=1e-6)
    assert end.rpy == pytest.approx(tip.rpy, abs=1e-6)
    refusal = bench.motions.preview({"what": "step", "joint": "J1", "by": 3.0}).refusal
    with pytest.raises(GoalError) as caught:
        bench.do(what="step", joint="J1", by=3.0)
    assert str(caught.value) == refusal != ""


def test_a_step_is_of_one_kind(bench: DeskBench) -> None:
    for args in (
        {},
        {"joint": "J1"},
        {"by": 0.1},
        {"joint": "J1", "by": 0.1, "move": [0, 0, 0]},
        {"turn": [0, 0, 0], "by": 1},
    ):
        with pytest.raises(UsageError, match="a step has a joint and by how far, or a move, or a turn"):
            bench.motions.preview({"what": "step", **args})


def test_a_preview_moves_nothing_and_the_motion_goes_where_it_said(bench: DeskBench) -> None:
    args = {"what": "place", "position": [0.0, 0.22, 0.2]}
    plan = bench.motions.preview(args)
    assert plan.refusal == ""
    bench.turn(0.5)
    assert bench.where("J2") == pytest.approx(HOME["J2"], abs=0.01)
    assert bench.motions.progress is None
    assert bench.do(**args) is Outcome.SUCCEEDED
    for joint, angle in plan.goal.items():
        assert bench.where(joint) == pytest.approx(angle, abs=0.02)
    assert bench.motions.progress is not None
    assert bench.motions.progress.title == "a motion to 0 220 200 mm"


@pytest.mark.parametrize("timed", [True, False])
def test_a_motion_to_where_the_arm_is_succeeds_and_says_nothing(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, timed: bool
) -> None:
    bench = DeskBench(tmp_path, host_timed=not timed)
    place = {"what": "place", "position": [0.0, 0.0, 0.0], "relative": True}
    for args in (*[{"what": "pose", "name": "home"}] * 2, place, {"what": "joints", "goals": {"J1": J1}}):
        assert bench.do(**args) is Outcome.SUCCEEDED, args
    assert caplog.text == ""


def test_a_refused_motion_says_the_same_as_its_preview(bench: DeskBench) -> None:
    args = {"what": "joints", "goals": {"J1": 1.4}}
    refusal = bench.motions.preview(args).refusal
    with pytest.raises(GoalError) as caught:
        bench.motions.begin(bench.orders, args)
    assert str(caught.value) == refusal != ""


@pytest.mark.slow
def test_a_pose_is_saved_and_recalled(bench: DeskBench) -> None:
    assert bench.do(what="joints", goals={"J1": J1 + 0.5, "J7": 0.2}) is Outcome.SUCCEEDED
    bench.motions.save_pose("here")
    assert bench.do(what="joints", goals={"J1": J1, "J7": 0.0}) is Outcome.SUCCEEDED
    assert bench.do(what="pose", name="here") is Outcome.SUCCEEDED
    assert (bench.where("J1"), bench.where("J7")) == pytest.approx((J1 + 0.5, 0.2), abs=0.02)
    assert bench.motions.progress is not None
    assert bench.motions.progress.title == "a motion to here"


def test_a_pose_may_leave_the_gripper_as_it_is(bench: DeskBench) -> None:
    bench.motions.save_pose("arm", gripper=False)
    bench.motions.save_pose("all")
    angles = {row.name: row.angles for row in bench.motions.pose_rows()}
    assert set(angles["all"]) - set(angles["arm"]) == {"J7"}


def test_saved_poses_come_after_those_of_the_settings_and_win(bench: DeskBench) -> None:
    assert [(row.name, row.saved) for row in bench.motions.pose_rows()] == [
        ("home", False),
        ("side", False),
        ("grip", False),
    ]
    bench.motions.save_pose("side")
    rows = [(row.name, row.saved) for row in bench.motions.pose_rows()]
    assert rows == [("home", False), ("grip", False), ("side", True)]
    with pytest.raises(UsageError, match="already"):
        bench.motions.save_pose("side")
    assert bench.do(what="pose", name="side", speed=0.5) is Outcome.SUCCEEDED
    assert bench.where("J1") == pytest.approx(J1, abs=0.02)


def test_an_unknown_pose_names_those_that_there_are(bench: DeskBench) -> None:
    with pytest.raises(UsageError, match="no pose 'x' of hex7bot; there are home, side, grip"):
        bench.motions.preview({"what": "pose", "name": "x"})


def test_a_damaged_file_of_poses_is_told(bench: DeskBench) -> None:
    bench.motions.poses.path.write_text("[poses")
    with pytest.raises(ConfigError):
        bench.motions.preview({"what": "pose", "name": "home"})


def test_the_gripper(bench: DeskBench) -> None:
    assert bench.do(what="grip", share=0.25) is Outcome.SUCCEEDED
    joint = HEX7BOT.joint("J7")
    assert bench.where("J7") == pytest.approx(joint.maximum - 0.25 * (joint.maximum - joint.minimum), abs=0.02)
    with pytest.raises(UsageError, match="from 0"):
        bench.motions.preview({"what": "grip", "share": 1.5})
    bench.motions.jaws = None
    with pytest.raises(UsageError, match="no gripper of hex7bot is known"):
        bench.motions.preview({"what": "grip", "share": 0.5})


@pytest.mark.slow
def test_what_was_taught_is_played_whole_and_in_part(bench: DeskBench) -> None:
    with pytest.raises(UsageError, match="nothing was taught"):
        bench.motions.preview({"what": "play"})
    assert "no torque" in bench.ask(lambda: bench.motions.teach(bench.orders(), True))
    assert bench.motions.teaching
    with pytest.raises(UsageError, match="teach mode"):
        bench.motions.begin(bench.orders, {"what": "joints", "goals": {"J1": J1}})
    guide(bench.bench, "J1", 0.6, 2.0)
    assert "taught" in bench.ask(lambda: bench.motions.teach(bench.orders(), False))
    assert not bench.motions.teaching
    taught = bench.motions.taught
    assert taught is not None
    plan = bench.motions.preview({"what": "play", "factor": 0.5})
    assert plan.duration - plan.lead_in == pytest.approx(2 * taught.duration)
    assert bench.do(what="play", end=taught.duration / 2) is Outcome.SUCCEEDED
    assert bench.where("J1") == pytest.approx(J1 + 0.3, abs=0.05)
    assert bench.do(what="play") is Outcome.SUCCEEDED
    assert bench.where("J1") == pytest.approx(J1 + 0.6, abs=0.03)


def test_an_arm_with_a_silent_joint_goes_nowhere_and_says_why(bench: DeskBench) -> None:
    bench.bench.silence("J3")
    bench.turn(1.0)
    for args in ({"what": "joints", "goals": {"J1": J1}}, {"what": "place", "position": [0.0, 0.22, 0.2]}):
        plan = bench.motions.preview(args)
        assert "J3" in plan.refusal + plan.unready, args
        with pytest.raises(HexwireError, match="J3"):
            bench.motions.begin(bench.orders, args)


def test_a_page_ends_teaching_holding_although_torque_was_off(bench: DeskBench) -> None:
    bench.ask(lambda: bench.bench.arm.enable(False))
    bench.ask(lambda: bench.motions.teach(bench.orders(), True))
    guide(bench.bench, "J1", 0.6)
    bench.ask(lambda: bench.motions.teach(bench.orders(), False))
    assert bench.bench.torques() == [True] * 7


def test_only_the_holder_of_the_lease_teaches_and_moves(bench: DeskBench) -> None:
    bench.key += 1
    with pytest.raises(LeaseError):
        bench.motions.teach(bench.orders(), True)
    with pytest.raises(LeaseError):
        bench.do(what="pose", name="side")
    assert all(bench.bench.torques())


def test_titles_are_for_people(bench: DeskBench) -> None:
    for args, title in (
        ({"what": "joints", "goals": {"J1": math.radians(12.5)}}, "a motion to J1 12.5 deg"),
        ({"what": "joints", "goals": dict(HOME)}, "a motion to joint angles"),
        ({"what": "place", "position": [0.0, 0.0, 0.01], "relative": True}, "a motion by 0 0 10 mm"),
        ({"what": "grip", "share": 0.5}, "the gripper to 50 % open"),
    ):
        run = bench.motions.begin(bench.orders, args)
        assert run.progress().title == title
        run.end("enough")
        bench.turn(0.3)
