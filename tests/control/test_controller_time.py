"""One controller and time: goals for later, goals that are late, and a loop that stalls; with an ideal arm."""

from __future__ import annotations

import pytest
from tests.control.arm_bench import (
    ABORTED_LATE,
    CANCELLED,
    NOT_READY,
    PREEMPTED,
    STOPPED,
    SUCCEEDED,
    Loop,
    Told,
    limp,
    order,
    tolerances,
)
from tests.motion.arms import HOME

from hexwire.control.loop.outcomes import Outcome, Reason
from hexwire.control.motion.arrival import Tolerance
from hexwire.errors import GoalError
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.motion.safety import StopReason

J1, J2 = HOME["J1"], HOME["J2"]


# -- stamps ------------------------------------------------------------------------------------------------------


def test_a_future_goal_begins_on_time_while_the_old_motion_continues() -> None:
    loop = Loop()
    first = loop.send(order((4.0, {"J1": J1 + 1.0})))
    loop.run(0.5)
    second = loop.send(order((1.0, {"J1": J1}), (2.0, {"J2": J2 - 0.2}), delay=1.0))
    assert first.outcome == PREEMPTED, "its handle is free at once"
    assert loop.controller.words == "waiting for the start time"
    loop.run(0.9)
    assert loop.where("J1") == pytest.approx(J1 + 0.35, abs=0.03), "the old motion goes on"
    loop.run(1.1 + 0.05)
    assert loop.where("J1") == pytest.approx(J1, abs=0.01), "points keep their times"
    assert loop.where("J2") == pytest.approx(J2, abs=0.02)
    loop.run(1.2)
    assert second.outcome == SUCCEEDED


def test_a_waiting_goal_can_be_cancelled_stopped_and_replaced() -> None:
    loop = Loop()
    told = loop.send(order((1.0, {"J1": J1 + 0.5}), delay=1.0))
    loop.controller.cancel(told)
    loop.run(3.0)
    assert told.outcome == CANCELLED
    assert loop.where("J1") == J1
    many = [loop.send(order((1.0, {"J1": J1 + 0.5}), delay=1.0 + i)) for i in range(100)]
    assert [told.outcome for told in many[:-1]] == [PREEMPTED] * 99
    loop.controller.stop(StopReason("asked", "it burns"))
    loop.deliver()
    assert many[-1].outcome == STOPPED
    loop.controller.reset()
    loop.run(3.0)
    assert loop.where("J1") == J1


def test_a_waiting_goal_of_a_single_point_at_once_is_done_where_the_arm_is() -> None:
    loop = Loop()
    told = loop.send(order((0.0, {}), delay=0.5))
    loop.run(0.45)
    assert told.ends == []
    loop.run(0.2)
    assert told.outcome == SUCCEEDED
    with pytest.raises(GoalError, match=r"begins 5\.73 deg from where J1 is"):
        loop.send(order((0.0, {"J1": J1 + 0.1}), delay=0.5))


def test_a_waiting_goal_whose_torque_went_away() -> None:
    loop = Loop()
    told = loop.send(order((1.0, {"J1": J1 + 0.5}), delay=0.5))
    loop.change = limp
    loop.run(1.0)
    assert told.outcome == NOT_READY
    assert "enable it first" in told.text


def test_a_stall_past_the_begin_of_a_waiting_goal() -> None:
    loop = Loop()
    told = loop.send(order((1.0, {"J1": J1 + 0.5}), (2.0, {"J1": J1 + 1.0}), delay=0.5))
    loop.run(0.2)
    loop.time.sleep(1.5)
    begin = loop.now
    loop.run(2.0)
    assert told.outcome == SUCCEEDED
    most = HEX7BOT.joint("J1").max_speed
    assert max(map(abs, loop.speeds("J1"))) < most, "the first point is past: straight to the second"
    reached = next(when for when, where in loop.track if where["J1"] > J1 + 0.999)
    assert reached - begin == pytest.approx(0.9, abs=0.06), "a tenth of a second longer, within its limits"


def test_a_stall_past_the_end_of_a_waiting_goal() -> None:
    loop = Loop()
    told = loop.send(order((1.0, {"J1": J1 + 0.5}), delay=0.5))
    loop.time.sleep(5.0)
    loop.run(0.3)
    assert told.outcome == ABORTED_LATE
    assert "ended 3.5 s ago" in told.text
    assert loop.where("J1") == J1


def test_past_points_are_dropped_and_a_past_trajectory_is_refused() -> None:
    loop = Loop()
    points = ((1.0, {"J1": J1 - 1.0}), (2.0, {"J1": J1 + 0.3}))
    told = loop.send(order(*points, delay=-1.5))
    loop.run(0.8)
    assert told.outcome == SUCCEEDED
    assert loop.where("J1") == pytest.approx(J1 + 0.3)
    assert min(where["J1"] for _, where in loop.track) >= J1 - 1e-9
    with pytest.raises(GoalError, match=r"ended 8 s ago") as caught:
        loop.send(order(*points, delay=-10.0))
    assert caught.value.reason == Reason.TOO_LATE


