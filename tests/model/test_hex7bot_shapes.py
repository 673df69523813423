from __future__ import annotations

import math
from dataclasses import replace

import pytest
from tests.model.poses import random_angles
from tests.model.solids import distance, loose, placed, positions_within

from hexwire.model.arm import ArmModel
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.model.arms.hex7bot.kinematics import Hex7BotModel
from hexwire.model.arms.hex7bot.links import LINK_SETS, parse_link_set
from hexwire.model.arms.hex7bot.shapes import LEVEL_JOINT, make_hex7bot_shapes
from hexwire.model.geometry import make_kinematics
from hexwire.model.pose import IDENTITY
from hexwire.model.shapes import moved

# An arm whose signs and offsets are not all alike.
MIXED = ArmModel(
    "mixed", tuple(replace(j, sign=(-1) ** i, offset=0.1 * i - 0.2) for i, j in enumerate(HEX7BOT.joints))
)
MODELS = [Hex7BotModel(links, arm) for links in LINK_SETS.values() for arm in (HEX7BOT, MIXED)]
OPEN, CLOSED = HEX7BOT.joint("J7").minimum, HEX7BOT.joint("J7").maximum


@pytest.mark.parametrize("model", MODELS, ids=lambda m: f"{m.links.name}-{m.arm.name}")
def test_tip_elbow_and_wrist_are_those_of_the_kinematics(model: Hex7BotModel) -> None:
    shapes = make_hex7bot_shapes(model)
    for angles in random_angles(21, 40):
        poses = shapes.poses(model.to_joints(angles))
        tip = model.forward(angles)
        assert math.dist(poses[shapes.tip].position, tip.position) < 1e-5
        for mine, theirs in zip(poses[shapes.tip].rotation, tip.rotation, strict=True):
            assert mine == pytest.approx(theirs, abs=1e-9)
        assert math.dist(poses["forearm"].position, model.elbow(angles)) < 1e-5
        assert math.dist(poses["hand"].position, model.wrist(angles)) < 1e-5


@pytest.mark.parametrize("name", sorted(LINK_SETS))
def test_no_part_floats(name: str) -> None:
    shapes = make_hex7bot_shapes(Hex7BotModel(LINK_SETS[name]))
    for positions in positions_within(shapes, 22, 6):
        assert loose(shapes, positions) == set()


def test_a_link_set_of_somebodys_own_has_shapes_too() -> None:
    text = "a=60\nb=0\nc=90\nd=0\ne=0\nf=0\ng=0\nh=0\noffset=90\n"
    shapes = make_hex7bot_shapes(Hex7BotModel(parse_link_set(text)))
    assert all(min(shape.size) > 0 for link in shapes.links for shape in link.shapes)


@pytest.mark.parametrize("model", MODELS, ids=lambda m: f"{m.links.name}-{m.arm.name}")
def test_the_rod_ends_at_the_forearms_lever(model: Hex7BotModel) -> None:
    shapes, k = make_hex7bot_shapes(model), model.links
    for angles in random_angles(23, 10):
        poses = shapes.poses(model.to_joints(angles))
        lever = moved(poses["forearm"], (-k.b, 0.0, 0.0))
        assert math.dist(moved(poses["rod"], (0.0, 0.0, k.a)), lever) < 1e-9
        assert math.dist(poses["rod"].position, moved(poses["crank"], (-k.b, 0.0, 0.0))) < 1e-9


def test_the_elbows_frame_stays_level() -> None:
    shapes = make_hex7bot_shapes(Hex7BotModel())
    assert next(joint for joint in shapes.joints if joint.name == LEVEL_JOINT).follows
    poses = shapes.poses({"J1": HEX7BOT.joint("J1").offset - math.pi / 2, "J2": 0.7})
    for mine, level in zip(poses["elbow"].rotation, IDENTITY, strict=True):
        assert mine == pytest.approx(level, abs=1e-9)


@pytest.mark.parametrize("name", sorted(LINK_SETS))
def test_jaws_meet_at_the_tip_and_open(name: str) -> None:
    model = Hex7BotModel(LINK_SETS[name])
    shapes = make_hex7bot_shapes(model)

    def gap(position: float) -> float:
        pads = [solid for link, shape, solid in placed(shapes, {"J7": position}) if shape.name == "pad"]
        assert len(pads) == 2
        return distance(*pads)

    closed, half, wide = gap(CLOSED), gap(0.5 * (OPEN + CLOSED)), gap(OPEN)
    assert closed < 0.001
    assert 0.004 < half < wide
    assert wide > 0.02
    # The pads end where the tool's tip is.
    tip = shapes.poses({"J7": CLOSED})[shapes.tip].position
    ends = [
        moved(pose, (0.0, 0.0, 0.5 * shape.size[2]))
        for _, shape, pose in shapes.placed({"J7": CLOSED})
        if shape.name == "pad"
    ]
    assert [math.dist(end, tip) < 0.002 for end in ends] == [True, True]


def test_the_forearm_is_beside_the_elbow_and_joined_to_it() -> None:
    shapes = make_hex7bot_shapes(Hex7BotModel())
    solids = {(link, shape.name): solid for link, shape, solid in placed(shapes, {})}
    beam = next(shape for shape in shapes.link("forearm").shapes if shape.name == "beam")
    assert beam.place[2] == pytest.approx(Hex7BotModel().links.h)
    assert distance(solids["forearm", "beam"], solids["forearm", "plate_left"]) <= 0
    assert distance(solids["forearm", "elbow_axle"], solids["upper_arm", "plate_high_left"]) <= 0


def test_limits_are_those_of_the_arm() -> None:
    shapes = make_hex7bot_shapes(Hex7BotModel())
    joints = {joint.name: joint for joint in shapes.joints}
    for joint in HEX7BOT.joints:
        assert joints[joint.name].limits == (joint.minimum, joint.maximum, joint.max_speed)
    low, high, _ = joints["J7_left"].limits
    assert (low, high) == pytest.approx((0.0, math.radians(40.0)))
    assert make_kinematics("hex7bot").name == shapes.name
