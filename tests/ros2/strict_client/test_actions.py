"""follow_joint_trajectory, by the rules of rcl_action and of the trajectory controller of ros2_controllers."""

from __future__ import annotations

import time
from typing import Any

import pytest
from tests.ros1.ros_world import still as stands
from tests.ros2.strict_client import action as a
from tests.ros2.strict_client.action import ActionClient, goal, new_id, point, tolerance
from tests.ros2.strict_client.wire import STATUS, Participant, until
from tests.ros2.strict_client.world import ACTION, Arm

pytestmark = pytest.mark.system


def refused_or_aborted(arm: Arm, sent: dict[str, Any], code: int | None = None) -> str:
    """The reason why a goal may not run: it is refused with a log message, or accepted and aborted with a code."""
    arm.rosout.take_all()
    made = arm.send(sent)
    if made.accepted:
        end = made.result()
        assert end.status == a.ABORTED
        assert code is None or end.result.error_code == code
        assert end.result.error_string
        return str(end.result.error_string)
    return str(arm.rosout.wait(lambda message: message.level >= 30).message.msg)


def still(arm: Arm, before: dict[str, float]) -> None:
    assert arm.positions() == pytest.approx(before, abs=0.03)


# --- a goal that succeeds ---


def test_a_goal_is_accepted_and_succeeds(arm: Arm) -> None:
    made = arm.send(arm.short_goal())
    assert made.accepted
    end = made.result()
    assert (end.status, end.result.error_code) == (a.SUCCEEDED, a.SUCCESSFUL)


@pytest.mark.slow
def test_the_arm_is_where_the_goal_says(arm: Arm) -> None:
    sent = arm.short_goal(0.2, 1.0)
    assert arm.send(sent).result().status == a.SUCCEEDED
    wanted = dict(zip(arm.names, sent["trajectory"]["points"][0]["positions"], strict=True))
    assert arm.positions() == pytest.approx(wanted, abs=0.06)


@pytest.mark.slow
def test_a_goal_where_the_arm_is_already_needs_no_time(arm: Arm) -> None:
    here = arm.positions()
    sent = goal(list(here), [point(list(here.values()), 0.0)])
    end = arm.send(sent).result()
    assert (end.status, end.result.error_code) == (a.SUCCEEDED, a.SUCCESSFUL)
    assert arm.positions() == pytest.approx(here, abs=0.03)


@pytest.mark.slow
def test_joints_are_ordered_by_name(arm: Arm) -> None:
    sent = arm.short_goal()
    trajectory = sent["trajectory"]
    wanted = dict(zip(arm.names, trajectory["points"][0]["positions"], strict=True))
    trajectory["joint_names"] = trajectory["joint_names"][::-1]
    trajectory["points"][0]["positions"] = trajectory["points"][0]["positions"][::-1]
    assert arm.send(sent).result().status == a.SUCCEEDED
    assert arm.positions() == pytest.approx(wanted, abs=0.06)


@pytest.mark.slow
def test_some_joints_if_that_is_allowed(arm: Arm) -> None:
    at = arm.positions()["J1"]
    sent = goal(["J1"], [point([at - 0.1 if at > 0 else at + 0.1], 0.6)])
    assert arm.send(sent).result().status == a.SUCCEEDED


@pytest.mark.slow
def test_several_points(arm: Arm) -> None:
    points = [point(arm.near({"J1": 0.05}), 0.4), point(arm.near(), 0.8)]
    assert arm.send(goal(arm.names, points)).result().status == a.SUCCEEDED


@pytest.mark.slow
def test_velocities_with_zero_at_the_end(arm: Arm) -> None:
    zero = [0.0] * 7
    points = [point(arm.near({"J1": 0.05}), 0.5, velocities=zero), point(arm.near(), 1.0, velocities=zero)]
    assert arm.send(goal(arm.names, points)).result().status == a.SUCCEEDED


