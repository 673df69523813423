"""How MoveIt moves the tool: lines, arcs and sequences by Pilz's planner, and streams of velocities by Servo.

Owns the keys and numbers of these files, from the sources of MoveIt 2.
"""

from __future__ import annotations

from hexwire.model.urdf import ROOT_LINK, TIP_LINK

from .arms import ARM_GROUP, PackageArm
from .releases import Release
from .yaml_text import Value, yaml_text

__all__ = ["PILZ", "REQUEST_ADAPTERS", "tool_motion_files"]

PILZ = "pilz_industrial_motion_planner"
"""Name of the pipeline, of its package, and before its file."""
REQUEST_ADAPTERS = (
    "ResolveConstraintFrames",
    "ValidateWorkspaceBounds",
    "CheckStartStateBounds",
    "CheckStartStateCollision",
)
"""What MoveIt does with a request before it plans, since Jazzy."""

_TIP_SPEED, _TIP_ACCELERATION, _TURN_SPEED = 0.25, 1.0, 1.57
"""Metres per second, ISO 10218-1's limit for reduced speed; metres per second squared; radians per second."""
_SERVO_SPEED, _SERVO_TURN, _SERVO_JOINT = 0.1, 0.5, 0.5
_SERVO_PERIOD = 0.034
"""Seconds between two trajectories, which the node blends into one another."""
_SINGULAR, _SINGULAR_STOP, _MARGIN = 17.0, 30.0, 0.1
_SEQUENCES = f"{PILZ}/MoveGroupSequenceAction {PILZ}/MoveGroupSequenceService"


def tool_motion_files(arm: PackageArm, release: Release, controller: str) -> dict[str, str]:
    """Texts by path in the package.

    Args:
        arm: The arm.
        release: The distribution.
        controller: Name of the controller that takes Servo's trajectories.
    """
    return {
        "config/pilz_cartesian_limits.yaml": _cartesian_limits(arm),
        f"config/{PILZ}_planning.yaml": _planning(release),
        "config/servo.yaml": _servo(release, controller),
    }


def _cartesian_limits(arm: PackageArm) -> str:
    head: tuple[str, ...] = (
        "Of the tool, in metres, radians and seconds. Joints are limited by joint_limits.yaml.",
    )
    if arm.joints_short_of_six:
        head += ("Five joints do not reach every orientation: LIN and CIRC need goals that they do reach.",)
    return yaml_text(
        {
            "cartesian_limits": {
                "max_trans_vel": _TIP_SPEED,
                "max_trans_acc": _TIP_ACCELERATION,
                "max_trans_dec": -_TIP_ACCELERATION,
                "max_rot_vel": _TURN_SPEED,
            }
        },
        head=head,
    )


def _planning(release: Release) -> str:
    table: dict[str, Value] = {"default_planner_config": "PTP", "capabilities": _SEQUENCES}
    plugin = f"{PILZ}/CommandPlanner"
    if release.one_planning_plugin:
        table |= {"planning_plugin": plugin, "request_adapters": ""}
    else:
        table |= {
            "planning_plugins": [plugin],
            "request_adapters": [f"default_planning_request_adapters/{name}" for name in REQUEST_ADAPTERS],
            "response_adapters": [
                f"default_planning_response_adapters/{name}" for name in ("ValidateSolution", "DisplayMotionPath")
            ],
        }
    return yaml_text(
        table, head=("The planners PTP, LIN and CIRC; MoveIt uses them if the pipeline is asked for.",)
    )


def _servo(release: Release, controller: str) -> str:
    table: dict[str, Value] = {
        "move_group_name": ARM_GROUP,
        "publish_period": _SERVO_PERIOD,
        "command_in_type": "speed_units",
        "scale": {"linear": _SERVO_SPEED, "rotational": _SERVO_TURN, "joint": _SERVO_JOINT},
        "incoming_command_timeout": _MARGIN,
        "command_out_type": "trajectory_msgs/JointTrajectory",
        "command_out_topic": f"/{controller}/joint_trajectory",
        "publish_joint_positions": True,
        "publish_joint_velocities": True,
        "publish_joint_accelerations": False,
        "smoothing_filter_plugin_name": "online_signal_smoothing::ButterworthFilterPlugin",
        # move_group is the one.
        "is_primary_planning_scene_monitor": False,
        "joint_topic": "/joint_states",
        "status_topic": "~/status",
        "cartesian_command_in_topic": "~/delta_twist_cmds",
        "joint_command_in_topic": "~/delta_joint_cmds",
        "lower_singularity_threshold": _SINGULAR,
        "hard_stop_singularity_threshold": _SINGULAR_STOP,
        "check_collisions": True,
        "collision_check_rate": 10.0,
        "self_collision_proximity_threshold": 0.01,
        "scene_collision_proximity_threshold": 0.02,
    }
    if release.one_planning_plugin:
        table |= {
            "use_gazebo": False,
            "low_latency_mode": False,
            "planning_frame": ROOT_LINK,
            "ee_frame_name": TIP_LINK,
            "robot_link_command_frame": ROOT_LINK,
            "num_outgoing_halt_msgs_to_publish": 4,
            "joint_limit_margin": _MARGIN,
        }
    else:
        table |= {"use_smoothing": True, "max_expected_latency": 0.1, "joint_limit_margins": [_MARGIN]}
    return yaml_text(
        table,
        head=(
            "MoveIt Servo: velocities of the tool or of joints become a stream of short trajectories, on the topic",
            "that the node has, and the controller of ros2_control. Metres, radians, seconds.",
        ),
    )
