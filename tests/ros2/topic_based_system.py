"""What `joint_state_topic_hardware_interface`, once `topic_based_ros2_control`, does on a machine with ROS.

Written from what the plug-in sends and when, not from its code: `read` takes the newest joint states; `write` sends
all commands whenever they differ from the states by more than a threshold in sum, and nothing otherwise.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping

from tests.ros2.node_world import Peer

from hexwire.ros2.qos import SENSOR_DATA, Qos

STATE = "sensor_msgs/msg/JointState"
PERIOD = 0.01


class TopicBasedSystem:
    """The plug-in in a controller manager of 100 Hz.

    Args:
        peer: Its node.
        joints: Of its ros2_control tag.
        unclaimed: Command of a joint that no controller has claimed: NaN, or 0 in the plug-in's first versions.
        threshold: `trigger_joint_command_threshold`.
        at: Namespace of its topics, with a slash at both ends.
    """

    def __init__(
        self,
        peer: Peer,
        joints: tuple[str, ...],
        *,
        unclaimed: float = math.nan,
        threshold: float = 1e-5,
        at: str = "/",
    ) -> None:
        self._peer, self._joints, self._threshold = peer, joints, threshold
        self._topic = f"{at}robot_joint_states"
        self.commands = dict.fromkeys(joints, unclaimed)
        self.states = dict.fromkeys(joints, math.nan)
        self.written = 0
        peer.listen(self._topic, STATE, SENSOR_DATA)
        self._publisher = peer.node.publisher(f"{at}robot_joint_commands", STATE, Qos(depth=1))
        deadline = time.monotonic() + 30.0
        while not (peer.received[self._topic] and self._publisher.subscriber_count()):
            assert time.monotonic() < deadline, "the node is not there"
            time.sleep(0.02)
        self.read()

    def read(self) -> None:
        message = self._peer.received[self._topic][-1]
        self.states.update(zip(message.name, message.position, strict=True))

    def write(self) -> None:
        off = sum(abs(self.states[joint] - self.commands[joint]) for joint in self._joints)
        # NaN is not below any threshold: such commands are sent.
        if off <= self._threshold:
            return
        self.written += 1
        make = self._peer.types.message(STATE)
        self._publisher.publish(make(name=self._joints, position=[self.commands[joint] for joint in self._joints]))

    def run(self, seconds: float) -> None:
        """Run the manager's loop with the present commands."""
        for _ in range(max(1, round(seconds / PERIOD))):
            self.read()
            self.write()
            time.sleep(PERIOD)

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
            time.sleep(PERIOD)
