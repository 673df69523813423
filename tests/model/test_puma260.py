from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.model.poses import (
    VECTORS,
    check_jacobian,
    determinant,
    pose_error,
    puma260_edges,
    rad,
    random_angles,
    turn_error,
)
from tests.soak import rounds

from hexwire.errors import LimitError, UsageError
from hexwire.model.arms.puma260.kinematics import PUMA260, Puma260Model, angles_to_counts, counts_to_angles
from hexwire.model.pose import IDENTITY, Pose

MODEL = Puma260Model()


@pytest.mark.parametrize("row", VECTORS["puma260"], ids=lambda row: "/".join(map(str, row["q"])))
def test_published_pose(row: dict[str, Any]) -> None:
    pose = MODEL.forward(rad(row["q"]))
    assert pose.position == pytest.approx(row["p_m"], abs=1e-12)
    assert [v for r in pose.rotation for v in r] == pytest.approx([v for r in row["R"] for v in r], abs=1e-12)


def test_the_third_published_pose_to_its_printed_digits() -> None:
    pose = MODEL.forward(rad([50, -105, 31, 4, 126, -184]))
    assert pose.position == pytest.approx((0.2236, 0.0693, 0.4265), abs=6e-5)


@pytest.mark.soak
def test_inverse_of_forward_over_the_whole_workspace() -> None:
    branches = set()
    for angles in random_angles(4, rounds(1_000, 50_000)):
        pose = MODEL.forward(angles)
        solutions = MODEL.inverse(pose)
        own = min(solutions, key=lambda s: turn_error(s.angles, angles))
        assert turn_error(own.angles, angles) < 1e-9
        branches.add(own.branch)
        assert max(pose_error(MODEL.forward(s.angles), pose) for s in solutions) < 1e-9
    assert len(branches) == 8


def test_a_pose_at_the_edge_of_reach_is_found_though_rounding_puts_it_outside() -> None:
    for angles in puma260_edges(30):
        pose = MODEL.forward(angles)
        solutions = MODEL.inverse(pose)
        assert len(solutions) == 8
        assert max(pose_error(MODEL.forward(s.angles), pose) for s in solutions) < 1e-7


def test_angles_come_back_in_the_turn_that_limits_allow() -> None:
    angles = rad([200, -100, -90, -300, 100, -200])
    found = [s for s in MODEL.inverse(MODEL.forward(angles)) if turn_error(s.angles, angles) < 1e-9]
    assert found[0].allowed


def test_singular_wrist_keeps_the_pose() -> None:
    for q5 in (90, -90):
        pose = MODEL.forward(rad([20, -60, 30, 50, q5, 10]))
        for solution in MODEL.inverse(pose):
            assert pose_error(MODEL.forward(solution.angles), pose) < 1e-9
            assert pose_error(MODEL.forward(solution.slid([0.3] * 6)), pose) < 1e-9
        assert any(s.singular for s in MODEL.inverse(pose))


def test_jacobian_and_its_determinant() -> None:
    for angles in random_angles(5, 60):
        check_jacobian(MODEL, angles)
        expected = abs(determinant(MODEL.jacobian(angles)))
        assert MODEL.singularity(angles).manipulability == pytest.approx(expected, abs=1e-12)


def test_out_of_reach_says_by_how_much_and_why() -> None:
    far = Pose((0.6, -0.12446, 0.3302), IDENTITY)
    report = MODEL.reach(far)
    assert not report.reachable
    assert report.excess == pytest.approx(0.6 - 0.05588 - math.hypot(7.8, 0.75) * 0.0254 - 0.2032)
    assert "beyond" in report.cause
    assert MODEL.inverse(far) == ()
    with pytest.raises(LimitError, match="out of reach"):
        MODEL.best(far)


def test_too_near_the_base_axis_is_the_shoulders_fault() -> None:
    near = Pose((0.05588, 0.02, 0.5), IDENTITY)
    report = MODEL.reach(near)
    assert report.excess == pytest.approx(0.12446 - 0.02)
    assert "the shoulder is set aside" in report.cause
    assert MODEL.inverse(near) == ()


def test_folded_too_far() -> None:
    near = Pose((0.05588, -0.12446, 0.3302), IDENTITY)
    assert "of the folded arm" in MODEL.reach(near).cause
    assert MODEL.inverse(near) == ()


@given(st.lists(st.floats(-6.0, 6.0), min_size=6, max_size=6))
def test_counts_and_angles_are_inverse(angles: list[float]) -> None:
    again = counts_to_angles(angles_to_counts(angles))
    # Rounding of encoders 4 and 5 shows in 5 and 6 as well.
    for got, angle, joint in zip(again, angles, PUMA260.joints, strict=True):
        assert abs(got - angle) <= 2.5 * joint.scale


def test_counts_per_degree_are_the_published_ones() -> None:
    per_degree = [joint.sign * math.radians(1) / joint.scale for joint in PUMA260.joints]
    assert per_degree == pytest.approx([-129.78, 194.37, -119.41, 96.69, 87.52, 70.60], abs=0.006)


def test_wrist_joints_turn_the_encoders_after_them() -> None:
    turned = angles_to_counts((0, 0, 0, math.tau, 0, 0))
    assert turned == (0, 0, 0, round(800 * 43.5111), round(-9.8462 * 800), 800)
    assert angles_to_counts((0, 0, 0, 0, math.tau, 0))[5] == round(-5.59999 * 800)


def test_six_values_are_wanted() -> None:
    with pytest.raises(UsageError, match="got 5 counts"):
        counts_to_angles([0] * 5)
    with pytest.raises(UsageError, match="got 7 angles"):
        angles_to_counts([0.0] * 7)


def test_limits_are_the_published_ones() -> None:
    assert [round(math.degrees(j.minimum)) for j in PUMA260.joints] == [-5, -256, -214, -384, -32, -267]
    assert MODEL.violations(rad([320, 0, 0, 0, 0, 0]))[0].startswith(
        "J1=320 deg is 7 deg above its limits -5 to 313"
    )


def test_joints_are_the_drivers_and_points_are_on_the_arm() -> None:
    angles = rad([10, 20, 30, 40, 50, 60])
    assert MODEL.from_joints(MODEL.to_joints(angles)) == angles
    with pytest.raises(UsageError, match="the position of J6 is missing"):
        MODEL.from_joints(dict(zip(PUMA260.names[:5], angles[:5], strict=True)))
    points = MODEL.points((0.0,) * 6)
    assert points["elbow"] == pytest.approx((7.8 * 0.0254, -4.9 * 0.0254, 12.25 * 0.0254))
    assert points["wrist"] == pytest.approx((7.8 * 0.0254, -4.9 * 0.0254, 4.25 * 0.0254))


def test_tool_down_and_carried() -> None:
    angles = rad([20, -60, 30, 50, 40, 10])
    place = (0.3, 0.1, 0.2)
    down = MODEL.tool_down(place, angles)
    assert [row[0] for row in down] == pytest.approx([0, 0, -1], abs=1e-12)
    assert MODEL.carried(place, angles) == MODEL.forward(angles).rotation
