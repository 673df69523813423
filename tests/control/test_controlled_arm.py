"""What a node is asked for, with an emulated arm in simulated time; services are threads that wait meanwhile."""

from __future__ import annotations

import math
import threading
from collections.abc import Mapping, Sequence
from typing import Any

import pytest
from tests.control.arm_bench import (
    CANCELLED,
    PREEMPTED,
    SPLIT,
    SUCCEEDED,
    Bench,
    Told,
    free,
    guide,
    make_bench,
    order,
)
from tests.few import few
from tests.motion.arms import HOME, NAMES
from tests.waits import PATIENCE

from hexwire.control.loop.outcomes import Outcome, Reason
from hexwire.control.motion.goals import Point, TrajectoryGoal
from hexwire.control.motion.path_check import PathCheck
from hexwire.control.requests.diagnostics import diagnose
from hexwire.errors import GoalError, LimitError, LinkLostError, ServoError, UsageError

J1 = HOME["J1"]
STOPPED = (Outcome.ABORTED, Reason.STOPPED)
NOT_READY = (Outcome.ABORTED, Reason.NOT_READY)


# -- orders ------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_an_empty_trajectory_holds() -> None:
    bench = make_bench()
    told = bench.command(order((3.0, {"J1": J1 + 1.0})))
    bench.turn(1.0)
    bench.arm.command("", order())
    assert told.outcome == PREEMPTED
    assert told.text == "replaced by an empty trajectory"
    bench.turn(0.4)
    stood = bench.where("J1")
    bench.turn(1.0)
    assert bench.where("J1") == pytest.approx(stood, abs=0.005)
    assert stood < J1 + 0.6
    with pytest.raises(GoalError, match="no points"):
        bench.command(order())


@pytest.mark.slow
def test_a_mere_command_replaces_a_goal() -> None:
    bench = make_bench()
    told = bench.command(order((3.0, {"J1": J1 + 1.0})))
    bench.turn(1.0)
    bench.arm.command("", order((1.0, {"J1": J1})))
    assert told.outcome == PREEMPTED
    bench.turn(1.5)
    assert bench.where("J1") == pytest.approx(J1, abs=0.02)


def test_every_refusal_has_a_reason() -> None:
    bench = make_bench(on=False)
    with pytest.raises(GoalError, match="no torque on J1") as caught:
        bench.command(order((1.0, {})))
    assert caught.value.reason == Reason.NOT_READY
    bench.ask(lambda: bench.arm.enable(True))
    with pytest.raises(GoalError, match="unknown") as caught:
        bench.command(TrajectoryGoal(("J9",), order((1.0, {})).points))
    assert caught.value.reason == Reason.WRONG_JOINTS
    with pytest.raises(GoalError, match="outside its limits"):
        bench.command(order((9.0, {"J1": 1.4})))
    bench.link.lost = True
    bench.turn(1.0)
    with pytest.raises(GoalError, match="the robot cannot be reached") as caught:
        bench.command(order((1.0, {})))
    assert caught.value.reason == Reason.NOT_READY


def test_who_cancels_ends_only_its_own_goal() -> None:
    bench = make_bench(controllers=SPLIT)
    (whole,) = order((2.0, {"J1": J1 + 0.5})).points
    told = bench.command(TrajectoryGoal(NAMES[:6], (Point(2.0, whole.positions[:6]),)), "arm")
    other = bench.command(TrajectoryGoal(("J7",), (Point(2.0, (HOME["J7"] + 0.2,)),)), "hand")
    bench.turn(0.5)
    bench.owner.group.cancel(other)
    assert (told.ends, other.outcome) == ([], CANCELLED)
    bench.owner.group.cancel(told)
    assert told.outcome == CANCELLED


# -- set-points --------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    ("positions", "error"),
    [
        ({"J9": 0.0}, "no joint 'J9'; there are J1, "),
        ({"j1": 0.0}, "no joint 'j1'"),
        ({"J1": math.nan}, "J1=nan deg is outside its limits"),
        ({}, "it has no positions"),
        ({"J1": 0.0, "J2": 9.0}, "J2=515.7 deg is outside its limits"),
    ],
)
def test_set_points_that_are_refused_change_nothing(positions: dict[str, float], error: str) -> None:
    bench = make_bench()
    told = bench.command(order((1.0, {"J1": J1 + 0.2})))
    with pytest.raises(UsageError, match=error):
        bench.arm.set_points(positions)
    bench.until(lambda: told.ends)
    assert told.outcome == SUCCEEDED


