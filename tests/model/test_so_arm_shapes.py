from __future__ import annotations

import math

import pytest
from tests.model.poses import pose_error, random_angles
from tests.model.solids import distance, loose, placed, positions_within

from hexwire.model.arms.so_arm.kinematics import SoArmModel
from hexwire.model.arms.so_arm.links import SO_ARMS
from hexwire.model.arms.so_arm.shapes import make_so_arm_shapes

MODELS = [SoArmModel(links) for links in SO_ARMS.values()]


@pytest.mark.parametrize("model", MODELS, ids=lambda m: m.name)
def test_the_tip_is_that_of_the_kinematics(model: SoArmModel) -> None:
    shapes = make_so_arm_shapes(model)
    for angles in random_angles(31, 40):
        poses = shapes.poses({**model.to_joints(angles[:5]), "gripper": angles[5]})
        assert pose_error(poses[shapes.tip], model.forward(angles[:5])) < 1e-5


@pytest.mark.parametrize("model", MODELS, ids=lambda m: m.name)
def test_no_part_floats(model: SoArmModel) -> None:
    shapes = make_so_arm_shapes(model)
    for positions in positions_within(shapes, 32, 6):
        assert loose(shapes, positions) == set()


@pytest.mark.parametrize("model", MODELS, ids=lambda m: m.name)
def test_the_jaw_opens_from_the_pad_at_the_tip(model: SoArmModel) -> None:
    shapes = make_so_arm_shapes(model)

    def gap(position: float) -> float:
        solids = {shape.name: solid for _, shape, solid in placed(shapes, {"gripper": position})}
        return distance(solids["fixed_pad"], solids["jaw_pad"])

    low, high = model.links.jaw_range
    gaps = [gap(low + share * (high - low)) for share in (0.0, 0.25, 0.5, 1.0)]
    assert 0.0 < gaps[0] < 0.008
    assert gaps == sorted(gaps)
    assert gaps[-1] > 0.05
    # The end of the fixed jaw's inner face is the tip.
    pad = next(shape for shape in shapes.link("gripper_body").shapes if shape.name == "fixed_pad")
    ahead, below, left = model.links.tip
    end = pad.place[0] + 0.5 * pad.size[0] * math.cos(pad.rpy[1])
    assert end == pytest.approx(ahead, abs=0.001)
    assert pad.place[1] == pytest.approx(left)
    assert pad.place[2] - 0.5 * pad.size[0] * math.sin(pad.rpy[1]) == pytest.approx(-below, abs=0.0015)


@pytest.mark.parametrize("model", MODELS, ids=lambda m: m.name)
def test_limits_and_masses_are_the_published_ones(model: SoArmModel) -> None:
    shapes = make_so_arm_shapes(model)
    joints = {joint.name: joint for joint in shapes.joints}
    for limit in model.ranges:
        assert joints[limit.name].limits[:2] == (limit.minimum, limit.maximum)
    assert joints["gripper"].limits[:2] == model.links.jaw_range
    masses = [link.inertia.mass for link in shapes.links if link.inertia is not None]
    assert sorted(masses) == sorted(model.links.masses)
