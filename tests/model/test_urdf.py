from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree
from dataclasses import replace

import pinocchio
import pytest
from tests.model.poses import pose_error, random_angles

from hexwire.drivers.arm_file import load_profile
from hexwire.errors import UsageError
from hexwire.model.arm import ArmModel
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.model.arms.hex7bot.kinematics import Hex7BotModel
from hexwire.model.arms.hex7bot.links import LINK_SETS
from hexwire.model.arms.hex7bot.shapes import LEVEL_JOINT
from hexwire.model.arms.puma260.kinematics import PUMA260, Puma260Model
from hexwire.model.arms.so_arm.kinematics import SoArmModel
from hexwire.model.arms.so_arm.links import SO_ARMS
from hexwire.model.geometry import make_shapes
from hexwire.model.kinematics import KinematicModel
from hexwire.model.pose import Pose
from hexwire.model.urdf import ROOT_LINK, TIP_LINK, make_urdf

# An arm whose signs are not all alike: a wrong sign must not hide behind a one.
MIXED = ArmModel(
    "mixed", tuple(replace(j, sign=(-1) ** i, offset=0.1 * i - 0.2) for i, j in enumerate(HEX7BOT.joints))
)
SEVEN = [Hex7BotModel(links, arm) for links in LINK_SETS.values() for arm in (HEX7BOT, MIXED)]


SO_MODELS = [SoArmModel(links) for links in SO_ARMS.values()]


def pinocchio_pose(text: str, joints: dict[str, float]) -> Pose:
    """Pose of the tool as Pinocchio computes it from the file."""
    model = pinocchio.buildModelFromXML(text)
    data = model.createData()
    q = pinocchio.neutral(model)
    for name, angle in joints.items():
        q[model.joints[model.getJointId(name)].idx_q] = angle
    pinocchio.framesForwardKinematics(model, data, q)
    frame = data.oMf[model.getFrameId(TIP_LINK)]
    x, y, z = (float(v) for v in frame.translation)
    a, b, c = (tuple(float(v) for v in row) for row in frame.rotation)
    return Pose((x, y, z), (a, b, c))  # type: ignore[arg-type]


@pytest.mark.parametrize("model", SEVEN, ids=lambda m: f"{m.links.name}-{m.arm.name}")
def test_pinocchio_agrees_on_the_7bot(model: Hex7BotModel) -> None:
    text = make_urdf(model)
    for angles in random_angles(11, 25):
        joints = model.to_joints(angles)
        # Without its support for mimic joints Pinocchio takes the level joint as one of its own.
        joints[LEVEL_JOINT] = -joints["J2"]
        assert pose_error(pinocchio_pose(text, joints), model.forward(angles)) < 1e-9


def test_pinocchio_agrees_on_the_puma() -> None:
    model = Puma260Model()
    text = make_urdf(model)
    for angles in random_angles(12, 25):
        joints = dict(zip(PUMA260.names, angles, strict=True))
        assert pose_error(pinocchio_pose(text, joints), model.forward(angles)) < 1e-9


@pytest.mark.parametrize("model", SO_MODELS, ids=lambda m: m.name)
def test_pinocchio_agrees_on_the_so_arms(model: SoArmModel) -> None:
    text = make_urdf(model)
    for angles in random_angles(13, 25):
        joints = {**model.to_joints(angles[:5]), "gripper": angles[5]}
        assert pose_error(pinocchio_pose(text, joints), model.forward(angles[:5])) < 1e-9


def test_jaw_of_the_so_arms_opens_upwards_from_the_tip() -> None:
    for arm in SO_MODELS:
        text = make_urdf(arm)
        model = pinocchio.buildModelFromXML(text)
        data = model.createData()
        heights = []
        for angle in (0.0, 0.5):
            q = pinocchio.neutral(model)
            q[model.joints[model.getJointId("gripper")].idx_q] = angle
            pinocchio.framesForwardKinematics(model, data, q)
            jaw = data.oMf[model.getFrameId("jaw")]
            finger = jaw.rotation @ arm.links.finger + jaw.translation
            heights.append(finger[2])
            # About as far ahead as the fixed jaw, which it meets.
            assert 0.08 * math.cos(angle) < finger[0] - arm.wrist([0.0] * 5)[0] - arm.links.hand < 0.11
        tip = arm.forward([0.0] * 5).position[2]
        assert 0.0 < heights[0] - tip < 0.02
        assert heights[1] > heights[0] + 0.03


