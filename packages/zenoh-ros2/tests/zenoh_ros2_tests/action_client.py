"""A client of an action, which the package itself does not have."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from zenoh_ros2.node import Node
from zenoh_ros2.qos import ACTION_STATUS, DEFAULT
from zenoh_ros2.types import Types

TYPES = Types()
ACTION_NAME = "control_msgs/action/FollowJointTrajectory"
ACTION = TYPES.action(ACTION_NAME)
UUID = TYPES.message("unique_identifier_msgs/msg/UUID")
PATIENCE = 30.0


def uuid(*parts: int) -> Any:
    return UUID(uuid=bytes(parts) + bytes(16 - len(parts)))


def goal(angle: float, seconds: int) -> Any:
    make = TYPES.message
    duration = make("builtin_interfaces/msg/Duration")(sec=seconds)
    point = make("trajectory_msgs/msg/JointTrajectoryPoint")(positions=[angle], time_from_start=duration)
    trajectory = make("trajectory_msgs/msg/JointTrajectory")(joint_names=["J1"], points=[point])
    return ACTION.goal(trajectory=trajectory)


class ActionClient:
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
