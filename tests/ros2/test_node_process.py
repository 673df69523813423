"""The node as others meet it: a process, a router, a client of its own session, an emulated arm.

What it decides is in `test_hardware_interface.py`, in simulated time.
"""

from __future__ import annotations

import math
import sys
import threading
from pathlib import Path
from typing import Any

import pytest
from tests.ros2.node_fixtures import arm, shared_arm, world
from tests.ros2.node_world import CONTROLLER, Arm, near, still
from tests.waits import until

__all__ = ["arm", "shared_arm", "world"]

ROOT = Path(__file__).resolve().parent.parent.parent
pytestmark = pytest.mark.system


def aside(arm: Arm, angle: float = 0.2) -> float:
    """A place for J1 so far away, towards its middle."""
    here = arm.position()["J1"]
    return here - math.copysign(angle, here)


@pytest.mark.slow
def test_the_example_moves_the_arm(arm: Arm) -> None:
    before = arm.position()["J1"]
    program = arm.world.start(sys.executable, str(ROOT / "examples" / "ros2_client.py"))
    assert program.wait() == 0, program.report()
    first, last = (float(line.split()[3]) for line in program.out.splitlines())
    assert (first, last) == (pytest.approx(before, abs=0.02), pytest.approx(before + 0.2, abs=0.03))
    until(lambda: near({"J1": before + 0.2}, arm.board.positions), "it is there", arm.node.report)


def long_trajectories(arm: Arm, count: int, points: int) -> None:
    """All at once; each moves J1 far."""
    target = {"J1": aside(arm, 0.8)}
    message = arm.trajectory(*((1.0 + i / points, target) for i in range(points)))
    topic, kind = f"/{CONTROLLER}/joint_trajectory", "trajectory_msgs/msg/JointTrajectory"
    publisher = arm.peer.node.publisher(topic, kind)
    until(lambda: publisher.subscriber_count() and publisher.has_readers, "somebody subscribes", arm.node.report)
    payload = publisher.type.serialize(message)
    for _ in range(count):
        publisher.publish_serialized(payload)


@pytest.mark.slow
def test_a_stop_does_not_wait_until_long_messages_are_read(arm: Arm) -> None:
    query = f"/{CONTROLLER}/query_state", "control_msgs/srv/QueryTrajectoryState"
    arm.peer.call(*query)
    arm.trigger("stop")
    long_trajectories(arm, 72, 100_000)
    answers: list[Any] = []
    behind = threading.Thread(target=lambda: answers.append(arm.peer.call(*query)))
    behind.start()
    arm.trigger("stop")
    assert not answers, "what comes after the trajectories is not yet answered"
    behind.join()
    assert answers


@pytest.mark.slow
def test_a_stop_voids_long_messages_that_are_read_after_it(arm: Arm) -> None:
    said = len(arm.node.err)
    long_trajectories(arm, 8, 9_000)
    arm.trigger("stop")
    # Before the stop it may have begun.
    stood = arm.board.positions
    arm.trigger("reset")
    # Its turn comes after theirs.
    arm.send((1.0, {"elbow": 0.0}))
    until(lambda: "elbow" in arm.node.err[said:], "all of them are checked", arm.node.report)
    assert near(stood, still(lambda: arm.board.positions), 0.1)
