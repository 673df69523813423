"""follow_joint_trajectory as a client of ROS 2 sees it: each of its messages, codes and states, over the wire.

What a goal may be, and how it ends, is decided and tested in `control`; the rules of an action server are tested in
the package of the wire.
"""

from __future__ import annotations

import time

import pytest
from tests.ros2.strict_client import action as a
from tests.ros2.strict_client.action import ActionClient, Goal, goal, new_id, point, tolerance
from tests.ros2.strict_client.wire import Participant, Received
from tests.ros2.strict_client.world import ACTION, Arm
from tests.waits import until

pytestmark = pytest.mark.system


def states(received: list[Received], made: Goal) -> list[int]:
    """What the status topic said of a goal, in order, each once in a row."""
    found: list[int] = []
    for each in received:
        ids = [row.goal_info.goal_id.uuid for row in each.message.status_list]
        assert len(set(ids)) == len(ids), "each goal once"
        found += [row.status for row in each.message.status_list if row.goal_info.goal_id.uuid == made.id]
    return [state for i, state in enumerate(found) if i == 0 or found[i - 1] != state]


def until_state(arm: Arm, made: Goal, state: int) -> list[Received]:
    """All that the status topic says until a goal has a state."""
    seen: list[Received] = []
    until(lambda: seen.extend(arm.action.status.take_all()) or state in states(seen, made), f"its state is {state}")
    return seen


def seconds(stamp: object) -> float:
    return float(stamp.sec + stamp.nanosec * 1e-9)  # type: ignore[attr-defined]


def test_a_goal_is_accepted_runs_and_succeeds(arm: Arm) -> None:
    """Its answer, states, feedback and result, and what is beside these messages."""
    before, sent = time.time(), arm.short_goal(0.2, 1.5)
    made = arm.send(sent)
    assert made.accepted
    feedback = [arm.action.feedback.take()]
    end = made.result()
    assert (end.status, end.result.error_code) == (a.SUCCEEDED, a.SUCCESSFUL)
    later = arm.action.result_of(made.id).message()
    assert (later.status, later.result) == (end.status, end.result)
    wanted = dict(zip(arm.names, sent["trajectory"]["points"][0]["positions"], strict=True))
    assert arm.positions() == pytest.approx(wanted, abs=0.06)
    told = until_state(arm, made, a.SUCCEEDED)
    assert [state for state in states(told, made) if state != a.ACCEPTED] == [a.EXECUTING, a.SUCCEEDED]
    (accepted,) = {
        seconds(row.goal_info.stamp)
        for each in told
        for row in each.message.status_list
        if row.goal_info.goal_id.uuid == made.id
    }
    assert before - 0.1 < accepted < time.time() + 0.1
    feedback += arm.action.feedback.take_all()
    for kind, received in (("feedback", feedback), ("status", told)):
        token = arm.me.graph.one(kind="MP", topic=f"{ACTION}/_action/{kind}")
        numbers = [each.attachment.sequence for each in received]
        assert numbers == list(range(numbers[0], numbers[0] + len(numbers))), kind
        assert {each.attachment.gid for each in received} == {token.gid}, kind
    # joint_trajectory_controller fills time_from_start of `desired` and `actual`.
    times = [seconds(each.message.feedback.desired.time_from_start) for each in feedback]
    assert times == sorted(set(times))
    assert times[-1] > 0.0
    for each in feedback:
        assert each.message.goal_id.uuid == made.id
        content = each.message.feedback
        assert (content.joint_names, content.multi_dof_joint_names) == (arm.names, [])
        assert content.actual.time_from_start == content.desired.time_from_start
        off = [w - p for w, p in zip(content.desired.positions, content.actual.positions, strict=True)]
        assert content.error.positions == pytest.approx(off, abs=1e-9)
        assert len(off) == 7
        assert abs(each.at - seconds(content.header.stamp)) < 30


def test_the_result_of_an_unknown_goal_is_unknown(arm: Arm) -> None:
    assert arm.action.result_of(new_id()).message().status == a.UNKNOWN


