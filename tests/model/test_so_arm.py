from __future__ import annotations

import math
import random
from dataclasses import replace

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from tests.model.poses import check_jacobian, determinant, pose_error, rad, turn_error
from tests.soak import rounds

from hexwire.drivers.arm_file import load_profile
from hexwire.errors import LimitError, UsageError
from hexwire.model.arms.so_arm.kinematics import SoArmModel
from hexwire.model.arms.so_arm.links import SO_ARMS
from hexwire.model.kinematics import JointRange
from hexwire.model.pose import Pose, Vector, column, multiply, rotation_between, rotation_from_rpy, rotation_z

ARMS = [SoArmModel(links) for links in SO_ARMS.values()]
SO101, SO100 = ARMS
each_arm = pytest.mark.parametrize("arm", ARMS, ids=lambda arm: arm.name)


def within(arm: SoArmModel, rng: random.Random) -> list[float]:
    return [rng.uniform(r.minimum, r.maximum) for r in arm.ranges]


def pitch_of(pose: Pose) -> float:
    """How far the tool points down, radians."""
    return math.asin(max(-1.0, min(1.0, -column(pose.rotation, 2)[2])))


@each_arm
def test_levers_bound_how_far_the_lowest_point_moves(arm: SoArmModel) -> None:
    rng = random.Random(5)
    nearest = 0.0
    for _ in range(2000):
        one = within(arm, rng)
        step = rng.choice((1e-4, 0.02, 0.3))
        other = [angle + rng.uniform(-step, step) for angle in one]
        most = sum(arm.levers[r.name] * abs(a - b) for r, a, b in zip(arm.ranges, one, other, strict=True))
        moved = abs(arm.lowest(one)[1] - arm.lowest(other)[1])
        assert moved <= most + 1e-12
        nearest = max(nearest, moved / most)
    assert nearest > 0.9, "and no more than that"


@pytest.mark.soak
@each_arm
def test_inverse_of_forward_over_the_whole_workspace(arm: SoArmModel) -> None:
    rng, branches = random.Random(31), set()
    for _ in range(rounds(700, 50_000)):
        angles = tuple(rng.uniform(-math.pi, math.pi) for _ in range(5))
        pose = arm.forward(angles)
        solutions = arm.inverse(pose)
        own = min(solutions, key=lambda s: turn_error(s.angles, angles))
        assert turn_error(own.angles, angles) < 1e-7
        assert pose_error(arm.forward(own.angles), pose) < 1e-9
        for solution in solutions:
            branches.add(solution.branch)
            again = arm.forward(solution.angles)
            assert math.dist(again.position, pose.position) < 1e-9
            assert abs(pitch_of(again) - pitch_of(pose)) < 1e-6
    assert branches == {f"{side}, elbow {bend}" for side in ("front", "back") for bend in ("up", "down")}


@each_arm
def test_poses_within_limits_have_an_allowed_branch_and_its_angles_are_within(arm: SoArmModel) -> None:
    rng = random.Random(32)
    for _ in range(300):
        angles = within(arm, rng)
        solutions = arm.inverse(arm.forward(angles))
        assert solutions[0].allowed
        assert any(turn_error(s.angles, tuple(angles)) < 1e-7 for s in solutions)
        for solution in solutions:
            inside = all(r.excess(a) == 0.0 for r, a in zip(arm.ranges, solution.angles, strict=True))
            assert inside is solution.allowed
        best = arm.best(arm.forward(angles), angles)
        assert best.distance(angles) < 1e-7


