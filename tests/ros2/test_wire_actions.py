"""Actions, parameters and the life cycle between nodes, through a router."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import pytest
from tests.control.arm_bench import Bench
from tests.motion.arms import HOME
from tests.ros2.world import Router
from tests.waits import eventually

from hexwire.ros2.actions import FOLLOW_JOINT_TRAJECTORY, ActionGoals
from hexwire.ros2.rmw.action_server import ActionServer, GoalHandle
from hexwire.ros2.rmw.goals import CancelCode, GoalStatus
from hexwire.ros2.rmw.lifecycle import Lifecycle, State
from hexwire.ros2.rmw.node import Node
from hexwire.ros2.rmw.parameters import ParameterServer
from hexwire.ros2.rmw.qos import ACTION_STATUS, DEFAULT
from hexwire.ros2.rmw.types import Types

pytestmark = pytest.mark.system

TYPES = Types()
ACTION = TYPES.action(FOLLOW_JOINT_TRAJECTORY)
UUID = TYPES.message("unique_identifier_msgs/msg/UUID")
PATIENCE = 30.0
J1 = HOME["J1"]


def uuid(*parts: int) -> Any:
    return UUID(uuid=bytes(parts) + bytes(16 - len(parts)))


def goal(angle: float, seconds: int) -> Any:
    make = TYPES.message
    duration = make("builtin_interfaces/msg/Duration")(sec=seconds)
    point = make("trajectory_msgs/msg/JointTrajectoryPoint")(positions=[angle], time_from_start=duration)
    trajectory = make("trajectory_msgs/msg/JointTrajectory")(joint_names=["J1"], points=[point])
    return ACTION.goal(trajectory=trajectory)


class Client:
    """As much of an action client as the tests need."""

    def __init__(self, node: Node, name: str = "/follow") -> None:
        self.feedback: list[Any] = []
        self.statuses: list[dict[bytes, int]] = []
        within = f"{name}/_action"
        self._send = node.client(f"{within}/send_goal", ACTION.send_goal.name)
        self._cancel = node.client(f"{within}/cancel_goal", ACTION.cancel_goal.name)
        self._result = node.client(f"{within}/get_result", ACTION.get_result.name)
        # Deep enough for a burst; a real client keeps the last 10.
        deep = replace(DEFAULT, depth=1000)
        node.subscribe(f"{within}/feedback", ACTION.feedback.name, lambda m, _: self.feedback.append(m), deep)
        node.subscribe(f"{within}/status", ACTION.status.name, self._on_status, ACTION_STATUS)
        for client in (self._send, self._cancel, self._result):
            assert client.wait_for_service(PATIENCE)

    def _on_status(self, message: Any, _stamp: int) -> None:
        self.statuses.append({row.goal_info.goal_id.uuid: row.status for row in message.status_list})

    def send(self, goal_id: Any, content: Any = None) -> bool:
        request = ACTION.send_goal.request(goal_id=goal_id, goal=content or ACTION.goal())
        return bool(self._send.call(request, PATIENCE).accepted)

    def cancel(self, goal_id: Any) -> int:
        info = TYPES.message("action_msgs/msg/GoalInfo")(goal_id=goal_id)
        return int(self._cancel.call(ACTION.cancel_goal.request(goal_info=info), PATIENCE).return_code)

    def result(self, goal_id: Any) -> tuple[int, str]:
        response = self._result.call(ACTION.get_result.request(goal_id=goal_id), PATIENCE)
        return response.status, response.result.error_string


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

    ActionServer(make("arm"), TYPES, "/follow", FOLLOW_JOINT_TRAJECTORY, on_goal=on_goal, on_cancel=print)
    several = [Client(make(f"client{number}")) for number in range(clients)]
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
        FOLLOW_JOINT_TRAJECTORY,
        on_goal=on_goal,
        on_cancel=lambda handle: handle.canceled(ACTION.result(error_string="held")),
    )
    mine = uuid(1)
    assert Client(make("first")).send(mine)
    late = Client(make("late"))
    eventually(lambda: late.statuses)
    assert late.statuses[0] == {mine.uuid: GoalStatus.EXECUTING}
    assert late.result(uuid(2)) == (GoalStatus.UNKNOWN, "")
    assert late.cancel(uuid(2)) == CancelCode.UNKNOWN_GOAL_ID
    assert late.cancel(mine) == CancelCode.NONE
    assert late.result(mine) == (GoalStatus.CANCELED, "held")
    assert late.cancel(mine) == CancelCode.GOAL_TERMINATED
    eventually(lambda: late.statuses[-1] == {mine.uuid: GoalStatus.CANCELED})


DYING = """
import os, sys, threading
from hexwire.ros2.rmw.node import Node, NodeOptions
from hexwire.ros2.rmw.zenoh_session import ZenohSettings
from tests.ros2.test_wire_actions import TYPES, Client, goal, uuid

node = Node(NodeOptions("dying", zenoh=ZenohSettings(connect=(sys.argv[1],))), TYPES)
node.open()
client = Client(node)
accepted = client.send(uuid(1), goal(float(sys.argv[2]), 2))
threading.Thread(target=client.result, args=(uuid(1),), daemon=True).start()
print(accepted, flush=True)
sys.stdin.readline()
os._exit(1)
"""


@pytest.fixture
def bench() -> Iterator[tuple[Bench, ActionGoals]]:
    bench = Bench(check_table=False, allow_partial_joints_goal=True)
    bench.ask(lambda: bench.arm.enable(True))
    goals = ActionGoals(bench.arm, ACTION.result)
    goals.start()
    yield bench, goals
    goals.close()


def test_a_goal_goes_on_when_the_client_that_sent_it_dies(
    make: Callable[..., Node], router: Router, bench: tuple[Bench, ActionGoals]
) -> None:
    arm, goals = bench
    node = make("arm")
    server = ActionServer(
        node,
        TYPES,
        "/follow",
        FOLLOW_JOINT_TRAJECTORY,
        on_goal=partial(goals.on_goal, ""),
        on_cancel=partial(goals.on_cancel, ""),
    )
    there = J1 + 0.3
    with subprocess.Popen(
        [sys.executable, "-c", DYING, router.endpoint, str(there)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        assert process.stdout.readline() == "True\n"
        arm.turn(0.5)
        eventually(lambda: server._services[2].pending)
        process.stdin.write("\n")
    assert process.returncode == 1
    # The request of the dead client is forgotten, its goal is not.
    eventually(lambda: not server._services[2].pending)
    assert arm.controller.busy
    arm.until(lambda: not arm.controller.busy)
    assert arm.where("J1") == pytest.approx(there, abs=0.05)
    assert Client(make("other")).result(uuid(1)) == (GoalStatus.SUCCEEDED, "")


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