def test_a_set_point_is_checked_once(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = make_bench(controllers=SPLIT)
    checked: list[Mapping[str, float]] = []
    limits = PathCheck.limits

    def note(check: PathCheck, goal: Mapping[str, float]) -> None:
        checked.append(dict(goal))
        limits(check, goal)

    monkeypatch.setattr(PathCheck, "limits", note)
    positions = {"J1": J1 + 0.1, "J7": 0.2}
    bench.arm.set_points(positions)
    assert checked == [positions]


def test_set_points_are_pursued() -> None:
    bench = make_bench()
    told = bench.command(order((3.0, {"J1": J1 + 1.0})))
    for _ in range(40):
        bench.arm.set_points({"J4": 0.3, "J1": J1 - 0.2})
        bench.turn(0.05)
    assert told.outcome == PREEMPTED
    assert (bench.where("J1"), bench.where("J4")) == pytest.approx((J1 - 0.2, 0.3), abs=0.02)


def test_set_points_of_several_controllers_are_all_taken_or_none() -> None:
    bench = make_bench(controllers=SPLIT)
    assert bench.ask(lambda: bench.owner.torque(False, ["J7"])) == ("J7",)
    with pytest.raises(GoalError, match="no torque on J7"):
        bench.arm.set_points({"J1": J1 + 0.3, "J7": 0.3})
    bench.turn(0.5)
    assert bench.where("J1") == pytest.approx(J1, abs=0.01)
    bench.arm.set_points({"J1": J1 + 0.3})
    bench.turn(0.4)
    assert bench.where("J1") > J1 + 0.1


def test_set_points_without_a_robot() -> None:
    bench = make_bench()
    bench.link.lost = True
    bench.turn(1.0)
    with pytest.raises(LinkLostError):
        bench.arm.set_points({"J1": J1})


# -- the arm as a whole ------------------------------------------------------------------------------------

HALVES = {
    "upper": {"joints": ["J1", "J2"], "allow_partial_joints_goal": True},
    "fore": {"joints": list(NAMES[2:]), "allow_partial_joints_goal": True},
}
FOLD = {"J2": HOME["J2"] + math.radians(55), "J3": HOME["J3"] + math.radians(40)}
"""Each may be there if the other is at home; together they fold the elbow."""


def half(bench: Bench, name: str, to: float, seconds: float) -> Told:
    """Send one of the two halves to the fold, or part of the way."""
    joint = "J2" if name == "upper" else "J3"
    goal = HOME[joint] + to * (FOLD[joint] - HOME[joint])
    return bench.command(TrajectoryGoal((joint,), (Point(seconds, (goal,)),)), name)


def test_set_points_that_would_fold_the_arm_are_refused() -> None:
    bench = make_bench()
    for _ in range(60):
        bench.arm.set_points({"J3": FOLD["J3"]})
        bench.turn(0.05)
    assert bench.where("J3") == pytest.approx(FOLD["J3"], abs=0.02)
    stood = bench.where("J2")
    with pytest.raises(UsageError, match=r"^elbow .*nothing was sent$"):
        bench.arm.set_points({"J2": FOLD["J2"]})
    bench.turn(0.5)
    assert bench.where("J2") == pytest.approx(stood, abs=0.01)
    bench.arm.set_points({"J7": 0.2})


def test_set_points_below_the_table_are_refused() -> None:
    bench = make_bench(check_table=True, table_height=0.05)
    low = {"J2": HOME["J2"] - math.radians(30), "J3": HOME["J3"] + math.radians(65)}
    with pytest.raises(UsageError, match=r"^the tool would be .* mm below the table at 50 mm; nothing was sent$"):
        bench.arm.set_points(low)


@pytest.mark.slow
def test_goals_of_two_controllers_are_checked_against_each_other() -> None:
    bench = make_bench(controllers=HALVES)
    first = half(bench, "upper", 1.0, 4.0)
    bench.turn(0.2)
    with pytest.raises(GoalError, match=r"^at 2\.[5-9].*: elbow folded.*nothing was sent"):
        half(bench, "fore", 1.0, 2.0)
    second = half(bench, "fore", 0.5, 2.0)
    bench.until(lambda: first.ends and second.ends)
    assert first.outcome == second.outcome == SUCCEEDED


def test_an_unpredicted_violation_stops_the_arm_during_the_motion() -> None:
    bench = make_bench(controllers=HALVES)
    told = half(bench, "upper", 1.0, 3.0)
    # A set-point is good where the other joints are when it comes.
    end = bench.clock.time + 30.0
    while not told.ends:
        assert bench.clock.time < end
        if bench.owner.group.reason is None and not bench.where("J3") > FOLD["J3"] - 0.05:
            bench.arm.set_points({"J3": FOLD["J3"]})
        bench.turn(0.05)
    assert told.outcome == STOPPED
    assert told.text.startswith("stopped: elbow folded")
    bench.turn(0.5)
    kinematics = bench.arm.settings.kinematics
    assert kinematics is not None
    assert kinematics.coupling_excess(kinematics.from_joints({n: bench.where(n) for n in NAMES})) < math.radians(
        2.0
    )
    bench.ask(bench.arm.reset)
    back = half(bench, "upper", 0.0, 3.0)
    bench.until(lambda: back.ends)
    assert back.outcome == SUCCEEDED


@pytest.mark.slow
def test_a_goal_that_cannot_collide_with_another_is_followed_at_once() -> None:
    bench = make_bench(controllers=HALVES)
    raised = half(bench, "upper", 1.0, 3.0)
    bench.until(lambda: raised.ends)
    back = half(bench, "upper", 0.0, 1.5)
    bench.turn(0.1)
    told = half(bench, "fore", 1.0, 3.0)
    bench.until(lambda: back.ends and told.ends)
    assert back.outcome == told.outcome == SUCCEEDED


@pytest.mark.slow
def test_sag_at_an_allowed_position_does_not_stop_the_arm() -> None:
    bench = make_bench(controllers=SPLIT, check_table=True)
    kinematics = bench.arm.settings.kinematics
    assert kinematics is not None
    angles = {name: bench.arm.settings.model.joint(name) for name in ("J2", "J3")}
    low = {**HOME, "J2": HOME["J2"] - math.radians(30), "J3": HOME["J3"] + math.radians(65)}
    height = min(point[2] for point in kinematics.points(kinematics.from_joints(low)).values())
    bench = make_bench(controllers=SPLIT, check_table=True, table_height=height - 0.001)
    whole = tuple(low[name] for name in NAMES[:6])
    told = bench.command(TrajectoryGoal(NAMES[:6], (Point(4.0, whole),)), "arm")
    bench.until(lambda: told.ends)
    servo = bench.board.wire[angles["J3"].servo_id]
    droop = math.radians(1.5) / angles["J3"].scale
    bench.jammed[angles["J3"].servo_id] = servo.motion.position + droop
    grip = bench.command(TrajectoryGoal(("J7",), (Point(1.0, (0.2,)),)), "hand")
    bench.until(lambda: grip.ends)
    assert grip.outcome == SUCCEEDED


@pytest.mark.slow
def test_repeated_set_points_do_not_creep_into_a_violation() -> None:
    bench = make_bench()
    bench.arm.set_points({"J3": FOLD["J3"]})
    for _ in range(50):
        bench.arm.set_points({"J3": FOLD["J3"]})
        bench.turn(0.05)
    gate = HOME["J2"] + math.radians(40)
    for step in range(80):
        try:
            bench.arm.set_points({"J2": gate - 0.1 + 0.005 * step})
        except UsageError:
            continue
        bench.turn(0.6)
    assert bench.where("J2") < gate + math.radians(0.3)


def test_a_goal_that_takes_over_beside_the_coupling_limit_does_not_swing_through_it() -> None:
    bench = make_bench(allow_partial_joints_goal=True, host_timed=True)
    raised = bench.command(order((2.0, {"J3": FOLD["J3"]})))
    bench.until(lambda: raised.ends)
    # The gate is at 40 degrees then.
    near = HOME["J2"] + math.radians(39)
    bench.command(TrajectoryGoal(("J2",), (Point(0.5, (near,)),)))
    bench.until(lambda: bench.controller.generator.desired(NAMES, bench.clock.time).position[1] > near - 0.09)
    back = bench.command(TrajectoryGoal(("J2",), (Point(1.0, (HOME["J2"],)),)))
    bench.until(lambda: back.ends)
    assert back.outcome == SUCCEEDED, "the running check would have stopped it"


# -- stop, reset, torque -----------------------------------------------------------------------------------


def test_stop_latches_and_reset_moves_nothing() -> None:
    bench = make_bench()
    told = bench.command(order((3.0, {"J1": J1 + 1.0})))
    bench.turn(1.0)
    assert bench.arm.stop("test") == f"stopped, holding: {' '.join(NAMES)}; all joints confirmed it"
    assert told.outcome == STOPPED
    assert told.text == "stopped: test"
    assert bench.arm.stop("again") == f"stopped, holding: {' '.join(NAMES)}; all joints confirmed it"
    bench.turn(0.3)
    stood = bench.where("J1")
    for refused in (lambda: bench.command(order((1.0, {}))), lambda: bench.arm.go_to("home")):
        with pytest.raises(UsageError, match="stopped"):
            refused()
    with pytest.raises(UsageError, match="reset it first"):
        bench.ask(lambda: bench.arm.enable(True))
    with pytest.raises(UsageError, match="reset it first"):
        bench.arm.teach_start()
    assert free(bench)
    assert bench.ask(bench.arm.reset) == "reset; nothing moves until the next command"
    bench.turn(1.0)
    assert bench.where("J1") == pytest.approx(stood, abs=0.005)
    assert bench.ask(lambda: bench.arm.go_to("home")) == "at home"


@pytest.mark.parametrize(
    ("dialect", "host_timed"), [(2, False), (2, True), (1, True)], ids=["path", "targets", "the chapter's sketch"]
)
def test_a_stop_during_a_goal_leaves_the_joints_at_rest_within_300_ms(dialect: int, host_timed: bool) -> None:
    bench = make_bench(dialect=dialect, host_timed=host_timed)
    goal = {name: HOME[name] + by for name, by in (("J1", 1.0), ("J2", -0.3), ("J3", 0.3))}
    bench.command(order((1.0, goal), still=True))
    moved = bench.where("J1")
    bench.until(lambda: bench.where("J1") > moved + 0.4)
    asked = bench.clock.time
    bench.arm.stop("test")
    assert bench.clock.time <= asked + 0.3
    bench.turn(asked + 0.3 - bench.clock.time)
    stood = bench.emulated.shafts()
    bench.turn(1.0)
    assert bench.emulated.shafts() == pytest.approx(stood, abs=1.0), "a count at most"
    assert bench.where("J1") < moved + 0.8


def test_a_stop_that_a_servo_does_not_confirm_is_no_success() -> None:
    bench = make_bench()
    bench.silence("J3")
    with pytest.raises(UsageError, match=r"^stopped, but J3 did not confirm it$"):
        bench.arm.stop("test")
    assert bench.arm.facts().stopped == "test"


@pytest.mark.slow
def test_torque_off_aborts_and_on_again_begins_where_the_arm_is() -> None:
    bench = make_bench()
    told = bench.command(order((3.0, {"J1": J1 + 1.0})))
    bench.turn(1.0)
    assert bench.ask(lambda: bench.arm.enable(False)) == "torque is off"
    assert told.outcome == NOT_READY
    assert not any(bench.torques())
    guide(bench, "J1", -0.5)
    stood = bench.where("J1")
    assert bench.ask(lambda: bench.arm.enable(True)) == "torque is on"
    bench.turn(0.5)
    assert bench.where("J1") == pytest.approx(stood, abs=0.01)
    assert bench.ask(lambda: bench.arm.go_to("home")) == "at home"


def test_torque_that_a_servo_does_not_confirm() -> None:
    bench = make_bench(on=False)
    bench.silence("J3")
    with pytest.raises(ServoError, match=r"J3 \(servo 2\) did not confirm that torque is on"):
        bench.ask(lambda: bench.arm.enable(True))
    assert free(bench)


# -- poses -------------------------------------------------------------------------------------------------


@few("controllers", [{}, SPLIT], SPLIT)
def test_poses(controllers: dict[str, object]) -> None:
    bench = make_bench(controllers=controllers)
    assert bench.ask(lambda: bench.arm.go_to("side")) == "at side"
    assert (bench.where("J1"), bench.where("J4")) == pytest.approx((J1 + 0.5, 0.4), abs=0.02)
    assert bench.ask(lambda: bench.arm.go_to("grip")) == "at grip"
    assert bench.ask(lambda: bench.arm.go_to("grip")) == "at grip", "also if it is there already"
    assert bench.ask(lambda: bench.arm.go_to("home")) == "at home"
    assert [bench.where(name) for name in NAMES] == pytest.approx([HOME[name] for name in NAMES], abs=0.02)
    with pytest.raises(UsageError, match="no pose 'nowhere' of hex7bot; there are side, home, grip"):
        bench.arm.go_to("nowhere")


@pytest.mark.slow
def test_poses_and_goals_with_a_board_of_dialect_1() -> None:
    bench = make_bench(dialect=1, constraints={"J1": {"trajectory": 0.1, "goal": 0.02}})
    for _ in range(2):
        assert bench.ask(lambda: bench.arm.go_to("side")) == "at side"
        assert bench.where("J1") == pytest.approx(J1 + 0.5, abs=0.02)
        told = bench.command(order((4.0, {})))
        bench.until(lambda: told.ends)  # noqa: B023  # called before the next round
        assert told.outcome == SUCCEEDED, told.text
        assert bench.where("J1") == pytest.approx(J1, abs=0.02)


def test_a_pose_with_a_joint_that_no_controller_has() -> None:
    bench = make_bench(joints=["J1", "J2"])
    for pose, joint in (("side", "J4"), ("grip", "J7")):
        with pytest.raises(UsageError, match=f"no controller moves {joint}; there are J1, J2"):
            bench.arm.go_to(pose)
    assert free(bench)


@pytest.mark.slow
def test_a_pose_replaces_a_goal_at_speed() -> None:
    bench = make_bench()
    told = bench.command(order((1.0, {"J1": J1 + 1.2})))
    bench.turn(0.6)
    assert bench.ask(lambda: bench.arm.go_to("home")) == "at home"
    assert told.outcome == PREEMPTED
    assert told.text == "replaced by a motion to home"


def test_one_at_a_time_has_the_arm() -> None:
    bench = make_bench()
    first = bench.begin(lambda: bench.arm.go_to("side"))
    bench.until(lambda: bench.controller.busy)
    for second in (lambda: bench.arm.go_to("home"), bench.arm.teach_start):
        with pytest.raises(UsageError, match="busy with another request"):
            second()
    bench.settle(first)
    assert first.answer() == "at side"
    assert free(bench)


def test_a_goal_takes_the_arm_from_a_pose() -> None:
    bench = make_bench(controllers=SPLIT)
    service = bench.begin(lambda: bench.arm.go_to("side"))
    bench.until(lambda: bench.controller.busy)
    bench.arm.hold("arm", "somebody else wants it")
    bench.settle(service)
    with pytest.raises(UsageError, match="somebody else wants it"):
        service.answer()
    assert free(bench)


@pytest.mark.slow
@pytest.mark.parametrize("how", ["stop", "lost", "shutdown", "off"])
def test_whoever_waits_for_a_pose_hears_of_its_end(how: str) -> None:
    bench = make_bench(controllers=SPLIT)
    service = bench.begin(lambda: bench.arm.go_to("side"))
    bench.until(lambda: bench.controller.busy)
    bench.turn(0.2)
    if how == "stop":
        bench.arm.stop("test")
    elif how == "lost":
        bench.link.lost = True
        bench.turn(1.0)
    elif how == "off":
        bench.ask(lambda: bench.arm.enable(False))
    else:
        bench.arm.shutdown()
    words = {
        "stop": "stopped: test",
        "lost": "was lost",
        "shutdown": "program ends",
        "off": "torque was switched off",
    }
    with pytest.raises(UsageError, match=words[how]):
        service.answer()
    assert free(bench)
    assert not any(controller.busy for controller in bench.arm.controllers.values())


def test_a_pose_that_is_never_reached_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hexwire.control.requests.controlled_arm._GRACE", 0.0)
    bench = make_bench(poses={"near": {"J1": J1 + 0.01}})
    service = bench.begin(lambda: bench.arm.go_to("near"))
    # Nobody turns: in the service's own time the arm never arrives.
    with pytest.raises(UsageError, match="not arrived after 0 s; the arm holds"):
        service.answer()
    assert free(bench)
    assert not bench.controller.busy


@pytest.mark.slow
def test_if_one_controller_fails_the_others_hold() -> None:
    poses = {"both": {"J1": J1 + 1.0, "J7": 0.6}}
    bench = make_bench(
        controllers={**SPLIT, "hand": {"joints": ["J7"], "constraints": {"J7": {"trajectory": 0.01}}}}, poses=poses
    )
    bench.jam("J7")
    service = bench.begin(lambda: bench.arm.go_to("both"))
    bench.settle(service)
    with pytest.raises(UsageError, match="J7"):
        service.answer()
    assert bench.where("J1") < J1 + 0.9
    assert not bench.controller.busy


@pytest.mark.slow
def test_the_paths_of_a_pose_are_checked_together() -> None:
    fold = {"J2": HOME["J2"] + math.radians(60), "J3": HOME["J3"] + math.radians(40)}
    controllers = {"shoulder": {"joints": ["J1", "J2"]}, "rest": {"joints": ["J3", "J4", "J5", "J6", "J7"]}}
    poses = {"fold": fold, "J2": {"J2": fold["J2"]}, "home": dict(HOME)}
    bench = make_bench(controllers=controllers, poses=poses)
    before = [bench.where(name) for name in NAMES]
    with pytest.raises(UsageError, match="elbow folded"):
        bench.ask(lambda: bench.arm.go_to("fold"))
    bench.turn(1.0)
    assert [bench.where(name) for name in NAMES] == pytest.approx(before, abs=0.03)
    assert free(bench)
    assert bench.ask(lambda: bench.arm.go_to("J2")) == "at J2", "alone it may go there"


@pytest.mark.slow
def test_the_desired_state_of_a_controller_at_a_time() -> None:
    bench = make_bench()
    at_rest = bench.arm.query("", 0.0)
    assert at_rest.position[0] == pytest.approx(J1, abs=0.01)
    assert at_rest.velocity == (0.0,) * 7
    with pytest.raises(GoalError, match="s ago is not available"):
        bench.arm.query("", -30.0)
    bench.command(order((4.0, {"J1": J1 + 0.4})))
    bench.turn(1.0)
    assert bench.arm.query("", 1.0).position[0] == pytest.approx(J1 + 0.2, abs=0.02)
    assert bench.arm.query("", 0.0).velocity[0] == pytest.approx(0.1, abs=0.01)
    assert bench.arm.query("", 10.0).position[0] == pytest.approx(J1 + 0.4)
    assert bench.arm.query("", -0.5).position[0] == pytest.approx(J1 + 0.05, abs=0.02)
    with pytest.raises(GoalError, match="s ago is not available") as caught:
        bench.arm.query("", -1.5)  # before the motion began
    assert caught.value.reason == Reason.MALFORMED
    bench.arm.stop("test")
    with pytest.raises(GoalError, match="stopped"):
        bench.arm.query("", 0.0)


# -- what it reports ---------------------------------------------------------------------------------------


def test_facts() -> None:
    bench = make_bench(controllers=SPLIT)
    facts = bench.arm.facts()
    owner = bench.owner
    assert (facts.robot, facts.url, facts.reconnects) == ("hex7bot", owner.robot.url, 0)
    assert (facts.probe, facts.state, facts.watchdog) == (owner.probe, owner.state, owner.watchdog)
    assert (facts.rate, facts.wanted_rate) == (owner.rate, bench.arm.settings.publish_rate)
    assert facts.connected
    assert facts.controllers == {"arm": "hold", "hand": "hold"}
    assert facts.counters["requests"] > 0
    assert facts.counters["stalls_of_the_loop"] == facts.counters["set_points_lost"] == 0
    bench.arm.controllers["hand"].generator.counters.slips = 2
    bench.arm.controllers["arm"].generator.counters.slips = 1
    assert bench.arm.facts().counters["stalls_of_the_loop"] == 3
    assert (facts.stopped, facts.stop_kind) == ("", "")
    assert diagnose(facts)
    bench.arm.stop("test")
    facts = bench.arm.facts()
    assert (facts.stopped, facts.stop_kind) == ("test", "asked")
    bench.link.lost = True
    bench.turn(1.0)
    facts = bench.arm.facts()
    assert not facts.connected
    assert facts.error
    assert diagnose(facts)
    assert set(facts.counters) == {"stalls_of_the_loop", "set_points_lost"}, "those of the line are gone"


def test_enabling_at_the_start_may_fail_and_the_node_continues() -> None:
    bench = make_bench(on=False, enable_on_start=True)
    bench.silence("J3")
    bench.owner.start = lambda controllers: None  # type: ignore[method-assign]  # the test turns
    bench.ask(bench.arm.start)
    assert bench.torques()[0]
    bench.arm.shutdown()


def test_limits_are_described_as_such() -> None:
    bench = make_bench()
    with pytest.raises(LimitError):
        bench.arm.set_points({"J1": 3.0})


# -- what happens meanwhile --------------------------------------------------------------------------------


def test_a_goal_that_is_checked_while_teach_mode_begins_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = make_bench()
    check = bench.controller.check_path

    def check_path(*args: Any, **named: Any) -> None:
        check(*args, **named)
        bench.ask(bench.arm.teach_start)

    monkeypatch.setattr(bench.controller, "check_path", check_path)
    with pytest.raises(GoalError, match="in teach mode"):
        bench.command(order((1.0, {"J1": J1 + 0.3})))
    assert not bench.controller.busy


def test_set_points_that_arrive_while_teach_mode_begins_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = make_bench()
    locked = bench.owner.locked

    def late() -> Any:
        monkeypatch.setattr(bench.owner, "locked", locked)
        bench.ask(bench.arm.teach_start)
        return locked()

    monkeypatch.setattr(bench.owner, "locked", late)
    with pytest.raises(UsageError, match="in teach mode"):
        bench.arm.set_points({"J1": J1 + 0.1})
    assert not bench.controller.busy


def test_a_goal_that_nobody_wants_any_more_does_not_begin() -> None:
    bench = make_bench()
    with pytest.raises(GoalError, match="cancelled"):
        bench.command(order((1.0, {"J1": J1 + 0.3})), wanted=lambda: False)
    assert not bench.controller.busy


@pytest.mark.slow
def test_a_motion_says_how_far_off_the_arm_is_at_its_end(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = make_bench()
    seen: list[tuple[Sequence[float], Sequence[float]]] = []

    def off(names: Sequence[str], goal: Sequence[float], position: Sequence[float]) -> str:
        seen.append((goal, position))
        return "J2 0.6 deg off"

    monkeypatch.setattr("hexwire.control.loop.controller.off_goal", off)
    assert bench.ask(lambda: bench.arm.go_to("home")) == "at home, J2 0.6 deg off"
    told = bench.command(order((1.0, {"J1": HOME["J1"] + 0.3})))
    bench.turn(3.0)
    assert (told.outcome, told.text) == (SUCCEEDED, "J2 0.6 deg off")
    goal, position = seen[-1]
    assert position == pytest.approx(goal, abs=0.02)


def test_a_query_never_waits_for_a_busy_arm_for_longer_than_half_a_second(monkeypatch: pytest.MonkeyPatch) -> None:
    bench, waited = make_bench(), list[float]()
    lock = bench.owner.locked()

    def acquire(blocking: bool = True, timeout: float = -1) -> bool:
        waited.append(timeout)
        return False

    monkeypatch.setattr(lock, "acquire", acquire)
    with pytest.raises(GoalError, match=r"^the arm has been busy for 0\.5 s; ask again$"):
        bench.arm.query("", 0.0)
    assert waited == [0.5]
    monkeypatch.undo()
    assert bench.arm.query("", 0.0).velocity == (0.0,) * len(NAMES)
    assert lock._depth == 0


@pytest.mark.parametrize("dialect", [1, 2])
def test_a_query_waits_for_no_line(monkeypatch: pytest.MonkeyPatch, dialect: int) -> None:
    """Wherever in a motion the line is held: the owner waits for it without the lock of the controllers."""
    bench = make_bench(dialect=dialect)
    held, free_again = threading.Event(), threading.Event()
    write, skipped = bench.link.write, 0

    def hold(data: bytes, deadline: float | None = None) -> None:
        nonlocal skipped
        skipped -= 1
        if skipped == 0:
            held.set()
            assert free_again.wait(PATIENCE)
        write(data, deadline)

    monkeypatch.setattr(bench.link, "write", hold)
    bench.command(order((1.0, {"J1": HOME["J1"] + 0.3}), (3.0, HOME)))
    for number in range(12):
        skipped = 1 + number % 3
        turning = bench.begin(lambda: bench.until(held.is_set))
        assert held.wait(PATIENCE)
        assert len(bench.arm.query("", 0.0).position) == len(NAMES)
        free_again.set()
        turning.answer()
        held.clear()
        free_again.clear()
