from __future__ import annotations

import json
import math
from dataclasses import replace
from typing import Any

import pytest
from tests.model.poses import pose_error, random_angles

from hexwire.drivers.arm_file import load_profile
from hexwire.errors import UsageError
from hexwire.model.arm import ArmModel
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.model.arms.puma260.kinematics import PUMA260
from hexwire.model.geometry import kinematics_for, make_shapes
from hexwire.model.palette import DARK, LIGHT
from hexwire.model.pose import Matrix, Pose, Vector, multiply, rotation_about
from hexwire.model.shapes import moved
from hexwire.studio.geometry import make_geometry, make_turns

ARMS = [HEX7BOT, PUMA260, load_profile("so100").model, load_profile("so101").model]


def _matrix(turn: list[float]) -> Matrix:
    x, y, z, w = turn
    angle = 2 * math.atan2(math.hypot(x, y, z), w)
    length = math.hypot(x, y, z) or 1.0
    return rotation_about((x / length, y / length, z / length), angle)


def _poses(geometry: dict[str, Any], joints: list[float]) -> list[Pose]:
    """The poses of the links as the browser computes them: with nothing but the JSON."""
    poses: list[Pose] = []
    for link in geometry["links"]:
        before = poses[link["parent"]] if link["parent"] >= 0 else Pose((0.0, 0.0, 0.0))
        place: Vector = tuple(link["place"])
        turned = multiply(before.rotation, _matrix(link["turn"]))
        if "axis" in link:
            angle = link["multiplier"] * joints[link["joint"]] + link["offset"]
            turned = multiply(turned, rotation_about(tuple(link["axis"]), angle))
        poses.append(Pose(moved(before, place), turned))
    return poses


@pytest.mark.parametrize("arm", ARMS, ids=lambda arm: arm.name)
def test_the_browsers_tip_is_that_of_the_kinematics(arm: ArmModel) -> None:
    geometry = json.loads(json.dumps(make_geometry(arm)))
    model = kinematics_for(arm)
    assert model is not None
    for angles in random_angles(51, 20):
        own = angles[: len(model.ranges)]
        joints = model.to_joints(own)
        tip = _poses(geometry, [joints.get(name, 0.3) for name in arm.names])[geometry["tip"]]
        pose = model.forward(own)
        # A hundredth of a millimetre.
        assert math.dist(tip.position, pose.position) < 1e-5
        assert sum(math.dist(a, b) for a, b in zip(tip.rotation, pose.rotation, strict=True)) < 1e-5


@pytest.mark.parametrize("arm", ARMS, ids=lambda arm: arm.name)
def test_the_browsers_links_are_those_of_every_other_picture(arm: ArmModel) -> None:
    geometry, model = json.loads(json.dumps(make_geometry(arm))), kinematics_for(arm)
    assert model is not None
    shapes = make_shapes(model)
    joints = {name: 0.1 * i - 0.3 for i, name in enumerate(arm.names)}
    for link, pose in zip(geometry["links"], _poses(geometry, list(joints.values())), strict=True):
        assert pose_error(pose, shapes.poses(joints)[link["name"]]) < 1e-5, link["name"]


def test_joints_are_in_the_drivers_order_with_the_arms_own_limits() -> None:
    arm = load_profile("so101").model
    narrow = replace(arm, joints=tuple(replace(joint, maximum=0.25) for joint in reversed(arm.joints)))
    geometry = make_geometry(narrow)
    assert geometry is not None
    assert [joint["name"] for joint in geometry["joints"]] == list(narrow.names)
    assert {joint["maximum"] for joint in geometry["joints"]} == {0.25}
    jaw = next(link for link in geometry["links"] if link["name"] == "jaw")
    assert narrow.names[jaw["joint"]] == "gripper"


def test_an_arm_without_lengths_has_no_geometry() -> None:
    assert make_geometry(load_profile("chain").model) is None


def test_a_wrong_link_set_is_refused() -> None:
    with pytest.raises(UsageError, match="no link set 'Z'"):
        make_geometry(HEX7BOT, "Z")
    assert make_geometry(HEX7BOT, "V1") != make_geometry(HEX7BOT)


@pytest.mark.parametrize("arm", ARMS, ids=lambda arm: arm.name)
def test_shapes_have_a_colour_and_parents_come_first(arm: ArmModel) -> None:
    geometry = make_geometry(arm)
    assert geometry is not None
    assert geometry["palette"] == {"light": LIGHT, "dark": DARK}
    shapes = 0
    for i, link in enumerate(geometry["links"]):
        assert -1 <= link["parent"] < i
        for shape in link["shapes"]:
            shapes += 1
            assert 0 <= shape["joint"] < len(arm.names) if "joint" in shape else shape["colour"] in COLOUR_NAMES
            assert math.hypot(*shape["turn"]) == pytest.approx(1.0)
    assert shapes > 20
    assert len(json.dumps(geometry)) < 16_000


COLOUR_NAMES = {"base", "frame", "servo", "print", "paint", "jaw", "pad"}


@pytest.mark.parametrize(
    ("arm", "heading"), [(HEX7BOT, math.pi / 2), (load_profile("so101").model, 0.0)], ids=lambda v: str(v)[:9]
)
def test_heading_is_where_the_arm_points_at_0(arm: ArmModel, heading: float) -> None:
    geometry = make_geometry(arm)
    assert geometry is not None
    assert geometry["heading"] == pytest.approx(heading)


@pytest.mark.parametrize("arm", ARMS, ids=lambda arm: arm.name)
def test_the_tip_is_within_reach(arm: ArmModel) -> None:
    geometry, model = make_geometry(arm), kinematics_for(arm)
    assert geometry is not None
    assert model is not None
    far = max(math.hypot(*model.forward(a[: len(model.ranges)]).position) for a in random_angles(52, 300))
    assert 0.75 * geometry["reach"] < far < geometry["reach"]


def test_pitch_and_roll_of_the_tool_are_sums_that_a_browser_computes() -> None:
    model = load_profile("so101").model
    kinematics = kinematics_for(model)
    assert kinematics is not None
    turns = make_turns(model, kinematics)
    assert turns is not None
    angles = random_angles(7, 1)[0][: len(kinematics.ranges)]
    positions = [kinematics.to_joints(angles).get(name, 0.0) for name in model.names]
    sums = [row["offset"] + sum(f * positions[i] for i, f in row["factors"].items()) for row in turns]
    assert sums == pytest.approx(kinematics.pitch_and_roll(angles))


def test_an_arm_of_six_joints_has_no_such_sums() -> None:
    kinematics = kinematics_for(HEX7BOT)
    assert kinematics is not None
    assert make_turns(HEX7BOT, kinematics) is None
