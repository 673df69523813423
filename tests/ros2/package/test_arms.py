from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import pytest
import yaml

import hexwire.ros1
from hexwire.drivers.arm_file import load_profile
from hexwire.errors import UsageError
from hexwire.model.arms import arms_with_geometry
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.model.arms.hex7bot.links import LINK_SETS
from hexwire.model.arms.puma260.kinematics import PUMA260
from hexwire.model.geometry import make_kinematics, make_shapes
from hexwire.ros2.package.arms import ARM_GROUP, GRIPPER_GROUP, make_arm

CONFIG = Path(hexwire.ros1.__file__).parent / "share/hexwire/config"


@pytest.mark.parametrize("robot", arms_with_geometry())
def test_limits_are_within_those_of_driver_and_description_and_close_to_them(robot: str) -> None:
    model = {"hex7bot": HEX7BOT, "puma260": PUMA260}.get(robot) or load_profile(robot).model
    drawn = {joint.name: joint.limits for joint in make_shapes(make_kinematics(robot)).joints}
    arm = make_arm(robot)
    assert [joint.name for joint in arm.joints] == list(model.names) == list(arm.shapes.driven)
    for joint, own in zip(arm.joints, model.joints, strict=True):
        low, high, _ = drawn[joint.name]
        assert max(low, own.minimum) <= joint.lower <= max(low, own.minimum) + 1e-4
        assert min(high, own.maximum) - 1e-4 <= joint.upper <= min(high, own.maximum)
        assert joint.speed == own.max_speed
        own.check(joint.lower)
        own.check(joint.upper)


@pytest.mark.parametrize("robot", arms_with_geometry())
def test_poses_are_those_of_the_ros_1_package(robot: str) -> None:
    file = yaml.safe_load((CONFIG / f"{robot}.yaml").read_text(encoding="utf-8"))
    arm = make_arm(robot)
    assert {pose.name: dict(pose.positions) for pose in arm.poses if pose.group == ARM_GROUP} == file["poses"]
    assert arm.pose_speed == file["pose_speed"]


@pytest.mark.parametrize("robot", arms_with_geometry())
def test_poses_are_allowed(robot: str) -> None:
    arm = make_arm(robot)
    limits = {joint.name: joint for joint in arm.joints}
    for pose in arm.poses:
        for name, angle in pose.positions.items():
            assert limits[name].lower <= angle <= limits[name].upper, (pose.name, name)
        if pose.group == ARM_GROUP:
            assert set(pose.positions) == set(arm.arm_joints)
            assert not arm.kinematics.violations(arm.kinematics.from_joints(pose.positions)), pose.name


def test_gripper_of_the_7bot_has_its_two_jaws() -> None:
    arm = make_arm("hex7bot")
    assert arm.gripper_joints == ("J7", "J7_left", "J7_right")
    assert arm.groups == {ARM_GROUP: ("J1", "J2", "J3", "J4", "J5", "J6"), GRIPPER_GROUP: ("J7",)}
    opened, closed = (pose for pose in arm.poses if pose.group == GRIPPER_GROUP)
    assert (opened.name, closed.name) == ("open", "closed")
    # The upper limit is closed.
    assert opened.positions["J7"] == pytest.approx(-math.pi / 4, abs=1e-4)
    assert closed.positions["J7"] == pytest.approx(math.pi / 4, abs=1e-4)


def test_gripper_of_the_so_arms_opens_upwards() -> None:
    arm = make_arm("so101")
    assert arm.gripper_joints == ("gripper",)
    angles = {pose.name: pose.positions["gripper"] for pose in arm.poses if pose.group == GRIPPER_GROUP}
    assert angles["closed"] < 0 < angles["open"]


def test_puma_has_no_gripper() -> None:
    arm = make_arm("puma260")
    assert arm.jaws is None
    assert arm.gripper_joints == ()
    assert list(arm.groups) == [ARM_GROUP]


def test_link_sets_are_named_and_own_ones_are_files(tmp_path: Path) -> None:
    assert make_arm("hex7bot", "b").links == "B"
    assert make_arm("so101").links == ""
    own = tmp_path / "A.toml"
    lengths = {key: 1e3 * getattr(replace(LINK_SETS["A"]), key) for key in "abcdefgh"}
    lines = [f"{key} = {value + (key == 'a')}" for key, value in lengths.items()]
    own.write_text('name = "A"\noffset = 90.0\n' + "\n".join(lines), encoding="utf-8")
    # Its name is that of a published set, but it is another.
    assert make_arm("hex7bot", str(own)).links == str(own)


def test_arm_without_a_geometry_is_refused() -> None:
    with pytest.raises(UsageError, match="no geometry is known for robot 'sevenbot'"):
        make_arm("sevenbot")