def test_masses_of_the_so_arms_are_the_published_ones() -> None:
    for arm in SO_MODELS:
        masses = [float(mass.get("value", "")) for mass in ElementTree.fromstring(make_urdf(arm)).iter("mass")]
        assert sorted(masses) == sorted(arm.links.masses)


@pytest.mark.parametrize("model", [*SEVEN[:1], Puma260Model(), *SO_MODELS], ids=lambda m: m.name)
def test_joints_limits_and_inertias_are_plausible(model: KinematicModel) -> None:
    root = ElementTree.fromstring(make_urdf(model))
    revolute = [joint for joint in root.findall("joint") if joint.get("type") == "revolute"]
    # Those that mimic others are no joints of the driver.
    names = [joint.get("name") for joint in revolute if joint.find("mimic") is None]
    arms = {"hex7bot": HEX7BOT, "puma260": PUMA260}
    arm = arms.get(model.name) or load_profile(model.name).model
    # The profile has the limits in rounded degrees.
    rounded = 1e-9 if model.name in arms else 1e-3
    assert names == list(arm.names)
    for joint in arm.joints:
        limit = root.find(f"joint[@name='{joint.name}']/limit")
        assert limit is not None
        assert float(limit.get("lower", "")) == pytest.approx(joint.minimum, abs=rounded)
        assert float(limit.get("upper", "")) == pytest.approx(joint.maximum, abs=rounded)
    for inertia in root.iter("inertia"):
        moments = sorted(float(inertia.get(k, "")) for k in ("ixx", "iyy", "izz"))
        assert moments[0] > 0
        # A body's two smaller moments are together at least the largest.
        assert moments[0] + moments[1] >= moments[2]


def test_level_joint_mimics_the_upper_arm() -> None:
    root = ElementTree.fromstring(make_urdf(SEVEN[0]))
    mimic = root.find(f"joint[@name='{LEVEL_JOINT}']/mimic")
    assert mimic is not None
    assert (mimic.get("joint"), float(mimic.get("multiplier", ""))) == ("J2", -1.0)
    lower = root.find(f"joint[@name='{LEVEL_JOINT}']/limit")
    assert lower is not None
    assert float(lower.get("lower", "")) == pytest.approx(-HEX7BOT.joint("J2").maximum)


def test_no_urdf_of_an_unknown_model() -> None:
    class Other(Puma260Model):
        pass

    assert "puma260" in make_urdf(Other())
    with pytest.raises(UsageError, match="no shapes are known for None"):
        make_urdf(type("Nothing", (), {"name": None})())


def test_every_digit_is_written() -> None:
    assert repr(math.pi / 2 + 0.087265) in make_urdf(SEVEN[0])


@pytest.mark.parametrize("model", [SEVEN[0], Puma260Model(), *SO_MODELS], ids=lambda model: model.name)
def test_the_root_is_rep_105s_and_without_matter(model: KinematicModel) -> None:
    root = ElementTree.fromstring(make_urdf(model))
    links = {link.attrib["name"]: link for link in root.findall("link")}
    children = {child.attrib["link"] for child in root.iter("child")}
    assert set(links) - children == {ROOT_LINK}
    assert not list(links[ROOT_LINK])