def test_a_wrong_goal_is_refused_and_the_log_has_its_code(arm: Arm) -> None:
    before = arm.positions()
    wrong = {
        "nobody": (goal(["nobody"], [point([0.0], 1.0)]), "INVALID_JOINTS"),
        "twice": (goal(["J1", "J1"], [point([0.0, 0.0], 1.0)]), "INVALID_JOINTS"),
        "no joints": (goal([], [point([], 1.0)]), "INVALID_JOINTS"),
        "no points": (goal(arm.names, []), "INVALID_GOAL"),
        "not a number": (goal(["J1"], [point([float("nan")], 1.0)]), "INVALID_GOAL"),
        "moving at its end": (goal(["J1"], [point([0.0], 1.0, velocities=[0.3])]), "INVALID_GOAL"),
        "past": (goal(["J1"], [point([0.0], 1.0)], stamp=(int(time.time()) - 100, 0)), "OLD_HEADER_TIMESTAMP"),
    }
    for case, (sent, code) in wrong.items():
        assert not arm.send(sent).accepted, case
        message = arm.rosout.wait(lambda each: each.level >= 30).message
        assert message.msg.startswith(f"goal refused: {code}: "), f"{case}: {message.msg}"
    assert arm.positions() == pytest.approx(before, abs=0.03)


def test_a_new_goal_of_another_client_preempts_the_old_one(arm: Arm) -> None:
    """ros2_controllers: preempt_active_goal sets it canceled, with INVALID_GOAL."""
    with Participant(arm.port, "other") as other:
        client = ActionClient(other, ACTION)
        mine = arm.send(arm.long_goal())
        assert mine.accepted
        theirs = client.send(arm.short_goal(0.2, 1.0))
        assert theirs.accepted
        end = mine.result()
        assert (end.status, end.result.error_code) == (a.CANCELED, a.INVALID_GOAL)
        assert end.result.error_string
        assert theirs.result().status == a.SUCCEEDED
        ids = [received.message.goal_id.uuid for received in arm.action.feedback.take_all()]
        assert theirs.id in ids
        assert ids == sorted(ids, key=lambda each: each == theirs.id), "no feedback of the first after the second"


def test_a_late_client_sees_a_goal_and_cancels_it(arm: Arm) -> None:
    made = arm.send(arm.long_goal())
    assert made.accepted
    with Participant(arm.port, "late") as late:
        client = ActionClient(late, ACTION)
        client.status.wait(
            lambda message: any(
                row.goal_info.goal_id.uuid == made.id and row.status == a.EXECUTING for row in message.status_list
            )
        )
        client.wait()
        theirs = client.result_of(made.id)
        assert not made.ended, "who asks for a result waits for it"
        answer = client.cancel(made.id)
        assert answer.return_code == a.NONE
        assert [info.goal_id.uuid for info in answer.goals_canceling] == [made.id]
        assert made.result().status == theirs.message().status == a.CANCELED
    found = states(until_state(arm, made, a.CANCELED), made)
    assert [state for state in found if state != a.ACCEPTED] == [a.EXECUTING, a.CANCELING, a.CANCELED]


def test_what_is_answered_to_a_cancel(arm: Arm) -> None:
    assert vars(arm.action.cancel(new_id())) == {"return_code": a.UNKNOWN_GOAL, "goals_canceling": []}
    assert vars(arm.action.cancel()) == {"return_code": a.NONE, "goals_canceling": []}, "all, and there is none"
    made = arm.send(arm.long_goal())
    assert made.accepted
    past = int(time.time()) - 100
    assert arm.action.cancel(stamp=(past, 0)).goals_canceling == [], "all until a time"
    answer = arm.action.cancel()
    assert [info.goal_id.uuid for info in answer.goals_canceling] == [made.id], "all"
    assert made.result().status == a.CANCELED
    assert vars(made.cancel()) == {"return_code": a.TERMINATED, "goals_canceling": []}


@pytest.mark.slow
def test_a_tolerance_of_a_goal_ends_it_with_its_code(arm: Arm) -> None:
    made = arm.send({**arm.short_goal(0.5, 1.0), "path_tolerance": [tolerance("J1", 0.002)]})
    assert made.accepted
    end = made.result()
    assert (end.status, end.result.error_code) == (a.ABORTED, a.PATH_VIOLATED)
    assert "J1" in end.result.error_string


def test_a_stop_aborts_the_goal(arm: Arm) -> None:
    made = arm.send(arm.long_goal())
    assert made.accepted
    arm.trigger("stop")
    end = made.result()
    assert (end.status, end.result.error_code) == (a.ABORTED, a.INVALID_GOAL)
    assert end.result.error_string
