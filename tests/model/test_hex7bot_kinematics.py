from __future__ import annotations

import itertools
import math
from typing import Any

import pytest
from tests.model.poses import (
    VECTORS,
    check_jacobian,
    determinant,
    hex7bot_edges,
    pose_error,
    rad,
    random_angles,
    turn_error,
)
from tests.soak import rounds

from hexwire.errors import LimitError, UsageError
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.model.arms.hex7bot.kinematics import Hex7BotModel
from hexwire.model.arms.hex7bot.links import LINK_SETS
from hexwire.model.pose import IDENTITY, Pose, column, multiply, rotation_z

MODELS = {name: Hex7BotModel(links) for name, links in LINK_SETS.items()}
A = MODELS["A"]
ROWS = VECTORS["hex7bot_A"]
EACH_MODEL = pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)


@pytest.mark.parametrize("row", ROWS, ids=lambda row: "/".join(map(str, row["q"])))
def test_published_pose(row: dict[str, Any]) -> None:
    angles = rad(row["q"])
    pose = A.forward(angles)
    for got, printed in (
        (A.wrist(angles), row["wrist"]),
        (pose.position, row["tip"]),
        (A.side(pose), row["side"]),
    ):
        assert [1e3 * v for v in got] == pytest.approx(printed, abs=6e-7)
    assert [v for r in pose.rotation for v in r] == pytest.approx([v for r in row["R"] for v in r], abs=6e-10)
    k = A.links
    assert math.degrees(k.elbow_angle(*angles[1:3]) + k.forearm_angle) == pytest.approx(row["elbow_deg"], abs=6e-7)


@pytest.mark.parametrize("row", ROWS, ids=lambda row: "/".join(map(str, row["q"])))
def test_published_pose_backwards(row: dict[str, Any]) -> None:
    angles = rad(row["q"])
    # The solution that limits allow is the published one, and the first.
    assert turn_error(A.inverse(A.forward(angles))[0].angles, angles) < 1e-9
    front = [s for s in A.inverse_wrist(A.wrist(angles)) if s.branch == "front, elbow up"]
    assert [math.degrees(a) for a in front[0].angles] == pytest.approx(row["ik3"], abs=1e-9)


def test_the_first_7bots_published_start_pose() -> None:
    angles = rad([90, 115, 65, 90, 90, 90])
    wrist = [1e3 * v for v in MODELS["V1"].wrist(angles)]
    assert wrist == pytest.approx([0, 177.84, 215.98], abs=0.005)


def test_set_bs_published_start_point() -> None:
    found = MODELS["B"].inverse_wrist((0.0, 0.17622, 0.19055))
    allowed = [s for s in found if s.allowed]
    assert [math.degrees(a) for a in allowed[0].angles] == pytest.approx([90.0, 90.710, 93.576], abs=6e-4)


@pytest.mark.parametrize(("name", "degrees"), [("A", (90, 103.156, 102.840)), ("B", (90, 85.192, 94.337))])
def test_the_librarys_documented_point(name: str, degrees: tuple[float, ...]) -> None:
    found = MODELS[name].inverse_wrist((0.0, 0.188, 0.188))
    front = next(s for s in found if s.branch == "front, elbow up")
    assert [math.degrees(a) for a in front.angles] == pytest.approx(degrees, abs=6e-4)


@EACH_MODEL
def test_reach_of_the_link_sets(model: Hex7BotModel) -> None:
    published = {"A": (71.2, 311.2, 335.5), "B": (41.9, 281.9, 298.8), "V1": (80.7, 320.7, 350.7)}
    low, high = (1e3 * v for v in model.links.reach)
    assert (low, high, high + 1e3 * model.links.d) == pytest.approx(published[model.links.name], abs=0.06)


@pytest.mark.soak
@EACH_MODEL
def test_inverse_of_forward_over_the_whole_workspace(model: Hex7BotModel) -> None:
    branches = set()
    for angles in random_angles(1, rounds(1_000, 50_000)):
        pose = model.forward(angles)
        solutions = model.inverse(pose)
        assert solutions
        own = min(solutions, key=lambda s: turn_error(s.angles, angles))
        assert turn_error(own.angles, angles) < 1e-9
        branches.add(own.branch)
        # Every other branch is a way to the same pose.
        assert max(pose_error(model.forward(s.angles), pose) for s in solutions) < 1e-9
    assert len(branches) == 8


@EACH_MODEL
def test_a_pose_at_the_edge_of_reach_is_found_though_rounding_puts_it_outside(model: Hex7BotModel) -> None:
    for angles in hex7bot_edges(model.links, 30):
        pose = model.forward(angles)
        solutions = model.inverse(pose)
        assert min(turn_error(s.angles, angles) for s in solutions) < 1e-5
        assert max(pose_error(model.forward(s.angles), pose) for s in solutions) < 1e-7


def test_neutral_is_a_wrist_singularity_with_neutral_as_its_answer() -> None:
    neutral = rad([90] * 6)
    solution = A.inverse(A.forward(neutral))[0]
    assert solution.singular
    assert solution.allowed
    assert solution.angles == pytest.approx(neutral, abs=1e-12)
    assert A.singularity(neutral).near == ("wrist",)


