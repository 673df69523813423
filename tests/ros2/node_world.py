"""A router, emulated arms, nodes in processes of their own, and a client in the test's process.

Every process is ended with its world, whatever happens, and every wait has a deadline that only a fault meets.
"""

from __future__ import annotations

import contextlib
import json
import sys
import threading
import uuid
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, TypeVar

from tests.link.far_ends import free_port
from tests.ros1.ros_world import Program, Programs, PtyBoard, near, still
from tests.waits import PATIENCE, until
from zenoh_ros2_tests.router import Router

from hexwire.model.arms.hex7bot.joints import HEX7BOT
from zenoh_ros2.distributions import Distribution
from zenoh_ros2.node import Client, Node, NodeOptions, Publisher
from zenoh_ros2.qos import DEFAULT, Qos
from zenoh_ros2.types import Types
from zenoh_ros2.zenoh_session import ZenohSettings

__all__ = [
    "ABORTED",
    "ACTION",
    "CONTROLLER",
    "JOINTS",
    "NODE",
    "SUCCEEDED",
    "Arm",
    "Goal",
    "Peer",
    "PtyBoard",
    "World",
    "made",
    "near",
    "still",
]

T = TypeVar("T")
NODE = (sys.executable, "-m", "tests.patient_node", "ros2")
JOINTS = HEX7BOT.names
CONTROLLER = "joint_trajectory_controller"
ACTION = "control_msgs/action/FollowJointTrajectory"
SUCCEEDED, ABORTED = 4, 6
"""States of a goal."""


class World(Programs):
    """A router on a free loopback port.

    Args:
        folder: For output; a new one.
        routed: The router runs; otherwise only its address is known.
    """

    def __init__(self, folder: Path, *, routed: bool = True) -> None:
        self._router = Router() if routed else None
        self.endpoint = self._router.endpoint if self._router else f"tcp/127.0.0.1:{free_port()}"
        self._peers: list[Peer] = []
        env = {
            "ZENOH_CONFIG_OVERRIDE": f"connect/endpoints={json.dumps([self.endpoint])}",
            "PYTHONFAULTHANDLER": "1",
            "HOME": str(folder),
        }
        super().__init__(folder, env, ("ROS_", "HEXWIRE_", "PYTHON", "ZENOH_"))

    def node(self, *args: str, ready: bool = True, **env: str) -> Program:
        """The node under test; arguments are those after ``--ros-args``."""
        program = self.start(*NODE, "--ros-args", *args, **env)
        if ready:
            program.said("is ready at")
        return program

    def peer(self, name: str = "tester", distribution: Distribution = Distribution.JAZZY, **options: Any) -> Peer:
        """Another node."""
        zenoh = ZenohSettings(connect=(self.endpoint,))
        self._peers.append(Peer(Node(NodeOptions(name, zenoh=zenoh, **options), Types(distribution))))
        return self._peers[-1]

    @contextlib.contextmanager
    def apart(self) -> Iterator[None]:
        """What is started inside ends with it, also where a test has failed halfway."""
        programs, peers = len(self._programs), len(self._peers)
        try:
            yield
        finally:
            for peer in self._peers[peers:]:
                peer.close()
            self.end_later_than(programs)

    def close(self) -> None:
        for peer in self._peers:
            peer.close()
        super().close()
        if self._router is not None:
            self._router.stop()


class Peer:
    """Another node, with what it has received."""

    def __init__(self, node: Node) -> None:
        self.node, self.types = node, node.types
        self.received: dict[str, list[Any]] = {}
        self._clients: dict[str, Client] = {}
        self._publishers: dict[str, Publisher] = {}
        self._changed = threading.Condition()
        node.open()

    def close(self) -> None:
        self.node.close()

    def listen(self, topic: str, type_name: str, qos: Qos = DEFAULT) -> None:
        """Receive a topic from now on."""
        if topic in self.received:
            return
        self.received[topic] = []

        def take(message: Any, _: int) -> None:
            with self._changed:
                self.received[topic].append(message)
                self._changed.notify_all()

        self.node.subscribe(topic, type_name, take, qos)

    def collect(self, topic: str, type_name: str, count: int = 1, qos: Qos = DEFAULT) -> list[Any]:
        """The next messages of a topic; also those that a latched one keeps."""
        self.listen(topic, type_name, qos)
        with self._changed:
            begin = 0 if qos.latched else len(self.received[topic])
            enough = self._changed.wait_for(lambda: len(self.received[topic]) >= begin + count, PATIENCE)
            assert enough, f"waited in vain for {topic}"
            return self.received[topic][begin : begin + count]

    def publish(self, topic: str, type_name: str, **fields: Any) -> None:
        """Publish a message once somebody subscribes."""
        publisher = self._publishers.get(topic)
        if publisher is None:
            publisher = self._publishers[topic] = self.node.publisher(topic, type_name)
            reached = lambda: publisher.subscriber_count() and publisher.has_readers  # noqa: E731
            # A subscription may be in the graph before Zenoh knows the way to it.
            until(reached, f"somebody subscribes to {topic}")
        publisher.publish(self.types.message(type_name)(**fields))  # type: ignore[operator]  # a message type

    def asks(self, leaf: str) -> bool:
        """Whether it has asked a service of this last name."""
        # Another thread may add one.
        clients = list(self._clients.items())
        return any(name.endswith(f"/{leaf}") and client._sequence for name, client in clients)

    def call(self, service: str, type_name: str, timeout: float = PATIENCE, **fields: Any) -> Any:
        """Call a service."""
        client = self._clients.get(service)
        if client is None:
            client = self._clients[service] = self.node.client(service, type_name)
        assert client.wait_for_service(PATIENCE), f"nobody offers {service}"
        return client.call(self.types.service(type_name).request(**fields), timeout)  # type: ignore[operator]


