"""Other programs that end while a node goes on: the client of a goal, and `hexwire fleet router`."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import pytest
from tests.control.arm_bench import Bench
from tests.link.far_ends import free_port
from tests.motion.arms import HOME
from tests.system.programs import hexwire_program
from tests.waits import eventually
from zenoh_ros2_tests import action_client
from zenoh_ros2_tests.action_client import ACTION, TYPES, ActionClient, uuid
from zenoh_ros2_tests.router import Router
from zenoh_ros2_tests.tiny_types import Text, TinyTypes

from hexwire.ros2.actions import FOLLOW_JOINT_TRAJECTORY, ActionGoals
from zenoh_ros2.action_server import ActionServer
from zenoh_ros2.goals import GoalStatus
from zenoh_ros2.node import Node, NodeOptions
from zenoh_ros2.zenoh_session import ZenohSettings

pytestmark = pytest.mark.system

J1 = HOME["J1"]

DYING = """
import os, sys, threading
from zenoh_ros2.node import Node, NodeOptions
from zenoh_ros2.zenoh_session import ZenohSettings
from zenoh_ros2_tests import action_client
from zenoh_ros2_tests.action_client import TYPES, ActionClient, goal, uuid

node = Node(NodeOptions("dying", zenoh=ZenohSettings(connect=(sys.argv[1],))), TYPES)
node.open()
client = ActionClient(node)
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
    make_node: Callable[..., Node], router: Router, bench: tuple[Bench, ActionGoals]
) -> None:
    arm, goals = bench
    node = make_node("arm", types=TYPES)
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
        cwd=Path(action_client.__file__).parents[1],
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
    assert ActionClient(make_node("other", types=TYPES)).result(uuid(1)) == (GoalStatus.SUCCEEDED, "")


@pytest.mark.slow
def test_the_router_of_the_fleet_is_one_for_ros() -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    zenoh = ZenohSettings(connect=(endpoint,))

    def node(name: str) -> Node:
        return Node(NodeOptions(name, zenoh=zenoh, rosout=False, type_descriptions=False), TinyTypes())

    with node("talker") as talker, node("listener") as listener:
        found: list[Text] = []
        listener.subscribe("chatter", "std_msgs/msg/String", lambda message, stamp: found.append(message))
        publisher = talker.publisher("chatter", "std_msgs/msg/String")
        for number in range(2):
            text = Text(f"{number}")
            with hexwire_program("fleet", "router", "--listen", endpoint) as router:
                eventually(lambda: talker.routers == listener.routers == 1)
                eventually(lambda text=text: publisher.publish(text) or text in found)  # type: ignore[misc]
                router.send_signal(signal.SIGKILL if number == 0 else signal.SIGTERM)
                router.wait(30)