def test_singular_wrist_keeps_the_pose() -> None:
    for t4 in (90, -90):
        pose = A.forward(rad([70, 100, 80, 130, t4, 20]))
        for solution in A.inverse(pose):
            assert pose_error(A.forward(solution.angles), pose) < 1e-9
            slid = solution.slid([0.3] * 6)
            assert pose_error(A.forward(slid), pose) < 1e-9


def test_singular_wrist_keeps_the_share_of_its_joints() -> None:
    # t3 and t5 turn about one line at t4 = 90 deg: the same pose again must not turn them against each other.
    angles = rad([70, 100, 80, 120, 90, 60])
    best = A.best(A.forward(angles), angles)
    assert best.angles == pytest.approx(angles, abs=1e-9)


def test_straight_up_over_the_base_axis() -> None:
    k = A.links
    up = (0.0, 0.0, k.e + math.sqrt(0.25**2 - k.d**2))
    found = A.inverse_wrist(up)
    assert found
    for solution in found:
        assert A.wrist(solution.angles) == pytest.approx(up, abs=1e-9)
    assert A.singularity((*found[0].angles, 1.0, 1.0, 1.0)).near == ("base axis",)


@EACH_MODEL
def test_jacobian_and_its_determinant(model: Hex7BotModel) -> None:
    for angles in random_angles(2, 60):
        check_jacobian(model, angles)
        expected = abs(determinant(model.jacobian(angles)))
        assert model.singularity(angles).manipulability == pytest.approx(expected, abs=1e-12)


def test_stretched_elbow_is_singular() -> None:
    k = A.links
    t1 = math.radians(60)
    t2 = math.pi + k.offset + k.forearm_angle - t1 - math.pi
    assert "elbow" in A.singularity((1.5, t1, t2, 1.5, 0.3, 1.5)).near


def test_too_far_says_by_how_much_and_why() -> None:
    k = A.links
    far = (0.0, k.d + k.reach[1] + 0.040, k.e)
    report = A.reach_wrist(far)
    assert not report.reachable
    assert report.excess == pytest.approx(0.040)
    assert "40.0 mm beyond the 311.2 mm" in report.cause
    assert A.inverse_wrist(far) == ()
    with pytest.raises(LimitError, match=r"out of reach: .* 40\.0 mm beyond"):
        A.best(Pose((far[0], far[1], far[2] + k.f), IDENTITY))


def test_too_near_says_so() -> None:
    k = A.links
    report = A.reach_wrist((0.0, 0.0, k.e))
    assert report.excess == pytest.approx(k.reach[0] - k.d)
    assert "less than the 71.2 mm of the folded arm" in report.cause
    assert A.inverse_wrist((0.0, 0.0, k.e)) == ()


def test_forbidden_by_a_joint_names_it_and_the_excess() -> None:
    behind = A.forward(rad([-60, 90, 90, 90, 30, 90]))
    with pytest.raises(
        LimitError,
        match=r"no joint angles within limits; nearest is back.* t2=-27.09 deg is 37.1 deg below its limits",
    ):
        A.best(behind)


def test_best_turns_the_joints_least() -> None:
    angles = rad([100, 95, 85, 80, 60, 100])
    assert turn_error(A.best(A.forward(angles), angles).angles, angles) < 1e-9


@pytest.mark.parametrize("t1_t2", [(80, 80), (90, 90), (91, 91), (100, 155)])
def test_no_coupling_violation_while_the_elbow_is_within_its_limits(t1_t2: tuple[float, float]) -> None:
    # Among them the poses at which the library's own line rule changes its mind.
    assert A.violations(rad([90, *t1_t2, 90, 90, 90])) == ()


@pytest.mark.parametrize(
    ("name", "t1_t2", "words"),
    [
        ("A", (110, 155), "elbow folded 5 deg too far: 5 deg between upper arm and forearm, 10 to 165 deg allowed"),
        ("A", (50, 50), "elbow open 5 deg too far"),
        ("V1", (50, 32), "elbow open 1 deg too far"),
        ("V1", (118, 110), "elbow folded 1 deg too far"),
        ("B", (140, 60), "arm raised 10.2 deg too far: 88.19 deg from shoulder to wrist, 78 deg allowed"),
    ],
)
def test_poses_beyond_the_joint_coupling_limit(name: str, t1_t2: tuple[float, float], words: str) -> None:
    found = MODELS[name].violations(rad([90, *t1_t2, 90, 90, 90]))
    assert len(found) == 1
    assert words in found[0]
    # The number that goes with the words.
    excess = math.degrees(MODELS[name].coupling_excess(rad([90, *t1_t2, 90, 90, 90])))
    assert excess == pytest.approx(float(found[0].split(" deg")[0].split()[-1]), abs=0.06)


def test_without_a_coupling_violation_the_excess_is_zero() -> None:
    assert A.coupling_excess(rad([90] * 6)) == 0.0


