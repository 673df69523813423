"""A `ros2` that asks the running node as the real one would, and returns what that would print.

It knows the words that docs/ros2_check.py uses. The strict client asks; the forms are those of ros2cli and rclpy.
"""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import yaml
from tests.ros2.check_here import WAIT
from tests.ros2.strict_client import action as a
from tests.ros2.strict_client.action import ActionClient
from tests.ros2.strict_client.parameters import ParameterClient
from tests.ros2.strict_client.wire import DEFAULT, LATCHED, Participant, Token

LABELS = ["", "Boolean", "Integer", "Double", "String", "Byte", "Boolean", "Integer", "Double", "String"]
KINDS = ["not set", "boolean", "integer", "double", "string", "byte array", "boolean array", "integer array"]
STATUS = ["UNKNOWN", "ACCEPTED", "EXECUTING", "CANCELING", "SUCCEEDED", "CANCELED", "ABORTED"]


def ros_type(token: Token) -> str:
    return token.type.replace("::dds_", "").replace("::", "/").removesuffix("_")


def as_yaml(message: Any) -> str:
    """As rosidl_runtime_py's message_to_yaml: fields in their order, items of a sequence below its name."""

    def simple(value: Any) -> Any:
        if isinstance(value, SimpleNamespace):
            return {name: simple(each) for name, each in vars(value).items()}
        return [simple(each) for each in value] if isinstance(value, list | bytes) else value

    return yaml.safe_dump(simple(message), sort_keys=False, width=10**6)


def represented(message: SimpleNamespace) -> str:
    return ", ".join(f"{name}={value!r}" for name, value in vars(message).items())


