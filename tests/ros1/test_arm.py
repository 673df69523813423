"""What a node is asked for, with an emulated arm in simulated time; services are threads that wait meanwhile."""

from __future__ import annotations

import json
import math
import threading
from pathlib import Path
from typing import Any

import pytest
from tests.motion.arms import HOME, NAMES
from tests.ros1.arm_bench import PREEMPTED, SUCCEEDED, Bench, order

from hexwire.errors import GoalError, HexwireError, LimitError, LinkLostError, UsageError
from hexwire.model.hex7bot import HEX7BOT
from hexwire.motion.waypoint_file import parse_waypoints
from hexwire.motion.waypoints import Spline, Waypoint
from hexwire.ros1.arm import taught_part
from hexwire.ros1.controller import Outcome
from hexwire.ros1.diagnostics import diagnose
from hexwire.ros1.goals import ErrorCode, Point, TrajectoryOrder

J1 = HOME["J1"]
POSES = {"side": {"J1": J1 + 0.5, "J4": 0.4}, "home": dict(HOME), "grip": {"J7": 0.3}}
SPLIT = {"arm": {"joints": list(NAMES[:6])}, "hand": {"joints": ["J7"]}}
ABORTED = (Outcome.ABORTED, ErrorCode.INVALID_GOAL)


def make_bench(*, on: bool = True, **options: Any) -> Bench:
    bench = Bench(**({"poses": POSES, "check_table": False} | options))
    if on:
        assert bench.ask(lambda: bench.arm.enable(True)) == "torque is on"
    return bench


def free(bench: Bench) -> bool:
    """Nobody has the arm for longer."""
    return not bench.arm._busy.locked() and not bench.arm._power.locked()


def guide(bench: Bench, joint: str, by: float, seconds: float = 1.0) -> None:
    """A hand moves a limp joint."""
    model = HEX7BOT.joint(joint)
    servo = bench.board.wire[model.servo_id]
    assert not servo.torque_on
    start, begin = bench.emulated.shaft(model.servo_id), bench.clock.time
    while bench.clock.time < begin + seconds:
        servo.motion.position = start + by / model.scale * min(1.0, (bench.clock.time - begin) / seconds)
        bench._step()


# -- orders ------------------------------------------------------------------------------------------------


def test_an_empty_trajectory_holds() -> None:
    bench = make_bench()
    told = bench.command(order((3.0, {"J1": J1 + 1.0})))
    bench.turn(1.0)
    bench.arm.command("", order())
    assert told.outcome == PREEMPTED
    assert told.text == "an empty trajectory came"
    bench.turn(0.2)
    stood = bench.where("J1")
    bench.turn(1.0)
    assert bench.where("J1") == pytest.approx(stood, abs=0.005)
    assert stood < J1 + 0.6
    with pytest.raises(GoalError, match="no points"):
        bench.command(order())


def test_a_mere_command_replaces_a_goal() -> None:
    bench = make_bench()
    told = bench.command(order((3.0, {"J1": J1 + 1.0})))
    bench.turn(1.0)
    bench.arm.command("", order((1.0, {"J1": J1})))
    assert told.outcome == PREEMPTED
    bench.turn(1.5)
    assert bench.where("J1") == pytest.approx(J1, abs=0.02)


def test_every_refusal_has_a_code() -> None:
    bench = make_bench(on=False)
    with pytest.raises(GoalError, match="no torque on J1") as caught:
        bench.command(order((1.0, {})))
    assert caught.value.code == ErrorCode.INVALID_GOAL
    bench.ask(lambda: bench.arm.enable(True))
    with pytest.raises(GoalError, match="unknown") as caught:
        bench.command(TrajectoryOrder(("J9",), order((1.0, {})).points))
    assert caught.value.code == ErrorCode.INVALID_JOINTS
    with pytest.raises(GoalError, match="outside its limits"):
        bench.command(order((9.0, {"J1": 1.4})))
    bench.link.lost = True
    bench.turn(1.0)
    with pytest.raises(GoalError, match="the robot cannot be reached") as caught:
        bench.command(order((1.0, {})))
    assert caught.value.code == ErrorCode.INVALID_GOAL


