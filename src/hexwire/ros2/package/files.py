"""The whole package of an arm: descriptions, parameter files, and the files that are the same for all arms.

Owns the list of files and the names in them.
"""

from __future__ import annotations

import json
import re
from importlib import resources
from xml.sax.saxutils import escape

import hexwire
from hexwire.model.arms import arm_with_geometry
from hexwire.model.kinematics import KinematicModel
from hexwire.model.urdf import ROOT_LINK

from .arms import make_arm
from .configuration import configuration_files, controller_of
from .description import PLANNING_FRAME, make_srdf, make_urdf_text
from .foxglove import foxglove_layout
from .releases import DEFAULT_RELEASE, Release, release
from .tool_motion import PILZ

__all__ = ["make_package", "package_name"]

_NAME = re.compile(r"@([A-Z_]+)@")
_TEMPLATES = {
    "CMakeLists.txt": "CMakeLists.txt",
    "README.md": "README.md",
    "launch/arm.launch.py": "arm.launch.py.in",
    "launch/ros2_control.launch.py": "ros2_control.launch.py.in",
    "launch/moveit.launch.py": "moveit.launch.py.in",
    "package.xml": "package.xml",
    "rviz/arm.rviz": "arm.rviz",
    "rviz/moveit.rviz": "moveit.rviz",
}
"""Path in the package -> file in the folder of templates."""


def package_name(robot: str) -> str:
    """Name of a robot's package."""
    return f"hexwire_{robot}"


def make_package(robot: str, links: str = "A", distribution: str = DEFAULT_RELEASE) -> dict[str, str]:
    """The texts of a package's files, by path in its folder; the same for the same arguments.

    Args:
        robot: One of `hexwire.model.arms.arms_with_geometry`.
        links: Link set of the 7Bot, as in `make_kinematics`.
        distribution: Name of a ROS 2 distribution, one of `RELEASES`.

    Raises:
        UsageError: No such robot, link set or distribution; or as `make_kinematics`.
    """
    found = release(distribution)
    arm, record = make_arm(robot, links), arm_with_geometry(robot)
    package = package_name(robot)
    names = {
        "PACKAGE": package,
        "ROBOT": robot,
        "VERSION": hexwire.__version__,
        "DISTRIBUTION": found.name,
        "ROOT": ROOT_LINK,
        "WORLD": PLANNING_FRAME,
        "CONTROLLERS": json.dumps([controller_of(group) for group in arm.groups]),
        "DESCRIPTION_TOPIC": found.description_topic,
        "HARDWARE_PACKAGE": found.hardware_package,
        "PILZ": PILZ,
        "SERVO_PROGRAM": found.servo,
        "DEPENDS": _depends(found, gripper=arm.jaws is not None),
        "LIMITS": _limits(arm.kinematics),
        "PORT": record.port,
        "SIM": record.emulated,
        "SIM_PROGRAM": f", while `{record.emulator}` runs" if record.emulator else "",
        "FRAMES": _frames([link.name for link in arm.shapes.links]),
    }
    files = {
        f"urdf/{robot}.urdf": make_urdf_text(arm, found),
        f"config/{robot}.srdf": make_srdf(arm),
        "foxglove/arm.json": foxglove_layout([joint.name for joint in arm.joints]),
        **configuration_files(arm, found, package),
    }
    folder = resources.files(__package__) / "templates"
    for path, template in _TEMPLATES.items():
        text = (folder / template).read_text(encoding="utf-8")
        files[path] = _NAME.sub(lambda match: names[match[1]], text)
    return dict(sorted(files.items()))


def _depends(found: Release, *, gripper: bool) -> str:
    packages = [
        "controller_manager",
        "joint_state_broadcaster",
        "joint_trajectory_controller",
        "launch",
        "launch_ros",
        "moveit_configs_utils",
        "moveit_kinematics",
        "moveit_planners_ompl",
        "moveit_ros_move_group",
        "moveit_servo",
        "moveit_ros_visualization",
        "moveit_simple_controller_manager",
        PILZ,
        "rmw_zenoh_cpp",
        "robot_state_publisher",
        "rviz2",
        "rviz_default_plugins",
        "tf2_ros",
        "xacro",
        found.hardware_package,
        *([found.gripper_package] if gripper else []),
    ]
    return "\n".join(f"  <exec_depend>{escape(name)}</exec_depend>" for name in sorted(packages))


def _limits(kinematics: KinematicModel) -> str:
    if kinematics.has_coupling:
        return "the joint coupling limit between upper arm and forearm, and the table"
    return "the table"


def _frames(links: list[str]) -> str:
    shown = {ROOT_LINK, "tool"}
    return "\n".join(f"        {name}:\n          Value: {str(name in shown).lower()}" for name in sorted(links))