@each_arm
def test_a_heading_that_the_arm_cannot_take_costs_neither_position_nor_pitch(arm: SoArmModel) -> None:
    rng = random.Random(33)
    for _ in range(200):
        pose = arm.forward(within(arm, rng))
        turned = Pose(pose.position, multiply(rotation_z(rng.uniform(-0.6, 0.6)), pose.rotation))
        for solution in arm.inverse(turned):
            got = arm.forward(solution.angles)
            assert math.dist(got.position, pose.position) < 1e-9
            assert abs(pitch_of(got) - pitch_of(pose)) < 1e-6
            # Nor more of the orientation than it must: no other roll comes closer.
            off = rotation_between(got.rotation, turned.rotation)[1]
            for more in (-0.01, 0.01):
                other = arm.rotation([*solution.angles[:4], solution.angles[4] + more])
                assert rotation_between(other, turned.rotation)[1] > off


@each_arm
def test_a_tool_that_points_straight_down_keeps_its_direction_anywhere(arm: SoArmModel) -> None:
    rng, here = random.Random(34), rad([10, 20, 30, 40, 50])
    rotation = arm.tool_down((0.2, 0.05, 0.1), here)
    for _ in range(50):
        place = (rng.uniform(0.15, 0.25), rng.uniform(-0.1, 0.1), 0.1)
        for solution in arm.inverse(Pose(place, rotation)):
            assert rotation_between(arm.forward(solution.angles).rotation, rotation)[1] < 1e-7


@each_arm
def test_angles_change_smoothly_along_a_line_with_a_heading_of_its_own(arm: SoArmModel) -> None:
    # The orientation stays that of the start, which the arm soon cannot take: pitch 50 degrees, roll 30.
    here: tuple[float, ...] = rad([30, 10, 0, 40, 30])
    start = arm.forward(here)
    x, y, z = start.position
    steps = 400
    for i in range(1, steps + 1):
        place: Vector = (x - 0.05 * i / steps, y + 0.25 * i / steps, z - 0.02 * i / steps)
        found = arm.best(Pose(place, start.rotation), here).angles
        assert max(abs(a - b) for a, b in zip(found, here, strict=True)) < 0.02
        assert sum(found[1:4]) == pytest.approx(math.radians(50), abs=1e-9)
        here = found
    # It has turned to the other side.
    assert here[0] < math.radians(-20)


@each_arm
def test_jacobian_and_manipulability(arm: SoArmModel) -> None:
    rng = random.Random(35)
    for _ in range(40):
        angles = tuple(rng.uniform(-math.pi, math.pi) for _ in range(5))
        check_jacobian(arm, angles)
        # Of position, pitch and roll.
        rows = (*arm.jacobian(angles)[:3], (0.0, 1.0, 1.0, 1.0, 0.0), (0.0, 0.0, 0.0, 0.0, 1.0))
        assert arm.singularity(angles).manipulability == pytest.approx(abs(determinant(rows)), abs=1e-12)


def test_singularities_have_names() -> None:
    straight = math.degrees(math.atan2(0.0052, 0.1349) - math.atan2(0.11257, 0.028))
    assert SO101.singularity(rad([0, 0, straight, 0, 0])).near == ("elbow",)
    above = SO101.inverse(
        Pose((0.0388353, 0.008, 0.25), SO101.aimed((0.0388353, 0.008, 0.25), 0.3, 0.0, [0.0] * 5))
    )
    assert "base axis" in SO101.singularity(above[0].angles).near


@pytest.mark.parametrize(
    ("place", "pitch", "words"),
    [
        ((0.6, 0.0, 0.1), 90, "mm beyond the 251.0 mm that upper arm and forearm reach"),
        ((0.0388353, 0.001, 0.3), 0, "the tip would be 1.0 mm from the base axis"),
    ],
)
def test_out_of_reach_says_by_how_much_and_why(place: Vector, pitch: float, words: str) -> None:
    roll = 90.0 if "base axis" in words else 0.0
    pose = Pose(place, SO101.aimed(place, math.radians(pitch), math.radians(roll), [0.0] * 5))
    report = SO101.reach(pose)
    assert not report.reachable
    assert report.excess > 0.0
    assert words in report.cause
    assert SO101.inverse(pose) == ()
    with pytest.raises(LimitError, match="out of reach"):
        SO101.best(pose)


