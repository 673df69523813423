"""A ROS program of somebody else: what it is told on standard input it does, and answers on standard output.

Runs on Debian's own interpreter, as rospy programs do. A line is a JSON list: the name of a function below and its
named arguments. The answer is a line with {"ok": value} or {"error": text}.
"""

from __future__ import annotations

import json
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import actionlib
import genpy
import rosgraph
import roslib.message
import rospy
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

sys.path.append(str(Path(__file__).resolve().parents[2] / "src"))

from hexwire.ros1.messages import control_msgs, control_srvs, osrf_msgs

PATIENCE = 30.0
OWN = {"control_msgs": control_msgs, "osrf_msgs": osrf_msgs}


def plain(value: Any) -> Any:
    """A message as JSON has it; times as seconds."""
    if isinstance(value, genpy.Message):
        return {name: plain(getattr(value, name)) for name in value.__slots__}
    if isinstance(value, (genpy.Time, genpy.Duration)):
        return value.to_sec()
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    return value


def message_class(kind: str) -> Any:
    package, _, name = kind.partition("/")
    return getattr(OWN[package](), name) if package in OWN else roslib.message.get_message_class(kind)


def trajectory(names: list[str], points: list[dict[str, Any]], delay: float | None = None) -> JointTrajectory:
    """`delay`: seconds from now to the stamp; None for none. A point's `t` is its time."""
    message = JointTrajectory(joint_names=names)
    if delay is not None:
        message.header.stamp = rospy.Time.now() + rospy.Duration.from_sec(delay)
    for point in points:
        rest = {name: value for name, value in point.items() if name != "t"}
        message.points.append(JointTrajectoryPoint(time_from_start=rospy.Duration.from_sec(point["t"]), **rest))
    return message


class Goal:
    """A goal of an action client of its own, made once there is a server: a stamp is a time from then on."""

    def __init__(self, action: str, make: Callable[[], Any]) -> None:
        self.client = actionlib.SimpleActionClient(action, control_msgs().FollowJointTrajectoryAction)
        if not self.client.wait_for_server(rospy.Duration.from_sec(PATIENCE)):
            raise RuntimeError(f"no action server at {action}")
        self.feedback: list[Any] = []
        self.client.send_goal(make(), feedback_cb=self.feedback.append)


GOALS: dict[str, Goal] = {}