@pytest.mark.slow
def test_a_start_in_the_future_is_waited_for(arm: Arm) -> None:
    sent = arm.short_goal(0.1, 0.4)
    now = time.time() + 1.0
    sent["trajectory"]["header"]["stamp"] = {"sec": int(now), "nanosec": int(now % 1 * 1e9)}
    made = arm.send(sent)
    assert made.result().status == a.SUCCEEDED
    assert time.time() > now


# --- status ---


def test_the_status_goes_from_executing_to_succeeded(arm: Arm) -> None:
    made = arm.send(arm.short_goal())
    made.result()
    seen: list[int] = []
    until(lambda: seen.extend(made.statuses()) or a.SUCCEEDED in seen, "the status is succeeded")
    assert [status for status in seen if status != a.ACCEPTED] == [a.EXECUTING, a.SUCCEEDED]


@pytest.mark.slow
def test_the_status_has_the_time_of_acceptance(arm: Arm) -> None:
    before = time.time()
    made = arm.send(arm.short_goal())
    made.result()

    def info(message: Any) -> Any:
        return [each for each in message.status_list if each.goal_info.goal_id.uuid == made.id]

    (status,) = info(arm.action.status.wait(info).message)
    stamp = status.goal_info.stamp
    assert before - 0.1 < stamp.sec + stamp.nanosec * 1e-9 < time.time() + 0.1


@pytest.mark.slow
def test_a_late_joiner_gets_the_status(arm: Arm) -> None:
    made = arm.send(arm.long_goal())
    assert made.accepted
    with Participant(arm.port, "late") as late:
        status = late.subscribe(f"{ACTION}/_action/status", "action_msgs/msg/GoalStatusArray", STATUS)
        status.wait(
            lambda message: any(
                each.goal_info.goal_id.uuid == made.id and each.status == a.EXECUTING
                for each in message.status_list
            )
        )


@pytest.mark.slow
def test_an_ended_goal_stays_in_the_array_for_a_while(arm: Arm) -> None:
    """rcl_action keeps a goal for its result time-out, 10 s since Jazzy."""
    first = arm.send(arm.short_goal())
    first.result()
    second = arm.send(arm.short_goal())
    second.result()
    listed = arm.action.status.wait(
        lambda message: (
            {each.goal_info.goal_id.uuid: each.status for each in message.status_list}.get(second.id) == a.SUCCEEDED
        )
    ).message
    assert first.id in {each.goal_info.goal_id.uuid for each in listed.status_list}


@pytest.mark.slow
def test_the_status_has_each_goal_once(arm: Arm) -> None:
    arm.send(arm.short_goal()).result()
    for received in arm.action.status.take_all():
        ids = [each.goal_info.goal_id.uuid for each in received.message.status_list]
        assert len(set(ids)) == len(ids)


# --- feedback ---


def test_feedback_comes_while_the_goal_runs(arm: Arm) -> None:
    made = arm.send(arm.short_goal(0.2, 1.5))
    message = arm.action.feedback.take().message
    assert message.goal_id.uuid == made.id
    feedback = message.feedback
    assert feedback.joint_names == arm.names
    assert len(feedback.desired.positions) == len(feedback.actual.positions) == len(feedback.error.positions) == 7
    assert feedback.multi_dof_joint_names == []
    made.result()


@pytest.mark.slow
def test_feedback_says_where_the_arm_is(arm: Arm) -> None:
    made = arm.send(arm.short_goal(0.2, 1.5))
    received = arm.action.feedback.take()
    feedback = received.message.feedback
    assert feedback.actual.positions == pytest.approx(arm.near(), abs=0.25)
    for error, wanted, seen in zip(
        feedback.error.positions, feedback.desired.positions, feedback.actual.positions, strict=True
    ):
        assert error == pytest.approx(wanted - seen, abs=1e-9)
    stamp = feedback.header.stamp
    assert abs(received.at - (stamp.sec + stamp.nanosec * 1e-9)) < 30
    made.result()


