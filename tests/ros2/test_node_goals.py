"""Goals of FollowJointTrajectory clients: what they are told, and what the arm does."""

from __future__ import annotations

import math
import uuid

import pytest
from tests.ros2.node_fixtures import arm, shared_arm, world
from tests.ros2.node_world import (
    ABORTED,
    ACTION,
    CANCELED,
    CONTROLLER,
    SUCCEEDED,
    Arm,
    Goal,
    near,
    still,
    until,
)

from hexwire.ros2.qos import ACTION_STATUS

__all__ = ["arm", "shared_arm", "world"]

pytestmark = pytest.mark.system
AT = f"/{CONTROLLER}/follow_joint_trajectory/_action"


def aside(arm: Arm, angle: float) -> dict[str, float]:
    here = arm.position()["J1"]
    return {"J1": here - math.copysign(angle, here)}


def test_a_goal_is_reached_with_feedback_and_states_on_the_way(arm: Arm) -> None:
    arm.peer.listen(f"{AT}/feedback", f"{ACTION}_FeedbackMessage")
    arm.peer.listen(f"{AT}/status", "action_msgs/msg/GoalStatusArray", ACTION_STATUS)
    target = aside(arm, 0.3)
    goal = Goal(arm, (1.5, target))
    assert goal.accepted
    # The text may say how far off a joint came to rest.
    assert goal.result()[:2] == (SUCCEEDED, 0)
    assert near(target, arm.board.positions)
    feedback = [m for m in arm.peer.received[f"{AT}/feedback"] if bytes(m.goal_id.uuid) == goal.id]
    assert len(feedback) >= 5
    assert all(math.isfinite(m.feedback.error.positions[0]) for m in feedback)

    def states() -> list[int]:
        found = []
        for message in arm.peer.received[f"{AT}/status"]:
            for row in message.status_list:
                if bytes(row.goal_info.goal_id.uuid) == goal.id and row.status not in found[-1:]:
                    found.append(row.status)
        return found

    until(lambda: states()[-1:] == [SUCCEEDED], "its end is published", arm.node.report)
    assert states() == [2, SUCCEEDED]


def test_a_new_goal_aborts_the_old_one_and_takes_over(arm: Arm) -> None:
    here = arm.position()
    old = Goal(arm, (6.0, aside(arm, 0.6)))
    until(lambda: not near(here, arm.board.positions, 0.02), "it moves", arm.node.report)
    new = Goal(arm, (2.0, {"J1": here["J1"]}))
    status, code, text = old.result()
    assert (status, code) == (ABORTED, -1)
    assert "replaced by a new goal" in text
    assert new.result()[0] == SUCCEEDED


def test_a_cancelled_goal_is_held(arm: Arm) -> None:
    target, here = aside(arm, 0.6), arm.position()
    goal = Goal(arm, (6.0, target))
    until(lambda: not near(here, arm.board.positions, 0.02), "it moves", arm.node.report)
    assert goal.cancel() == 0
    assert goal.result()[:2] == (CANCELED, 0)
    assert not near(target, still(lambda: arm.board.positions), 0.1)
    assert goal.cancel() == 3


@pytest.mark.parametrize(
    ("points", "text"),
    [
        ([(1.0, {"elbow": 0.0})], "INVALID_JOINTS: joint_names: 'elbow' unknown"),
        ([(1.0, {"J1": math.nan})], "INVALID_GOAL: points[0].positions: J1 is nan"),
        ([(1.0, {"J1": 9.0})], "INVALID_GOAL: "),
        ([(0.001, {"J1": 0.5})], "INVALID_GOAL: "),
    ],
)
def test_a_wrong_goal_is_refused_and_the_log_says_why(
    arm: Arm, points: list[tuple[float, dict[str, float]]], text: str
) -> None:
    arm.peer.listen("/rosout", "rcl_interfaces/msg/Log")
    before = arm.board.positions
    assert not Goal(arm, *points).accepted
    said = lambda: any(row.msg.startswith(f"goal refused: {text}") for row in arm.peer.received["/rosout"])  # noqa: E731
    until(said, "its reason is on /rosout", arm.node.report)
    assert near(before, arm.board.positions, 0.002)


def test_a_goal_that_does_not_end_at_rest_is_refused(arm: Arm) -> None:
    trajectory = arm.trajectory((2.0, aside(arm, 0.2)))
    trajectory.points[0].velocities = [0.2]
    action = arm.peer.types.action(ACTION)
    goal_id = arm.peer.types.message("unique_identifier_msgs/msg/UUID")(uuid=uuid.uuid4().bytes)
    answer = arm.peer.call(
        f"{AT}/send_goal", f"{ACTION}_SendGoal", goal_id=goal_id, goal=action.goal(trajectory=trajectory)
    )
    assert not answer.accepted
    until(lambda: "the last point must have velocity 0" in arm.node.err, "the log says why", arm.node.report)


def test_tolerances_of_a_goal_decide_how_it_ends(arm: Arm) -> None:
    tolerance = arm.peer.types.message("control_msgs/msg/JointTolerance")
    goal = Goal(arm, (4.0, aside(arm, 0.3)), path_tolerance=[tolerance(name="J1", position=0.0002)])
    status, code, text = goal.result()
    assert (status, code) == (ABORTED, -4)
    assert "off its path" in text


def test_a_stop_aborts_a_goal_and_refuses_others_until_reset(arm: Arm) -> None:
    here = arm.position()
    goal = Goal(arm, (6.0, aside(arm, 0.6)))
    until(lambda: not near(here, arm.board.positions, 0.02), "it moves", arm.node.report)
    arm.trigger("stop")
    status, code, text = goal.result()
    assert (status, code) == (ABORTED, -1)
    assert "stopped" in text
    assert not Goal(arm, (1.0, here)).accepted
    arm.trigger("reset")
    assert Goal(arm, (1.0, arm.position())).result()[0] == SUCCEEDED


def test_a_goal_lives_on_when_its_client_ends(arm: Arm) -> None:
    """As in ROS 2; whoever sent it is not needed to bring the arm to rest."""
    target = aside(arm, 0.3)
    mine, other = arm.peer, arm.world.peer("short_lived")
    try:
        arm.peer = other
        goal = Goal(arm, (2.0, target))
        assert goal.accepted
    finally:
        arm.peer = mine
        other.close()
    assert goal.result()[0] == SUCCEEDED
    assert near(target, arm.board.positions)
