"""What `joint_state_topic_hardware_interface`, once `topic_based_ros2_control`, does on a machine with ROS.

Written from what the plug-in sends and when, not from its code: `read` takes the newest joint states; `write` sends
all commands whenever they differ from the states by more than a threshold in sum, and nothing otherwise.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from typing import Any, Protocol

from tests.ros2.front_bench import Front
from tests.ros2.node_world import Peer
from tests.waits import until

from zenoh_ros2.qos import SENSOR_DATA, Qos

STATE = "sensor_msgs/msg/JointState"
PERIOD = 0.01
STATES, COMMANDS = "/robot_joint_states", "/robot_joint_commands"


class Topics(Protocol):
    """What the plug-in is connected to."""

    def read(self) -> Any:
        """The newest joint states."""

    def write(self, **fields: Any) -> None:
        """Send joint commands."""

    def wait(self, seconds: float) -> None:
        """Until the next cycle."""


class OverZenoh:
    """A node elsewhere, in real time."""

    def __init__(self, peer: Peer) -> None:
        self._peer, self.wait = peer, time.sleep
        peer.listen(STATES, STATE, SENSOR_DATA)
        self._publisher = peer.node.publisher(COMMANDS, STATE, Qos(depth=1))
        until(lambda: bool(peer.received[STATES] and self._publisher.subscriber_count()), "the node is there")

    def read(self) -> Any:
        return self._peer.received[STATES][-1]

    def write(self, **fields: Any) -> None:
        self._publisher.publish(self._peer.types.message(STATE)(**fields))


class InProcess:
    """A node in this process, in simulated time."""

    def __init__(self, front: Front) -> None:
        self._front, self.wait = front, front.turn

    def read(self) -> Any:
        return self._front.topic(STATES).sent[-1]

    def write(self, **fields: Any) -> None:
        self._front.send(COMMANDS, **fields)


class TopicBasedSystem:
    """The plug-in in a controller manager of 100 Hz.

    Args:
        topics: What it is connected to.
        joints: Of its ros2_control tag.
        unclaimed: Command of a joint that no controller has claimed: NaN, or 0 in the plug-in's first versions.
        threshold: `trigger_joint_command_threshold`.
    """

    def __init__(
        self,
        topics: Topics,
        joints: tuple[str, ...],
        *,
        unclaimed: float = math.nan,
        threshold: float = 1e-5,
    ) -> None:
        self._topics, self._joints, self._threshold = topics, joints, threshold
        self.commands = dict.fromkeys(joints, unclaimed)
        self.states = dict.fromkeys(joints, math.nan)
        self.written = 0
        self.read()

    def read(self) -> None:
        message = self._topics.read()
        self.states.update(zip(message.name, message.position, strict=True))

    def write(self) -> None:
        off = sum(abs(self.states[joint] - self.commands[joint]) for joint in self._joints)
        # NaN is not below any threshold: such commands are sent.
        if off <= self._threshold:
            return
        self.written += 1
        self._topics.write(name=self._joints, position=[self.commands[joint] for joint in self._joints])

    def run(self, seconds: float) -> None:
        """Run the manager's loop with the present commands."""
        for _ in range(max(1, round(seconds / PERIOD))):
            self.read()
            self.write()
            self._topics.wait(PERIOD)

    def activate(self) -> None:
        """A controller begins: it commands the present position."""
        self.read()
        self.commands.update(self.states)

    def move(self, target: Mapping[str, float], seconds: float) -> None:
        """A trajectory controller moves joints on straight lines."""
        start, steps = dict(self.commands), round(seconds / PERIOD)
        for i in range(1, steps + 1):
            for joint, angle in target.items():
                self.commands[joint] = start[joint] + (angle - start[joint]) * i / steps
            self.read()
            self.write()
            self._topics.wait(PERIOD)