@pytest.mark.slow
def test_feedback_says_how_long_the_goal_has_run(arm: Arm) -> None:
    """joint_trajectory_controller fills time_from_start of `desired` and `actual`."""
    made = arm.send(arm.short_goal(0.2, 1.5))
    times = []
    for received in (arm.action.feedback.take() for _ in range(5)):
        feedback = received.message.feedback
        assert feedback.actual.time_from_start == feedback.desired.time_from_start
        times.append(feedback.desired.time_from_start.sec + feedback.desired.time_from_start.nanosec * 1e-9)
    assert times == sorted(set(times))
    assert times[-1] > 0.0
    made.result()


@pytest.mark.slow
def test_feedback_ends_with_the_goal(arm: Arm) -> None:
    made = arm.send(arm.short_goal())
    made.result()
    time.sleep(0.3)
    arm.action.feedback.take_all()
    assert arm.action.feedback.listen(0.5) == []


@pytest.mark.slow
def test_feedback_is_of_the_running_goal_only(arm: Arm) -> None:
    first = arm.send(arm.long_goal())
    assert first.accepted
    second = arm.send(arm.short_goal(0.2, 1.0))
    assert second.accepted
    second.result()
    ids = [received.message.goal_id.uuid for received in arm.action.feedback.take_all()]
    assert set(ids) <= {first.id, second.id}
    assert second.id in ids
    assert ids == sorted(ids, key=lambda each: each == second.id), "nothing of the first after the second began"


# --- get_result ---


@pytest.mark.slow
def test_the_result_waits_for_the_end(arm: Arm) -> None:
    made = arm.send(arm.short_goal(0.2, 1.5))
    assert made.accepted
    time.sleep(0.3)
    assert not made.ended
    assert made.result().status == a.SUCCEEDED


@pytest.mark.slow
def test_the_result_can_be_had_after_the_end(arm: Arm) -> None:
    made = arm.send(arm.short_goal())
    made.result()
    later = arm.action.result_of(made.id).message()
    assert (later.status, later.result.error_code) == (a.SUCCEEDED, a.SUCCESSFUL)


def test_the_result_of_an_unknown_goal_is_unknown(arm: Arm) -> None:
    answer = arm.action.result_of(new_id()).message()
    assert answer.status == a.UNKNOWN


@pytest.mark.slow
def test_the_result_of_a_refused_goal_is_unknown(arm: Arm) -> None:
    made = arm.send(goal(["nobody"], [point([0.0], 1.0)]))
    if not made.accepted:
        assert arm.action.result_of(made.id).message().status == a.UNKNOWN


@pytest.mark.slow
def test_two_clients_may_ask_for_one_result(arm: Arm) -> None:
    made = arm.send(arm.short_goal(0.2, 1.0))
    assert made.accepted
    with Participant(arm.port, "other") as other:
        client = ActionClient(other, ACTION)
        client.wait()
        theirs = [client.result_of(made.id) for _ in range(3)]
        assert made.result().status == a.SUCCEEDED
        assert [reply.message().status for reply in theirs] == [a.SUCCEEDED] * 3


# --- refused goals ---


@pytest.mark.slow
def test_a_goal_that_is_known_is_refused(arm: Arm) -> None:
    made = arm.send(arm.long_goal())
    assert made.accepted
    again = arm.action.send(arm.short_goal(), id=made.id)
    assert not again.reply.message().accepted
    assert not made.ended, "the first goes on"


@pytest.mark.parametrize(
    ("names", "code"),
    [(["nobody"], a.INVALID_JOINTS), (["J1", "J1"], a.INVALID_JOINTS), ([], a.INVALID_JOINTS)],
)
def test_wrong_joints(arm: Arm, names: list[str], code: int) -> None:
    before = arm.positions()
    reason = refused_or_aborted(arm, goal(names, [point([0.0] * len(names), 1.0)]))
    assert reason
    still(arm, before)


