"""The parameter files of an arm's package: the node, the controllers of ros2_control, and MoveIt.

Owns their keys and numbers.
"""

from __future__ import annotations

from collections.abc import Mapping

from .arms import ACCELERATION, ARM_GROUP, GRIPPER_GROUP, PackageArm
from .releases import Release
from .tool_motion import REQUEST_ADAPTERS, tool_motion_files
from .yaml_text import Value, yaml_text

__all__ = ["configuration_files", "controller_of"]

_UPDATE_RATE = 100
_GOAL_TIME = 2.0
_GRIPPER_GOAL_TIME = 1.0
_STOPPED = 0.1
_GOAL = 0.05
_START = 0.03
_KDL = "kdl_kinematics_plugin/KDLKinematicsPlugin"
_RESPONSE = ("AddTimeOptimalParameterization", "ValidateSolution", "DisplayMotionPath")
_HUMBLE_REQUEST = (
    "AddTimeOptimalParameterization",
    "ResolveConstraintFrames",
    "FixWorkspaceBounds",
    "FixStartStateBounds",
    "FixStartStateCollision",
    "FixStartStatePathConstraints",
)
_PLANNERS = ("RRTConnect", "BiTRRT", "PRM", "RRTstar")


def controller_of(group: str) -> str:
    """Name of the controller of a group, the same in the node and in ros2_control."""
    return f"{group}_controller"


def configuration_files(arm: PackageArm, release: Release, package: str) -> dict[str, str]:
    """Texts by path in the package."""
    return {
        ".setup_assistant": _setup_assistant(arm, package),
        "config/hardware_interface.yaml": _node(arm, release),
        "config/joint_limits.yaml": _joint_limits(arm),
        "config/kinematics.yaml": _kinematics(arm),
        "config/moveit_controllers.yaml": _moveit_controllers(arm),
        "config/ompl_planning.yaml": _planning(arm, release),
        "config/ros2_controllers.yaml": _controllers(arm, release),
        **tool_motion_files(arm, release, controller_of(ARM_GROUP)),
    }


def _constraints(arm: PackageArm, group: str) -> dict[str, Value]:
    if group == GRIPPER_GROUP:
        # No goal tolerance: a gripper that holds something never comes to its goal.
        return {"goal_time": _GRIPPER_GOAL_TIME}
    table: dict[str, Value] = {"goal_time": _GOAL_TIME, "stopped_velocity_tolerance": _STOPPED}
    return table | {name: {"goal": _GOAL} for name in arm.groups[group]}


def _node(arm: PackageArm, release: Release) -> str:
    poses: dict[str, Value] = {pose.name: dict(pose.positions) for pose in arm.poses if pose.group == ARM_GROUP}
    controllers: dict[str, Value] = {}
    for group, joints in arm.groups.items():
        controllers[controller_of(group)] = {"joints": joints, "constraints": _constraints(arm, group)}
    parameters: dict[str, Value] = {"distribution": release.name, "robot": arm.name}
    if arm.links:
        parameters["links"] = arm.links
    parameters |= {"poses": poses, "pose_speed": arm.pose_speed, "controllers": controllers}
    return yaml_text(
        {"/**": {"ros__parameters": parameters}},
        head=(
            "Parameters of the node hardware_interface (hexwire-ros2). What is not here has its default:",
            "hexwire-ros2 --help. The port is given in the launch files.",
        ),
    )


def _controllers(arm: PackageArm, release: Release) -> str:
    manager: dict[str, Value] = {
        "update_rate": _UPDATE_RATE,
        "joint_state_broadcaster": {"type": "joint_state_broadcaster/JointStateBroadcaster"},
    }
    tables: dict[str, Value] = {}
    for group, joints in arm.groups.items():
        name = controller_of(group)
        manager[name] = {"type": "joint_trajectory_controller/JointTrajectoryController"}
        tables[name] = {
            "ros__parameters": {
                "joints": joints,
                "command_interfaces": ["position"],
                "state_interfaces": ["position", "velocity"],
                "allow_nonzero_velocity_at_trajectory_end": False,
                # Its own default would ask a gripper to stand still.
                "constraints": {"stopped_velocity_tolerance": 0.0, **_constraints(arm, group)},
            }
        }
    if arm.jaws is not None:
        # Configured, but not started by the launch file: it and gripper_controller command the same joint.
        manager["gripper_action_controller"] = {"type": release.gripper}
        tables["gripper_action_controller"] = {
            "ros__parameters": {"joint": arm.jaws.joint, "goal_tolerance": _GOAL, "allow_stalling": True}
        }
    return yaml_text(
        {"controller_manager": {"ros__parameters": manager}, **tables},
        head=(
            "Controllers of ros2_control. Tolerances are in radians and seconds; a servo stops up to half a degree",
            "beside its goal, and its speed at rest is noise of 0.1 rad/s.",
        ),
    )


