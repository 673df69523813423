"""Transforms between the frames of an arm: the same frames as in its URDF, at the same places as its shapes."""

from __future__ import annotations

import math
from typing import Any
from xml.etree import ElementTree

import pytest

from hexwire.model.geometry import kinematics_or_none, make_shapes
from hexwire.model.pose import multiply, rotation_about
from hexwire.model.shapes import moved
from hexwire.model.urdf import make_urdf
from hexwire.ros2.reports import TRANSFORMS, Transforms
from zenoh_ros2.types import Types

ARMS = ("hex7bot", "puma260", "so100", "so101")
TYPES = Types()


def made(arm: str) -> tuple[Any, Transforms]:
    kinematics = kinematics_or_none(arm)
    assert kinematics is not None
    return kinematics, Transforms(TYPES, make_shapes(kinematics))


def rows(message: Any) -> dict[str, Any]:
    type_ = TYPES.message(TRANSFORMS)
    again = type_.parse(type_.serialize(message))
    return {each.child_frame_id: each for each in again.transforms}


def rotation(q: Any) -> Any:
    angle = 2.0 * math.acos(max(-1.0, min(1.0, q.w)))
    if angle < 1e-9:
        return rotation_about((0.0, 0.0, 1.0), 0.0)
    n = math.sin(angle / 2.0)
    return rotation_about((q.x / n, q.y / n, q.z / n), angle)


@pytest.mark.parametrize("arm", ARMS)
def test_the_frames_are_those_of_the_urdf(arm: str) -> None:
    kinematics, transforms = made(arm)
    stamp = TYPES.message("builtin_interfaces/msg/Time")(sec=5)
    fixed, moving = (
        rows(transforms.fixed(stamp)),
        rows(transforms.moving(dict.fromkeys(kinematics_joints(arm), 0.0), stamp)),
    )
    assert not set(fixed) & set(moving)
    joints = ElementTree.fromstring(make_urdf(kinematics)).findall("joint")
    assert {row.find("child").get("link"): row.find("parent").get("link") for row in joints} == {  # type: ignore[union-attr]
        child: each.header.frame_id for child, each in (fixed | moving).items()
    }
    assert {row.find("child").get("link") for row in joints if row.get("type") == "fixed"} == set(fixed)  # type: ignore[union-attr]
    assert all(each.header.stamp.sec == 5 for each in (fixed | moving).values())


def kinematics_joints(arm: str) -> tuple[str, ...]:
    kinematics = kinematics_or_none(arm)
    assert kinematics is not None
    return make_shapes(kinematics).driven


@pytest.mark.parametrize("arm", ARMS)
def test_every_link_is_where_the_shapes_are(arm: str) -> None:
    kinematics, transforms = made(arm)
    shapes = make_shapes(kinematics)
    positions = {name: 0.1 + 0.2 * i for i, name in enumerate(shapes.driven)}
    stamp = TYPES.message("builtin_interfaces/msg/Time")()
    found = rows(transforms.fixed(stamp)) | rows(transforms.moving(positions, stamp))
    wanted = shapes.poses(positions)
    for joint in shapes.joints:
        parent, row = wanted[joint.parent], found[joint.child].transform
        place = moved(parent, (row.translation.x, row.translation.y, row.translation.z))
        assert place == pytest.approx(wanted[joint.child].position, abs=1e-9)
        turned = multiply(parent.rotation, rotation(row.rotation))
        for line, wanted_line in zip(turned, wanted[joint.child].rotation, strict=True):
            assert line == pytest.approx(wanted_line, abs=1e-9)


def test_a_joint_whose_position_is_unknown_has_no_transform() -> None:
    _, transforms = made("hex7bot")
    stamp = TYPES.message("builtin_interfaces/msg/Time")()
    found = rows(transforms.moving({"J1": 0.5}, stamp))
    assert len(found) == 1
