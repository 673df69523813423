"""An action client, as rclcpp_action has it: three services and two topics (the design article on actions)."""

from __future__ import annotations

import os
from types import SimpleNamespace
from typing import Any

from tests.ros2.strict_client.wire import DEFAULT, STATUS, Participant, Reply

UNKNOWN, ACCEPTED, EXECUTING, CANCELING, SUCCEEDED, CANCELED, ABORTED = range(7)
# action_msgs/srv/CancelGoal
NONE, REJECTED, UNKNOWN_GOAL, TERMINATED = range(4)
# control_msgs/action/FollowJointTrajectory
SUCCESSFUL, INVALID_GOAL, INVALID_JOINTS, OLD_HEADER, PATH_VIOLATED, GOAL_VIOLATED = (0, -1, -2, -3, -4, -5)
TYPE = "control_msgs/action/FollowJointTrajectory"


def new_id() -> bytes:
    """A random UUID of version 4, as rclcpp_action and rclpy send."""
    made = bytearray(os.urandom(16))
    made[6] = made[6] & 0x0F | 0x40
    made[8] = made[8] & 0x3F | 0x80
    return bytes(made)


class ActionClient:
    def __init__(self, participant: Participant, name: str) -> None:
        base = f"{name}/_action"
        self.name = name
        self.participant = participant
        # In the order of rcl_action_client_init.
        self.goals = participant.client(f"{base}/send_goal", f"{TYPE}_SendGoal")
        self.cancels = participant.client(f"{base}/cancel_goal", "action_msgs/srv/CancelGoal")
        self.results = participant.client(f"{base}/get_result", f"{TYPE}_GetResult")
        self.feedback = participant.subscribe(f"{base}/feedback", f"{TYPE}_FeedbackMessage", DEFAULT)
        self.status = participant.subscribe(f"{base}/status", "action_msgs/msg/GoalStatusArray", STATUS)

    def wait(self) -> None:
        for client in (self.goals, self.cancels, self.results):
            client.wait()

    def send(self, goal: dict[str, Any], *, id: bytes | None = None) -> Goal:
        """Send a goal; the caller looks at `accepted`."""
        self.wait()
        id = id or new_id()
        return Goal(self, id, self.goals.send(goal_id={"uuid": id}, goal=goal))

    def cancel(self, id: bytes = bytes(16), stamp: tuple[int, int] = (0, 0)) -> SimpleNamespace:
        info = {"goal_id": {"uuid": id}, "stamp": {"sec": stamp[0], "nanosec": stamp[1]}}
        return self.cancels.send(goal_info=info).message()

    def result_of(self, id: bytes) -> Reply:
        return self.results.send(goal_id={"uuid": id})


class Goal:
    def __init__(self, client: ActionClient, id: bytes, reply: Reply) -> None:
        self.client = client
        self.id = id
        self.reply = reply
        self._result: Reply | None = None

    @property
    def accepted(self) -> bool:
        answer = self.reply.message()
        if answer.accepted and self._result is None:
            # As rclcpp_action: it asks for the result as soon as a goal is accepted.
            self._result = self.client.result_of(self.id)
        return bool(answer.accepted)

    def result(self) -> SimpleNamespace:
        """Its end: `status`, `result.error_code`, `result.error_string`."""
        assert self.accepted
        assert self._result is not None
        return self._result.message()

    @property
    def ended(self) -> bool:
        assert self._result is not None
        return self._result.done

    def cancel(self) -> SimpleNamespace:
        return self.client.cancel(self.id)

    def statuses(self) -> list[int]:
        """What the status topic has said of it so far, in order, each once in a row."""
        found: list[int] = []
        for received in self.client.status.take_all():
            for status in received.message.status_list:
                if status.goal_info.goal_id.uuid == self.id and found[-1:] != [status.status]:
                    found.append(status.status)
        return found


def point(positions: list[float], seconds: float, **more: list[float]) -> dict[str, Any]:
    whole = int(seconds)
    return {
        "positions": positions,
        "time_from_start": {"sec": whole, "nanosec": round((seconds - whole) * 1e9)},
        **more,
    }


def goal(names: list[str], points: list[dict[str, Any]], **more: Any) -> dict[str, Any]:
    stamp = more.pop("stamp", (0, 0))
    header = {"stamp": {"sec": stamp[0], "nanosec": stamp[1]}}
    return {"trajectory": {"header": header, "joint_names": names, "points": points}, **more}


def tolerance(name: str, position: float = 0.0, velocity: float = 0.0, acceleration: float = 0.0) -> dict[str, Any]:
    return {"name": name, "position": position, "velocity": velocity, "acceleration": acceleration}
