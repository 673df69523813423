"""Actions, parameters and the life cycle between nodes, through a router."""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import partial
from typing import Any

import pytest
from tests.waits import eventually
from zenoh_ros2_tests.action_client import ACTION, ACTION_NAME, PATIENCE, TYPES, ActionClient, uuid

from zenoh_ros2.action_server import ActionServer, GoalHandle
from zenoh_ros2.goals import CancelCode, GoalStatus
from zenoh_ros2.lifecycle import Lifecycle, State
from zenoh_ros2.node import Node
from zenoh_ros2.parameters import ParameterServer

pytestmark = pytest.mark.system


@pytest.fixture
def make(make_node: Callable[..., Node]) -> Callable[..., Node]:
    return partial(make_node, types=TYPES)


def test_results_and_feedback_of_many_clients_are_never_crossed(make: Callable[..., Node]) -> None:
    clients, goals_each = 5, 4
    handles: list[GoalHandle] = []
    everything = threading.Event()

    def on_goal(handle: GoalHandle) -> None:
        handle.accept()
        handles.append(handle)
        if len(handles) == clients * goals_each:
            everything.set()

    ActionServer(make("arm"), TYPES, "/follow", ACTION_NAME, on_goal=on_goal, on_cancel=print)
    several = [ActionClient(make(f"client{number}")) for number in range(clients)]
    got: dict[bytes, tuple[int, str]] = {}

    def run(number: int, part: int) -> None:
        goal_id = uuid(number + 1, part + 1)
        assert several[number].send(goal_id)
        got[goal_id.uuid] = several[number].result(goal_id)

    threads = [threading.Thread(target=run, args=(n, k)) for n in range(clients) for k in range(goals_each)]
    for thread in threads:
        thread.start()
    assert everything.wait(PATIENCE)
    for handle in reversed(handles):
        handle.publish_feedback(ACTION.feedback_content(joint_names=[handle.id.hex()]))
        handle.abort(ACTION.result(error_string=handle.id.hex()))
    for thread in threads:
        thread.join(PATIENCE)
    assert len(got) == clients * goals_each
    assert got == {key: (GoalStatus.ABORTED, key.hex()) for key in got}
    for client in several:
        eventually(lambda client=client: len(client.feedback) == len(got))  # type: ignore[misc]
        assert all(m.feedback.joint_names == [m.goal_id.uuid.hex()] for m in client.feedback)


def test_a_late_client_sees_the_goals_and_may_cancel_them(make: Callable[..., Node]) -> None:
    handles: list[GoalHandle] = []

    def on_goal(handle: GoalHandle) -> None:
        handles.append(handle)
        handle.accept()

    ActionServer(
        make("arm"),
        TYPES,
        "/follow",
        ACTION_NAME,
        on_goal=on_goal,
        on_cancel=lambda handle: handle.canceled(ACTION.result(error_string="held")),
    )
    mine = uuid(1)
    assert ActionClient(make("first")).send(mine)
    late = ActionClient(make("late"))
    eventually(lambda: late.statuses)
    assert late.statuses[0] == {mine.uuid: GoalStatus.EXECUTING}
    assert late.result(uuid(2)) == (GoalStatus.UNKNOWN, "")
    assert late.cancel(uuid(2)) == CancelCode.UNKNOWN_GOAL_ID
    assert late.cancel(mine) == CancelCode.NONE
    assert late.result(mine) == (GoalStatus.CANCELED, "held")
    assert late.cancel(mine) == CancelCode.GOAL_TERMINATED
    eventually(lambda: late.statuses[-1] == {mine.uuid: GoalStatus.CANCELED})


def test_parameters_and_life_cycle_answer_others(make: Callable[..., Node]) -> None:
    node, other = make("arm", namespace="/lab"), make("other")
    parameters = ParameterServer(node, TYPES)
    parameters.declare("rate", 100.0)
    parameters.offer()
    lifecycle = Lifecycle(node, TYPES, print)
    events: list[Any] = []
    other.subscribe("/parameter_events", "rcl_interfaces/msg/ParameterEvent", lambda m, _: events.append(m))
    calls = {
        "set_parameters": "rcl_interfaces/srv/SetParameters",
        "get_parameters": "rcl_interfaces/srv/GetParameters",
        "get_state": "lifecycle_msgs/srv/GetState",
        "change_state": "lifecycle_msgs/srv/ChangeState",
    }
    clients = {name: other.client(f"/lab/arm/{name}", kind) for name, kind in calls.items()}
    assert all(client.wait_for_service(PATIENCE) for client in clients.values())

    def ask(name: str, **fields: Any) -> Any:
        return clients[name].call(TYPES.service(calls[name]).request(**fields), PATIENCE)

    held = TYPES.message("rcl_interfaces/msg/ParameterValue")(type=3, double_value=20.0)
    row = TYPES.message("rcl_interfaces/msg/Parameter")(name="rate", value=held)
    eventually(lambda: parameters._events.subscriber_count())
    assert [result.successful for result in ask("set_parameters", parameters=[row]).results] == [True]
    assert [value.double_value for value in ask("get_parameters", names=["rate"]).values] == [20.0]

    def changes() -> list[Any]:
        # A subscriber that is there early is also told of the new parameters.
        return [(m.node, [r.name for r in m.changed_parameters]) for m in events if m.changed_parameters]

    eventually(changes)
    assert changes() == [("/lab/arm", ["rate"])]
    lifecycle.mirror(State.INACTIVE)
    assert ask("get_state").current_state.label == "inactive"
    transition = TYPES.message("lifecycle_msgs/msg/Transition")(label="activate")
    assert ask("change_state", transition=transition).success
    assert ask("get_state").current_state.label == "active"
