"""Plans of motions, around an emulated board in simulated time. Nothing moves."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import replace

import pytest
from tests.control.arm_bench import Bench, make_bench
from tests.motion.arms import HOME, NAMES

from hexwire.control.motion.via import Place
from hexwire.control.requests.controlled_arm import ControlledArm
from hexwire.control.requests.preview import Planner, goal_of
from hexwire.control.requests.setting import Faults
from hexwire.control.requests.settings_reader import read_settings
from hexwire.errors import GoalError, UsageError
from hexwire.model.aim import Aim, Tip
from hexwire.model.arms.hex7bot.kinematics import Hex7BotModel
from hexwire.model.arms.so_arm.kinematics import SoArmModel
from hexwire.motion.checks import check_trajectory
from hexwire.motion.teach import Edits, Taught
from hexwire.motion.trajectory import Spline, Waypoint

AHEAD = (0.0, 0.22, 0.2)
WAVE = Taught(("J1", "J4"), (0.0, 1.0, 2.0), ((HOME["J1"] + 0.3, 0.2), (HOME["J1"] + 0.6, 0.0), (HOME["J1"], 0.0)))


@pytest.fixture
def bench() -> Bench:
    return make_bench(check_table=True)


@pytest.fixture
def so101() -> Iterator[Planner]:
    settings, driver = read_settings({"port": "sim://so101", "check_table": False}, Faults())
    arm = ControlledArm(driver, settings)
    arm.connect()
    arm.owner.turn()
    yield arm.planner
    arm.shutdown()


@pytest.fixture
def planner(bench: Bench) -> Planner:
    return bench.arm.planner


def test_joints_go_where_they_are_sent_and_the_others_stay(bench: Bench, planner: Planner) -> None:
    plan = planner.to_joints({"j1": HOME["J1"] + 0.5, "J4": 0.4})
    assert (plan.refusal, plan.unready) == ("", "")
    assert plan.goal == {"J1": HOME["J1"] + 0.5, "J4": 0.4}
    path = plan.require()
    assert set(path.names) == set(NAMES)
    ends = dict(zip(path.names, path.goal, strict=True))
    assert ends["J1"] == HOME["J1"] + 0.5
    assert ends["J2"] == pytest.approx(bench.where("J2"), abs=0.01)
    assert plan.tip is not None
    bench.turn(1.0)
    assert bench.where("J1") == pytest.approx(HOME["J1"], abs=0.01)


def test_speed_decides_the_duration(planner: Planner) -> None:
    slow, fast = (planner.to_joints({"J1": HOME["J1"] + 1.0}, speed=speed) for speed in (0.1, 1.0))
    assert slow.duration > 3 * fast.duration
    assert fast.refusal == ""
    for speed in (0.0, 1.1, math.nan):
        with pytest.raises(UsageError):
            planner.to_joints({"J1": 0.0}, speed=speed)


@pytest.mark.parametrize("goals", [{}, {"J9": 0.0}, {"J1": math.nan}])
def test_a_malformed_goal_is_an_error_not_a_plan(planner: Planner, goals: dict[str, float]) -> None:
    with pytest.raises(UsageError):
        planner.to_joints(goals)


def test_a_refused_path_says_why_and_keeps_its_goal(planner: Planner) -> None:
    plan = planner.to_joints({"J1": 1.4})
    assert "J1=" in plan.refusal
    assert "outside its limits" in plan.refusal
    assert plan.goal == {"J1": 1.4}
    with pytest.raises(GoalError, match="outside its limits"):
        plan.require()


def test_a_place_has_branches_and_the_nearest_is_chosen(planner: Planner) -> None:
    plan = planner.to_place(Place(AHEAD))
    assert plan.refusal == ""
    assert plan.tip is not None
    assert plan.tip.position == pytest.approx(AHEAD)
    allowed = [branch for branch in plan.branches if not branch.why]
    assert plan.branch == allowed[0].name
    assert allowed[0].turn == min(branch.turn for branch in allowed)
    assert any(branch.why for branch in plan.branches)


def test_a_branch_can_be_chosen(so101: Planner) -> None:
    place = Place((0.4, 0.0, 0.2), Aim(pitch=math.radians(-60.0), roll=0.0))
    plan = so101.to_place(place)
    allowed = [branch.name for branch in plan.branches if not branch.why]
    assert plan.branch == allowed[0]
    assert len(allowed) == 2
    chosen = so101.to_place(replace(place, branch=allowed[1]))
    assert chosen.branch == allowed[1]
    assert chosen.goal != plan.goal
    assert chosen.tip is not None
    assert chosen.tip.position == pytest.approx(place.position)


def test_a_branch_outside_the_limits_is_refused(planner: Planner) -> None:
    forbidden = next(branch for branch in planner.to_place(Place(AHEAD)).branches if branch.why)
    refused = planner.to_place(Place(AHEAD, branch=forbidden.name))
    assert refused.refusal == f"{forbidden.name}: {forbidden.why}"
    assert "no solution 'x'" in planner.to_place(Place(AHEAD, branch="x")).refusal


@pytest.mark.parametrize("arm", ["hex7bot", "so101"])
def test_the_tip_of_a_plan_is_where_its_goal_puts_it_though_it_is_refused(
    planner: Planner, so101: Planner, arm: str
) -> None:
    asked, model = (planner, Hex7BotModel()) if arm == "hex7bot" else (so101, SoArmModel())
    place = Place(AHEAD) if arm == "hex7bot" else Place((0.25, 0.0, 0.1), Aim(pitch=math.radians(60.0), roll=0.0))
    names = [branch.name for branch in asked.to_place(place).branches]
    assert len(names) > 1
    for branch in (*names, "x"):
        plan = asked.to_place(replace(place, branch=branch))
        there = Tip.of(model, model.from_joints(plan.goal))
        assert plan.tip is not None
        assert plan.tip.position == pytest.approx(there.position)
        assert plan.tip.rpy == pytest.approx(there.rpy)
        assert plan.tip.pitch_roll == (there.pitch_roll and pytest.approx(there.pitch_roll))


def test_out_of_reach_is_told_with_the_missing_distance(planner: Planner) -> None:
    plan = planner.to_place(Place((0.0, 0.9, 0.2)))
    assert "out of reach" in plan.refusal
    assert " mm" in plan.refusal
    assert plan.goal == {}
    assert plan.path is None


def test_under_the_table_is_refused_by_the_path_check(planner: Planner) -> None:
    plan = planner.to_place(Place((0.0, 0.22, -0.05), Aim(down=True)))
    assert "below the table" in plan.refusal
    assert plan.goal


def test_a_straight_line_is_straight(planner: Planner) -> None:
    planned = planner.to_place(Place((0.03, 0.02, 0.04), relative=True, straight=True), speed=0.2)
    assert planned.refusal == ""
    path = planned.require()
    model = planner._kinematics
    assert model is not None
    tips = [
        model.forward(model.from_joints(dict(zip(path.names, row, strict=True)))).position
        for row in planned.rows(9)
    ]
    a, b = tips[0], tips[-1]
    assert math.dist(a, b) == pytest.approx(math.hypot(0.03, 0.02, 0.04), abs=1e-6)
    assert all(math.dist(a, tip) + math.dist(tip, b) == pytest.approx(math.dist(a, b), abs=1e-6) for tip in tips)
    assert "of the line" in planner.to_place(Place((0.0, 0.9, 0.2), straight=True)).refusal


def test_without_geometry_there_is_no_place() -> None:
    planner = make_bench().arm.planner
    planner._kinematics = None
    with pytest.raises(UsageError, match="no geometry is known"):
        planner.to_place(Place(AHEAD))
    assert planner.to_joints({"J1": HOME["J1"]}).tip is None


def test_a_taught_motion_begins_with_the_way_to_its_start(planner: Planner) -> None:
    plan = planner.along(WAVE)
    path = plan.require()
    assert plan.lead_in > 0.0
    assert plan.duration == pytest.approx(plan.lead_in + 2.0)
    at = dict(zip(path.names, path.at(plan.lead_in).position, strict=True))
    assert (at["J1"], at["J4"]) == pytest.approx(WAVE.rows[0])


def test_a_part_of_a_taught_motion_at_another_speed(planner: Planner) -> None:
    plan = planner.along(WAVE, Edits(begin=1.0), factor=2.0)
    path = plan.require()
    assert plan.duration - plan.lead_in == pytest.approx(0.5)
    at = dict(zip(path.names, path.at(plan.lead_in).position, strict=True))
    assert (at["J1"], at["J4"]) == pytest.approx(WAVE.rows[1])
    for wrong in (0.0, 5.0, math.nan):
        with pytest.raises(UsageError):
            planner.along(WAVE, factor=wrong)


def test_a_taught_motion_too_fast_for_the_arm_is_refused(planner: Planner) -> None:
    jerk = Taught(("J1",), (0.0, 0.1, 0.2), ((HOME["J1"],), (HOME["J1"] + 0.9,), (HOME["J1"],)))
    refused = planner.along(jerk)
    assert re.search(r"J1 would turn at .*; it keeps the limits at 0\.\d+ of its speed$", refused.refusal)
    assert refused.fits is not None
    path = planner.along(jerk, factor=refused.fits).require()
    assert planner.along(jerk, factor=refused.fits + 0.001).fits == refused.fits
    fit = planner.along(jerk, fit=True)
    assert (fit.refusal, fit.duration) == ("", path.duration)
    # What is sent is what was checked: through the points of the recording.
    goal = goal_of(path, NAMES)
    assert [point.positions[0] for point in goal.points[-2:]] == pytest.approx([HOME["J1"] + 0.9, HOME["J1"]])
    # Another limit is in the way, too, whatever the speed.
    beyond = replace(jerk, rows=((HOME["J1"],), (10.0,), (HOME["J1"],)))
    assert "outside its limits" in planner.along(beyond).refusal
    assert planner.along(beyond).fits is None


def test_a_taught_motion_of_another_arm_is_an_error(planner: Planner) -> None:
    with pytest.raises(UsageError, match="no joint 'elbow'"):
        planner.along(Taught(("elbow",), (0.0, 1.0), ((0.0,), (0.1,))))


def test_what_keeps_the_arm_from_moving_is_told_apart_from_the_path(bench: Bench, planner: Planner) -> None:
    bench.ask(lambda: bench.arm.enable(False))
    bench.turn(0.2)
    plan = planner.to_joints({"J1": HOME["J1"] + 0.2})
    assert plan.refusal == ""
    assert "no torque on J1" in plan.unready
    with pytest.raises(GoalError, match="no torque"):
        plan.require()
    bench.ask(lambda: bench.arm.stop("test"))
    assert "the arm is stopped (test)" in planner.to_joints({"J1": HOME["J1"] + 0.2}).unready


def test_teach_mode_keeps_the_arm_from_moving(bench: Bench, planner: Planner) -> None:
    bench.ask(bench.arm.teach_start)
    assert "teach mode" in planner.to_joints({"J1": HOME["J1"] + 0.2}).unready


def test_a_joint_whose_position_is_unknown_is_named(bench: Bench, planner: Planner) -> None:
    fresh = make_bench(on=False, faults=("silent:1",))
    plan = fresh.arm.planner.to_joints({"J2": HOME["J2"] + 0.1})
    assert "the position of J2 is unknown" in plan.refusal
    assert "the position of J2" in fresh.arm.planner.to_place(Place(AHEAD)).refusal


def test_the_goal_that_is_sent_keeps_to_the_path(planner: Planner) -> None:
    plan = planner.to_joints({"J1": HOME["J1"] + 1.0, "J4": 0.5}, speed=1.0)
    path = plan.require()
    goal = goal_of(path, NAMES)
    assert goal.names == NAMES
    assert goal.points[-1].time == path.duration
    start = Waypoint(0.0, tuple(dict(zip(path.names, path.start, strict=True))[n] for n in NAMES), (0.0,) * 7)
    sent = Spline(NAMES, [start, *(Waypoint(p.time, p.positions, p.velocities) for p in goal.points)])
    for t, sample in sent.samples(0.007):
        wanted = dict(zip(path.names, path.sample(t).position, strict=True))
        assert sample.position == pytest.approx([wanted[n] for n in NAMES], abs=1e-4)
    assert check_trajectory(sent, planner._model).findings == ()


def test_a_motion_to_nowhere_has_no_points(bench: Bench, planner: Planner) -> None:
    plan = planner.to_joints({"J1": bench.owner.newest().positions["J1"]})
    assert plan.duration == pytest.approx(0.0, abs=1e-6)
    assert goal_of(plan.require(), NAMES).points == ()