def _moveit_controllers(arm: PackageArm) -> str:
    names = [controller_of(group) for group in arm.groups]
    manager: dict[str, Value] = {"controller_names": names}
    for group, joints in arm.groups.items():
        manager[controller_of(group)] = {
            "type": "FollowJointTrajectory",
            "action_ns": "follow_joint_trajectory",
            "default": True,
            "joints": joints,
        }
    return yaml_text(
        {
            "moveit_controller_manager": "moveit_simple_controller_manager/MoveItSimpleControllerManager",
            "moveit_simple_controller_manager": manager,
            "trajectory_execution": {
                "allowed_execution_duration_scaling": 1.5,
                "allowed_goal_duration_margin": _GOAL_TIME,
                "allowed_start_tolerance": _START,
            },
        },
        head=(
            "The actions that MoveIt uses: those of hexwire-ros2, or of ros2_control under the same names.",
            "Servos stop up to half a degree beside their goal, so MoveIt's own start tolerance is too small.",
        ),
    )


def _joint_limits(arm: PackageArm) -> str:
    rows: dict[str, Value] = {}
    for joint in arm.joints:
        rows[joint.name] = {
            "has_position_limits": True,
            "min_position": joint.lower,
            "max_position": joint.upper,
            "has_velocity_limits": True,
            "max_velocity": joint.speed,
            "has_acceleration_limits": True,
            "max_acceleration": ACCELERATION,
        }
    return yaml_text(
        {
            "default_velocity_scaling_factor": arm.pose_speed,
            "default_acceleration_scaling_factor": arm.pose_speed,
            "joint_limits": rows,
        },
        head=(
            "Radians and seconds. Positions and velocities are the driver's limits. No acceleration is published",
            "for any of these arms: it is the one that hexwire plans with.",
        ),
    )


def _kinematics(arm: PackageArm) -> str:
    table: dict[str, Value] = {
        "kinematics_solver": _KDL,
        "kinematics_solver_search_resolution": 0.005,
        "kinematics_solver_timeout": 0.05,
    }
    head: tuple[str, ...] = ()
    if arm.joints_short_of_six:
        table["position_only_ik"] = True
        head = ("Five joints do not reach every orientation: the solver brings the tool to a position.",)
    return yaml_text({ARM_GROUP: table}, head=head)


def _planning(arm: PackageArm, release: Release) -> str:
    table: dict[str, Value]
    if release.one_planning_plugin:
        adapters = " ".join(f"default_planner_request_adapters/{name}" for name in _HUMBLE_REQUEST)
        table = {
            "planning_plugin": "ompl_interface/OMPLPlanner",
            "request_adapters": adapters,
            "start_state_max_bounds_error": 0.1,
        }
    else:
        table = {
            "planning_plugins": ["ompl_interface/OMPLPlanner"],
            "request_adapters": [f"default_planning_request_adapters/{name}" for name in REQUEST_ADAPTERS],
            "response_adapters": [f"default_planning_response_adapters/{name}" for name in _RESPONSE],
        }
    groups: Mapping[str, Value] = {
        group: {"default_planner_config": _PLANNERS[0], "planner_configs": _PLANNERS} for group in arm.groups
    }
    planners: Mapping[str, Value] = {name: {"type": f"geometric::{name}"} for name in _PLANNERS}
    return yaml_text({**table, "planner_configs": planners, **groups})


def _setup_assistant(arm: PackageArm, package: str) -> str:
    return yaml_text(
        {
            "moveit_setup_assistant_config": {
                "urdf": {"package": package, "relative_path": f"urdf/{arm.name}.urdf"},
                "srdf": {"relative_path": f"config/{arm.name}.srdf"},
                # Fixed, so that the same arm gives the same file.
                "package_settings": {"author_name": "hexwire", "author_email": "", "generated_timestamp": 0},
            }
        }
    )
