"""The router that comes with the package."""

from __future__ import annotations

import subprocess
import sys

import pytest
from tests.link.far_ends import free_port
from tests.waits import eventually
from zenoh_ros2_tests.tiny_types import Text, TinyTypes

from zenoh_ros2 import Node, NodeOptions, ZenohSettings

pytestmark = pytest.mark.system


def router(*words: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "zenoh_ros2", *words]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def test_nodes_meet_at_the_router_and_it_ends_when_asked() -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"

    def node(name: str) -> Node:
        zenoh = ZenohSettings(connect=(endpoint,))
        return Node(NodeOptions(name, zenoh=zenoh, rosout=False, type_descriptions=False), TinyTypes())

    with router("--listen", endpoint) as process, node("talker") as talker, node("listener") as listener:
        found: list[Text] = []
        listener.subscribe("chatter", "std_msgs/msg/String", lambda message, _: found.append(message))
        publisher = talker.publisher("chatter", "std_msgs/msg/String")
        eventually(lambda: publisher.publish(Text("hello")) or found)  # type: ignore[func-returns-value]
        with router("--listen", endpoint) as second:
            said = second.communicate(timeout=30)[1]
            assert second.returncode == 1
            assert said.startswith(f"there can be no router at {endpoint}: ")
            assert len(said.splitlines()) == 1
        process.terminate()
        said = process.communicate(timeout=30)[0]
        assert said == f"the router is at {endpoint}; Ctrl-C ends it\n"
        assert process.returncode == 0
