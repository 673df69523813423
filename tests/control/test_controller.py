"""One controller: by itself with an ideal arm, and around an emulated one in simulated time."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest
from tests.control.arm_bench import (
    ABORTED_GOAL,
    ABORTED_PATH,
    CANCELLED,
    LEAD,
    NOT_READY,
    PREEMPTED,
    STOPPED,
    SUCCEEDED,
    Bench,
    Loop,
    Told,
    limp,
    order,
    tolerances,
)
from tests.motion.arms import HOME, NAMES, state

from hexwire.control.loop.outcomes import Outcome, Reason
from hexwire.control.motion.arrival import Tolerance
from hexwire.control.motion.goals import Point, TrajectoryGoal
from hexwire.errors import GoalError, LimitError
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.model.state import JointFlag, JointState
from hexwire.motion.safety import StopReason

J1, J2 = HOME["J1"], HOME["J2"]


# -- reaching and keeping ---------------------------------------------------------------------------------------


def test_a_goal_is_reached_on_time_and_kept() -> None:
    loop = Loop()
    told = loop.send(order((1.0, {"J1": J1 + 0.5})))
    assert loop.controller.busy
    loop.run(0.95)
    assert told.ends == []
    loop.run(0.3)
    assert told.outcome == SUCCEEDED
    assert told.text == ""
    targets = len(loop.robot.targets)
    loop.run(1.0)
    assert loop.where("J1") == pytest.approx(J1 + 0.5)
    assert len(loop.robot.targets) == targets, "the servos hold by themselves"
    assert not loop.controller.busy
    assert loop.controller.words == "hold"


def test_a_mere_command_is_followed_and_forgotten() -> None:
    loop = Loop()
    loop.controller.accept(loop.controller.plan(order((0.5, {"J1": J1 + 0.2})), loop.now), loop.state, loop.now)
    assert loop.controller.listener is None
    assert loop.controller.busy
    loop.run(1.0)
    assert not loop.controller.busy
    assert loop.where("J1") == pytest.approx(J1 + 0.2)


def test_the_ideal_arm_is_never_far_from_what_is_desired() -> None:
    loop = Loop()
    loop.send(order((1.0, {"J1": J1 + 0.5}), (2.0, {"J1": J1}), still=True))
    for _ in range(230):
        loop.turn()
        assert loop.controller.progress is not None
        # The arm goes straight between targets, 50 ms apart.
        assert max(map(abs, loop.controller.progress.error)) < 0.008
        loop.time.sleep(0.01)


def test_goal_time_zero_waits_until_the_arm_is_there() -> None:
    loop = Loop(tolerances=tolerances(goal=0.05))
    loop.change = lambda what: replace(what, load=(0.0,) * 7)
    loop.robot.jammed = {"J1": J1 + 0.1}
    told = loop.send(order((1.0, {"J1": J1 + 0.2})))
    loop.run(6.0)
    assert told.ends == []
    assert loop.controller.busy
    loop.robot.jammed = {}
    loop.run(0.2)
    assert told.outcome == SUCCEEDED


def test_out_of_goal_tolerance_after_goal_time() -> None:
    loop = Loop(tolerances=tolerances(goal=0.05, goal_time=0.5))
    loop.change = lambda what: replace(what, load=(0.0,) * 7)
    loop.robot.jammed = {"J1": J1 + 0.1}
    told = loop.send(order((1.0, {"J1": J1 + 0.2})))
    loop.run(1.45)
    assert told.ends == []
    loop.run(0.15)
    assert told.outcome == ABORTED_GOAL
    assert told.text == "J1 is 0.1 rad (5.73 deg) off its goal, tolerance 0.05 rad (2.86 deg)"
    assert not loop.controller.busy
    assert loop.controller.generator.reason is None, "it holds, and takes the next goal"
    loop.robot.jammed = {}
    told = loop.send(order((1.0, {"J1": J1})))
    loop.run(1.2)
    assert told.outcome == SUCCEEDED


def test_a_goals_own_tolerances_count() -> None:
    loop = Loop(tolerances=tolerances(goal=0.01, goal_time=0.5))
    loop.change = lambda what: replace(what, load=(0.0,) * 7)
    loop.robot.jammed = {"J1": J1 + 0.15}
    told = loop.send(order((1.0, {"J1": J1 + 0.2})), tolerances=tolerances(goal=0.1))
    loop.run(1.2)
    assert told.outcome == SUCCEEDED


def test_off_the_path() -> None:
    loop = Loop(tolerances=tolerances(path={"J1": Tolerance(0.1)}))
    loop.change = lambda what: replace(what, load=(0.0,) * 7)
    told = loop.send(order((2.0, {"J1": J1 + 1.0})))
    loop.run(0.5)
    assert told.ends == []
    loop.robot.jammed = {"J1": loop.where("J1")}
    loop.run(0.15)
    assert told.ends == []
    loop.run(0.15)
    assert told.outcome == ABORTED_PATH
    assert "J1 is 0.1" in told.text
    loop.run(0.4)
    targets = len(loop.robot.targets)
    loop.run(0.3)
    assert len(loop.robot.targets) == targets, "it has braked, and holds"


def test_velocities_that_are_not_known_are_not_judged() -> None:
    loop = Loop(tolerances=tolerances(path={"J1": Tolerance(0.0, 0.001)}))
    told = loop.send(order((1.0, {"J1": J1 + 0.5})))
    nan = [math.nan] * 7
    for _ in range(130):
        loop.robot.read()
        loop.controller.judge(loop.state, nan, loop.now)
        target = loop.controller.cycle(loop.state, loop.now, LEAD)
        if target is not None:
            loop.robot.write(target)  # type: ignore[arg-type]  # no reason to stop
        loop.deliver()
        loop.time.sleep(0.01)
    assert told.outcome == SUCCEEDED


def test_a_success_needs_a_new_position_of_every_joint() -> None:
    loop = Loop()
    told = loop.send(order((1.0, {"J1": J1 + 0.3})))
    loop.run(0.9)
    silent = loop.now
    loop.change = lambda what: replace(what, age=(what.stamp - silent, *what.age[1:]))
    loop.run(0.35)
    assert told.ends == [], "J1 was last seen on its way"
    loop.change = lambda what: what
    loop.run(0.02)
    assert told.outcome == SUCCEEDED


def test_joints_are_judged_by_where_they_were_to_be_when_sampled() -> None:
    """A board of dialect 1 is asked joint after joint: one sample is half a second older than another."""
    loop = Loop(tolerances=tolerances(path={name: Tolerance(0.02) for name in NAMES}))
    past: list[tuple[float, dict[str, float]]] = []

    def late(what: JointState) -> JointState:
        past.append((what.stamp, what.positions))
        then = next((where for when, where in reversed(past) if when <= what.stamp - 0.3), what.positions)
        old = 0.3 if past[0][0] <= what.stamp - 0.3 else 0.0
        return replace(what, position=(then["J1"], *what.position[1:]), age=(old, *what.age[1:]))

    loop.change = late
    loop.run(0.5)
    told = loop.send(order((2.0, {"J1": J1 + 1.0, "J4": 1.0})))
    loop.run(3.0)
    assert told.outcome == SUCCEEDED


def test_the_desired_point_of_a_goal_that_replaces_another_does_not_run_ahead() -> None:
    loop = Loop(tolerances=tolerances(path={"J1": Tolerance(0.03)}))
    first = loop.send(order((2.0, {"J1": J1 + 1.0})))
    for i in range(20):
        loop.run(0.05 + 0.01 * (i % 3))
        second = loop.send(order((2.0, {"J1": J1 + 1.0 - 0.02 * i})))
        assert first.outcome == PREEMPTED
        loop.run(0.1)
        assert second.ends == [], second.text
        first = second


# -- replacing ------------------------------------------------------------------------------------------------


def test_a_new_goal_replaces_the_old_without_a_jump() -> None:
    loop = Loop()
    first = loop.send(order((2.0, {"J1": J1 + 1.0}), still=True))
    loop.run(1.0)
    second = loop.send(order((1.5, {"J1": J1 - 0.2}), still=True))
    assert first.outcome == PREEMPTED
    assert first.text == "replaced by a new goal"
    assert loop.controller.listener is second
    loop.run(2.0)
    assert second.outcome == SUCCEEDED
    assert first.outcome == PREEMPTED, "told once"
    speeds = loop.speeds("J1")
    # 50 ms between targets, each at an even speed.
    assert max(abs(b - a) for a, b in zip(speeds, speeds[5:], strict=False)) < 0.6
    assert loop.where("J1") == pytest.approx(J1 - 0.2)


@pytest.mark.parametrize("still", [True, False])
@pytest.mark.parametrize("after", [0.05, 0.3, 0.55, 0.8, 0.99])
def test_turning_round_at_speed_stays_within_limits(after: float, still: bool) -> None:
    loop = Loop()
    limit = HEX7BOT.joint("J1")
    loop.send(order((1.0, {"J1": limit.maximum}), still=still))
    loop.run(after)
    told = loop.send(order((1.5, {"J1": J1 - 0.5}), still=still))
    loop.run(2.0)
    assert told.outcome == SUCCEEDED
    assert max(where["J1"] for _, where in loop.track) <= limit.maximum + 1e-9, "also while it turns round"
    assert max(map(abs, loop.speeds("J1"))) < limit.max_speed


def test_a_goal_is_not_judged_by_what_was_sampled_before_it_began() -> None:
    loop = Loop(tolerances=tolerances(path={"J1": Tolerance(0.009)}))
    loop.send(order((1.0, {"J1": J1 + 0.5})), tolerances=tolerances())
    loop.run(0.5)
    # On its way to the last target, where the next goal begins.
    loop.controller.hold("")
    target = loop.robot.targets[-1][1].positions[0][1]
    assert target - loop.where("J1") > 0.01
    told = loop.send(order((1.0, {"J1": target})))
    loop.run(1.3)
    assert told.outcome == SUCCEEDED


def test_a_refused_goal_leaves_the_other_alone() -> None:
    loop = Loop()
    first = loop.send(order((2.0, {"J1": J1 + 1.0})))
    loop.run(0.5)
    with pytest.raises(GoalError, match=r"the path is no longer allowed: .* its limit is"):
        loop.controller.accept(
            loop.controller.plan(order((0.1, {"J1": J1 - 1.0})), loop.now), loop.state, loop.now, listener=Told()
        )
    with pytest.raises(GoalError, match="unknown"):
        loop.send(TrajectoryGoal(("J9",), (Point(1.0, (0.0,)),)))
    loop.run(2.0)
    assert first.outcome == SUCCEEDED


def test_a_controller_refuses_a_goal_that_does_not_end_at_rest_if_that_is_its_rule() -> None:
    sent = order((1.0, {"J1": J1 + 0.1}), still=True)
    moving = replace(sent.points[0], velocities=tuple(0.1 for _ in NAMES))
    Loop().send(replace(sent, points=(moving,)))
    strict = Loop(end_at_rest=True)
    with pytest.raises(GoalError, match="the last point must have velocity 0"):
        strict.send(replace(sent, points=(moving,)))
    told = strict.send(sent)
    strict.run(2.0)
    assert told.outcome == SUCCEEDED


def test_cancel_holds_and_only_for_the_goal_that_is_followed() -> None:
    loop = Loop()
    first = loop.send(order((2.0, {"J1": J1 + 1.0})))
    loop.run(0.5)
    second = loop.send(order((2.0, {"J1": J1 + 1.0})))
    loop.controller.cancel(first)
    assert second.ends == []
    loop.run(0.5)
    loop.controller.cancel(second)
    loop.deliver()
    assert second.outcome == CANCELLED
    assert second.text == "cancelled"
    loop.run(0.6)
    stood = loop.where("J1")
    loop.run(0.5)
    assert loop.where("J1") == stood != J1
    loop.controller.cancel(second)
    assert loop.controller.take_ended() == []


def test_a_trajectory_without_points_is_not_a_goal() -> None:
    with pytest.raises(GoalError, match="no points"):
        Loop().send(TrajectoryGoal(NAMES, ()))


# -- stop, reset, torque ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kind", "reason"),
    [
        ("asked", Reason.STOPPED),
        ("following", Reason.PATH_TOLERANCE),
        ("collision", Reason.PATH_TOLERANCE),
        ("overload", Reason.PATH_TOLERANCE),
        ("fault", Reason.STOPPED),
        ("lost", Reason.STOPPED),
        ("board", Reason.STOPPED),
    ],
)
def test_a_stop_aborts_latches_and_is_reset(kind: str, reason: Reason) -> None:
    loop = Loop()
    told = loop.send(order((2.0, {"J1": J1 + 1.0})))
    loop.run(0.5)
    loop.controller.stop(StopReason(kind, "something happened"))
    loop.controller.stop(StopReason("asked", "and more"))
    loop.deliver()
    assert told.outcome == (Outcome.ABORTED, reason)
    assert told.text == "stopped: something happened"
    assert loop.controller.words == "stopped: something happened"
    targets = len(loop.robot.targets)
    loop.run(0.3)
    for refused in (
        lambda: loop.send(order((1.0, {}))),
        lambda: loop.controller.accept(loop.controller.plan(order((1.0, {})), loop.now), loop.state, loop.now),
        lambda: loop.stream({"J1": J1}),
        lambda: loop.controller.start(0.0, loop.state, loop.now),
    ):
        with pytest.raises(GoalError, match=r"stopped \(something happened\); reset first"):
            refused()
    assert len(loop.robot.targets) == targets
    loop.controller.hold("an empty trajectory")
    assert loop.controller.generator.reason is not None, "holding is no reset"
    loop.controller.reset()
    loop.robot.where["J1"] = J1 - 0.4
    loop.robot._ways.clear()
    loop.run(0.1)
    assert len(loop.robot.targets) == targets, "nothing moves by it"
    told = loop.send(order((1.0, {"J1": J1})))
    loop.run(1.2)
    assert told.outcome == SUCCEEDED
    assert max(map(abs, loop.speeds("J1")[-110:])) < 0.6, "it begins where the arm is"


def test_torque_that_is_taken_away_aborts_and_forgets() -> None:
    loop = Loop()
    told = loop.send(order((2.0, {"J1": J1 + 1.0})))
    loop.run(0.5)
    loop.controller.release("torque was switched off")
    loop.deliver()
    assert told.outcome == NOT_READY
    assert told.text == "torque was switched off"
    assert loop.controller.generator.reason is None
    loop.change = limp
    with pytest.raises(GoalError, match=r"no torque on J1, J2, .*; enable it first"):
        loop.send(order((1.0, {"J1": J1})))
    with pytest.raises(GoalError, match="no torque on J1; enable it first"):
        loop.stream({"J1": J1})
    with pytest.raises(GoalError, match="no torque"):
        loop.controller.accept(loop.controller.plan(order((1.0, {})), loop.now), loop.state, loop.now)
    loop.change = lambda what: what
    loop.robot.where["J1"] = J1 - 0.3
    loop.robot._ways.clear()
    told = loop.send(order((1.0, {"J1": J1})))
    loop.run(1.2)
    assert told.outcome == SUCCEEDED
    assert max(map(abs, loop.speeds("J1")[-115:])) < 0.5


def test_a_goal_for_a_joint_without_a_position_is_refused() -> None:
    loop = Loop(allow_partial=True)
    loop.controller.release("")
    nan, inf = math.nan, math.inf
    deaf = replace(state(), position=(nan, *state().position[1:]), age=(inf, *state().age[1:]))
    controller = loop.controller
    controller._progress = None
    controller.judge(deaf, [0.0] * 7, loop.now)
    assert controller.progress is None
    with pytest.raises(GoalError, match="the position of J1 is still unknown"):
        controller.start(0.0, deaf, loop.now)
    with pytest.raises(GoalError, match="the position of J1 is still unknown"):
        loop.stream({"J1": J1}, deaf)
    loop.stream({"J2": J2 - 0.01}, deaf)


def test_progress_between_goals_is_kept_only_for_those_who_monitor_it() -> None:
    controller = Loop(monitored=False).controller
    controller.judge(state(), [0.0] * 7, 5.0)
    assert controller.progress is None
    monitored = Loop().controller
    monitored.judge(state(), [0.0] * 7, 5.0)
    assert monitored.progress is not None
    assert monitored.progress.position == state().position


def test_a_goal_of_an_unmonitored_controller_is_still_checked() -> None:
    loop = Loop(monitored=False)
    told = loop.send(order((1.0, {"J1": J1 + 0.2})))
    loop.run(0.5)
    assert loop.controller.progress is not None
    loop.run(1.0)
    assert told.outcome == SUCCEEDED
    assert loop.controller.progress is None


def test_a_joint_that_is_silent_is_no_joint_to_move() -> None:
    loop = Loop()
    silent = (JointFlag.SILENT | JointFlag.TORQUE_ON, *[JointFlag.TORQUE_ON] * 6)
    loop.change = lambda what: replace(what, flags=silent, age=(0.3, *what.age[1:]))
    assert loop.send(order((1.0, {"J2": J2 - 0.1}))).ends == [], "one missed answer is nothing"
    loop.controller.hold("")
    loop.change = lambda what: replace(what, flags=silent, age=(0.6, *what.age[1:]))
    with pytest.raises(GoalError, match=r"no answer from J1 for more than 0\.5 s"):
        loop.send(order((1.0, {"J2": J2 - 0.1})))
    with pytest.raises(GoalError, match="no answer from J1"):
        loop.stream({"J1": J1})
    loop.stream({"J2": J2})


def test_partial_goals_leave_the_others_where_they_are() -> None:
    loop = Loop()
    loop.send(order((0.5, {"J2": J2 - 0.2})))
    loop.run(1.0)
    told = loop.send(TrajectoryGoal(("J4", "J1"), (Point(1.0, (0.3, J1 + 0.2)),)))
    loop.run(1.3)
    assert told.outcome == SUCCEEDED
    assert (loop.where("J1"), loop.where("J4"), loop.where("J2")) == pytest.approx((J1 + 0.2, 0.3, J2 - 0.2))
    whole = Loop(allow_partial=False)
    with pytest.raises(GoalError, match="missing") as caught:
        whole.send(TrajectoryGoal(("J4", "J1"), (Point(1.0, (0.3, J1 + 0.2)),)))
    assert caught.value.reason == Reason.WRONG_JOINTS


# -- set-points --------------------------------------------------------------------------------------------------


def test_set_points_preempt_a_goal_and_are_followed_until_they_stop_coming() -> None:
    loop = Loop()
    told = loop.send(order((2.0, {"J1": J1 + 1.0})))
    loop.run(0.5)
    for i in range(20):
        loop.stream({"J1": J1 + 0.25 + 0.01 * i})
        loop.run(0.05)
    assert told.outcome == PREEMPTED
    assert told.text == "replaced by set-points"
    assert loop.controller.words == "stream"
    assert loop.where("J1") == pytest.approx(J1 + 0.44, abs=0.011)
    loop.run(0.7)
    assert loop.controller.words == "hold"
    assert loop.controller.generator.counters.lost == 1
    after = loop.send(order((1.0, {"J1": J1})))
    loop.run(1.3)
    assert after.outcome == SUCCEEDED
    assert max(map(abs, loop.speeds("J1"))) < HEX7BOT.joint("J1").max_speed


def test_a_bad_set_point_leaves_the_goal_alone() -> None:
    loop = Loop()
    told = loop.send(order((1.0, {"J1": J1 + 0.5})))
    with pytest.raises(LimitError):
        loop.stream({"J1": 9.0})
    loop.run(1.3)
    assert told.outcome == SUCCEEDED


# -- around an emulated arm ----------------------------------------------------------------------------------------


def enabled(**options: Any) -> Bench:
    bench = Bench(check_table=False, **options)
    assert bench.ask(lambda: bench.arm.enable(True)) == "torque is on"
    return bench


def test_an_emulated_arm_reaches_its_goal() -> None:
    bench = enabled(constraints={"goal_time": 1.0, "J1": {"trajectory": 0.3, "goal": 0.02}})
    told = bench.command(order((1.0, {"J1": J1 + 0.6}), (2.0, {"J1": J1}), still=True))
    bench.turn(0.9)
    assert told.ends == []
    bench.until(lambda: told.ends)
    assert told.outcome == SUCCEEDED, told.text
    assert bench.where("J1") == pytest.approx(J1, abs=0.02)
    bench.turn(3.0)
    assert bench.where("J1") == pytest.approx(J1, abs=0.02)


@pytest.mark.slow
def test_an_emulated_arm_turns_round_at_full_speed() -> None:
    bench = enabled()
    speed = HEX7BOT.joint("J1").max_speed
    first = bench.command(order((1.0, {"J1": J1 + 0.9 * speed * 0.5}), still=False))
    bench.turn(0.6)
    second = bench.command(order((1.2, {"J1": J1 - 1.0})))
    assert first.outcome == PREEMPTED
    bench.until(lambda: second.ends)
    assert second.outcome == SUCCEEDED, second.text
    assert bench.where("J1") == pytest.approx(J1 - 1.0, abs=0.02)
    joint, window = HEX7BOT.joint("J1"), 10
    for (t, a), (u, b) in zip(bench.track, bench.track[window:], strict=False):
        # A servo's own profile is a little faster than the even speed it was asked for.
        assert abs(joint.counts_to_angle(b[0]) - joint.counts_to_angle(a[0])) < 1.1 * speed * (u - t) + 0.01


@pytest.mark.slow
def test_an_emulated_arm_that_meets_something() -> None:
    bench = enabled()
    told = bench.command(order((3.0, {"J5": 1.2})))
    bench.turn(0.6)
    bench.jam("J5")
    bench.until(lambda: told.ends)
    assert told.outcome == ABORTED_PATH
    assert "J5" in told.text
    assert bench.controller.generator.reason is not None
    assert bench.controller.generator.reason.kind in {"collision", "following", "overload"}
    assert bench.ask(bench.arm.reset).startswith("reset")


@pytest.mark.slow
def test_a_servo_that_is_lost_during_a_motion() -> None:
    bench = enabled()
    told = bench.command(order((5.0, {"J5": 1.2})))
    bench.turn(0.6)
    bench.silence("J5")
    bench.until(lambda: told.ends)
    assert told.outcome == STOPPED
    assert "J5 has not answered for" in told.text


@pytest.mark.slow
def test_two_controllers_move_at_once_and_stop_together() -> None:
    bench = enabled(
        controllers={"arm": {"joints": ["J1", "J2", "J3", "J4", "J5", "J6"]}, "hand": {"joints": ["J7"]}}
    )
    whole = order((1.0, {"J1": J1 + 0.3})).points[0]
    first = bench.command(TrajectoryGoal(NAMES[:6], (Point(1.0, whole.positions[:6]),)), "arm")
    second = bench.command(TrajectoryGoal(("J7",), (Point(1.0, (0.4,)),)), "hand")
    bench.until(lambda: first.ends and second.ends)
    assert first.outcome == second.outcome == SUCCEEDED
    assert (bench.where("J1"), bench.where("J7")) == pytest.approx((J1 + 0.3, 0.4), abs=0.02)
    told = bench.command(TrajectoryGoal(("J7",), (Point(2.0, (-0.4,)),)), "hand")
    bench.turn(0.5)
    bench.arm.set_points({"J1": J1 + 0.2})
    assert told.ends == [], "the other controller's goal goes on"
    bench.turn(0.2)
    assert "all joints confirmed" in bench.ask(lambda: bench.arm.stop("test"))
    assert told.outcome == STOPPED
    assert [c.words for c in bench.arm.controllers.values()] == ["stopped: test"] * 2


@pytest.mark.parametrize("heard", [True, False])
def test_a_goal_lasts_until_the_robot_that_follows_it_says_how_it_ended(heard: bool) -> None:
    """It may have run out of points, and rest on the way when the time is over; then the goal goes on."""
    loop = Loop()
    controller, generator = loop.controller, loop.controller.generator
    told, begun = Told(), loop.now
    plan = controller.plan(order((0.5, {"J1": HOME["J1"] + 0.2})), begun)
    controller.accept(plan, loop.state, begun, listener=told if heard else None)
    # Nothing is sent target by target: the robot has the path, and does nothing with it.
    generator.onboard = True
    loop.run(1.5)
    assert controller.busy
    assert not told.ends
    generator.onboard = False
    generator.rejoin(loop.state.positions, begun, loop.now, wanted=controller.busy)
    loop.run(2.0)
    assert loop.where("J1") == pytest.approx(HOME["J1"] + 0.2, abs=0.01)
    assert [end.outcome for end in told.ends] == ([Outcome.SUCCEEDED] if heard else [])
    assert not controller.busy
