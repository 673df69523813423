"""The lifecycle as `ros2 lifecycle` asks for it: names and ids of lifecycle_msgs."""

from __future__ import annotations

import pytest
from tests.ros2.strict_client.world import NODE, Arm
from tests.waits import until

pytestmark = pytest.mark.system

STATES = {1: "unconfigured", 2: "inactive", 3: "active", 4: "finalized"}


def state(arm: Arm) -> tuple[int, str]:
    answer = arm.service(f"{NODE}/get_state", "lifecycle_msgs/srv/GetState").call().current_state
    return answer.id, answer.label


def test_the_state_is_that_of_this_moment(arm: Arm) -> None:
    """A client that asks right after a service was answered sees what it did."""
    for _ in range(3):
        arm.enable(False)
        assert state(arm) == (2, "inactive")
        assert arm.enable().success
        assert state(arm) == (3, "active")
        assert arm.trigger("stop").success
        assert state(arm) == (2, "inactive")
        assert arm.trigger("reset").success
        assert state(arm) == (3, "active")


def test_an_arm_that_was_deactivated_takes_no_goals(arm: Arm) -> None:
    """joint_trajectory_controller: goals are rejected while it is inactive."""
    assert until(lambda: state(arm)[0] == 3, "the node is active")
    goal = arm.short_goal()
    change = arm.service(f"{NODE}/change_state", "lifecycle_msgs/srv/ChangeState")
    assert change.call(transition={"id": 4, "label": ""}).success
    assert state(arm) == (2, "inactive")
    assert not arm.send(goal).accepted
    assert change.call(transition={"id": 0, "label": "activate"}).success
    assert state(arm) == (3, "active")
    assert arm.send(goal).accepted


def test_the_four_primary_states_are_available(arm: Arm) -> None:
    answer = arm.service(f"{NODE}/get_available_states", "lifecycle_msgs/srv/GetAvailableStates").call()
    listed = {each.id: each.label for each in answer.available_states}
    assert {number: listed.get(number) for number in STATES} == STATES


def test_available_transitions_start_at_the_state(arm: Arm) -> None:
    answer = arm.service(f"{NODE}/get_available_transitions", "lifecycle_msgs/srv/GetAvailableTransitions").call()
    here = state(arm)[0]
    assert all(each.start_state.id == here for each in answer.available_transitions)
    listed = {each.transition.id: each.transition.label for each in answer.available_transitions}
    # lifecycle_msgs/Transition: deactivate 4, shutdown of an active node 7.
    assert set(listed) <= {4, 7}


def test_the_whole_graph_of_transitions(arm: Arm) -> None:
    answer = arm.service(f"{NODE}/get_transition_graph", "lifecycle_msgs/srv/GetAvailableTransitions").call()
    graph = {(each.transition.id, each.start_state.id) for each in answer.available_transitions}
    assert {(1, 1), (3, 2), (4, 3)} <= graph  # configure, activate, deactivate


def test_an_impossible_or_unknown_transition_is_refused(arm: Arm) -> None:
    change = arm.service(f"{NODE}/change_state", "lifecycle_msgs/srv/ChangeState")
    before = state(arm)
    assert not change.call(transition={"id": 1, "label": "configure"}).success
    assert not change.call(transition={"id": 77, "label": "fly"}).success
    assert state(arm) == before


def test_a_change_is_an_event(arm: Arm) -> None:
    events = arm.me.subscribe(f"{NODE}/transition_event", "lifecycle_msgs/msg/TransitionEvent")
    until(lambda: state(arm)[0] == 3, "the node is active")
    arm.enable(False)
    event = events.wait(lambda message: message.goal_state.id == 2).message
    assert event.goal_state.label == "inactive"
