"""The parameter files, as a reader of YAML sees them, and as hexwire's own node checks its part."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping
from typing import Any

import pytest
import yaml

from hexwire.model.arms import arms_with_geometry
from hexwire.ros2.package.arms import PackageArm, make_arm
from hexwire.ros2.package.configuration import configuration_files, controller_of
from hexwire.ros2.package.description import make_urdf_text
from hexwire.ros2.package.releases import RELEASES, release
from hexwire.ros2.settings import load_settings

JTC = "joint_trajectory_controller/JointTrajectoryController"


@pytest.fixture(params=arms_with_geometry())
def arm(request: pytest.FixtureRequest) -> PackageArm:
    return make_arm(request.param)


def read(arm: PackageArm, name: str, distribution: str = "jazzy") -> dict[str, Any]:
    table: dict[str, Any] = yaml.safe_load(configuration_files(arm, release(distribution), "pack")[name])
    return table


def flat(table: Mapping[str, Any], above: str = "") -> dict[str, Any]:
    """ROS's names of parameters."""
    found: dict[str, Any] = {}
    for name, value in table.items():
        found |= flat(value, f"{above}{name}.") if isinstance(value, dict) else {f"{above}{name}": value}
    return found


@pytest.mark.parametrize("name", RELEASES)
def test_node_takes_its_parameters(arm: PackageArm, name: str) -> None:
    file = read(arm, "config/hardware_interface.yaml", name)
    assert set(file) == {"/**"}
    given = flat(file["/**"]["ros__parameters"])
    settings, _ = load_settings({**given, "port": "/dev/ttyUSB0"}, {})
    assert settings.warnings == ()
    assert settings.arm.model.name == arm.name
    assert settings.distribution.value == name
    assert {c.name: c.joints for c in settings.arm.controllers} == {
        controller_of(group): joints for group, joints in arm.groups.items()
    }
    assert set(settings.arm.poses) == {pose.name for pose in arm.poses if pose.group == "arm"}
    assert settings.arm.pose_speed == arm.pose_speed


def test_node_takes_another_link_set() -> None:
    given = flat(read(make_arm("hex7bot", "V1"), "config/hardware_interface.yaml")["/**"]["ros__parameters"])
    settings, _ = load_settings({**given, "port": "/dev/ttyUSB0"}, {})
    assert settings.arm.kinematics is not None
    assert settings.arm.kinematics.links.name == "V1"  # type: ignore[attr-defined]


def test_a_gripper_that_closes_on_something_has_arrived(arm: PackageArm) -> None:
    file = read(arm, "config/ros2_controllers.yaml")
    assert ("gripper_action_controller" in file) is (arm.jaws is not None)
    if arm.jaws is not None:
        settings = file["gripper_action_controller"]["ros__parameters"]
        assert settings["joint"] == arm.jaws.joint
        assert settings["allow_stalling"] is True


@pytest.mark.parametrize("name", RELEASES)
def test_each_joint_has_one_started_controller_and_is_in_the_description(arm: PackageArm, name: str) -> None:
    file = read(arm, "config/ros2_controllers.yaml", name)
    manager = dict(file.pop("controller_manager")["ros__parameters"])
    assert manager.pop("update_rate") == 100
    assert manager.pop("joint_state_broadcaster") == {"type": "joint_state_broadcaster/JointStateBroadcaster"}
    assert set(manager) == set(file)
    described = ET.fromstring(make_urdf_text(arm, release(name))).findall("ros2_control/joint")
    trajectory = [name for name, row in manager.items() if row["type"] == JTC]
    assert trajectory == [controller_of(group) for group in arm.groups]
    moved = [joint for name in trajectory for joint in file[name]["ros__parameters"]["joints"]]
    assert moved == [joint.get("name") for joint in described]
    for controller in trajectory:
        row = file[controller]["ros__parameters"]
        assert row["command_interfaces"] == ["position"]
        assert row["state_interfaces"] == ["position", "velocity"]
        tolerances = {key: value for key, value in row["constraints"].items() if isinstance(value, dict)}
        assert set(tolerances) == (set(row["joints"]) if controller == "arm_controller" else set())
        assert row["constraints"]["goal_time"] > 0
    others = set(manager) - set(trajectory)
    assert others == ({"gripper_action_controller"} if arm.jaws is not None else set())
    for controller in others:
        assert manager[controller]["type"] == release(name).gripper
        assert arm.jaws is not None
        assert file[controller]["ros__parameters"]["joint"] == arm.jaws.joint


