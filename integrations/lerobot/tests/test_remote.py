"""An arm that another program shares."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator

import pytest
from lerobot_robot_hexwire import (
    HexwireRemote,
    HexwireRemoteConfig,
    HexwireRemoteLeader,
    HexwireRemoteLeaderConfig,
)

from hexwire.drivers.registry import connect

ADDRESS = "zenoh:lab/arm1"


@pytest.fixture
def shared() -> Iterator[str]:
    command = [sys.executable, "-m", "hexwire.cli", "serve", "--port", "sim://so101", "--robot", "so101"]
    with subprocess.Popen(
        [*command, "--name", "lab/arm1", "--no-table", "--lease", "5"], stdout=subprocess.PIPE, text=True
    ) as server:
        try:
            assert server.stdout is not None
            assert server.stdout.readline()
            yield ADDRESS
        finally:
            server.terminate()
            server.communicate(timeout=30.0)


def _send_for(seconds: float, robot: HexwireRemote, goal: dict[str, float]) -> None:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        robot.send_action(goal)
        time.sleep(0.03)


def test_a_shared_arm_moves_and_a_stop_of_another_program_is_respected(shared: str) -> None:
    robot = HexwireRemote(HexwireRemoteConfig(port=shared))
    assert robot.name == "so_follower"
    robot.connect()
    here = robot.get_observation()
    goal = {**here, "shoulder_pan.pos": here["shoulder_pan.pos"] + 10.0}
    for _ in range(60):
        robot.send_action(goal)
        time.sleep(0.03)
    assert robot.get_observation()["shoulder_pan.pos"] == pytest.approx(goal["shoulder_pan.pos"], abs=2.0)
    with connect(shared) as other:
        other.stop()
        # Nobody waits for the answers to set-points that follow each other closely: a later one raises the error.
        with pytest.raises(RuntimeError, match="stopped"):
            _send_for(30.0, robot, goal)
        assert len(robot.get_observation()) == 6
    # Its own program holds the lease, and so ends the stop.
    robot._arm.driver.resume()
    robot.send_action(goal)
    robot.disconnect()
    leader = HexwireRemoteLeader(HexwireRemoteLeaderConfig(port=shared))
    leader.connect()
    assert leader.get_action()["shoulder_pan.pos"] == pytest.approx(goal["shoulder_pan.pos"], abs=3.0)
    leader.disconnect()


def test_an_address_that_leads_to_another_kind_of_arm(shared: str) -> None:
    robot = HexwireRemote(HexwireRemoteConfig(port=shared, arm="hex7bot"))
    with pytest.raises(ValueError, match="is a so101, not a hex7bot"):
        robot.connect()
    with pytest.raises(ValueError, match="no arm 'so102'"):
        HexwireRemote(HexwireRemoteConfig(port=shared, arm="so102"))


@pytest.mark.parametrize("port", ["/dev/ttyACM0", "sim://so101", "COM3"])
def test_a_device_is_no_shared_arm(port: str) -> None:
    for make in (
        lambda: HexwireRemote(HexwireRemoteConfig(port=port)),
        lambda: HexwireRemoteLeader(HexwireRemoteLeaderConfig(port=port)),
    ):
        with pytest.raises(ValueError, match="needs the address of a shared arm, as in zenoh:lab/arm1, not"):
            make()