def test_cancel_by_name() -> None:
    bench = make_bench(controllers=SPLIT)
    (whole,) = order((2.0, {"J1": J1 + 0.5})).points
    told = bench.command(TrajectoryOrder(NAMES[:6], (Point(2.0, whole.positions[:6]),)), "arm")
    bench.turn(0.5)
    bench.arm.cancel("hand", told)
    assert told.ends == []
    bench.arm.cancel("arm", told)
    assert told.outcome == PREEMPTED


# -- set-points --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("names", "fields", "error"),
    [
        (["J1", "J1"], {"position": [0.0, 0.0]}, "named twice: J1, J1"),
        (["J9"], {"position": [0.0]}, "no joint 'J9'; there are J1, "),
        (["j1"], {"position": [0.0]}, "no joint 'j1'"),
        (["J1"], {"position": [0.0, 0.0]}, "position has 2 values for 1 names"),
        (["J1"], {"position": [0.0], "kp_position": [1.0, 1.0]}, "kp_position has 2 values for 1 names"),
        (["J1"], {"position": [math.nan]}, "the position of J1 is nan, not a number"),
        (["J1"], {"position": [0.0], "effort": [math.inf]}, "the effort of J1 is inf, not a number"),
        (["J1"], {"position": []}, "it holds no position"),
        ([], {"position": []}, "it holds no position"),
        ([], {"position": [1.0]}, "position has 1 values for 0 names"),
        (["J1", "J2"], {"position": [0.0, 9.0]}, "J2=515.7 deg is outside its limits"),
    ],
)
def test_set_points_that_are_refused_change_nothing(
    names: list[str], fields: dict[str, list[float]], error: str
) -> None:
    bench = make_bench()
    told = bench.command(order((1.0, {"J1": J1 + 0.2})))
    with pytest.raises(UsageError, match=error):
        bench.arm.set_points(names, fields)
    bench.until(lambda: told.ends)
    assert told.outcome == SUCCEEDED


def test_set_points_are_pursued_and_what_servos_cannot_do_is_told() -> None:
    bench = make_bench()
    told = bench.command(order((3.0, {"J1": J1 + 1.0})))
    fields = {"position": [0.3, J1 - 0.2], "velocity": [], "effort": [0.0, 0.0], "kp_position": [9.0, 9.0]}
    for _ in range(40):
        assert bench.arm.set_points(["J4", "J1"], fields) == ("kp_position",)
        bench.turn(0.05)
    assert told.outcome == PREEMPTED
    assert (bench.where("J1"), bench.where("J4")) == pytest.approx((J1 - 0.2, 0.3), abs=0.02)


def test_set_points_of_several_controllers_are_all_taken_or_none() -> None:
    bench = make_bench(controllers=SPLIT)
    assert bench.ask(lambda: bench.hardware.torque(False, ["J7"])) == ("J7",)
    with pytest.raises(GoalError, match="no torque on J7"):
        bench.arm.set_points(["J1", "J7"], {"position": [J1 + 0.3, 0.3]})
    bench.turn(0.5)
    assert bench.where("J1") == pytest.approx(J1, abs=0.01)
    bench.arm.set_points(["J1"], {"position": [J1 + 0.3]})
    bench.turn(0.4)
    assert bench.where("J1") > J1 + 0.1


def test_set_points_without_a_robot() -> None:
    bench = make_bench()
    bench.link.lost = True
    bench.turn(1.0)
    with pytest.raises(LinkLostError):
        bench.arm.set_points(["J1"], {"position": [J1]})


# -- stop, reset, torque -----------------------------------------------------------------------------------