def test_checking_took_so_long_that_points_are_past() -> None:
    loop = Loop()
    sent = order((0.2, {"J1": J1 - 0.3}), (0.9, {"J1": J1 + 0.3}), delay=-1e-3)
    received = loop.now
    plan = loop.controller.plan(sent, received)
    loop.run(0.3)
    told = Told()
    loop.controller.accept(plan, loop.state, loop.now, listener=told)
    loop.run(0.8)
    assert told.outcome == SUCCEEDED
    assert min(where["J1"] for _, where in loop.track) >= J1 - 1e-9


def test_checking_took_so_long_that_it_would_be_too_fast() -> None:
    loop = Loop()
    sent = order((0.31, {"J1": J1 + 0.5}), delay=-1e-3)
    plan = loop.controller.plan(sent, loop.now)
    loop.run(0.3)
    with pytest.raises(GoalError, match=r"too late: before the next point, .* J1 would turn at") as caught:
        loop.controller.accept(plan, loop.state, loop.now, listener=Told())
    assert caught.value.reason == Reason.TOO_LATE
    assert not loop.controller.busy


def test_a_motion_at_the_speed_limit_may_begin_a_little_late() -> None:
    loop = Loop()
    way = 0.5 * 0.98 * HEX7BOT.joint("J1").max_speed
    sent = order((0.5, {"J1": J1 + way}), delay=-1e-3)
    received = loop.now
    plan = loop.controller.plan(sent, received)
    start = loop.controller.start(-1e-3, loop.state, received)
    loop.controller.check_path(plan.trajectory(start, received), loop.state)
    loop.time.sleep(0.03)
    told = Told()
    loop.controller.accept(plan, loop.state, loop.now, listener=told)
    loop.run(1.5)
    assert told.outcome == SUCCEEDED, "as late as its limits of acceleration and jerk require"


def test_a_stamp_now_and_points_from_now_are_on_time_to_a_cycle() -> None:
    loop = Loop()
    for delay in (0.0, 1e-9, 0.001, 0.3):
        begin = loop.now
        goal = J1 + 0.2 if abs(loop.where("J1") - J1) < 0.1 else J1
        told = loop.send(order((0.0, {"J1": loop.where("J1")}), (0.5, {"J1": goal}), delay=delay))
        loop.run(0.7 + delay)
        assert told.outcome == SUCCEEDED
        reached = next(when for when, where in loop.track if when > begin and abs(where["J1"] - goal) < 1e-6)
        assert reached - begin == pytest.approx(0.5 + delay, abs=0.08)


@pytest.mark.parametrize("seconds", [3601.0, 2.0**31])
def test_a_trajectory_that_takes_for_ever_to_check(seconds: float) -> None:
    with pytest.raises(GoalError, match="send at most 3600 s"):
        Loop().send(order((seconds, {"J1": J1 + 0.5})))


# -- stalls ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("after", [0.02, 0.2, 0.5, 0.93, 0.97])
def test_after_a_stall_the_goal_continues_and_ends_later(after: float) -> None:
    loop = Loop(tolerances=tolerances(path={"J1": Tolerance(0.05)}, goal=0.01, goal_time=0.2))
    told = loop.send(order((1.0, {"J1": J1 + 0.8})))
    loop.run(after)
    before = loop.where("J1")
    loop.time.sleep(0.7)
    loop.turn()
    assert all(end.outcome is Outcome.SUCCEEDED for end in told.ends), "what nobody was told is no reason to abort"
    loop.run(1.6 - after)
    assert told.outcome == SUCCEEDED, told.text
    steps = [where["J1"] for when, where in loop.track]
    assert before <= steps[-1]
    assert max(map(abs, loop.speeds("J1"))) < 1.2, "it is not made up for"


@pytest.mark.parametrize("late", [0.03, 0.05, 0.07])
def test_a_loop_that_is_often_a_little_late_makes_no_joint_faster_and_ends_later(late: float) -> None:
    loop = Loop(tolerances=tolerances(path={"J1": Tolerance(0.05)}, goal=0.005, goal_time=0.05))
    told = loop.send(order((1.0, {"J1": J1 + 0.8})))
    begins = loop.now
    while not told.ends and loop.now < begins + 5.0:
        loop.run(0.1)
        loop.time.sleep(late)
    assert told.outcome == SUCCEEDED, told.text
    assert loop.now > begins + 1.05
    assert max(map(abs, loop.speeds("J1"))) < 1.25, "a motion of 0.8 rad in 1 s has at most 1.2 rad/s"


@pytest.mark.parametrize("after", [0.9, 0.94])
def test_a_stall_before_the_last_target_gives_the_arm_the_time_to_get_there(after: float) -> None:
    loop = Loop(tolerances=tolerances(goal=0.005, goal_time=0.05))
    told = loop.send(order((1.0, {"J1": J1 + 0.8})))
    loop.run(after)
    loop.time.sleep(0.7)
    loop.run(0.4)
    assert told.outcome == SUCCEEDED, told.text
