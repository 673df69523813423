"""The links against the chains of the public models, joint by joint."""

from __future__ import annotations

import math
import random

import pytest

from hexwire.drivers.arm_file import load_profile
from hexwire.model.arms.so_arm.kinematics import SoArmModel
from hexwire.model.arms.so_arm.links import SO_ARMS
from hexwire.model.pose import IDENTITY, Matrix, Pose, Vector, apply, multiply, rotation_from_rpy, rotation_z

Row = tuple[Vector, Vector, Vector]
"""Of a joint: place and roll, pitch, yaw of its frame in that of the link before; its axis."""

ZERO: Vector = (0.0, 0.0, 0.0)
Z: Vector = (0.0, 0.0, 1.0)
# TheRobotStudio/SO-ARM100, Simulation/SO101/so101_new_calib.urdf at 385e8d7; the last row: its gripper_frame_joint.
SO101: tuple[Row, ...] = (
    ((0.0388353, -8.97657e-09, 0.0624), (3.14159, 4.18253e-17, -3.14159), Z),
    ((-0.0303992, -0.0182778, -0.0542), (-1.5708, -1.5708, 0.0), Z),
    ((-0.11257, -0.028, 1.73763e-16), (-3.63608e-16, 8.74301e-16, 1.5708), Z),
    ((-0.1349, 0.0052, 3.62355e-17), (4.02456e-15, 8.67362e-16, -1.5708), Z),
    ((5.55112e-17, -0.0611, 0.0181), (1.5708, 0.0486795, 3.14159), Z),
    ((-0.0079, -0.000218121, -0.0981274), (0.0, 3.14159, 0.0), ZERO),
)
X: Vector = (1.0, 0.0, 0.0)
Y: Vector = (0.0, 1.0, 0.0)
# Simulation/SO100/so100.urdf; the last row is the inner face of the pad fixed_jaw_pad_1 of mujoco_menagerie.
SO100: tuple[Row, ...] = (
    ((0.0, -0.0452, 0.0165), (1.57079, 0.0, 0.0), Y),
    ((0.0, 0.1025, 0.0306), (-1.8, 0.0, 0.0), X),
    ((0.0, 0.11257, 0.028), (1.57079, 0.0, 0.0), X),
    ((0.0, 0.0052, 0.1349), (-1.0, 0.0, 0.0), X),
    ((0.0, -0.0601, 0.0), (0.0, 1.57079, 0.0), Y),
    ((0.0079, -0.1014, 0.0), ZERO, ZERO),
)


def turn(axis: Vector, angle: float) -> Matrix:
    x, y, z = (angle * v for v in axis)
    # Each axis is one of x, y and z.
    return rotation_from_rpy(x, y, z)


def chain(rows: tuple[Row, ...], angles: list[float]) -> Pose:
    """The end of a chain by its own rows, one joint after the other."""
    place, rotation = ZERO, IDENTITY
    for (xyz, rpy, axis), angle in zip(rows, [*angles, 0.0], strict=True):
        x, y, z = (a + b for a, b in zip(place, apply(rotation, xyz), strict=True))
        place = (x, y, z)
        rotation = multiply(rotation, rotation_from_rpy(*rpy), turn(axis, angle))
    return Pose(place, rotation)


def anywhere(rng: random.Random) -> list[float]:
    return [rng.uniform(-math.pi, math.pi) for _ in range(5)]


def test_the_so101_is_the_public_chain_with_the_same_angles() -> None:
    rng, model = random.Random(21), SoArmModel(SO_ARMS["so101"])
    for _ in range(1000):
        angles = anywhere(rng)
        public, own = chain(SO101, angles), model.forward(angles)
        # The file rounds a quarter turn; a hundredth of a millimetre.
        assert math.dist(public.position, own.position) < 1e-5
        assert (
            max(
                abs(a - b)
                for r, s in zip(public.rotation, own.rotation, strict=True)
                for a, b in zip(r, s, strict=True)
            )
            < 5e-5
        )


def test_the_so100_is_the_public_chain_with_the_zero_of_the_so101() -> None:
    rng, model = random.Random(22), SoArmModel(SO_ARMS["so100"])
    for _ in range(1000):
        pan, lift, elbow, flex, roll = anywhere(rng)
        # The public zero is the folded arm, and its pan turns to the left.
        public = chain(SO100, [-pan, lift + 1.8, elbow - math.pi / 2, flex + 1.0 - math.pi / 2, roll])
        ahead = apply(rotation_z(math.pi / 2), public.position)
        assert math.dist(ahead, model.forward([pan, lift, elbow, flex, roll]).position) < 1e-5


def test_zero_is_upright_and_level_in_both() -> None:
    for links in SO_ARMS.values():
        model = SoArmModel(links)
        zero = [0.0] * 5
        elbow, wrist = model.elbow(zero), model.wrist(zero)
        assert math.degrees(math.atan2(elbow[2] - links.shoulder[1], links.upper[0])) == pytest.approx(
            76.0, abs=0.1
        )
        assert wrist[2] - elbow[2] == pytest.approx(0.0052)
        assert [row[2] for row in model.forward(zero).rotation] == pytest.approx([1, 0, 0], abs=1e-12)


@pytest.mark.parametrize("name", SO_ARMS)
def test_limits_are_those_of_the_drivers_profile(name: str) -> None:
    joints = load_profile(name).model.joints
    for joint, limit in zip(joints, SO_ARMS[name].ranges, strict=False):
        assert joint.name == limit.name
        assert (limit.minimum, limit.maximum) == pytest.approx((joint.minimum, joint.maximum), abs=1e-3)
    assert SO_ARMS[name].jaw_range == pytest.approx((joints[5].minimum, joints[5].maximum), abs=1e-3)


def test_limits_of_the_so100_are_at_most_three_degrees_beyond_the_published_ones() -> None:
    published = ((-2.0, 2.0), (-1.8, 1.7), (-math.pi / 2, math.pi / 2), (-1.93, 1.77), (-math.pi, math.pi))
    for limit, (low, high) in zip(SO_ARMS["so100"].ranges, published, strict=False):
        assert low - 0.05 <= limit.minimum < limit.maximum <= high + 0.05


def test_reach_is_that_of_the_two_lengths() -> None:
    links = SO_ARMS["so101"]
    assert links.lengths == pytest.approx((0.116, 0.135), abs=1e-4)
    assert links.reach == pytest.approx((0.019, 0.251), abs=1e-4)