@pytest.mark.slow
@pytest.mark.parametrize("bad", [float("nan"), float("inf"), 99.0])
def test_wrong_positions(arm: Arm, bad: float) -> None:
    before = arm.positions()
    sent = arm.short_goal()
    sent["trajectory"]["points"][0]["positions"][0] = bad
    refused_or_aborted(arm, sent, a.INVALID_GOAL)
    still(arm, before)


@pytest.mark.slow
def test_too_few_positions(arm: Arm) -> None:
    sent = arm.short_goal()
    del sent["trajectory"]["points"][0]["positions"][-1]
    refused_or_aborted(arm, sent, a.INVALID_GOAL)


@pytest.mark.slow
def test_times_that_do_not_rise(arm: Arm) -> None:
    refused_or_aborted(arm, goal(arm.names, [point(arm.near(), 1.0), point(arm.near(), 0.5)]), a.INVALID_GOAL)


@pytest.mark.slow
def test_no_points(arm: Arm) -> None:
    refused_or_aborted(arm, goal(arm.names, []))


@pytest.mark.slow
def test_a_speed_at_the_end(arm: Arm) -> None:
    """allow_nonzero_velocity_at_trajectory_end is false since Iron."""
    sent = goal(arm.names, [point(arm.near({"J1": 0.05}), 1.0, velocities=[0.3, 0, 0, 0, 0, 0, 0])])
    refused_or_aborted(arm, sent, a.INVALID_GOAL)


@pytest.mark.slow
def test_too_fast(arm: Arm) -> None:
    refused_or_aborted(arm, arm.short_goal(1.0, 0.01), a.INVALID_GOAL)


@pytest.mark.slow
def test_all_in_the_past(arm: Arm) -> None:
    sent = arm.short_goal()
    sent["trajectory"]["header"]["stamp"] = {"sec": int(time.time()) - 100, "nanosec": 0}
    refused_or_aborted(arm, sent, a.OLD_HEADER)


@pytest.mark.slow
def test_a_refusal_leaves_the_running_goal_alone(arm: Arm) -> None:
    made = arm.send(arm.short_goal(0.2, 2.0))
    assert made.accepted
    refused = arm.send(goal(["nobody"], [point([0.0], 1.0)]))
    assert not refused.accepted or refused.result().status == a.ABORTED
    assert made.result().status == a.SUCCEEDED


# --- another goal ---


def test_a_new_goal_preempts_the_old_one(arm: Arm) -> None:
    """ros2_controllers: preempt_active_goal sets it canceled, with INVALID_GOAL."""
    first = arm.send(arm.long_goal())
    assert first.accepted
    second = arm.send(arm.short_goal())
    assert second.accepted
    end = first.result()
    assert (end.status, end.result.error_code) == (a.CANCELED, a.INVALID_GOAL)
    assert end.result.error_string
    assert second.result().status == a.SUCCEEDED


@pytest.mark.slow
def test_the_old_goal_is_preempted_before_the_new_one_ends(arm: Arm) -> None:
    first = arm.send(arm.long_goal())
    assert first.accepted
    second = arm.send(arm.short_goal(0.2, 1.5))
    assert second.accepted
    first.result()
    assert not second.ended
    assert second.result().status == a.SUCCEEDED


@pytest.mark.slow
def test_many_goals_one_after_the_other(arm: Arm) -> None:
    made = [arm.send(arm.short_goal(0.05, 3.0)) for _ in range(5)]
    assert all(each.accepted for each in made)
    last = arm.send(arm.short_goal(0.05, 0.5))
    assert last.accepted
    assert [each.result().status for each in made] == [a.CANCELED] * 5
    assert last.result().status == a.SUCCEEDED


@pytest.mark.slow
def test_two_clients_take_the_arm_from_each_other(arm: Arm) -> None:
    with Participant(arm.port, "other") as other:
        client = ActionClient(other, ACTION)
        mine = arm.send(arm.long_goal())
        assert mine.accepted
        theirs = client.send(arm.short_goal())
        assert theirs.accepted
        assert mine.result().status == a.CANCELED
        assert theirs.result().status == a.SUCCEEDED


