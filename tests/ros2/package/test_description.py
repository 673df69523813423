"""URDF and SRDF, as Pinocchio, urdfdom's `check_urdf` and an XML parser read them."""

from __future__ import annotations

import math
import subprocess
import xml.etree.ElementTree as ET
from pathlib import Path

import pinocchio
import pytest

from hexwire.model.arms import arms_with_geometry
from hexwire.model.urdf import make_urdf
from hexwire.ros2.package.arms import PackageArm, make_arm
from hexwire.ros2.package.collisions import idle_pairs
from hexwire.ros2.package.description import COMMANDS_TOPIC, STATES_TOPIC, make_srdf, make_urdf_text
from hexwire.ros2.package.releases import RELEASES, release
from hexwire.ros2.settings import OWN


@pytest.fixture(params=arms_with_geometry())
def arm(request: pytest.FixtureRequest) -> PackageArm:
    return make_arm(request.param)


def control(arm: PackageArm, name: str = "jazzy") -> ET.Element:
    tag = ET.fromstring(make_urdf_text(arm, release(name))).find("ros2_control")
    assert tag is not None
    return tag


def test_description_is_the_arms_own_with_one_more_tag(arm: PackageArm) -> None:
    root = ET.fromstring(make_urdf_text(arm, release("jazzy")))
    tag = root.find("ros2_control")
    assert tag is not None
    root.remove(tag)
    own = ET.fromstring(make_urdf(arm.kinematics))
    assert [ET.tostring(row).strip() for row in root] == [ET.tostring(row).strip() for row in own]


def test_urdfdom_reads_it(arm: PackageArm, tmp_path: Path) -> None:
    """The parser of ROS itself, from Debian."""
    file = tmp_path / "arm.urdf"
    file.write_text(make_urdf_text(arm, release("jazzy")), encoding="utf-8")
    found = subprocess.run(["check_urdf", str(file)], capture_output=True, text=True, timeout=60, check=True)
    assert f"robot name is: {arm.name}" in found.stdout
    assert "root Link: base_link has 1 child" in found.stdout
    for link in arm.shapes.links[1:]:
        assert f":  {link.name}\n" in found.stdout


@pytest.mark.parametrize("name", RELEASES)
def test_every_joint_of_the_driver_takes_and_tells_its_position(arm: PackageArm, name: str) -> None:
    tag = control(arm, name)
    assert tag.get("type") == "system"
    assert [joint.get("name") for joint in tag.findall("joint")] == [joint.name for joint in arm.joints]
    for row, joint in zip(tag.findall("joint"), arm.joints, strict=True):
        assert [i.get("name") for i in row.findall("command_interface")] == ["position"]
        assert [i.get("name") for i in row.findall("state_interface")] == ["position", "velocity"]
        ends = [float(row.findtext(f"command_interface/param[@name='{end}']", "")) for end in ("min", "max")]
        assert ends == [joint.lower, joint.upper]
        initial = row.findtext("state_interface[@name='position']/param[@name='initial_value']")
        assert initial is None if name != "humble" else math.isnan(float(initial or 0.0))


def test_topics_are_those_of_the_node(arm: PackageArm) -> None:
    tag = control(arm)
    defaults = {row.name: f"/{row.default}" for row in OWN if row.name.startswith("joint_") and "topic" in row.name}
    params = {row.get("name"): row.text for row in tag.findall("hardware/param")}
    assert {name: params[name] for name in defaults} == defaults
    assert (params["joint_states_topic"], params["joint_commands_topic"]) == (STATES_TOPIC, COMMANDS_TOPIC)
    # Commands come also while nothing changes.
    assert float(params["trigger_joint_command_threshold"] or 0) < 0


@pytest.mark.parametrize("name", RELEASES)
def test_plug_in_is_the_distributions(name: str) -> None:
    assert control(make_arm("so101"), name).findtext("hardware/plugin") == release(name).hardware


def test_pinocchio_reads_groups_poses_and_pairs(arm: PackageArm, tmp_path: Path) -> None:
    text = make_urdf_text(arm, release("jazzy"))
    model = pinocchio.buildModelFromXML(text)
    geometry = pinocchio.buildGeomFromUrdfString(model, text, pinocchio.GeometryType.COLLISION)
    geometry.addAllCollisionPairs()
    before = len(geometry.collisionPairs)
    pinocchio.removeCollisionPairsFromXML(model, geometry, make_srdf(arm))

    def link(number: int) -> str:
        return model.frames[geometry.geometryObjects[number].parentFrame].name

    left = {tuple(sorted((link(pair.first), link(pair.second)))) for pair in geometry.collisionPairs}
    idle = {(pair.first, pair.second) for pair in idle_pairs(arm)}
    assert len(geometry.collisionPairs) < before
    assert not left & idle
    file = tmp_path / "arm.srdf"
    file.write_text(make_srdf(arm), encoding="utf-8")
    pinocchio.loadReferenceConfigurations(model, str(file), False)
    assert {row.key() for row in model.referenceConfigurations} == {pose.name for pose in arm.poses}
    for row in model.referenceConfigurations:
        pose = next(pose for pose in arm.poses if pose.name == row.key())
        for name, angle in pose.positions.items():
            assert row.data()[model.joints[model.getJointId(name)].idx_q] == angle
        assert (model.lowerPositionLimit - 1e-9 <= row.data()).all()
        assert (row.data() <= model.upperPositionLimit + 1e-9).all()


def test_groups_are_made_of_what_the_description_has(arm: PackageArm) -> None:
    urdf, srdf = ET.fromstring(make_urdf_text(arm, release("jazzy"))), ET.fromstring(make_srdf(arm))
    assert srdf.get("name") == urdf.get("name")
    links = {link.get("name") for link in urdf.findall("link")}
    joints = {joint.attrib["name"]: joint for joint in urdf.findall("joint")}
    chain = srdf.find("group[@name='arm']/chain")
    assert chain is not None
    assert {chain.get("base_link"), chain.get("tip_link")} <= links
    # From the tip to the base there are the arm's joints, and no joint of the gripper.
    above = {joint.find("child").get("link"): joint for joint in joints.values()}  # type: ignore[union-attr]
    link, passed = chain.get("tip_link"), []
    while link != chain.get("base_link"):
        joint = above[link]
        passed.append(joint.attrib["name"])
        link = joint.find("parent").get("link")  # type: ignore[union-attr]
    assert [name for name in reversed(passed) if name in arm.arm_joints] == list(arm.arm_joints)
    grip = {row.get("name") for row in srdf.findall("group[@name='gripper']/joint")}
    assert grip <= set(joints)
    assert not grip & set(passed)
    for row in srdf.findall("disable_collisions"):
        assert {row.get("link1"), row.get("link2")} <= links
    for state in srdf.findall("group_state"):
        own = set(passed) if state.get("group") == "arm" else grip
        assert {row.get("name") for row in state} <= own
    hand = srdf.find("end_effector")
    assert (hand is None) == (arm.jaws is None) == (not grip)
    if hand is not None:
        # Its parent is the chain's tip, which the planning panel moves.
        assert hand.attrib["parent_link"] == chain.get("tip_link")
        assert (hand.get("group"), hand.get("parent_group")) == ("gripper", "arm")
    mount = srdf.find("virtual_joint")
    assert mount is not None
    assert (mount.get("type"), mount.get("child_link")) == ("fixed", "base_link")
