from __future__ import annotations

import math
import re

import pytest
from tests.model.poses import pose_error

from hexwire.model.geometry import make_kinematics, make_shapes
from hexwire.model.pose import IDENTITY, Pose, column, rotation_from_rpy, rotation_z
from hexwire.model.shapes import (
    COLOURS,
    ArmShapes,
    Drive,
    ShapeJoint,
    ShapeLink,
    bar,
    box,
    cylinder,
    mirrored,
    moved,
    rod,
)

ARMS = ("hex7bot", "so100", "so101", "puma260")
QUARTER = math.pi / 2


def tower() -> ArmShapes:
    """Two links over each other, the upper one turned about z by `turn`; a third that follows it the other way."""
    joints = (
        ShapeJoint("turn", "foot", "top", (0.0, 0.0, 1.0), axis=(0.0, 0.0, 1.0), drive=Drive("turn")),
        ShapeJoint("back", "top", "level", (1.0, 0.0, 0.0), axis=(0.0, 0.0, 1.0), drive=Drive("turn", -1.0, 0.5)),
    )
    links = (
        ShapeLink("foot"),
        ShapeLink("top", (box("block", "frame", (0.1, 0.2, 0.3), (0.5, 0.0, 0.0)),)),
        ShapeLink("level"),
    )
    return ArmShapes("tower", links, joints, "level", "here", "")


def test_links_follow_their_joints() -> None:
    poses = tower().poses({"turn": QUARTER})
    assert pose_error(poses["top"], Pose((0.0, 0.0, 1.0), rotation_z(QUARTER))) < 1e-12
    assert pose_error(poses["level"], Pose((0.0, 1.0, 1.0), rotation_z(0.5))) < 1e-12


def test_a_joint_without_a_position_is_at_0() -> None:
    assert pose_error(tower().poses({})["top"], Pose((0.0, 0.0, 1.0), IDENTITY)) < 1e-12


def test_shapes_are_placed_with_their_links() -> None:
    ((link, shape, pose),) = tower().placed({"turn": QUARTER})
    assert (link.name, shape.name) == ("top", "block")
    assert pose_error(pose, Pose((0.0, 0.5, 1.0), rotation_z(QUARTER))) < 1e-12


def test_driven_joints_are_those_that_do_not_only_follow() -> None:
    assert tower().driven == ("turn",)
    assert [joint.follows for joint in tower().joints] == [False, True]


def test_forms_by_their_ends() -> None:
    for made, start, end in (
        (rod("r", "frame", (1.0, 2.0, 3.0), (1.5, 1.0, 4.0), 0.1), (1.0, 2.0, 3.0), (1.5, 1.0, 4.0)),
        (rod("r", "frame", (0.0, 0.0, 1.0), (0.0, 0.0, -1.0), 0.1), (0.0, 0.0, 1.0), (0.0, 0.0, -1.0)),
    ):
        half = made.size[1] / 2
        pose = Pose(made.place, made.rotation)
        assert moved(pose, (0.0, 0.0, -half)) == pytest.approx(start)
        assert moved(pose, (0.0, 0.0, half)) == pytest.approx(end)
    flat = bar("b", "frame", (0.0, 0.3, 0.0), (1.0, 0.3, 2.0), 0.2, 0.1)
    assert flat.size == pytest.approx((math.sqrt(5), 0.2, 0.1))
    pose = Pose(flat.place, flat.rotation)
    assert moved(pose, (math.sqrt(5) / 2, 0.0, 0.0)) == pytest.approx((1.0, 0.3, 2.0))
    other = mirrored(flat)
    assert moved(Pose(other.place, other.rotation), (-math.sqrt(5) / 2, 0.0, 0.0)) == pytest.approx(
        (-1.0, 0.3, 2.0)
    )


@pytest.mark.parametrize(("along", "axis"), [("x", (1, 0, 0)), ("y", (0, 1, 0)), ("z", (0, 0, 1))])
def test_a_cylinder_lies_along_its_axis(along: str, axis: tuple[int, ...]) -> None:
    made = cylinder("c", "frame", 0.1, 0.2, (0.0, 0.0, 0.0), along)  # type: ignore[arg-type]
    assert column(rotation_from_rpy(*made.rpy), 2) == pytest.approx(axis)
    assert (made.colour, made.joint) == ("frame", "")


