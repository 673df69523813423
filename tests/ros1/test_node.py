"""The node, as its users meet it: a real master, real clients in other processes, an emulated arm."""

from __future__ import annotations

from itertools import pairwise

from tests.ros1.ros_world import JOINTS, Arm, near, still


def test_joint_states_have_the_stamps_of_their_samples(arm: Arm) -> None:
    messages = arm.client.collect(topic="/joint_states", kind="sensor_msgs/JointState", count=200)
    assert all(tuple(message["name"]) == JOINTS for message in messages)
    assert all(len(m["position"]) == len(m["velocity"]) == len(JOINTS) and not m["effort"] for m in messages)
    stamps = [message["header"]["stamp"] for message in messages]
    assert stamps == sorted(set(stamps))
    # Stalls of the machine make gaps, not bursts.
    steps = sorted(later - earlier for earlier, later in pairwise(stamps))
    assert 1 / 140 < steps[len(steps) // 2] < 1 / 60
    assert near(arm.position(), arm.board.positions)


def test_goal_is_reached_with_feedback(arm: Arm) -> None:
    start = arm.position()
    target = {"J1": start["J1"] + 0.2}
    arm.send("one", target, 1.0)
    result = arm.result("one")
    assert (result["state"], result["code"], result["text"]) == ("SUCCEEDED", 0, "")
    assert near(target, arm.board.positions)
    (feedback, *_) = result["feedback"]
    assert tuple(feedback["joint_names"]) == JOINTS
    assert all(len(feedback[part]["positions"]) == len(JOINTS) for part in ("desired", "actual", "error"))


def test_stop_ends_a_goal_and_is_latched(arm: Arm) -> None:
    start = arm.position()
    arm.send("one", {"J1": start["J1"] + 0.6}, 4.0)
    arm.client.wait_active(key="one")
    assert arm.trigger("stop") == "stopped; all joints confirmed it"
    result = arm.result("one")
    assert (result["state"], result["code"]) == ("ABORTED", -1)
    assert "stopped" in result["text"]
    stood = still(lambda: arm.board.positions)
    assert not near({"J1": start["J1"] + 0.6}, stood)
    arm.send("two", {"J1": start["J1"]}, 1.0)
    result = arm.result("two")
    assert result["state"] == "REJECTED"
    assert "reset first" in result["text"]
    arm.trigger("reset")
    arm.send("three", {"J1": start["J1"]}, 2.0)
    assert arm.result("three")["state"] == "SUCCEEDED"