def test_stop_latches_and_reset_moves_nothing() -> None:
    bench = make_bench()
    told = bench.command(order((3.0, {"J1": J1 + 1.0})))
    bench.turn(1.0)
    assert bench.arm.stop("test") == "stopped; all joints confirmed it"
    assert told.outcome == ABORTED
    assert told.text == "stopped: test"
    assert bench.arm.stop("again") == "stopped; all joints confirmed it"
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
    assert bench.ask(bench.arm.reset) == "reset; nothing moves until it is told to"
    bench.turn(1.0)
    assert bench.where("J1") == pytest.approx(stood, abs=0.005)
    assert bench.ask(lambda: bench.arm.go_to("home")) == "at home"


def test_a_stop_that_a_servo_does_not_confirm_is_no_success() -> None:
    bench = make_bench()
    bench.silence("J3")
    with pytest.raises(UsageError, match=r"^stopped, but J3 did not confirm it$"):
        bench.arm.stop("test")
    assert bench.arm.facts("n").stopped == "test"


def test_torque_off_aborts_and_on_again_begins_where_the_arm_is() -> None:
    bench = make_bench()
    told = bench.command(order((3.0, {"J1": J1 + 1.0})))
    bench.turn(1.0)
    assert bench.ask(lambda: bench.arm.enable(False)) == "torque is off"
    assert told.outcome == ABORTED
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
    with pytest.raises(UsageError, match="J3 did not confirm that torque is on"):
        bench.ask(lambda: bench.arm.enable(True))
    assert free(bench)


# -- poses -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("controllers", [{}, SPLIT])
def test_poses(controllers: dict[str, object]) -> None:
    bench = make_bench(controllers=controllers)
    assert bench.ask(lambda: bench.arm.go_to("side")) == "at side"
    assert (bench.where("J1"), bench.where("J4")) == pytest.approx((J1 + 0.5, 0.4), abs=0.02)
    assert bench.ask(lambda: bench.arm.go_to("grip")) == "at grip"
    assert bench.ask(lambda: bench.arm.go_to("grip")) == "at grip", "also if it is there already"
    assert bench.ask(lambda: bench.arm.go_to("home")) == "at home"
    assert [bench.where(name) for name in NAMES] == pytest.approx([HOME[name] for name in NAMES], abs=0.02)
    with pytest.raises(UsageError, match="no pose 'nowhere'; there are side, home, grip"):
        bench.arm.go_to("nowhere")


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


def test_a_pose_replaces_a_goal_at_speed() -> None:
    bench = make_bench()
    told = bench.command(order((1.0, {"J1": J1 + 1.2})))
    bench.turn(0.6)
    assert bench.ask(lambda: bench.arm.go_to("home")) == "at home"
    assert told.outcome == PREEMPTED
    assert told.text == "the arm goes to home"


def test_one_at_a_time_has_the_arm() -> None:
    bench = make_bench()
    first = bench.begin(lambda: bench.arm.go_to("side"))
    bench.until(lambda: bench.controller.busy)
    for second in (lambda: bench.arm.go_to("home"), bench.arm.teach_start):
        with pytest.raises(UsageError, match="on its way for somebody else"):
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
    words = {"stop": "stopped: test", "lost": "was lost", "shutdown": "node ends", "off": "torque was taken away"}
    with pytest.raises(UsageError, match=words[how]):
        service.answer()
    assert free(bench)
    assert not any(controller.busy for controller in bench.arm.controllers.values())


def test_a_pose_that_is_never_reached_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hexwire.ros1.arm._GRACE", 0.0)
    monkeypatch.setattr("hexwire.ros1.arm.approach", lambda *a, **k: _short())
    bench = make_bench()
    service = bench.begin(lambda: bench.arm.go_to("side"))
    # Nobody turns: in the service's own time the arm never arrives.
    with pytest.raises(UsageError, match="not there after 0 s; the arm holds"):
        service.answer()
    assert free(bench)
    assert not bench.controller.busy


def _short() -> Spline:
    home = tuple(HOME[name] for name in NAMES)
    return Spline(NAMES, [Waypoint(0.0, home), Waypoint(0.01, home)])


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


# -- teaching ----------------------------------------------------------------------------------------------