def test_folded_too_far_to_either_side() -> None:
    # The SO-101 reaches around its shoulder by leaning back; one with a longer upper arm does not.
    arm = SoArmModel(replace(SO101.links, upper=(0.028, 0.25)))
    place = (0.0388353, 0.0, 0.1166 - 0.1592)
    pose = Pose(place, arm.tool_down(place, [0.0] * 5))
    assert arm.inverse(pose) == ()
    assert "mm less than the 116.6 mm of the folded arm" in arm.reach(pose).cause


def test_the_missing_distance_is_that_of_the_links() -> None:
    pose = Pose((0.6, 0.0, 0.1), SO101.aimed((0.6, 0.0, 0.1), math.pi / 2, 0.0, [0.0] * 5))
    x, _, z = SO101.wrist(SO101.inverse(Pose((0.2, 0.0, 0.1), pose.rotation))[0].angles)
    line = math.hypot(x + 0.4 - 0.0388353 - 0.0303992, z - 0.1166)
    assert SO101.reach(pose).excess == pytest.approx(line - SO101.links.reach[1], abs=1e-6)
    assert SO101.reach(SO101.forward([0.0] * 5)) == SO101.reach(SO101.forward([0.1] * 5))


def test_a_pose_beyond_a_limit_names_the_joint() -> None:
    with pytest.raises(
        LimitError, match=r"no joint angles within limits.*wrist_flex=.* above its limits -95 to 95 deg"
    ):
        SO101.best(SO101.forward(rad([0, 10, 20, 100, 0])))
    assert SO101.violations(rad([0, 0, 0, 0, 170])) == (
        "wrist_roll=170 deg is 7.21 deg above its limits -157.2 to 162.8 deg",
    )


@given(st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=5, max_size=5))
@example([0.0, 1.7e308, 1.7e308, 1.7e308, -1.7e308])
def test_any_finite_angles_have_a_pose(angles: list[float]) -> None:
    pose = SO101.forward(angles)
    assert math.dist(pose.position, (0.0388353, 0.0, 0.1166)) < 0.45


_ANY = st.floats(allow_nan=True, allow_infinity=True)


@given(st.lists(_ANY, min_size=3, max_size=3), st.lists(_ANY, min_size=9, max_size=9))
def test_any_numbers_are_a_pose_or_refused(place: list[float], numbers: list[float]) -> None:
    x, y, z = place
    a, b, c = (tuple(numbers[i : i + 3]) for i in (0, 3, 6))
    pose = Pose((x, y, z), (a, b, c))  # type: ignore[arg-type]  # three each
    if all(map(math.isfinite, (*place, *numbers))):
        for solution in SO101.inverse(pose):
            assert all(map(math.isfinite, solution.angles))
        assert SO101.reach(pose).excess >= 0.0
    else:
        for ask in (SO101.inverse, SO101.reach, SO101.best):
            with pytest.raises(UsageError, match="the pose has a number that is not finite"):
                ask(pose)


@given(st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=3, max_size=3))
def test_any_finite_position_is_reached_exactly_or_out_of_reach(place: list[float]) -> None:
    x, y, z = place
    pose = Pose((x, y, z), rotation_from_rpy(0.3, 2.0, 0.1))
    solutions = SO101.inverse(pose)
    assert bool(solutions) == SO101.reach(pose).reachable
    for solution in solutions:
        assert math.dist(SO101.forward(solution.angles).position, pose.position) < 1e-9


@pytest.mark.parametrize("angles", [[0.0] * 6, [0.0] * 4, [0.0, math.nan, 0.0, 0.0, 0.0], [math.inf] + [0.0] * 4])
def test_five_finite_angles_are_wanted(angles: list[float]) -> None:
    for ask in (SO101.forward, SO101.violations, SO101.jacobian, SO101.singularity, SO101.to_joints):
        with pytest.raises(UsageError, match=r"joints here, got|not a number"):
            ask(angles)