class Program:
    """Functions that can be called by name."""

    def __init__(self) -> None:
        self._publishers: dict[str, Any] = {}
        self._seen: dict[str, list[Any]] = {}

    def collect(self, topic: str, kind: str, count: int = 1, patience: float = PATIENCE) -> list[Any]:
        """The next messages of a topic."""
        found: list[Any] = []
        enough = threading.Event()

        def take(message: Any) -> None:
            if len(found) < count:
                found.append(plain(message))
            if len(found) == count:
                enough.set()

        subscriber = rospy.Subscriber(topic, message_class(kind), take, queue_size=1000)
        try:
            if not enough.wait(patience):
                raise RuntimeError(f"only {len(found)} of {count} messages on {topic}")
        finally:
            subscriber.unregister()
        return found

    def watch(self, topic: str, kind: str) -> None:
        """Note every message of a topic from now on, for `seen`."""
        messages = self._seen[topic] = []
        subscriber = rospy.Subscriber(topic, message_class(kind), messages.append, queue_size=1000)
        deadline = time.monotonic() + PATIENCE
        while not subscriber.get_num_connections():
            if time.monotonic() > deadline:
                raise RuntimeError(f"nobody publishes {topic}")
            time.sleep(0.01)

    def seen(self, topic: str) -> list[Any]:
        return [plain(message) for message in self._seen[topic]]

    def forget(self, node: str, service: str) -> None:
        """Have the master forget a node's service."""
        master = rosgraph.Master(node)
        master.unregisterService(service, master.lookupService(service))

    def send(
        self,
        key: str,
        action: str,
        names: list[str],
        points: list[dict[str, Any]],
        delay: float | None = None,
        path: dict[str, float] | None = None,
        goal: dict[str, float] | None = None,
        goal_time: float = 0.0,
    ) -> None:
        """Send a goal that later calls name `key`; path and goal are tolerances by joint."""
        kinds = control_msgs()

        def make() -> Any:
            message = kinds.FollowJointTrajectoryGoal()
            message.trajectory = trajectory(names, points, delay)
            message.path_tolerance = [kinds.JointTolerance(name, x, 0.0, 0.0) for name, x in (path or {}).items()]
            message.goal_tolerance = [kinds.JointTolerance(name, x, 0.0, 0.0) for name, x in (goal or {}).items()]
            message.goal_time_tolerance = rospy.Duration.from_sec(goal_time)
            return message

        GOALS[key] = Goal(action, make)

    def send_wrong(self, action: str, times: int) -> dict[str, int]:
        """Send goals without joints, one after the other; how many ended in each state. One that hangs is LOST."""
        goal = Goal(action, control_msgs().FollowJointTrajectoryGoal)
        states: dict[str, int] = {}
        for i in range(times):
            if i:
                goal.client.send_goal(control_msgs().FollowJointTrajectoryGoal())
            ended = goal.client.wait_for_result(rospy.Duration.from_sec(PATIENCE))
            state = actionlib.GoalStatus.to_string(goal.client.get_state()) if ended else "LOST"
            states[state] = states.get(state, 0) + 1
        return states

    def query(self, service: str, delay: float) -> dict[str, Any]:
        """Ask for the desired state in so many seconds."""
        rospy.wait_for_service(service, PATIENCE)
        when = rospy.Time.now() + rospy.Duration.from_sec(delay)
        try:
            return plain(rospy.ServiceProxy(service, control_srvs().QueryTrajectoryState)(when))
        except rospy.ServiceException as error:
            return {"error": str(error)}

    def wait_active(self, key: str, feedback: int = 1) -> None:
        """Wait until so many feedbacks of a goal have come."""
        deadline = time.monotonic() + PATIENCE
        while len(GOALS[key].feedback) < feedback:
            if time.monotonic() > deadline:
                client = GOALS[key].client
                raise RuntimeError(f"no feedback; state {client.get_state()}: {client.get_goal_status_text()}")
            time.sleep(0.005)

    def cancel(self, key: str) -> None:
        GOALS[key].client.cancel_goal()

    def result(self, key: str, patience: float = PATIENCE) -> dict[str, Any]:
        """Wait for a goal's end."""
        goal = GOALS[key]
        if not goal.client.wait_for_result(rospy.Duration.from_sec(patience)):
            raise RuntimeError(f"no result; state {goal.client.get_state()}")
        result = goal.client.get_result()
        return {
            "state": actionlib.GoalStatus.to_string(goal.client.get_state()),
            "code": result.error_code,
            "text": result.error_string,
            "feedback": [plain(message) for message in goal.feedback],
        }

    def command(
        self, topic: str, names: list[str], points: list[dict[str, Any]], delay: float | None = None
    ) -> None:
        """Publish a trajectory once."""
        self._publisher(topic, JointTrajectory).publish(trajectory(names, points, delay))

    def joint_commands(self, topic: str, times: int = 1, rate: float = 50.0, **fields: Any) -> None:
        """Publish osrf_msgs/JointCommands."""
        kind = osrf_msgs().JointCommands
        publisher = self._publisher(topic, kind)
        for _ in range(times):
            publisher.publish(kind(**fields))
            rospy.sleep(1.0 / rate)

    def trigger(self, service: str) -> list[Any]:
        rospy.wait_for_service(service, PATIENCE)
        answer = rospy.ServiceProxy(service, Trigger)()
        return [answer.success, answer.message]

    def burst(self, service: str, callers: int, each: int) -> int:
        """Trigger a service by many programs at once; how many calls succeeded."""
        rospy.wait_for_service(service, PATIENCE)
        done: list[bool] = []

        def call() -> None:
            done.extend(rospy.ServiceProxy(service, Trigger)().success for _ in range(each))

        threads = [threading.Thread(target=call) for _ in range(callers)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        return sum(done)

    def switch(self, service: str, on: bool) -> list[Any]:
        rospy.wait_for_service(service, PATIENCE)
        answer = rospy.ServiceProxy(service, SetBool)(on)
        return [answer.success, answer.message]

    def set_param(self, name: str, value: Any) -> None:
        rospy.set_param(name, value)

    def get_param(self, name: str) -> Any:
        return rospy.get_param(name)

    def delete_param(self, name: str) -> None:
        if rospy.has_param(name):
            rospy.delete_param(name)

    def topics(self) -> list[list[str]]:
        return rospy.get_published_topics()

    def position(self, topic: str) -> dict[str, float]:
        message = rospy.wait_for_message(topic, JointState, PATIENCE)
        return dict(zip(message.name, message.position, strict=True))

    def _publisher(self, topic: str, kind: Any) -> Any:
        publisher = self._publishers.get(topic)
        if publisher is None:
            publisher = self._publishers[topic] = rospy.Publisher(topic, kind, queue_size=100)
        deadline = time.monotonic() + PATIENCE
        while not publisher.get_num_connections():
            if time.monotonic() > deadline:
                raise RuntimeError(f"nobody listens to {topic}")
            time.sleep(0.01)
        return publisher


def main() -> None:
    rospy.init_node("somebody", anonymous=True, disable_signals=True)
    program = Program()
    print(json.dumps({"ok": "ready"}), flush=True)
    for line in sys.stdin:
        name, arguments = json.loads(line)
        try:
            answer = {"ok": getattr(program, name)(**arguments)}
        except Exception as error:  # noqa: BLE001  # whatever it is, it is the test's to judge
            answer = {"error": f"{type(error).__name__}: {error}"}
        print(json.dumps(answer), flush=True)


main()
