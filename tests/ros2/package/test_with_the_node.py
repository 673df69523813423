"""The package in use: the node as a launch file starts it, and a controller manager as the description says."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.ros2.node_world import Arm, Goal, PtyBoard, near
from tests.ros2.node_world import made as made_world
from tests.ros2.package.launch_stand_ins import described, stand_ins, text
from tests.ros2.topic_based_system import OverZenoh, TopicBasedSystem
from tests.waits import until

from hexwire.ros2.package import make_package, package_name

pytestmark = pytest.mark.system
ROBOT = "hex7bot"
PATIENT = [word for name in ("lag", "following_time", "max_age") for word in ("-p", f"safety.{name}:=5.0")]
"""The board is in this process, which a busy machine may let wait."""


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("package")
    for path, content in make_package(ROBOT).items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_text(content, encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def arm(package: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Arm]:
    """An arm whose node was started with the words of `ros2_control.launch.py`."""
    with made_world(tmp_path_factory.mktemp("world")) as world:
        board = PtyBoard(world.folder / "board")
        try:
            with stand_ins(package, package_name(ROBOT)):
                found = described(package / "launch/ros2_control.launch.py")
            (process,) = (thing for thing in found if thing.kind == "ExecuteProcess")
            words = [text(word, {"port": board.port}) for word in process["cmd"]]
            assert words[:2] == ["hexwire-ros2", "--ros-args"]
            arm = Arm(world, world.node(*words[2:], *PATIENT), board)
            arm.enable()
            yield arm
            assert arm.node.end() == 0
            arm.peer.close()
        finally:
            board.close()


def named(package: Path, name: str) -> dict[str, float]:
    """A named pose of the SRDF."""
    state = ET.parse(package / f"config/{ROBOT}.srdf").find(f"group_state[@name='{name}']")
    assert state is not None
    return {row.attrib["name"]: float(row.attrib["value"]) for row in state}


@pytest.mark.slow
def test_a_controller_manager_brings_the_arm_to_named_poses(arm: Arm, package: Path) -> None:
    tag = ET.parse(package / f"urdf/{ROBOT}.urdf").find("ros2_control")
    assert tag is not None
    joints = tuple(joint.attrib["name"] for joint in tag.findall("joint"))
    threshold = float(tag.findtext("hardware/param[@name='trigger_joint_command_threshold']", ""))
    peer = arm.world.peer("controller_manager")
    try:
        manager = TopicBasedSystem(OverZenoh(peer), joints, threshold=threshold)
        manager.activate()
        goal = named(package, "ready") | named(package, "open")
        assert set(goal) == set(joints)
        manager.move(goal, 3.0)
        until(lambda: manager.run(0.1) or near(goal, arm.board.positions, 0.03), "it is there", arm.node.report)
    finally:
        peer.close()
    assert "refused" not in arm.node.err


def test_moveits_controllers_are_actions_of_the_node(arm: Arm, package: Path) -> None:
    for controller, name in (("arm_controller", "home"), ("gripper_controller", "closed")):
        goal = Goal(arm, (2.0, named(package, name)), controller=controller)
        assert goal.result()[:2] == (4, 0), arm.node.report()
        assert near(named(package, name), arm.board.positions, 0.06)
