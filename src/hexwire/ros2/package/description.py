"""The arm for ROS: the URDF with the tags of ros2_control, and the SRDF for MoveIt.

Owns both formats as far as `hexwire.model.urdf` does not. Must not know controllers or launch files.
"""

from __future__ import annotations

from xml.sax.saxutils import quoteattr

from hexwire.model.urdf import ROOT_LINK, TIP_LINK, make_urdf

from .arms import ARM_GROUP, GRIPPER_GROUP, PackageArm
from .collisions import idle_pairs
from .releases import Release

__all__ = ["COMMANDS_TOPIC", "PLANNING_FRAME", "STATES_TOPIC", "make_ros2_control", "make_srdf", "make_urdf_text"]

STATES_TOPIC = "/robot_joint_states"
COMMANDS_TOPIC = "/robot_joint_commands"
"""The topic pair between the node and the controller manager, by the plug-in's own defaults."""
PLANNING_FRAME = "world"

_ALWAYS_SEND = -1
"""The plug-in then sends commands also while they do not differ from the states: the node sees that it lives."""


def make_urdf_text(arm: PackageArm, release: Release) -> str:
    """The URDF, with the tags of ros2_control."""
    text = make_urdf(arm.kinematics)
    head, end = text.rsplit("</robot>", 1)
    return "\n".join([head.rstrip("\n"), *make_ros2_control(arm, release), "</robot>"]) + end


def make_ros2_control(arm: PackageArm, release: Release) -> list[str]:
    """The lines of the tag ``ros2_control``: every joint of the driver takes and tells its position.

    Joints that only follow others are left out: nobody measures them, and robot_state_publisher computes them.
    """
    rows = [
        f"  <ros2_control{_text(name=arm.name, type='system')}>",
        "    <hardware>",
        f"      <plugin>{release.hardware}</plugin>",
        f'      <param name="joint_states_topic">{STATES_TOPIC}</param>',
        f'      <param name="joint_commands_topic">{COMMANDS_TOPIC}</param>',
        f'      <param name="trigger_joint_command_threshold">{_ALWAYS_SEND}</param>',
        "    </hardware>",
    ]
    unknown = release.unknown_state
    for joint in arm.joints:
        rows += [
            f"    <joint{_text(name=joint.name)}>",
            '      <command_interface name="position">',
            f'        <param name="min">{joint.lower}</param>',
            f'        <param name="max">{joint.upper}</param>',
            "      </command_interface>",
            '      <state_interface name="position"/>'
            if unknown is None
            else f'      <state_interface name="position"><param name="initial_value">{unknown}</param>'
            "</state_interface>",
            '      <state_interface name="velocity"/>',
            "    </joint>",
        ]
    return [*rows, "  </ros2_control>"]


def make_srdf(arm: PackageArm) -> str:
    """Groups, named poses, end effector, and the pairs of links that are not checked against each other."""
    rows = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        "<!-- Made by 'hexwire model ros2-package'. -->",
        f"<robot{_text(name=arm.shapes.name)}>",
        f"  <group{_text(name=ARM_GROUP)}>",
        f"    <chain{_text(base_link=ROOT_LINK, tip_link=TIP_LINK)}/>",
        "  </group>",
    ]
    if arm.jaws is not None:
        rows += [
            f"  <group{_text(name=GRIPPER_GROUP)}>",
            *(f"    <joint{_text(name=name)}/>" for name in arm.gripper_joints),
            "  </group>",
        ]
    for pose in arm.poses:
        rows += [
            f"  <group_state{_text(name=pose.name, group=pose.group)}>",
            *(f"    <joint{_text(name=name, value=repr(angle))}/>" for name, angle in pose.positions.items()),
            "  </group_state>",
        ]
    if arm.jaws is not None:
        rows.append(
            "  <end_effector"
            + _text(name="hand", parent_link=TIP_LINK, group=GRIPPER_GROUP, parent_group=ARM_GROUP)
            + "/>"
        )
    rows.append(
        "  <virtual_joint"
        + _text(name="mount", type="fixed", parent_frame=PLANNING_FRAME, child_link=ROOT_LINK)
        + "/>"
    )
    rows += [
        f"  <disable_collisions{_text(link1=pair.first, link2=pair.second, reason=pair.reason)}/>"
        for pair in idle_pairs(arm)
    ]
    return "\n".join([*rows, "</robot>", ""])


def _text(**attributes: str) -> str:
    return "".join(f" {name}={quoteattr(value)}" for name, value in attributes.items())