@pytest.mark.parametrize("model", [SEVEN[0], Puma260Model(), *SO_MODELS], ids=lambda model: model.name)
def test_every_part_has_a_colour_that_is_defined(model: KinematicModel) -> None:
    root = ElementTree.fromstring(make_urdf(model))
    colours = {}
    for material in root.findall("material"):
        colour = material.find("color")
        assert colour is not None
        colours[material.attrib["name"]] = [float(part) for part in colour.attrib["rgba"].split()]
    assert all(len(rgba) == 4 and rgba[3] == 1.0 and max(rgba) <= 1.0 for rgba in colours.values())
    used = {material.attrib["name"] for link in root.findall("link") for material in link.iter("material")}
    assert used == set(colours)
    # Joints, and at least three sorts of parts.
    joints = {joint.attrib["name"] for joint in root.findall("joint")}
    assert len(used & joints) >= 6
    assert len(used - joints) >= 3


@pytest.mark.parametrize("model", [*SEVEN, Puma260Model(), *SO_MODELS], ids=lambda model: model.name)
def test_parts_are_where_the_shapes_are(model: KinematicModel) -> None:
    shapes = make_shapes(model)
    root = ElementTree.fromstring(make_urdf(model))
    for link in shapes.links:
        row = root.find(f"link[@name='{link.name}']")
        assert row is not None
        for kind, expected in (("visual", link.shapes), ("collision", [s for s in link.shapes if s.solid])):
            parts = row.findall(kind)
            assert len(parts) == len(expected)
            for part, shape in zip(parts, expected, strict=True):
                origin, form = part.find("origin"), part.find("geometry/*")
                assert origin is not None
                assert form is not None
                numbers = [float(n) for key in ("xyz", "rpy") for n in origin.attrib[key].split()]
                assert numbers == [*shape.place, *shape.rpy]
                assert form.tag == shape.kind
                assert [float(n) for text in form.attrib.values() for n in text.split()] == list(shape.size)


@pytest.mark.parametrize("model", [SEVEN[0], Puma260Model(), *SO_MODELS], ids=lambda model: model.name)
def test_pinocchio_sees_the_parts_where_the_shapes_have_them(model: KinematicModel) -> None:
    shapes, text = make_shapes(model), make_urdf(model)
    tree = pinocchio.buildModelFromXML(text)
    seen = pinocchio.buildGeomFromUrdfString(tree, text, pinocchio.GeometryType.VISUAL)
    positions = {name: 0.2 + 0.1 * i for i, name in enumerate(shapes.driven)}
    q = pinocchio.neutral(tree)
    for joint in shapes.joints:
        if joint.drive is not None:
            lead = joint.drive
            q[tree.joints[tree.getJointId(joint.name)].idx_q] = (
                lead.multiplier * positions[lead.joint] + lead.offset
            )
    data, drawn = tree.createData(), seen.createData()
    pinocchio.forwardKinematics(tree, data, q)
    pinocchio.updateGeometryPlacements(tree, data, seen, drawn)
    # Named after their link, with a number.
    found = {part.name: place for part, place in zip(seen.geometryObjects, drawn.oMg, strict=True)}
    counts: dict[str, int] = {}
    for link, shape, pose in shapes.placed(positions):
        number = counts.setdefault(link.name, 0)
        counts[link.name] += 1
        place = found.pop(f"{link.name}_{number}")
        assert math.dist(place.translation, pose.position) < 1e-9, (link.name, shape.name)
        assert place.rotation.tolist() == [pytest.approx(row, abs=1e-9) for row in pose.rotation]
    assert not found


def test_both_jaws_and_the_rod_mimic_joints_of_the_driver() -> None:
    root = ElementTree.fromstring(make_urdf(SEVEN[0]))
    leads = {}
    for joint in root.findall("joint"):
        mimic = joint.find("mimic")
        if mimic is not None:
            leads[joint.attrib["name"]] = (
                mimic.attrib["joint"],
                math.copysign(1.0, float(mimic.attrib["multiplier"])),
            )
    assert leads["J7_left"] == leads["J7_right"] == ("J7", -1.0)
    assert {lead for lead, _ in leads.values()} == {"J2", "J3", "J7"}
    assert not {joint.name for joint in HEX7BOT.joints} & set(leads)
