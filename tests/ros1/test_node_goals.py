"""The action follow_joint_trajectory of the node, with actionlib's client in another process."""

from __future__ import annotations

import math
import os
from typing import Any

import pytest
from tests.ros1.ros_world import JOINTS, Arm, near, still


def _elsewhere(arm: Arm, angle: float = 0.2) -> dict[str, float]:
    """A place for J1 so far away, towards its middle."""
    here = arm.position()["J1"]
    return {"J1": here - math.copysign(angle, here)}


def test_goal_is_reached_with_feedback(arm: Arm) -> None:
    target = _elsewhere(arm)
    arm.send("one", target, 1.0)
    result = arm.result("one")
    # The text may say how far off a joint came to rest.
    assert (result["state"], result["code"]) == ("SUCCEEDED", 0)
    assert near(target, arm.board.positions)
    assert len(result["feedback"]) > 1
    feedback = result["feedback"][-1]
    assert tuple(feedback["joint_names"]) == JOINTS
    for i in range(len(JOINTS)):
        for what in ("positions", "velocities"):
            desired, actual, error = (feedback[part][what][i] for part in ("desired", "actual", "error"))
            assert error == pytest.approx(desired - actual), what


def test_cancelled_goal_is_preempted_and_the_arm_holds(arm: Arm) -> None:
    target = _elsewhere(arm, 0.6)
    arm.send("one", target, 5.0)
    arm.client.wait_active(key="one", feedback=4)
    arm.client.cancel(key="one")
    assert arm.result("one")["state"] == "PREEMPTED"
    stood = still(lambda: arm.board.positions)
    assert not near(target, stood)
    # It is no stop: what comes next needs no reset.
    arm.moves("two", {"J1": stood["J1"] + 0.05}, 1.0)


# Of each code, and of each part of the message; what else is wrong is tested in `control`.
REFUSED: dict[str, tuple[dict[str, Any], int, str]] = {
    "unknown joint": ({"names": ["J1", "elbow"], "points": [{"t": 1.0, "positions": [0.0, 0.0]}]}, -2, "elbow"),
    "no joints": ({"names": [], "points": [{"t": 1.0, "positions": []}]}, -2, "joint"),
    "not a number": ({"points": [{"t": 1.0, "positions": [math.nan]}]}, -1, "nan"),
    "infinite speed": ({"points": [{"t": 1.0, "positions": [0.0], "velocities": [math.inf]}]}, -1, "inf"),
    "short array": ({"names": ["J1", "J2"], "points": [{"t": 1.0, "positions": [0.0]}]}, -1, "1"),
    "times fall": ({"points": [{"t": 2.0, "positions": [0.0]}, {"t": 1.0, "positions": [0.1]}]}, -1, "point"),
    "past stamp": ({"delay": -100.0}, -3, "ago"),
    "unknown tolerance": ({"path": {"elbow": 0.1}}, -2, "elbow"),
    "tolerance not a number": ({"goal": {"J1": math.nan}}, -1, "J1"),
}


def test_wrong_goal_is_rejected_and_moves_nothing(arm: Arm) -> None:
    before = arm.board.positions
    for case, (more, code, word) in REFUSED.items():
        arm.send(case, {"J1": 0.0}, 1.0, **more)
        result = arm.result(case)
        assert (result["state"], result["code"]) == ("REJECTED", code), f"{case}: {result['text']}"
        assert word in result["text"].lower() or word in result["text"], case
        assert near(before, arm.board.positions, 0.002), case


@pytest.mark.slow
def test_rejected_goals_never_hang_a_client(arm: Arm) -> None:
    # actionlib's client drops what is answered before it has noted its own goal.
    times = int(os.environ.get("TEST_GOALS", "20"))
    assert arm.client.send_wrong(action=f"{arm.namespace}follow_joint_trajectory", times=times) == {
        "REJECTED": times
    }


def test_stop_aborts_a_goal_and_refuses_others_until_reset(arm: Arm) -> None:
    target = _elsewhere(arm, 0.6)
    arm.send("one", target, 5.0)
    arm.client.wait_active(key="one", feedback=4)
    said = arm.trigger("stop")
    assert said.startswith("stopped, ")
    assert said.endswith("; all joints confirmed it; at rest")
    result = arm.result("one")
    assert (result["state"], result["code"]) == ("ABORTED", -1)
    assert "stopped" in result["text"]
    stood = still(lambda: arm.board.positions)
    assert not near(target, stood)
    arm.send("two", target, 5.0)
    result = arm.result("two")
    assert result["state"] == "REJECTED"
    assert "reset first" in result["text"]
    assert near(stood, arm.board.positions, 0.002)
    arm.trigger("reset")
    arm.moves("three", {"J1": stood["J1"] + 0.05}, 1.0)