@each_arm
def test_aimed_carried_and_down(arm: SoArmModel) -> None:
    here, place = rad([20, 10, 30, 10, 40]), (0.24, 0.08, 0.04)
    for rotation, pitch, roll in (
        (arm.aimed(place, 0.5, -1.0, here), 0.5, -1.0),
        (arm.carried(place, here), math.radians(50), math.radians(40)),
        (arm.tool_down(place, here), math.pi / 2, math.radians(40)),
    ):
        best = arm.best(Pose(place, rotation), here)
        got = arm.forward(best.angles)
        assert pose_error(got, Pose(place, rotation)) < 1e-9
        assert sum(best.angles[1:4]) == pytest.approx(pitch)
        assert best.angles[4] == pytest.approx(roll)


def test_an_arm_that_leans_back_keeps_facing_so() -> None:
    back = rad([0, -95, -60, 0, 0])
    place = SO101.forward(back).position
    assert place[0] < -0.1
    assert pose_error(Pose(place, SO101.carried(place, back)), SO101.forward(back)) < 1e-9


def test_limits_of_an_arms_own_calibration_replace_the_models() -> None:
    profile = load_profile("so101").model
    own = replace(profile, joints=tuple(replace(j, minimum=-0.5, maximum=0.7) for j in profile.joints))
    narrow = SO101.for_arm(own)
    assert set(narrow.ranges) == {JointRange(r.name, -0.5, 0.7) for r in SO101.ranges}
    assert SO101.ranges == SO_ARMS["so101"].ranges
    assert SO101.violations([0.6] * 5) == ()
    assert narrow.violations([0.0, 0.0, 0.0, 0.0, 0.8])[0].startswith("wrist_roll=45.84 deg is 5.73 deg above")


def test_joints_are_the_drivers_and_points_are_on_the_arm() -> None:
    angles = rad([10, 20, 30, 40, 50])
    joints = SO101.to_joints(angles)
    assert SO101.joint_names == ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll")
    assert SO101.from_joints({**joints, "gripper": 1.0}) == angles
    with pytest.raises(UsageError, match="the position of wrist_flex, wrist_roll is missing"):
        SO101.from_joints(dict(list(joints.items())[:3]))
    points = SO101.points([0.0] * 5)
    assert points["elbow"] == pytest.approx((0.0972345, -0.0001778, 0.22917))
    assert points["wrist"] == pytest.approx((0.2321345, -0.0001778, 0.23437))
    assert points["tool"] == SO101.forward([0.0] * 5).position


def test_many_at_once_are_the_single_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = random.Random(36)
    rows = [within(SO101, rng) for _ in range(5)]
    places, turns = SO101.forward_many(rows)
    table = SO101.inverse_many(places, turns)
    assert (places.shape, turns.shape, table.shape) == ((5, 3), (5, 3, 3), (5, 4, 5))
    for row, lines in zip(rows, table, strict=True):
        assert min(turn_error(tuple(row), tuple(line)) for line in lines if not math.isnan(line[0])) < 1e-7
    monkeypatch.setattr("hexwire.model.arms.so_arm.kinematics.numpy_or_none", lambda: None)
    plain = SO101.forward_many(rows)
    assert plain[0] == places.tolist()
    assert str(SO101.inverse_many(*plain)) == str(table.tolist())


@pytest.mark.parametrize("arm", [SO100, SO101])
def test_the_lowest_point_is_the_lowest_of_its_points(arm: SoArmModel) -> None:
    draw = random.Random(1)
    for _ in range(300):
        angles = [draw.uniform(-3.0, 3.0) for _ in range(5)]
        points = {name: place[2] for name, place in arm.points(angles).items()}
        name, height = arm.lowest(angles)
        assert height == pytest.approx(min(points.values()), abs=1e-12)
        assert points[name] == pytest.approx(height, abs=1e-12)
    with pytest.raises(UsageError, match="not a number"):
        arm.lowest([0.0, math.nan, 0.0, 0.0, 0.0])
