"""docs/ros2_check.py looks at the running node, through a `ros2` that asks it as the real one would.

The programs of this `ros2` run in this process; `test_ros2_check` has real ones.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.ros2.check_here import load_check
from tests.ros2.stand_in_ros2 import Ros2
from tests.ros2.strict_client.wire import Participant
from tests.ros2.strict_client.world import CONTROLLER, NODE, Arm, running
from tests.waits import until

pytestmark = pytest.mark.system


@pytest.mark.slow
def test_every_check_passes_for_the_running_node(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    program = tmp_path / "ros2"
    program.touch(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:/usr/bin:/bin")
    monkeypatch.setenv("RMW_IMPLEMENTATION", "rmw_zenoh_cpp")
    with running(tmp_path / "node") as (port, node), Participant(port) as me:
        Arm(me, port, node)
        ros2 = Ros2(me)
        check = load_check(monkeypatch, ros2.answer)
        checks = check.Checks(None, NODE, CONTROLLER.strip("/"), 0.0)
        wanted = {checks.name(name) for name in (*check.TOPICS, *check.SERVICES)}
        until(lambda: wanted <= {token.topic for token in ros2.others()}, "all that is asked for is there")
        status = check.main(["--move"])
    said = capsys.readouterr().out
    outcomes = [line[:8].strip() for line in said.splitlines()]
    assert status == 0, said
    assert "FAIL" not in outcomes
    assert outcomes.count("left out") == 3, "a bag, rviz2 and MoveIt need a real ROS 2"
    assert outcomes.count("pass") == 23
