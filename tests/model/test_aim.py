from __future__ import annotations

import math

import pytest

from hexwire.errors import UsageError
from hexwire.model.aim import Aim, Tip, aimed_pose, rpy_of
from hexwire.model.geometry import make_kinematics
from hexwire.model.pose import Matrix, column, rotation_from_rpy

SIX, FIVE = make_kinematics("hex7bot"), make_kinematics("so101")
BENT = (0.3, 0.8, -0.4, 0.2, 0.5, -0.3)
LOW = (0.3, -0.5, 0.6, 0.9, 0.2)


def close(a: Matrix, b: Matrix) -> bool:
    return all(abs(x - y) < 1e-9 for row, other in zip(a, b, strict=True) for x, y in zip(row, other, strict=True))


@pytest.mark.parametrize("rpy", [(0.0, 0.0, 0.0), (0.4, -1.1, 2.9), (-3.0, 0.7, -0.2)])
def test_roll_pitch_and_yaw_make_the_rotation_again(rpy: tuple[float, float, float]) -> None:
    assert rpy_of(rotation_from_rpy(*rpy)) == pytest.approx(rpy)


@pytest.mark.parametrize("pitch", [math.pi / 2, -math.pi / 2])
def test_where_roll_and_yaw_are_one_turn_it_is_told_as_yaw(pitch: float) -> None:
    rotation = rotation_from_rpy(0.4, pitch, 1.0)
    roll, _, _ = rpy_of(rotation)
    assert roll == 0.0
    assert close(rotation_from_rpy(*rpy_of(rotation)), rotation)


def test_a_tip_is_where_the_kinematics_say() -> None:
    tip = Tip.of(SIX, BENT)
    pose = SIX.forward(BENT)
    assert tip.position == pose.position
    assert close(rotation_from_rpy(*tip.rpy), pose.rotation)
    assert tip.pitch_roll is None


def test_an_arm_of_five_joints_also_tells_pitch_and_roll() -> None:
    tip = Tip.of(FIVE, LOW)
    assert tip.pitch_roll == pytest.approx((1.0, 0.2))
    back = aimed_pose(FIVE, LOW, tip.position, Aim(pitch=1.0, roll=0.2))
    assert close(back.rotation, FIVE.forward(LOW).rotation)


def test_a_place_counts_from_the_base_or_from_the_tip() -> None:
    x, y, z = SIX.forward(BENT).position
    assert aimed_pose(SIX, BENT, (0.1, 0.2, 0.3), Aim()).position == (0.1, 0.2, 0.3)
    moved = aimed_pose(SIX, BENT, (0.01, 0.0, -0.02), Aim(), relative=True).position
    assert moved == pytest.approx((x + 0.01, y, z - 0.02))


def test_down_is_down() -> None:
    for model, angles in ((SIX, BENT), (FIVE, LOW)):
        assert column(aimed_pose(model, angles, (0.1, 0.2, 0.1), Aim(down=True)).rotation, 2)[2] == pytest.approx(
            -1
        )


def test_the_direction_stays_relative_to_the_arm_or_in_space() -> None:
    here = FIVE.forward(LOW)
    aside = (here.position[1], here.position[0], here.position[2])
    assert close(aimed_pose(FIVE, LOW, aside, Aim(fixed=True)).rotation, here.rotation)
    assert not close(aimed_pose(FIVE, LOW, aside, Aim()).rotation, here.rotation)


def test_pitch_alone_keeps_the_roll() -> None:
    there = aimed_pose(FIVE, LOW, FIVE.forward(LOW).position, Aim(pitch=0.5))
    assert close(there.rotation, aimed_pose(FIVE, LOW, there.position, Aim(pitch=0.5, roll=0.2)).rotation)


def test_an_arm_cannot_be_aimed_as_another() -> None:
    with pytest.raises(UsageError, match="give its pitch and roll"):
        aimed_pose(FIVE, LOW, (0.1, 0.1, 0.1), Aim(rpy=(0.0, 0.0, 0.0)))
    with pytest.raises(UsageError, match="has six joints"):
        aimed_pose(SIX, BENT, (0.1, 0.1, 0.1), Aim(pitch=0.5))


def test_at_the_prompt_a_tip_is_one_line() -> None:
    assert repr(Tip((0.0, 0.22, -1e-6), (0.0, math.pi / 2, 0.0), None)) == (
        "<Tip: 0.0, 220.0, 0.0 mm; rpy 0.0, 90.0, 0.0 deg>"
    )
    assert repr(Tip((0.2, 0.0, 0.1), (0.0, 0.0, 0.0), (0.5, 0.0))).endswith("; pitch, roll 28.6, 0.0 deg>")