class Arm:
    """A node and what a client does with it.

    Args:
        world: Its router.
        node: Running.
        board: Behind it, if that is in this process.
        peer: The client; a new one if None.
        at: Namespace of the node, with a slash at both ends.
    """

    def __init__(
        self, world: World, node: Program, board: PtyBoard | None = None, peer: Peer | None = None, at: str = "/"
    ) -> None:
        self.world, self.node, self._board, self.at = world, node, board, at
        self.peer = peer or world.peer()

    @property
    def board(self) -> PtyBoard:
        assert self._board is not None
        return self._board

    def trigger(self, name: str) -> str:
        """Call a service that must succeed."""
        answer = self.peer.call(f"{self.at}hardware_interface/{name}", "std_srvs/srv/Trigger")
        assert answer.success, answer.message
        return str(answer.message)

    def refused(self, name: str) -> str:
        """Call a service that must not succeed."""
        answer = self.peer.call(f"{self.at}hardware_interface/{name}", "std_srvs/srv/Trigger")
        assert not answer.success, answer.message
        return str(answer.message)

    def enable(self, on: bool = True) -> None:
        answer = self.peer.call(f"{self.at}hardware_interface/enable", "std_srvs/srv/SetBool", data=on)
        assert answer.success, answer.message

    def position(self) -> dict[str, float]:
        """As it is published."""
        (message,) = self.peer.collect(f"{self.at}joint_states", "sensor_msgs/msg/JointState")
        return dict(zip(message.name, message.position, strict=True))

    def trajectory(
        self, *points: tuple[float, Mapping[str, float]], names: tuple[str, ...] = (), stamp: float = 0.0
    ) -> Any:
        """A JointTrajectory: seconds and angles of each point."""
        message = self.peer.types.message
        rows: Any = [
            message("trajectory_msgs/msg/JointTrajectoryPoint")(  # type: ignore[operator]
                positions=list(angles.values()), time_from_start=self.duration(seconds)
            )
            for seconds, angles in points
        ]
        trajectory = message("trajectory_msgs/msg/JointTrajectory")(  # type: ignore[operator]
            joint_names=list(names or (points[0][1] if points else ())), points=rows
        )
        trajectory.header.stamp.sec, trajectory.header.stamp.nanosec = int(stamp), int(stamp % 1 * 1e9)
        return trajectory

    def duration(self, seconds: float) -> Any:
        type_ = self.peer.types.message("builtin_interfaces/msg/Duration")
        return type_(sec=int(seconds), nanosec=int(seconds % 1 * 1e9))  # type: ignore[operator]

    def send(self, *points: tuple[float, Mapping[str, float]], controller: str = CONTROLLER, **more: Any) -> None:
        """Send a trajectory by topic."""
        trajectory = self.trajectory(*points, **more)
        self.peer.publish(
            f"{self.at}{controller}/joint_trajectory",
            "trajectory_msgs/msg/JointTrajectory",
            header=trajectory.header,
            joint_names=trajectory.joint_names,
            points=trajectory.points,
        )

    def diagnosed(self, part: str, level: int, text: str = "") -> Any:
        """Wait for a row of a level with a text in its message."""

        def row() -> Any:
            (message,) = self.peer.collect("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray")
            found = [each for each in message.status if each.name == f"hardware_interface: {part}"]
            return next((each for each in found if each.level == level and text in each.message), None)

        return until(row, f"{part} is at level {level} for {text!r}", self.node.report)


class Goal:
    """A goal of a client: sent at once."""

    def __init__(
        self, arm: Arm, *points: tuple[float, dict[str, float]], controller: str = CONTROLLER, **more: Any
    ) -> None:
        self._arm, self.id = arm, uuid.uuid4().bytes
        self._at = f"{arm.at}{controller}/follow_joint_trajectory/_action"
        action = arm.peer.types.action(ACTION)
        goal = action.goal(trajectory=arm.trajectory(*points), **more)
        answer = arm.peer.call(f"{self._at}/send_goal", f"{ACTION}_SendGoal", goal_id=self._uuid(), goal=goal)
        self.accepted = bool(answer.accepted)

    def _uuid(self) -> Any:
        return self._arm.peer.types.message("unique_identifier_msgs/msg/UUID")(uuid=self.id)

    def result(self) -> tuple[int, int, str]:
        """Status, error code and text, once it has ended."""
        answer = self._arm.peer.call(f"{self._at}/get_result", f"{ACTION}_GetResult", goal_id=self._uuid())
        return answer.status, answer.result.error_code, answer.result.error_string


@contextlib.contextmanager
def made(folder: Path) -> Iterator[World]:
    world = World(folder)
    try:
        yield world
    finally:
        world.close()
