"""docs/ros2_check.py looks at the running node, through a `ros2` that asks it as the real one would."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from tests.ros2.strict_client.wire import Participant
from tests.ros2.strict_client.world import Arm, running

ROOT = Path(__file__).resolve().parents[2]
STAND_IN = Path(__file__).with_name("stand_in_ros2.py")


def test_every_check_passes_for_the_running_node(tmp_path: Path) -> None:
    program = tmp_path / "ros2"
    with running(tmp_path / "node") as (port, node), Participant(port) as me:
        Arm(me, port, node)
        program.write_text(f'#!/bin/sh\nPYTHONPATH={ROOT} exec {sys.executable} {STAND_IN} {port} "$@"\n')
        program.chmod(0o755)
        env = {"PATH": f"{tmp_path}:/usr/bin:/bin", "RMW_IMPLEMENTATION": "rmw_zenoh_cpp", "HOME": str(tmp_path)}
        done = subprocess.run(
            [sys.executable, ROOT / "docs" / "ros2_check.py", "--move", "--seconds", "1"],
            env={**os.environ, **env},
            capture_output=True,
            text=True,
            timeout=115,
            check=False,
        )
    outcomes = [line[:8].strip() for line in done.stdout.splitlines()]
    assert done.returncode == 0, done.stdout + done.stderr
    assert "FAIL" not in outcomes
    assert outcomes.count("left out") == 3, "a bag, rviz2 and MoveIt need a real ROS 2"
    assert outcomes.count("pass") == 22
