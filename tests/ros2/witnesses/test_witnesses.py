"""Programs that others wrote for ROS 2 on Zenoh meet the node.

zenoh-ros2-sdk, asyncio-for-robotics and ros2-pyterfaces each run once, in the environment `build/witnesses`, which
`make test` makes; the tests look at what they saw.
"""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from tests.ros2.strict_client.definitions import HASHES, dds_name
from tests.ros2.strict_client.wire import Participant
from tests.ros2.strict_client.world import NODE, Arm, running

pytestmark = [pytest.mark.slow, pytest.mark.system]
HERE = Path(__file__).parent
PYTHON = HERE.parents[2] / "build" / "witnesses" / "bin" / "python"


def run(program: str, folder: Path, *arguments: str) -> Any:
    env = {name: text for name, text in os.environ.items() if not name.startswith(("ROS_", "ZENOH_", "PYTHON"))}
    env |= {"ZENOH_SESSION_CONFIG_URI": str(folder / "session.json5"), "ROS_DISTRO": "jazzy", "HOME": str(folder)}
    done = subprocess.run(
        [PYTHON, HERE / program, *arguments], capture_output=True, text=True, env=env, timeout=110, check=False
    )
    assert done.returncode == 0, done.stderr[-4000:]
    return json.loads(done.stdout)


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Arm, Path]]:
    folder = tmp_path_factory.mktemp("witnesses")
    with running(folder, "enable_on_start:=true") as (port, node), Participant(port) as me:
        yield Arm(me, port, node), folder


@pytest.fixture(scope="module")
def sdk(arm: tuple[Arm, Path]) -> dict[str, Any]:
    arm[0].rest()
    return run("zenoh_sdk.py", arm[1], str(arm[0].port), NODE, str(arm[1]))


@pytest.fixture(scope="module")
def afor(arm: tuple[Arm, Path]) -> dict[str, Any]:
    return run("afor_pyterfaces.py", arm[1], NODE)


# --- zenoh-ros2-sdk ---


def test_the_sdk_lists_the_topics_with_their_types(sdk: dict[str, Any]) -> None:
    assert sdk["topics"]["/joint_states"] == ["sensor_msgs/msg/JointState"]
    assert sdk["topics"]["/joint_trajectory_controller/joint_trajectory"] == ["trajectory_msgs/msg/JointTrajectory"]
    assert sdk["topics"]["/robot_description"] == ["std_msgs/msg/String"]
    assert sdk["topics"]["/rosout"] == ["rcl_interfaces/msg/Log"]


def test_the_sdk_lists_the_services_with_their_types(sdk: dict[str, Any]) -> None:
    assert sdk["services"][f"{NODE}/reset"] == ["std_srvs/srv/Trigger"]
    assert sdk["services"][f"{NODE}/list_parameters"] == ["rcl_interfaces/srv/ListParameters"]


def test_the_sdk_knows_who_publishes(sdk: dict[str, Any]) -> None:
    assert [name.rpartition("/")[2] for name in sdk["publishers"]] == ["hardware_interface"]


def test_the_sdk_hears_joint_states(sdk: dict[str, Any], arm: tuple[Arm, Path]) -> None:
    assert sdk["joints"] == arm[0].names
    assert len(sdk["positions"]) == len(sdk["joints"])
    assert sdk["stamps"] == sorted(set(sdk["stamps"]))


def test_the_sdk_joins_late_and_gets_the_description(sdk: dict[str, Any]) -> None:
    assert "<robot" in sdk["description"]
    assert sdk["description"].rstrip().endswith("</robot>")


def test_the_sdk_drives_the_life_cycle(sdk: dict[str, Any]) -> None:
    assert sdk["lifecycle"] == ["active", True, "inactive", True, "active"]


def test_the_sdk_makes_the_time_of_a_node(tmp_path: Path) -> None:
    with running(tmp_path, "use_sim_time:=true") as (port, _):
        seen = run("sdk_clock.py", tmp_path, str(port))
    stamps = [stamp for stamp, _ in seen]
    assert len(stamps) == 50
    assert stamps == sorted(stamps)
    # As old as what was simulated when it was sampled; the real time is a billion seconds further.
    assert all(1000.0 < stamp <= simulated + 0.02 for stamp, simulated in seen)
    assert stamps[-1] > stamps[0]


def test_a_bag_of_the_topics_is_read_by_rosbags(sdk: dict[str, Any], arm: tuple[Arm, Path]) -> None:
    states, diagnostics = (sdk["bag"][topic] for topic in ("/joint_states", "/diagnostics"))
    assert states["read"] == states["heard"] >= 3
    assert states["names"] == arm[0].names
    assert diagnostics["read"] == diagnostics["heard"] >= 3
    assert diagnostics["status"][0].startswith("hardware_interface: ")


def test_the_sdk_calls_a_service(sdk: dict[str, Any]) -> None:
    assert sdk["trigger_hash"] == HASHES["std_srvs/srv/Trigger"]
    assert sdk["reset"] is not None
    assert sdk["reset"][0] is True


def test_a_trajectory_of_the_sdk_moves_the_arm(sdk: dict[str, Any]) -> None:
    assert sdk["reached"] is True


# --- asyncio-for-robotics and ros2-pyterfaces ---


def test_pyterfaces_computes_the_hash_of_every_token_that_it_knows(afor: dict[str, Any]) -> None:
    assert {name: told for name, (told, _) in afor["hashes"].items()} == {
        name: theirs for name, (_, theirs) in afor["hashes"].items()
    }
    assert len(afor["hashes"]) >= 14


def test_pyterfaces_agrees_with_the_literals_of_the_strict_client(afor: dict[str, Any]) -> None:
    ours = {dds_name(name): text for name, text in HASHES.items()}
    shared = ours.keys() & afor["hashes"].keys()
    assert len(shared) >= 14
    assert {name: ours[name] for name in shared} == {name: afor["hashes"][name][1] for name in shared}


@pytest.mark.parametrize("topic", ["/joint_states", "/diagnostics"])
def test_messages_are_read_and_written_again_unchanged(afor: dict[str, Any], topic: str) -> None:
    assert afor["understood"][topic]
    assert all(afor["understood"][topic])


def test_afor_hears_every_joint(afor: dict[str, Any], arm: tuple[Arm, Path]) -> None:
    assert afor["joints"] == arm[0].names


def test_requests_of_pyterfaces_are_answered(afor: dict[str, Any]) -> None:
    assert afor["reset"][0] is True
    assert {"port", "publish_rate"} <= set(afor["parameters"])
    assert afor["values"] == ["sim://hex7bot", 100.0]
    assert afor["state"] in ([2, "inactive"], [3, "active"])