def test_teaching_and_playing_back(tmp_path: Path) -> None:
    bench = make_bench(teach_directory=str(tmp_path))
    assert bench.ask(bench.arm.teach_start) == f"teaching {', '.join(NAMES)}; they have no torque"
    assert not any(bench.torques())
    guide(bench, "J1", 0.4)
    guide(bench, "J1", -0.1)
    end = bench.where("J1")
    words = bench.ask(bench.arm.teach_stop)
    assert all(bench.torques())
    assert "taught " in words
    (path,) = tmp_path.iterdir()
    assert str(path) in words
    assert json.loads(path.read_text(encoding="utf-8"))["joint_names"] == list(NAMES)
    way = parse_waypoints(path.read_bytes(), path.name)
    assert way.goal[0] == pytest.approx(end, abs=0.02)
    (taught,) = bench.taught
    assert taught is bench.arm.taught
    bench.ask(lambda: bench.arm.go_to("home"))
    assert bench.ask(bench.arm.teach_play) == f"played {taught.duration:.1f} s"
    assert bench.where("J1") == pytest.approx(end, abs=0.02)


def test_nothing_moves_while_somebody_holds_the_arm() -> None:
    bench = make_bench()
    bench.ask(bench.arm.teach_start)
    requests = [
        lambda: bench.command(order((1.0, {}))),
        lambda: bench.arm.command("", order()),
        lambda: bench.arm.set_points(["J1"], {"position": [J1]}),
        lambda: bench.arm.go_to("home"),
        lambda: bench.arm.enable(True),
        lambda: bench.arm.enable(False),
        bench.arm.teach_start,
    ]
    for request in requests:
        with pytest.raises(UsageError, match="the arm is being taught; end that first"):
            request()
    assert not any(bench.torques())
    with pytest.raises(UsageError, match="nothing was taught since"):
        bench.arm.teach_play()
    assert free(bench)


def test_an_arm_without_torque_is_taught_and_left_so() -> None:
    bench = make_bench(on=False)
    bench.ask(bench.arm.teach_start)
    guide(bench, "J1", 0.4)
    bench.ask(bench.arm.teach_stop)
    assert not any(bench.torques())
    assert bench.arm.taught is not None


def test_a_moving_arm_is_not_taught() -> None:
    bench = make_bench()
    told = bench.command(order((1.0, {"J1": J1 + 0.3})))
    with pytest.raises(UsageError, match="the arm is moving; wait, or cancel the goal first"):
        bench.arm.teach_start()
    bench.until(lambda: told.ends)
    assert told.outcome == SUCCEEDED
    with pytest.raises(UsageError, match="nothing is being taught"):
        bench.arm.teach_stop()


def test_torque_comes_back_even_if_nothing_was_recorded() -> None:
    bench = make_bench()
    bench.ask(bench.arm.teach_start)
    bench.hardware.observers.clear()
    bench.arm._teacher._samples.clear()
    with pytest.raises(UsageError, match="nothing was recorded"):
        bench.ask(bench.arm.teach_stop)
    assert all(bench.torques())
    assert free(bench)
    bench.ask(lambda: bench.arm.go_to("home"))


def test_a_stop_in_teaching_leaves_the_arm_without_torque() -> None:
    bench = make_bench()
    bench.ask(bench.arm.teach_start)
    guide(bench, "J1", 0.3)
    assert bench.arm.stop("test") == "stopped; all joints confirmed it"
    bench.turn(0.5)
    assert not any(bench.torques()), "somebody has a hand in it"
    with pytest.raises(UsageError, match="nothing is being taught"):
        bench.arm.teach_stop()
    bench.ask(bench.arm.reset)
    bench.turn(0.5)
    with pytest.raises(UsageError, match="nothing is being taught"):
        bench.arm.teach_stop()
    assert not any(bench.torques())
    bench.ask(lambda: bench.arm.enable(True))
    assert all(bench.torques())


def test_a_stop_while_teaching_begins() -> None:
    bench = make_bench()
    service = bench.begin(bench.arm.teach_start)
    pause = threading.Event()
    while not bench.arm._teaching and service.thread.is_alive():
        pause.wait(0.001)
    bench.arm.stop("test")
    bench.settle(service)
    with pytest.raises(HexwireError):
        service.answer()
    assert free(bench)
    assert not bench.arm._teaching
    assert not bench.arm._teacher.active