def test_moveit_uses_the_controllers_that_both_sides_have(arm: PackageArm) -> None:
    file = read(arm, "config/moveit_controllers.yaml")
    assert file["moveit_controller_manager"].startswith("moveit_simple_controller_manager/")
    manager = file["moveit_simple_controller_manager"]
    node = read(arm, "config/hardware_interface.yaml")["/**"]["ros__parameters"]["controllers"]
    control = read(arm, "config/ros2_controllers.yaml")
    assert manager["controller_names"] == list(node)
    for name in manager["controller_names"]:
        row = manager[name]
        assert row["type"] == "FollowJointTrajectory"
        assert row["action_ns"] == "follow_joint_trajectory"
        assert row["joints"] == node[name]["joints"] == control[name]["ros__parameters"]["joints"]
    goal = node["arm_controller"]["constraints"][arm.arm_joints[0]]["goal"]
    assert 0.01 < file["trajectory_execution"]["allowed_start_tolerance"] < goal


def test_limits_are_the_models(arm: PackageArm) -> None:
    file = read(arm, "config/joint_limits.yaml")
    assert list(file["joint_limits"]) == [joint.name for joint in arm.joints]
    described = ET.fromstring(make_urdf_text(arm, release("jazzy")))
    for joint in arm.joints:
        row = file["joint_limits"][joint.name]
        assert all(row[f"has_{kind}_limits"] is True for kind in ("position", "velocity", "acceleration"))
        assert (row["min_position"], row["max_position"]) == (joint.lower, joint.upper)
        assert row["max_velocity"] == joint.speed
        limit = described.find(f"joint[@name='{joint.name}']/limit")
        assert limit is not None
        assert float(limit.attrib["lower"]) <= row["min_position"] < row["max_position"]
        assert row["max_position"] <= float(limit.attrib["upper"])
        assert row["max_velocity"] == pytest.approx(float(limit.attrib["velocity"]))
        assert isinstance(row["max_acceleration"], float)
    assert 0 < file["default_velocity_scaling_factor"] <= 1


def test_five_joints_reach_positions_only(arm: PackageArm) -> None:
    file = read(arm, "config/kinematics.yaml")
    assert list(file) == ["arm"]
    assert file["arm"]["kinematics_solver"] == "kdl_kinematics_plugin/KDLKinematicsPlugin"
    assert file["arm"].get("position_only_ik", False) is (len(arm.arm_joints) == 5)
    assert len(arm.arm_joints) == (5 if arm.name.startswith("so") else 6)


def test_planning_is_by_ompl_in_the_form_of_the_distribution(arm: PackageArm) -> None:
    for name in RELEASES:
        file = read(arm, "config/ompl_planning.yaml", name)
        plugin = file["planning_plugin"] if name == "humble" else file["planning_plugins"][0]
        assert plugin == "ompl_interface/OMPLPlanner"
        assert isinstance(file["request_adapters"], str if name == "humble" else list)
        for group in arm.groups:
            assert file[group]["default_planner_config"] in file[group]["planner_configs"]
            assert set(file[group]["planner_configs"]) == set(file["planner_configs"])


def test_setup_assistant_finds_the_two_descriptions(arm: PackageArm) -> None:
    row = read(arm, ".setup_assistant")["moveit_setup_assistant_config"]
    assert row["urdf"] == {"package": "pack", "relative_path": f"urdf/{arm.name}.urdf"}
    assert row["srdf"] == {"relative_path": f"config/{arm.name}.srdf"}
