"""The ROS node with the firmware on a simulated chip: a goal from ROS ends at the servos behind it."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.avr.machines import ChipBoard
from tests.avr.pty import PtyBoard, on_pty
from tests.ros1.ros_world import Arm, made, near

pytestmark = [pytest.mark.slow, pytest.mark.system]


def test_a_goal_from_ros_moves_the_firmwares_servos(tmp_path: Path) -> None:
    with on_pty(PtyBoard(ChipBoard())) as board, made(tmp_path) as world:
        # What a busy machine keeps from the chip is no fault of the arm's.
        patient = [f"_safety/{name}:=5.0" for name in ("lag", "following_time", "max_age")]
        node = world.node(f"_port:={board.path}", "_watchdog:=10.0", *patient)
        # A second of the chip may take many of the client's.
        arm = Arm(world, node, patience=300.0)
        arm.enable()
        here = arm.position()
        # Less than what counts as off its way: on a loaded machine the chip runs slower than the clock.
        there = {**here, "J1": here["J1"] + 0.15, "J5": here["J5"] - 0.1}
        arm.moves("there", there, 1.0)
        assert near(there, arm.position())
        arm.send("back", here, 5.0)
        arm.client.wait_active(key="back")
        assert "all joints confirmed" in arm.trigger("stop")
        assert arm.result("back")["state"] == "ABORTED"
        assert "reset" in arm.trigger("reset")
        assert node.end() == 0
