"""Programs that others wrote for ROS 2 on Zenoh meet the node.

zenoh-ros2-sdk, asyncio-for-robotics and ros2-pyterfaces run in the environment `build/witnesses`, which `make test`
makes. Each takes seconds to start, so one test looks at all that one has seen.
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


def test_the_sdk_sees_reads_asks_and_moves_the_node(arm: tuple[Arm, Path]) -> None:
    node, folder = arm
    node.rest()
    sdk = run("zenoh_sdk.py", folder, str(node.port), NODE, str(folder))
    topics, services = sdk["topics"], sdk["services"]
    assert topics["/joint_states"] == ["sensor_msgs/msg/JointState"]
    assert topics["/joint_trajectory_controller/joint_trajectory"] == ["trajectory_msgs/msg/JointTrajectory"]
    assert topics["/robot_description"] == ["std_msgs/msg/String"]
    assert topics["/rosout"] == ["rcl_interfaces/msg/Log"]
    assert services[f"{NODE}/reset"] == ["std_srvs/srv/Trigger"]
    assert services[f"{NODE}/list_parameters"] == ["rcl_interfaces/srv/ListParameters"]
    assert [name.rpartition("/")[2] for name in sdk["publishers"]] == ["hardware_interface"]
    assert sdk["joints"] == node.names
    assert len(sdk["positions"]) == len(sdk["joints"])
    assert sdk["stamps"] == sorted(set(sdk["stamps"]))
    assert "<robot" in sdk["description"], "it joins late"
    assert sdk["description"].rstrip().endswith("</robot>")
    assert sdk["lifecycle"] == ["active", True, "inactive", True, "active"]
    assert sdk["trigger_hash"] == HASHES["std_srvs/srv/Trigger"]
    assert sdk["reset"] is not None
    assert sdk["reset"][0] is True
    assert sdk["reached"] is True, "the target of a trajectory"
    # rosbags reads the bag that it has made.
    states, diagnostics = (sdk["bag"][topic] for topic in ("/joint_states", "/diagnostics"))
    assert states["read"] == states["heard"] >= 3
    assert states["names"] == node.names
    assert diagnostics["read"] == diagnostics["heard"] >= 3
    assert diagnostics["status"][0].startswith("hardware_interface: ")


def test_the_sdk_makes_the_time_of_a_node(tmp_path: Path) -> None:
    with running(tmp_path, "use_sim_time:=true") as (port, _):
        seen = run("sdk_clock.py", tmp_path, str(port))
    stamps = [stamp for stamp, _ in seen]
    assert len(stamps) == 50
    assert stamps == sorted(stamps)
    # As old as what was simulated when it was sampled; the real time is a billion seconds further.
    assert all(1000.0 < stamp <= simulated + 0.02 for stamp, simulated in seen)
    assert stamps[-1] > stamps[0]


def test_asyncio_for_robotics_and_pyterfaces_read_the_node_and_ask_it(arm: tuple[Arm, Path]) -> None:
    node, folder = arm
    afor = run("afor_pyterfaces.py", folder, NODE)
    hashes = afor["hashes"]
    assert {name: told for name, (told, _) in hashes.items()} == {name: own for name, (_, own) in hashes.items()}
    assert len(hashes) >= 14
    literals = {dds_name(name): text for name, text in HASHES.items()}
    shared = literals.keys() & hashes.keys()
    assert len(shared) >= 14
    assert {name: literals[name] for name in shared} == {name: hashes[name][1] for name in shared}
    for topic in ("/joint_states", "/diagnostics"):
        assert afor["understood"][topic], topic
        assert all(afor["understood"][topic]), f"{topic} is read and written again unchanged"
    assert afor["joints"] == node.names
    assert afor["reset"][0] is True
    assert {"port", "publish_rate"} <= set(afor["parameters"])
    assert afor["values"] == ["sim://hex7bot", 100.0]
    assert afor["state"] in ([2, "inactive"], [3, "active"])
