"""Points of a motion as joint angles."""

from __future__ import annotations

import math

import pytest
from tests.motion.arms import HOME

from hexwire.control.motion.via import Place, chosen_solution, joint_points, tip_poses
from hexwire.errors import LimitError, UsageError
from hexwire.model.aim import Aim
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.model.geometry import kinematics_for

MODEL = kinematics_for(HEX7BOT)
assert MODEL is not None
AHEAD, ASIDE = (0.0, 0.22, 0.2), (0.06, 0.18, 0.12)


def tip(angles: dict[str, float]) -> tuple[float, ...]:
    assert MODEL is not None
    return MODEL.forward(MODEL.from_joints(HOME | angles)).position


def test_places_and_poses_become_rows_of_the_joints_that_move() -> None:
    names, rows = joint_points(HEX7BOT, MODEL, HOME, [Place(AHEAD), {"j7": 0.3}, Place(ASIDE), {"J1": 0.2}])
    assert names == HEX7BOT.names
    assert rows[0] == tuple(HOME[name] for name in names)
    angles = [dict(zip(names, row, strict=True)) for row in rows]
    assert tip(angles[1]) == pytest.approx(AHEAD, abs=1e-9)
    # A pose changes what it names only.
    assert angles[2] == angles[1] | {"J7": 0.3}
    assert tip(angles[3]) == pytest.approx(ASIDE, abs=1e-9)
    assert angles[3]["J7"] == 0.3
    assert angles[4] == angles[3] | {"J1": 0.2}


def test_joints_that_no_point_moves_are_left_out() -> None:
    names, rows = joint_points(HEX7BOT, None, HOME, [{"J4": 0.1, "J1": 0.2}, {"J4": 0.3}])
    assert names == ("J1", "J4")
    assert rows == [(HOME["J1"], HOME["J4"]), (0.2, 0.1), (0.2, 0.3)]


def test_a_relative_place_counts_from_the_point_before_it() -> None:
    names, rows = joint_points(
        HEX7BOT, MODEL, HOME, [Place(AHEAD), Place((0.02, 0.0, -0.03), Aim(fixed=True), relative=True)]
    )
    assert tip(dict(zip(names, rows[2], strict=True))) == pytest.approx((0.02, 0.22, 0.17), abs=1e-9)


def test_what_cannot_be_reached_is_told_with_its_number() -> None:
    far = Place((0.0, 0.9, 0.2))
    with pytest.raises(LimitError, match=r"^out of reach"):
        joint_points(HEX7BOT, MODEL, HOME, [far])
    with pytest.raises(LimitError, match=r"^point 2: out of reach"):
        joint_points(HEX7BOT, MODEL, HOME, [Place(AHEAD), far])
    with pytest.raises(LimitError, match="has no solution 'inside out'; there are "):
        joint_points(HEX7BOT, MODEL, HOME, [Place(AHEAD, branch="inside out")])


def test_what_makes_no_sense_is_refused() -> None:
    with pytest.raises(UsageError, match="no geometry is known for hex7bot"):
        joint_points(HEX7BOT, None, HOME, [Place(AHEAD)])
    with pytest.raises(UsageError, match="no joint 'J9'"):
        joint_points(HEX7BOT, MODEL, HOME, [{"J9": 0.0}])
    with pytest.raises(UsageError, match="the goal of J1"):
        joint_points(HEX7BOT, MODEL, HOME, [{"J1": math.nan}])
    for points in ([Place(AHEAD)], [{"J2": 1.0}]):
        with pytest.raises(UsageError, match="the position of J2 is unknown"):
            joint_points(HEX7BOT, MODEL, HOME | {"J2": math.nan}, points)


def test_tip_poses_of_places_and_of_poses() -> None:
    assert MODEL is not None
    down = Place(ASIDE, Aim(down=True))
    there = {"J1": 0.3, "J2": HOME["J2"] + 0.2}
    aside, posed, relative = tip_poses(
        MODEL, HOME, [down, there, Place((0.0, 0.0, 0.02), Aim(fixed=True), relative=True)]
    )
    assert aside.position == ASIDE
    assert [row[2] for row in aside.rotation] == pytest.approx([0, 0, -1], abs=1e-9)
    # Joints that the pose does not name are where the place before it has them.
    assert posed.position != pytest.approx(tip(there))
    x, y, z = posed.position
    assert relative.position == pytest.approx((x, y, z + 0.02))
    assert relative.rotation == posed.rotation


def test_a_branch_by_name() -> None:
    assert MODEL is not None
    near = MODEL.from_joints(HOME)
    pose = tip_poses(MODEL, HOME, [Place(AHEAD)])[0]
    best = chosen_solution(MODEL, pose, "", near)
    assert best.allowed
    assert chosen_solution(MODEL, pose, best.branch, near).angles == pytest.approx(best.angles)
    wrong = next(s for s in MODEL.inverse(pose) if s.violations)
    with pytest.raises(LimitError, match=wrong.branch):
        chosen_solution(MODEL, pose, wrong.branch, near)