# --- cancel ---


def test_a_goal_is_canceled(arm: Arm) -> None:
    made = arm.send(arm.long_goal())
    assert made.accepted
    answer = made.cancel()
    assert answer.return_code == a.NONE
    assert [info.goal_id.uuid for info in answer.goals_canceling] == [made.id]
    assert made.result().status == a.CANCELED


@pytest.mark.slow
def test_a_canceled_arm_holds(arm: Arm) -> None:
    start, sent = arm.positions()["J1"], arm.short_goal(0.6, 4.0)
    target = sent["trajectory"]["points"][0]["positions"][0]
    made = arm.send(sent)
    assert made.accepted
    until(lambda: abs(arm.positions()["J1"] - start) > 0.02, "it moves")
    made.cancel()
    assert made.result().status == a.CANCELED
    stands(arm.positions)
    assert abs(arm.positions()["J1"] - target) > 0.1


@pytest.mark.slow
def test_the_status_of_a_canceled_goal(arm: Arm) -> None:
    made = arm.send(arm.long_goal())
    assert made.accepted
    made.cancel()
    made.result()
    seen: list[int] = []
    until(lambda: seen.extend(made.statuses()) or a.CANCELED in seen, "the status is canceled")
    assert seen[-1] == a.CANCELED
    assert set(seen) <= {a.ACCEPTED, a.EXECUTING, a.CANCELING, a.CANCELED}


def test_canceling_an_unknown_goal(arm: Arm) -> None:
    answer = arm.action.cancel(new_id())
    assert (answer.return_code, answer.goals_canceling) == (a.UNKNOWN_GOAL, [])


@pytest.mark.slow
def test_canceling_an_ended_goal(arm: Arm) -> None:
    made = arm.send(arm.short_goal())
    made.result()
    answer = made.cancel()
    assert (answer.return_code, answer.goals_canceling) == (a.TERMINATED, [])


@pytest.mark.slow
def test_canceling_a_canceled_goal(arm: Arm) -> None:
    made = arm.send(arm.long_goal())
    assert made.accepted
    made.cancel()
    made.result()
    assert made.cancel().return_code == a.TERMINATED


@pytest.mark.slow
def test_canceling_all_without_a_goal(arm: Arm) -> None:
    answer = arm.action.cancel()
    assert (answer.return_code, answer.goals_canceling) == (a.NONE, [])


def test_canceling_all(arm: Arm) -> None:
    made = arm.send(arm.long_goal())
    assert made.accepted
    answer = arm.action.cancel()
    assert [info.goal_id.uuid for info in answer.goals_canceling] == [made.id]
    assert made.result().status == a.CANCELED


@pytest.mark.slow
def test_canceling_all_before_a_time(arm: Arm) -> None:
    now = int(time.time())
    made = arm.send(arm.long_goal())
    assert made.accepted
    assert arm.action.cancel(stamp=(now - 100, 0)).goals_canceling == []
    assert not made.ended
    answer = arm.action.cancel(stamp=(now + 100, 0))
    assert [info.goal_id.uuid for info in answer.goals_canceling] == [made.id]
    assert made.result().status == a.CANCELED


@pytest.mark.slow
def test_canceling_an_id_and_all_before_a_time(arm: Arm) -> None:
    """With both, all goals up to the time and the one of the id are canceled (rcl_action/action_server.c)."""
    made = arm.send(arm.long_goal())
    assert made.accepted
    answer = arm.action.cancel(made.id, stamp=(1, 0))
    assert [info.goal_id.uuid for info in answer.goals_canceling] == [made.id]
    assert made.result().status == a.CANCELED


@pytest.mark.slow
def test_another_client_may_cancel(arm: Arm) -> None:
    made = arm.send(arm.long_goal())
    assert made.accepted
    with Participant(arm.port, "other") as other:
        client = ActionClient(other, ACTION)
        client.wait()
        assert client.cancel(made.id).return_code == a.NONE
    assert made.result().status == a.CANCELED


