"""The node as others meet it: a process, a router, a client of its own session, an emulated arm.

What it decides is in `test_hardware_interface.py`, in simulated time.
"""

from __future__ import annotations

import math
import sys
import threading
import time
from pathlib import Path
from typing import Any

import pytest
from tests.ros2.node_fixtures import arm, shared_arm, world
from tests.ros2.node_world import ACTION, CONTROLLER, JOINTS, SUCCEEDED, Arm, Goal, near, still, until

from zenoh_ros2.keys import data_key
from zenoh_ros2.qos import ACTION_STATUS, DEFAULT, LATCHED
from zenoh_ros2.zenoh_session import ZenohSettings

__all__ = ["arm", "shared_arm", "world"]

ROOT = Path(__file__).resolve().parent.parent.parent
pytestmark = pytest.mark.system
STATE, STRING = "sensor_msgs/msg/JointState", "std_msgs/msg/String"
AT = f"/{CONTROLLER}/follow_joint_trajectory/_action"


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


def test_a_goal_is_reached_with_feedback_and_states_on_the_way(arm: Arm) -> None:
    arm.peer.listen(f"{AT}/feedback", f"{ACTION}_FeedbackMessage")
    arm.peer.listen(f"{AT}/status", "action_msgs/msg/GoalStatusArray", ACTION_STATUS)
    target = {"J1": aside(arm, 0.3)}
    goal = Goal(arm, (1.5, target))
    assert goal.accepted
    # The text may say how far off a joint came to rest.
    assert goal.result()[:2] == (SUCCEEDED, 0)
    until(lambda: near(target, arm.board.positions), "it is there", arm.node.report)
    feedback = [m for m in arm.peer.received[f"{AT}/feedback"] if bytes(m.goal_id.uuid) == goal.id]
    assert len(feedback) >= 5
    assert all(math.isfinite(m.feedback.error.positions[0]) for m in feedback)

    def states() -> list[int]:
        found = []
        for message in arm.peer.received[f"{AT}/status"]:
            for row in message.status_list:
                if bytes(row.goal_info.goal_id.uuid) == goal.id and row.status not in found[-1:]:
                    found.append(row.status)
        return found

    until(lambda: states()[-1:] == [SUCCEEDED], "its end is published", arm.node.report)
    assert states() == [2, SUCCEEDED]


def test_joint_states_are_of_now_and_of_this_arm(arm: Arm) -> None:
    messages = arm.peer.collect("/joint_states", STATE, 20)
    stamps = [message.header.stamp.sec + message.header.stamp.nanosec * 1e-9 for message in messages]
    assert stamps == sorted(set(stamps))
    assert abs(stamps[-1] - time.time()) < 600.0
    assert tuple(messages[-1].name) == JOINTS
    assert near(arm.position(), arm.board.positions)
    (message,) = arm.peer.collect("/robot_description", STRING, qos=LATCHED)
    assert message.data.startswith("<?xml"), "whoever comes late gets it, too"


def test_a_program_without_a_token_gets_what_is_published(arm: Arm) -> None:
    session = ZenohSettings(connect=(arm.world.endpoint,)).open()
    try:
        for topic, kind in (
            ("joint_states", STATE),
            (f"{CONTROLLER}/controller_state", "control_msgs/msg/JointTrajectoryControllerState"),
            ("tf", "tf2_msgs/msg/TFMessage"),
        ):
            message, received = arm.peer.types.message(kind), list[bytes]()
            key = data_key(0, topic, message.dds_name, message.hash)
            session.subscribe(key, DEFAULT, lambda payload, _, into=received: into.append(payload))  # type: ignore[misc]  # bound at once
            until(lambda into=received: bool(into), f"a message of {topic}", arm.node.report)  # type: ignore[misc]  # likewise
            message.parse(received[0])
    finally:
        session.close()


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