def test_what_was_taught_is_kept_if_a_joint_gets_no_torque() -> None:
    bench = make_bench()
    bench.ask(bench.arm.teach_start)
    guide(bench, "J1", 0.3)
    bench.silence("J6")
    with pytest.raises(UsageError, match=r"^taught .* points; J6 did not confirm that torque is on$"):
        bench.ask(bench.arm.teach_stop)
    assert bench.arm.taught is not None
    assert not bench.arm._teaching
    assert free(bench)


def test_what_was_taught_is_kept_if_it_cannot_be_saved(tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("mine")
    bench = make_bench(teach_directory=str(tmp_path / "taken"))
    bench.ask(bench.arm.teach_start)
    guide(bench, "J1", 0.3)
    with pytest.raises(UsageError, match="cannot be saved"):
        bench.ask(bench.arm.teach_stop)
    assert all(bench.torques())
    assert bench.arm.taught is not None


def test_a_joint_that_keeps_its_torque_is_not_taught() -> None:
    bench = make_bench()
    bench.silence("J2")
    with pytest.raises(UsageError, match="J2 did not confirm that torque is off"):
        bench.ask(bench.arm.teach_start)
    assert not bench.arm._teaching
    assert free(bench)
    assert bench.torques()[0], "the others hold again"


def test_a_robot_that_is_lost_while_it_is_taught() -> None:
    bench = make_bench()
    bench.ask(bench.arm.teach_start)
    guide(bench, "J1", 0.3)
    bench.link.lost = True
    bench.turn(1.0)
    with pytest.raises(UsageError, match="the robot cannot be reached"):
        bench.arm.teach_stop()
    assert bench.arm.taught is not None
    bench.link.lost = False
    bench.until(lambda: bench.hardware.connected)
    bench.turn(1.0)
    assert not any(bench.torques())
    assert free(bench)


def test_a_part_of_what_was_taught() -> None:
    bench = make_bench(controllers=SPLIT)
    bench.ask(bench.arm.teach_start)
    guide(bench, "J7", 0.3)
    bench.ask(bench.arm.teach_stop)
    assert bench.arm.taught is not None
    part = taught_part(bench.arm.taught, ("J7", "J1"))
    assert part.names == ("J7", "J1")
    assert part.goal == pytest.approx((0.3, J1), abs=0.02)
    bench.ask(bench.arm.teach_play)


# -- what it reports ---------------------------------------------------------------------------------------


def test_facts() -> None:
    bench = make_bench(controllers=SPLIT, hardware_id="A17")
    facts = bench.arm.facts("/hardware_interface")
    assert (facts.node, facts.robot, facts.hardware_id) == ("/hardware_interface", "hex7bot", "A17")
    assert facts.connected
    assert facts.controllers == {"arm": "hold", "hand": "hold"}
    assert facts.counters["requests"] > 0
    assert (facts.stopped, facts.stop_kind) == ("", "")
    assert diagnose(facts)
    bench.arm.stop("test")
    facts = bench.arm.facts("n")
    assert (facts.stopped, facts.stop_kind) == ("test", "asked")
    bench.link.lost = True
    bench.turn(1.0)
    facts = bench.arm.facts("n")
    assert not facts.connected
    assert facts.error
    assert diagnose(facts)


def test_enabling_at_the_start_may_fail_and_the_node_goes_on() -> None:
    bench = make_bench(on=False, enable_on_start=True)
    bench.silence("J3")
    bench.hardware.start = lambda controllers: None  # type: ignore[method-assign]  # the test turns
    bench.ask(bench.arm.start)
    assert bench.torques()[0]
    bench.arm.shutdown()


def test_limits_are_told_as_such() -> None:
    bench = make_bench()
    with pytest.raises(LimitError):
        bench.arm.set_points(["J1"], {"position": [3.0]})