class Ros2:
    """Its programs.

    Args:
        me: Asks; all of the node is in its graph.
    """

    def __init__(self, me: Participant) -> None:
        self.me = me
        self.options: dict[str, str] = {}

    def answer(self, words: tuple[str, ...]) -> str:
        """What `ros2 WORDS` prints."""
        self.options = {}
        plain_words: list[str] = []
        left = iter(words)
        for word in left:
            if word in VALUED:
                self.options[word] = next(left)
            elif word not in FLAGS:
                plain_words.append(word)
        first, second, *rest = plain_words
        before = len(self.me.ends)
        try:
            return str(getattr(self, f"{first}_{second}")(rest))
        finally:
            self.me.drop_later_than(before)

    def others(self) -> list[Token]:
        """All tokens of others."""
        return [token for token in self.me.graph.tokens() if token.zid != self.me.zid]

    def listed(self, kinds: tuple[str, ...], hidden: bool = False) -> list[str]:
        found = {f"{token.topic} [{ros_type(token)}]" for token in self.others() if token.kind in kinds}
        return sorted(line for line in found if hidden or "/_" not in line)

    def node_list(self, _: list[str]) -> str:
        return "\n".join(token.full_node for token in self.others() if token.kind == "NN")

    def topic_list(self, _: list[str]) -> str:
        return "\n".join(self.listed(("MP", "MS")))

    def service_list(self, _: list[str]) -> str:
        return "\n".join(self.listed(("SS",)))

    def action_list(self, _: list[str]) -> str:
        ends = [line for line in self.listed(("SS",), hidden=True) if "/_action/send_goal" in line]
        return "\n".join(line.replace("/_action/send_goal", "").replace("_SendGoal", "") for line in ends)

    def topic_info(self, words: list[str]) -> str:
        said = []
        for kind, count in (("MP", "Publisher"), ("MS", "Subscription")):
            ends = [token for token in self.others() if token.topic == words[-1] and token.kind == kind]
            said.append(f"{count} count: {len(ends)}\n")
            for token in ends:
                reliability = {"": "RELIABLE", "2": "BEST_EFFORT"}[token.qos.split(":")[0]]
                said.append(
                    f"Node name: {token.node}\nNode namespace: {token.namespace}\nTopic type: {ros_type(token)}\n"
                    f"Topic type hash: {token.hash}\nQoS profile:\n  Reliability: {reliability}\n"
                )
        return "\n".join(said)

    def heard(self, topic: str, qos: str = DEFAULT) -> SimpleNamespace:
        token = next(token for token in self.others() if token.kind == "MP" and token.topic == topic)
        return self.me.subscribe(topic, ros_type(token), qos).take().message

    def topic_echo(self, words: list[str]) -> str:
        if words[-1] == "tf2_msgs/msg/TFMessage":
            # As from robot_state_publisher, which is not here.
            return "transforms:\n- header:\n    frame_id: base_link\n  child_frame_id: turntable\n---"
        latched = self.options.get("--qos-durability") == "transient_local"
        message = self.heard(words[-1], LATCHED if latched else DEFAULT)
        if field := self.options.get("--field"):
            return f"{getattr(message, field)}\n---"
        return as_yaml(message) + "---"

    def topic_hz(self, words: list[str]) -> str:
        token = next(token for token in self.others() if token.kind == "MP" and token.topic == words[-1])
        subscription = self.me.subscribe(words[-1], ros_type(token))
        first, *_, last = [subscription.take().attachment.stamp for _ in range(20)]
        return f"average rate: {19 / (last - first) * 1e9:.3f}\n\tmin: 0.01s{WAIT}"

    def param_list(self, words: list[str]) -> str:
        return "\n".join(f"  {name}" for name in sorted(ParameterClient(self.me, words[0]).list().names))

    def param_get(self, words: list[str]) -> str:
        client = ParameterClient(self.me, words[0])
        (kind,) = client.types([words[1]])
        value = client.get(words[1])
        return f"{LABELS[kind]} value{'s are' if kind > 4 else ' is'}: {value}"

    def param_describe(self, words: list[str]) -> str:
        (found,) = ParameterClient(self.me, words[0]).describe([words[1]])
        said = f"Parameter name: {found.name}\n  Type: {KINDS[found.type]}\n  Description: {found.description}\n"
        said += "  Constraints:\n" + "    Read only: true\n" * found.read_only
        for each in [*found.floating_point_range, *found.integer_range]:
            said += f"    Min value: {each.from_value}\n    Max value: {each.to_value}\n"
        return said

    def param_set(self, words: list[str]) -> str:
        result = ParameterClient(self.me, words[0]).set(words[1], yaml.safe_load(words[2]))
        return "Set parameter successful" if result.successful else f"Setting parameter failed: {result.reason}"

    def lifecycle_get(self, words: list[str]) -> str:
        state = self.me.client(f"{words[0]}/get_state", "lifecycle_msgs/srv/GetState").call().current_state
        return f"{state.label} [{state.id}]"

    def lifecycle_set(self, words: list[str]) -> str:
        change = {"id": {"activate": 3, "deactivate": 4}[words[1]], "label": words[1]}
        client = self.me.client(f"{words[0]}/change_state", "lifecycle_msgs/srv/ChangeState")
        return f"Transitioning {'successful' if client.call(transition=change).success else 'failed'}"

    def service_call(self, words: list[str]) -> str:
        name, kind, fields = words
        answer = self.me.client(name, kind).call(**yaml.safe_load(fields))
        package, _, leaf = kind.split("/")
        return f"requester: making request: ...\n\nresponse:\n{package}.srv.{leaf}_Response({represented(answer)})"

    def action_send_goal(self, words: list[str]) -> str:
        client = ActionClient(self.me, words[0])
        made = client.send(yaml.safe_load(words[2]))
        if not made.accepted:
            return "Goal was rejected."
        end = made.result()
        heard = client.feedback.take_all()[:1]
        feedback = "".join(f"Feedback:\n    {as_yaml(each.message.feedback)}\n" for each in heard)
        assert end.status in (a.SUCCEEDED, a.ABORTED, a.CANCELED)
        result = f"Result:\n    {as_yaml(end.result)}\nGoal finished with status: {STATUS[end.status]}"
        return f"Goal accepted with ID: {made.id.hex()}\n\n{feedback}{result}"

    def interface_show(self, _: list[str]) -> str:
        return "trajectory_msgs/JointTrajectory trajectory\n---\nint32 error_code\n---\nstd_msgs/Header header"

    def pkg_list(self, _: list[str]) -> str:
        return "rclpy\nrobot_state_publisher"

    def run_robot_state_publisher(self, words: list[str]) -> str:
        file = next(word for word in words if word.endswith("robot.yaml"))
        read = yaml.safe_load(Path(file).read_text(encoding="utf-8"))
        assert read["/**"]["ros__parameters"]["robot_description"].startswith("<")
        return WAIT


FLAGS = {"--no-daemon", "--feedback", "-v", "-t", "--once", "--full-length"}
VALUED = {"--spin-time", "--qos-durability", "--qos-reliability", "--field"}