def test_the_neutral_pose_of_set_b_keeps_its_own_coupling_limit() -> None:
    model = MODELS["B"]
    assert model.violations(rad([90] * 6)) == ()
    gate = model.links.elevation
    assert gate is not None
    assert math.degrees(gate.elevation(math.pi / 2, model.links.elbow_angle(math.pi / 2, math.pi / 2))) == (
        pytest.approx(47.2, abs=0.1)
    )


def test_driver_joints_and_from_joints() -> None:
    neutral = {joint.name: joint.offset for joint in HEX7BOT.joints}
    assert A.from_joints(neutral) == pytest.approx([math.pi / 2] * 6)
    angles = rad([100, 80, 95, 70, 60, 200])
    assert A.from_joints(A.to_joints(angles)) == pytest.approx(angles)
    # A quarter turn of the servo is 1024 counts of 2 pi / 4096; the joint model counts with the chapter's constant.
    moved = A.to_joints(rad([180, 90, 90, 90, 90, 90]))
    assert HEX7BOT.joints[0].angle_to_counts(moved["J1"]) == 2047 + round(math.pi / 2 / 0.001534)


@EACH_MODEL
def test_within_the_arm_both_limits_count(model: Hex7BotModel) -> None:
    narrow = model.within_arm()
    for own, both, joint in zip(model.ranges, narrow.ranges, HEX7BOT.joints, strict=False):
        assert own.minimum <= both.minimum < both.maximum <= own.maximum
        for end in (both.minimum, both.maximum):
            joint.check(narrow.to_joints([end] * 6)[joint.name])
    assert narrow.links is model.links


def test_within_the_arm_a_turn_of_the_tool_that_its_servo_cannot_make_is_made_the_other_way() -> None:
    turned = rad([90, 95, 90, 100, 60, 300])
    assert A.best(A.forward(turned), turned).angles == pytest.approx(turned)
    other = A.within_arm().inverse(A.forward(turned))
    assert all("t5=" in s.violations[0] for s in other if turn_error(s.angles, turned) < 1e-6)


def test_points_that_may_hit_the_table() -> None:
    points = A.points(rad([90, 90, 90, 90, 45, 90]))
    assert points["elbow"] == pytest.approx((0, 0.02428, 0.199))
    assert points["tool"] == pytest.approx((0, 0.227553506, 0.249073506))
    with pytest.raises(UsageError, match="the position of J2, J3 is missing"):
        A.from_joints({"J1": 0.0, "J4": 0.0, "J5": 0.0, "J6": 0.0})


@EACH_MODEL
def test_the_lowest_point_is_the_lowest_of_its_points(model: Hex7BotModel) -> None:
    for angles in random_angles(3, 300):
        points = {name: place[2] for name, place in model.points(angles).items()}
        name, height = model.lowest(angles)
        assert height == pytest.approx(min(points.values()), abs=1e-12)
        assert points[name] == pytest.approx(height, abs=1e-12)
    with pytest.raises(UsageError, match="not a number"):
        model.lowest([0.0, math.nan, 0.0, 0.0, 0.0, 0.0])


def test_tool_down_and_carried() -> None:
    angles = rad([90, 95, 90, 90, 60, 110])
    place = (0.1, 0.18, 0.05)
    down = Pose(place, A.tool_down(place, angles))
    solution = A.best(down, angles)
    assert column(A.forward(solution.angles).rotation, 2) == pytest.approx((0, 0, -1), abs=1e-9)
    assert solution.angles[3] == pytest.approx(math.pi / 2, abs=1e-9)
    assert solution.angles[5] == pytest.approx(angles[5], abs=1e-9)
    tilted = rad([90, 95, 90, 75, 60, 110])
    place = (0.1, 0.18, 0.2)
    solution = A.best(Pose(place, A.carried(place, tilted)), tilted)
    turned = solution.angles[0] - tilted[0]
    expected = multiply(rotation_z(turned), A.rotation(tilted))
    assert pose_error(Pose(place, A.rotation(solution.angles)), Pose(place, expected)) < 1e-9


def test_wrong_number_of_angles() -> None:
    with pytest.raises(UsageError, match="6 joints here, got 5 angles"):
        A.forward([1.0] * 5)
    with pytest.raises(UsageError, match="t3 is nan"):
        A.forward([1.0, 1.0, 1.0, math.nan, 1.0, 1.0])


def test_the_excess_grows_with_the_coupling_violation() -> None:
    for t2 in (120.0, 150.0):
        rows = [A.coupling_excess([math.radians(d) for d in (90, t1, t2, 90, 90, 90)]) for t1 in range(100, 180)]
        steps = [b - a for a, b in itertools.pairwise(rows)]
        assert rows[0] == 0.0 < rows[-1]
        assert all(0.0 <= step <= math.radians(1.0) + 1e-9 for step in steps)
    beyond = A.violations([math.radians(d) for d in (90, 150, 150, 90, 90, 90)])
    assert any(text.startswith("elbow folded 40 deg too far: -30 deg between") for text in beyond)