@pytest.mark.slow
def test_a_goal_after_a_cancel(arm: Arm) -> None:
    made = arm.send(arm.long_goal())
    assert made.accepted
    made.cancel()
    assert arm.send(arm.short_goal()).result().status == a.SUCCEEDED


# --- tolerances, stop, clients that die ---


@pytest.mark.slow
def test_a_path_tolerance(arm: Arm) -> None:
    sent = arm.short_goal(0.5, 1.0)
    made = arm.send({**sent, "path_tolerance": [tolerance("J1", 0.002)]})
    assert made.accepted
    end = made.result()
    assert (end.status, end.result.error_code) == (a.ABORTED, a.PATH_VIOLATED)
    assert "J1" in end.result.error_string


@pytest.mark.slow
def test_a_goal_tolerance(arm: Arm) -> None:
    sent = arm.short_goal(0.3, 0.5)
    made = arm.send(
        {
            **sent,
            "goal_tolerance": [tolerance("J1", 1e-9)],
            "goal_time_tolerance": {"sec": 0, "nanosec": 200_000_000},
        }
    )
    assert made.accepted
    end = made.result()
    assert (end.status, end.result.error_code) == (a.ABORTED, a.GOAL_VIOLATED)


@pytest.mark.slow
def test_a_negative_tolerance_is_none(arm: Arm) -> None:
    sent = arm.short_goal(0.3, 0.5)
    made = arm.send(
        {**sent, "path_tolerance": [tolerance("J1", -1.0)], "goal_tolerance": [tolerance("J1", -1.0, -1.0)]}
    )
    assert made.result().status == a.SUCCEEDED


@pytest.mark.slow
def test_a_tolerance_of_an_unknown_joint(arm: Arm) -> None:
    """ros2_controllers ignores all tolerances of such a goal; a refusal is as good. Nothing else may happen."""
    made = arm.send({**arm.short_goal(), "path_tolerance": [tolerance("nobody", 1.0)]})
    if made.accepted:
        assert made.result().status in (a.SUCCEEDED, a.ABORTED)


def test_a_stop_aborts_the_goal(arm: Arm) -> None:
    made = arm.send(arm.long_goal())
    assert made.accepted
    arm.trigger("stop")
    end = made.result()
    assert end.status == a.ABORTED
    assert end.result.error_code != a.SUCCESSFUL
    assert end.result.error_string


@pytest.mark.slow
def test_torque_off_aborts_the_goal(arm: Arm) -> None:
    made = arm.send(arm.long_goal())
    assert made.accepted
    arm.enable(False)
    assert made.result().status in (a.ABORTED, a.CANCELED)


@pytest.mark.slow
def test_a_client_that_dies_leaves_a_server_that_works(arm: Arm) -> None:
    """ROS 2 has no tie between a goal and its client: the goal ends by itself, or by another client's."""
    dying = Participant(arm.port, "dying")
    client = ActionClient(dying, ACTION)
    made = client.send(arm.short_goal(0.2, 1.5))
    assert made.reply.message().accepted
    dying.close()
    assert arm.action.result_of(made.id).message().status in (a.SUCCEEDED, a.ABORTED, a.CANCELED)
    assert arm.send(arm.short_goal()).result().status == a.SUCCEEDED


@pytest.mark.slow
def test_sequences_of_the_topics_count(arm: Arm) -> None:
    arm.send(arm.short_goal(0.2, 1.0)).result()
    for subscription, kind in ((arm.action.feedback, "feedback"), (arm.action.status, "status")):
        received = subscription.take_all()
        token = arm.me.graph.one(kind="MP", topic=f"{ACTION}/_action/{kind}")
        numbers = [each.attachment.sequence for each in received]
        assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
        assert {each.attachment.gid for each in received} == {token.gid}
