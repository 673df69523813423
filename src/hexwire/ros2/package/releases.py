"""What differs between ROS 2 distributions in an arm's package.

Owns these facts, from the sources of topic_based_ros2_control, joint_state_topic_hardware_interface, ros2_control,
ros2_controllers and MoveIt 2. Must not know an arm.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from hexwire.errors import UsageError

__all__ = ["DEFAULT_RELEASE", "RELEASES", "Release", "release", "usual_release"]

DEFAULT_RELEASE = "jazzy"


@dataclass(frozen=True, slots=True)
class Release:
    """One distribution.

    Attributes:
        name: Its first name.
        hardware: Plug-in that is the far side of the topic pair.
        hardware_package: The package with it.
        unknown_state: Text of an initial position that is not known; None where this is so without saying it.
        gripper: Controller with an action that opens and closes a gripper.
        gripper_package: The package with it.
        description_topic: Where the controller manager expects the robot description.
        one_planning_plugin: MoveIt takes one planning plug-in and a line of adapters, not lists of both.
        servo: The program of MoveIt Servo. That of Humble has frames and a single margin among its parameters.
    """

    name: str
    hardware: str
    hardware_package: str
    unknown_state: str | None
    gripper: str
    gripper_package: str
    description_topic: str
    one_planning_plugin: bool = False
    servo: str = "servo_node"


_HUMBLE = Release(
    "humble",
    "topic_based_ros2_control/TopicBasedSystem",
    "topic_based_ros2_control",
    # It starts from 0 otherwise, and would command the arm to go there.
    "nan",
    "position_controllers/GripperActionController",
    "gripper_controllers",
    "~/robot_description",
    one_planning_plugin=True,
    servo="servo_node_main",
)


def _since_jazzy(name: str) -> Release:
    return Release(
        name,
        "joint_state_topic_hardware_interface/JointStateTopicSystem",
        "joint_state_topic_hardware_interface",
        None,
        "parallel_gripper_action_controller/GripperActionController",
        "parallel_gripper_controller",
        "robot_description",
    )


RELEASES: Mapping[str, Release] = {
    release.name: release for release in (_HUMBLE, *map(_since_jazzy, ("jazzy", "kilted", "lyrical", "rolling")))
}
"""The distributions that are known, oldest first."""


def release(name: str) -> Release:
    """A distribution by name, ignoring case.

    Raises:
        UsageError: There is none of this name.
    """
    found = RELEASES.get(name.lower())
    if found is None:
        raise UsageError(f"no ROS 2 distribution {name!r}; choose one of {', '.join(RELEASES)}")
    return found


def usual_release(environment: Mapping[str, str]) -> str:
    """The distribution of a shell in which ROS 2 is set up, from ROS_DISTRO; otherwise `DEFAULT_RELEASE`."""
    here = environment.get("ROS_DISTRO", "")
    return here if here in RELEASES else DEFAULT_RELEASE
