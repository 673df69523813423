"""The table of pairs, held against new samples of other postures."""

from __future__ import annotations

from dataclasses import replace

import pytest
from tests.ros2.package.sample_collisions import ARMS, Solids, home_of, postures, sampled

from hexwire.model.urdf import make_urdf
from hexwire.ros2.package.arms import PackageArm, make_arm
from hexwire.ros2.package.collisions import adjacent_pairs, idle_pairs

POSTURES = 1500


@pytest.fixture(scope="module", params=ARMS, ids="".join)
def arm(request: pytest.FixtureRequest) -> PackageArm:
    robot, links = request.param
    return make_arm(robot, links or "A")


def by_reason(arm: PackageArm) -> dict[str, set[tuple[str, str]]]:
    found: dict[str, set[tuple[str, str]]] = {"Adjacent": set(), "Always": set(), "Default": set(), "Never": set()}
    for pair in idle_pairs(arm):
        found[pair.reason].add((pair.first, pair.second))
    return found


@pytest.mark.slow
def test_each_pair_has_the_reason_that_postures_show(arm: PackageArm) -> None:
    reasons = by_reason(arm)
    solids = Solids(arm, make_urdf(arm.kinematics))
    assert reasons["Default"] <= solids.touching(home_of(arm))
    solids.only(reasons["Always"] | reasons["Never"])
    for posture in postures(arm, POSTURES, seed=99):
        assert solids.touching(posture) == reasons["Always"], posture


def test_no_pair_is_left_that_always_touches(arm: PackageArm) -> None:
    idle = {(pair.first, pair.second) for pair in idle_pairs(arm)}
    for pair in sampled(arm, 200, seed=5).get("Always", ()):
        assert pair in idle


def test_nothing_touches_in_a_named_pose(arm: PackageArm) -> None:
    """Otherwise MoveIt would refuse to plan from there."""
    solids = Solids(arm, make_urdf(arm.kinematics))
    solids.only(set(solids.pairs) - {(pair.first, pair.second) for pair in idle_pairs(arm)})
    grips = [pose.positions for pose in arm.poses if pose.group == "gripper"] or [{}]
    for pose in arm.poses:
        if pose.group == "arm":
            for grip in grips:
                assert not solids.touching({**pose.positions, **grip}), pose.name


def test_folded_arm_is_still_found(arm: PackageArm) -> None:
    """The pairs that are left can touch: each arm has postures in which it hits itself."""
    solids = Solids(arm, make_urdf(arm.kinematics))
    solids.only(set(solids.pairs) - {(pair.first, pair.second) for pair in idle_pairs(arm)})
    assert sum(bool(solids.touching(posture)) for posture in postures(arm, 300, seed=3)) > 5


def test_links_with_only_a_frame_between_them_are_adjacent() -> None:
    shapes = make_arm("hex7bot").shapes
    near = adjacent_pairs(shapes)
    assert ("base", "turret") in near
    assert not any("base_link" in pair or "tool" in pair for pair in near)
    # Without the elbow's pin, upper arm and forearm are neighbours.
    bare = tuple(replace(link, shapes=()) if link.name == "elbow" else link for link in shapes.links)
    assert ("forearm", "upper_arm") not in near
    assert ("forearm", "upper_arm") in adjacent_pairs(replace(shapes, links=bare))


def test_own_link_set_claims_nothing_that_was_not_sampled() -> None:
    arm = replace(make_arm("hex7bot"), links="/home/me/mine.toml")
    assert {pair.reason for pair in idle_pairs(arm)} == {"Adjacent", "Always", "Default"}
    assert ("forearm", "upper_arm", "Always") in {(p.first, p.second, p.reason) for p in idle_pairs(arm)}