def test_every_colour_is_written_for_both_backgrounds() -> None:
    for pair in COLOURS.values():
        assert len(pair) == 2
        assert all(re.fullmatch("#[0-9a-f]{6}", colour) for colour in pair)
    assert "joint" not in COLOURS


@pytest.mark.parametrize("robot", ARMS)
def test_an_arm_is_a_tree_of_named_parts(robot: str) -> None:
    shapes = make_shapes(make_kinematics(robot))
    names = [link.name for link in shapes.links]
    assert len(set(names)) == len(names)
    # Each joint comes after that of its parent, and each link but the first is behind one joint.
    known = {names[0]}
    for joint in shapes.joints:
        assert joint.parent in known
        assert joint.child not in known
        assert (joint.axis is None) == (joint.drive is None)
        assert joint.axis is None or math.hypot(*joint.axis) == pytest.approx(1.0)
        assert joint.drive is None or joint.drive.joint in shapes.driven
        known.add(joint.child)
    assert known == set(names)
    assert shapes.tip in known
    assert len({joint.name for joint in shapes.joints}) == len(shapes.joints)
    for link in shapes.links:
        assert len({shape.name for shape in link.shapes}) == len(link.shapes)
        for shape in link.shapes:
            assert len(shape.size) == {"box": 3, "cylinder": 2, "sphere": 1}[shape.kind]
            assert min(shape.size) > 0
            assert shape.joint in shapes.driven if shape.colour == "joint" else shape.colour in COLOURS


@pytest.mark.parametrize("robot", ARMS)
def test_every_joint_of_an_arm_is_seen_in_its_colour(robot: str) -> None:
    shapes = make_shapes(make_kinematics(robot))
    assert {shape.joint for link in shapes.links for shape in link.shapes} - {""} == set(shapes.driven)


SIZES = [("hex7bot", 0.6, 1.5), ("so100", 0.2, 0.9), ("so101", 0.2, 0.7), ("puma260", 4.0, 9.0)]
"""Arms with about what the heaviest part weighs, and all together, kilograms."""


@pytest.mark.parametrize(("robot", "part", "total"), SIZES)
def test_parts_are_as_large_and_as_heavy_as_those_of_an_arm(robot: str, part: float, total: float) -> None:
    shapes = make_shapes(make_kinematics(robot))
    for link in shapes.links:
        for shape in link.shapes:
            assert max(shape.size) < 0.3, f"{link.name}/{shape.name}: {shape.size}"
            assert max(map(abs, shape.place)) < 0.35, f"{link.name}/{shape.name}: {shape.place}"
    masses = [link.inertia.mass for link in shapes.links if link.inertia]
    assert 0.0 < min(masses) <= max(masses) <= part
    assert total / 2 < sum(masses) < total


@pytest.mark.parametrize("robot", ARMS)
def test_the_mass_of_a_part_is_where_the_part_is(robot: str) -> None:
    for link in make_shapes(make_kinematics(robot)).links:
        for end in (link.inertia.start, link.inertia.end) if link.inertia else ():
            # From a ball around each of its solids.
            beyond = [math.dist(end, shape.place) - math.hypot(*shape.size) / 2 for shape in link.shapes]
            assert min(beyond) < 0.13, f"{link.name}: {end}"


def test_turret_and_upper_arm_are_the_same_on_both_sides() -> None:
    for link in make_shapes(make_kinematics("hex7bot")).links:
        parts = {shape.name: shape for shape in link.shapes if link.name in ("turret", "upper_arm")}
        for name, left in parts.items():
            if name.endswith("_left"):
                right, (x, y, z) = parts[name.replace("left", "right")], left.place
                assert right.place == pytest.approx((x, -y, z)), name
                assert right.size == left.size, name


def test_solids_hit_something_unless_they_are_only_there_to_be_seen() -> None:
    origin = (0.0, 0.0, 0.0)
    assert cylinder("c", "frame", 0.1, 0.2, origin).solid
    assert not cylinder("c", "frame", 0.1, 0.2, origin, solid=False).solid
    assert box("b", "frame", (0.1, 0.2, 0.3), origin).solid
    assert rod("r", "frame", origin, (0.0, 0.0, 1.0), 0.1).solid
    assert bar("b", "frame", origin, (0.0, 0.0, 1.0), 0.1, 0.1).solid
