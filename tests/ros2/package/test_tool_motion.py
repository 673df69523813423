"""Pilz's planner and MoveIt Servo: names and bounds as MoveIt's sources declare them."""

from __future__ import annotations

from typing import Any

import pytest
import yaml
from tests.ros2.package.test_configuration import read

from hexwire.model.arms import arms_with_geometry
from hexwire.ros2.package.arms import PackageArm, make_arm
from hexwire.ros2.package.configuration import controller_of
from hexwire.ros2.package.releases import RELEASES, release

# moveit_servo/config/servo_parameters.yaml of jazzy to main: every parameter, with its type.
SERVO: dict[str, type] = {
    "thread_priority": int,
    "publish_period": float,
    "max_expected_latency": float,
    "move_group_name": str,
    "active_subgroup": str,
    "pose_command_in_topic": str,
    "cartesian_command_in_topic": str,
    "joint_command_in_topic": str,
    "command_in_type": str,
    "scale": dict,
    "incoming_command_timeout": float,
    "status_topic": str,
    "command_out_topic": str,
    "command_out_type": str,
    "publish_joint_positions": bool,
    "publish_joint_velocities": bool,
    "publish_joint_accelerations": bool,
    "monitored_planning_scene_topic": str,
    "joint_topic": str,
    "check_octomap_collisions": bool,
    "is_primary_planning_scene_monitor": bool,
    "use_smoothing": bool,
    "smoothing_filter_plugin_name": str,
    "check_collisions": bool,
    "self_collision_proximity_threshold": float,
    "scene_collision_proximity_threshold": float,
    "collision_check_rate": float,
    "lower_singularity_threshold": float,
    "hard_stop_singularity_threshold": float,
    "leaving_singularity_threshold_multiplier": float,
    "singularity_step_scale": float,
    "joint_limit_margins": list,
    "override_velocity_scaling_factor": float,
}
# moveit_servo/config/panda_simulated_config.yaml of humble: those that are other ones there.
HUMBLE: dict[str, type] = {
    "use_gazebo": bool,
    "low_latency_mode": bool,
    "planning_frame": str,
    "ee_frame_name": str,
    "robot_link_command_frame": str,
    "num_outgoing_halt_msgs_to_publish": int,
    "joint_limit_margin": float,
}
SINCE_JAZZY = {"use_smoothing", "max_expected_latency", "joint_limit_margins", "check_octomap_collisions"}


@pytest.fixture(params=arms_with_geometry())
def arm(request: pytest.FixtureRequest) -> PackageArm:
    return make_arm(request.param)


def test_pilz_has_limits_of_the_tool(arm: PackageArm) -> None:
    limits = read(arm, "config/pilz_cartesian_limits.yaml")["cartesian_limits"]
    assert set(limits) == {"max_trans_vel", "max_trans_acc", "max_trans_dec", "max_rot_vel"}
    assert all(isinstance(value, float) for value in limits.values())
    # Pilz takes a deceleration below zero only.
    assert limits["max_trans_dec"] < 0.0 < min(limits[name] for name in limits if name != "max_trans_dec")
    assert limits["max_trans_vel"] <= 0.25


@pytest.mark.parametrize("name", RELEASES)
def test_pilz_is_a_pipeline_in_the_form_of_the_distribution(arm: PackageArm, name: str) -> None:
    file = read(arm, "config/pilz_industrial_motion_planner_planning.yaml", name)
    assert file["default_planner_config"] == "PTP"
    assert [word.rpartition("/")[2] for word in file["capabilities"].split()] == [
        "MoveGroupSequenceAction",
        "MoveGroupSequenceService",
    ]
    plugin = "pilz_industrial_motion_planner/CommandPlanner"
    if release(name).one_planning_plugin:
        assert (file["planning_plugin"], file["request_adapters"]) == (plugin, "")
        return
    assert file["planning_plugins"] == [plugin]
    # Pilz's motions have their times: nothing may make new ones of them.
    assert not any("Parameterization" in row for row in file["request_adapters"] + file["response_adapters"])


@pytest.mark.parametrize("name", RELEASES)
def test_servo_knows_every_parameter_and_takes_its_value(arm: PackageArm, name: str) -> None:
    file = read(arm, "config/servo.yaml", name)
    known = SERVO if name != "humble" else {k: v for k, v in SERVO.items() if k not in SINCE_JAZZY} | HUMBLE
    assert set(file) <= set(known)
    assert {key for key, value in file.items() if type(value) is not known[key]} == set()
    assert set(file["scale"]) == {"linear", "rotational", "joint"}
    assert file["command_in_type"] in ("unitless", "speed_units")
    assert file["command_out_type"] in ("trajectory_msgs/JointTrajectory", "std_msgs/Float64MultiArray")
    assert 0.0 < file["lower_singularity_threshold"] < file["hard_stop_singularity_threshold"]
    assert (name == "humble") == ("ee_frame_name" in file)


def test_servo_streams_to_the_arms_controller_and_leaves_the_scene_to_move_group(arm: PackageArm) -> None:
    file = read(arm, "config/servo.yaml")
    node: dict[str, Any] = read(arm, "config/hardware_interface.yaml")["/**"]["ros__parameters"]
    assert file["command_out_topic"] == f"/{controller_of('arm')}/joint_trajectory"
    assert controller_of("arm") in node["controllers"]
    assert file["is_primary_planning_scene_monitor"] is False
    # As trajectories that the node blends: positions with velocities.
    assert (file["publish_joint_positions"], file["publish_joint_velocities"]) == (True, True)
    assert file["publish_period"] < 0.1 <= file["incoming_command_timeout"]


def test_a_yaml_1_1_reader_sees_the_same(arm: PackageArm) -> None:
    assert yaml.safe_load(yaml.safe_dump(read(arm, "config/servo.yaml"))) == read(arm, "config/servo.yaml")
