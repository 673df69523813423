from __future__ import annotations

import math
import random
from itertools import pairwise

import pytest

from hexwire.errors import LimitError, UsageError
from hexwire.model.arms.hex7bot.kinematics import Hex7BotModel
from hexwire.model.arms.puma260.kinematics import Puma260Model
from hexwire.model.pose import Pose, rotation_between
from hexwire.motion.line import Line, Lines

A = Hex7BotModel()
START = tuple(math.radians(d) for d in (90, 100, 90, 90, 45, 90))


def moved(dx: float, dy: float, dz: float, start: tuple[float, ...] = START) -> Pose:
    here = A.forward(start)
    x, y, z = here.position
    return Pose((x + dx, y + dy, z + dz), here.rotation)


def off_the_line(p: tuple[float, ...], a: tuple[float, ...], b: tuple[float, ...]) -> float:
    along = [q - r for q, r in zip(b, a, strict=True)]
    length = math.hypot(*along)
    share = sum((x - y) * d for x, y, d in zip(p, a, along, strict=True)) / length**2
    return math.dist(p, [r + share * d for r, d in zip(a, along, strict=True)])


def test_tip_stays_on_the_line_at_the_speed() -> None:
    goal = moved(0.08, 0.02, -0.06)
    line = Line(A, START, goal, speed=0.1, acceleration=0.5)
    a, b = A.forward(START).position, goal.position
    last = None
    for t, sample in line.samples(0.013):
        pose = A.forward(sample.position)
        assert off_the_line(pose.position, a, b) < 1e-9
        assert rotation_between(pose.rotation, goal.rotation)[1] < 1e-6
        if last and t - last[0] > 1e-3:
            assert math.dist(pose.position, last[1]) / (t - last[0]) < 0.1 * 1.001
        last = (t, pose.position)
    assert A.forward(line.goal).position == pytest.approx(goal.position, abs=1e-12)
    length = math.dist(a, b)
    # Full acceleration takes a tenth of a second.
    assert line.duration == pytest.approx(length / 0.1 + 0.1 / 0.5 + 0.1)
    assert line.start == pytest.approx(START, abs=1e-9)


def test_velocity_is_the_derivative() -> None:
    line = Line(A, START, moved(0.05, 0.03, -0.04))
    for share in (0.2, 0.5, 0.8):
        t, h = share * line.duration, 1e-3
        for v, b, c in zip(line.at(t).velocity, line.at(t - h).position, line.at(t + h).position, strict=True):
            assert v == pytest.approx((c - b) / (2 * h), abs=1e-5)


def test_tool_turns_evenly() -> None:
    here = A.forward(START)
    goal = Pose(here.position, A.forward((*START[:4], START[4] + 0.6, START[5])).rotation)
    line = Line(A, START, goal, turn_speed=0.5)
    assert line.duration > 0.6 / 0.5
    middle = A.forward(line.at(line.duration / 2).position)
    assert rotation_between(here.rotation, middle.rotation)[1] == pytest.approx(0.3, abs=1e-6)
    assert middle.position == pytest.approx(here.position, abs=1e-9)


def test_a_line_without_length_takes_no_time() -> None:
    line = Line(A, START, A.forward(START))
    assert line.duration == 0
    assert line.sample(0.0).position == pytest.approx(START, abs=1e-9)


def test_leaving_reach_says_where() -> None:
    with pytest.raises(LimitError, match=r"at \d+% of the line: .*(out of reach|deg)"):
        Line(A, START, moved(0.0, 0.4, 0.0))


def test_leaving_limits_says_where_and_which() -> None:
    with pytest.raises(LimitError, match=r"at \d+% of the line: (t\d=|elbow)"):
        Line(A, START, moved(0.0, 0.0, -0.33))


def test_a_start_outside_limits_is_refused() -> None:
    with pytest.raises(LimitError, match="t0=0 deg"):
        Line(A, (0.0, *START[1:]), moved(0.01, 0, 0))


def test_past_a_singularity_is_refused() -> None:
    # From nearly along the forearm the tool cannot tip sideways: roll and t5 would have to swing round first.
    start = tuple(math.radians(d) for d in (90, 90, 90, 90, 89, 90))
    here = A.forward(start)
    over = A.forward(tuple(math.radians(d) for d in (91, 90, 90, 90, 91, 90))).rotation
    with pytest.raises(
        LimitError, match=r"at \d+% of the line: t[35] would have to turn \d+.* deg at once; .*singularity"
    ):
        Line(A, start, Pose(here.position, over))


def test_line_through_the_neutral_singularity_in_the_arms_plane() -> None:
    start = tuple(math.radians(d) for d in (90, 90, 90, 90, 90, 90))
    goal = A.forward(tuple(math.radians(d) for d in (90, 95, 95, 90, 85, 90)))
    line = Line(A, start, Pose(goal.position, A.forward(start).rotation))
    for _, sample in line.samples(0.05):
        assert sample.position[3] == pytest.approx(math.pi / 2, abs=1e-6)
        assert sample.position[5] == pytest.approx(math.pi / 2, abs=1e-6)


def test_the_puma_draws_lines_too() -> None:
    model = Puma260Model()
    start = (0.3, -0.8, -0.6, 0.2, 0.9, 0.1)
    here = model.forward(start)
    goal = Pose((here.position[0], here.position[1] + 0.05, here.position[2] - 0.05), here.rotation)
    line = Line(model, start, goal)
    for _, sample in line.samples(0.1):
        assert off_the_line(model.forward(sample.position).position, here.position, goal.position) < 1e-9


@pytest.mark.parametrize("name", ["speed", "acceleration", "turn_speed"])
@pytest.mark.parametrize("value", [0.0, -1.0, math.inf, math.nan])
def test_an_invalid_speed_is_refused(name: str, value: float) -> None:
    with pytest.raises(UsageError, match=f"speeds and accelerations must be finite and above 0, not {value:g}"):
        Line(A, START, moved(0.01, 0, 0), **{name: value})


def test_velocity_and_acceleration_are_derivatives_up_to_both_ends() -> None:
    line = Line(A, START, moved(0.05, 0.03, -0.04))
    h = 1e-3
    for t in (0.0, 0.05, 0.3 * line.duration, 0.8 * line.duration, line.duration):
        middle = min(max(t, h), line.duration - h)
        before, here, after = (line.at(middle + k * h).position for k in (-1, 0, 1))
        for v, a, b, m, c in zip(*line.at(middle)[1:], before, here, after, strict=True):
            assert v == pytest.approx((c - b) / (2 * h), abs=1e-4)
            assert a == pytest.approx((c - 2 * m + b) / h**2, abs=0.02)
    for t in (0.0, line.duration):
        assert line.at(t).velocity == pytest.approx((0.0,) * 6, abs=1e-9)
        assert line.at(t).acceleration == pytest.approx((0.0,) * 6, abs=1e-9)
    assert line.at(line.duration + 1.0).position == line.goal


def test_the_slower_of_moving_and_turning_sets_the_time() -> None:
    here = A.forward(START)
    turned = A.forward((*START[:4], START[4] + 0.6, START[5])).rotation
    x, y, z = here.position
    # A tool that turns as fast as it may covers 0.6 rad in 1.2 s, gains and loses speed in 0.3 s each.
    turning = Line(A, START, Pose((x, y, z), turned), speed=0.1, acceleration=0.5, turn_speed=0.5)
    assert turning.duration == pytest.approx(0.6 / 0.5 + 0.1 / 0.5 + 0.1)
    both = Line(A, START, Pose((x + 0.05, y, z), turned), speed=0.1, acceleration=0.5, turn_speed=0.5)
    assert both.duration == pytest.approx(turning.duration)
    slow = Line(A, START, Pose((x + 0.05, y, z), turned), speed=0.01, acceleration=0.5, turn_speed=0.5)
    assert slow.duration > 5.0
    middle = slow.pose(0.5)
    assert middle.position == pytest.approx((x + 0.025, y, z))
    assert rotation_between(here.rotation, middle.rotation)[1] == pytest.approx(0.3)


def test_usual_speeds() -> None:
    line = Line(A, START, moved(0.05, 0.0, 0.0))
    assert line.duration == pytest.approx(0.05 / 0.1 + 0.1 / 0.5 + 0.1)
    here = A.forward(START)
    turned = A.forward((*START[:4], START[4] + 0.6, START[5])).rotation
    assert Line(A, START, Pose(here.position, turned)).duration == pytest.approx(0.6 / 1.0 + 0.1 / 0.5 + 0.1)


@pytest.mark.slow
def test_the_tip_stays_on_any_line() -> None:
    dice = random.Random(5)
    passed = 0
    while passed < 25:
        start = tuple(angle + dice.uniform(-0.6, 0.6) for angle in START)
        try:
            line = Line(A, start, goal := moved(*(dice.uniform(-0.12, 0.12) for _ in range(3)), start))
        except LimitError:
            continue
        passed += 1
        here = A.forward(start)
        for _, sample in line.samples(line.duration / 71):
            pose = A.forward(sample.position)
            assert off_the_line(pose.position, here.position, goal.position) < 1e-6
            assert rotation_between(pose.rotation, here.rotation)[1] < 1e-5


# -- several lines ----------------------------------------------------------------------------------------


def corners(*ways: tuple[float, float, float]) -> list[Pose]:
    x, y, z = A.forward(START).position
    return [Pose((x + dx, y + dy, z + dz), A.forward(START).rotation) for dx, dy, dz in ways]


SQUARE = ((0.06, 0.0, 0.0), (0.06, 0.03, -0.06), (-0.04, 0.03, -0.06))


def off_the_lines(p: tuple[float, ...], points: list[tuple[float, ...]]) -> float:
    found = math.inf
    for a, b in pairwise(points):
        along = [q - r for q, r in zip(b, a, strict=True)]
        share = sum((x - y) * d for x, y, d in zip(p, a, along, strict=True)) / math.hypot(*along) ** 2
        share = min(1.0, max(0.0, share))
        found = min(found, math.dist(p, [r + share * d for r, d in zip(a, along, strict=True)]))
    return found


@pytest.mark.parametrize("rounding", [0.0, 0.004, 0.02])
def test_lines_leave_their_corners_only_as_far_as_is_allowed(rounding: float) -> None:
    goals = corners(*SQUARE)
    lines = Lines(A, START, goals, rounding=rounding, speed=0.05, acceleration=0.2)
    points = [A.forward(START).position, *(goal.position for goal in goals)]
    last: tuple[float, tuple[float, ...]] | None = None
    for t, sample in lines.samples(lines.duration / 97):
        tip = A.forward(sample.position).position
        # It follows what is planned, and leaves the lines only near a corner.
        assert math.dist(tip, lines.pose(t / lines.duration).position) < 1e-6
        off = off_the_lines(tip, points)
        if min(math.dist(tip, corner) for corner in points[1:-1]) > rounding + 1e-6:
            assert off < 1e-6
        assert off <= rounding + 1e-6
        if last:
            assert math.dist(tip, last[1]) <= 0.05 * (t - last[0]) * 1.001
        last = t, tip
    assert A.forward(lines.goal).position == pytest.approx(goals[-1].position, abs=1e-12)
    stops = sum(
        Lines(A, START, [goal], speed=0.05, acceleration=0.2).duration if not i else _single(goals[i - 1], goal)
        for i, goal in enumerate(goals)
    )
    assert lines.duration == pytest.approx(stops) if not rounding else lines.duration < stops - 0.3
    rest = (0.0,) * 6
    assert lines.at(0.0).velocity == pytest.approx(rest, abs=1e-3)
    assert lines.sample(lines.duration)[1:] == (rest, rest)


def _single(a: Pose, b: Pose) -> float:
    return math.dist(a.position, b.position) / 0.05 + 0.05 / 0.2 + 0.1


def test_the_tip_does_not_stop_at_a_corner() -> None:
    lines = Lines(
        A, START, corners((0.06, 0.0, 0.0), (0.06, 0.0, -0.06)), rounding=0.02, speed=0.05, acceleration=0.2
    )
    tips = [A.forward(lines.at(k * lines.duration / 100).position).position for k in range(101)]
    slowest = min(math.dist(a, b) for a, b in pairwise(tips[20:80])) / (lines.duration / 100)
    assert slowest > 0.02


def test_several_lines_velocities_are_derivatives() -> None:
    lines = Lines(A, START, corners(*SQUARE))
    h = 1e-5
    for k in range(1, 30):
        t = k * lines.duration / 30
        for v, b, c in zip(lines.at(t).velocity, lines.at(t - h).position, lines.at(t + h).position, strict=True):
            assert v == pytest.approx((c - b) / (2 * h), abs=1e-4)


def test_a_tool_that_turns_at_a_corner_ends_as_it_should() -> None:
    x, y, z = A.forward(START).position
    turned = A.forward((*START[:4], START[4] + 0.4, START[5])).rotation
    back = A.forward((*START[:4], START[4] - 0.1, START[5] + 0.3)).rotation
    lines = Lines(A, START, [Pose((x + 0.03, y, z), turned), Pose((x + 0.03, y, z - 0.03), back)])
    assert rotation_between(A.forward(lines.goal).rotation, back)[1] < 1e-6
    turns = [lines.pose(k / 200).rotation for k in range(201)]
    steps = [rotation_between(a, b)[1] for a, b in pairwise(turns)]
    # Evenly: no jump where the second line begins.
    assert max(steps) <= 1.0 * lines.duration / 200 * 1.001


def test_corners_that_repeat_and_no_line_at_all() -> None:
    once = Lines(A, START, corners(*SQUARE[:2]))
    assert Lines(A, START, corners(SQUARE[0], SQUARE[0], SQUARE[1])).duration == once.duration
    still = Lines(A, START, [A.forward(START)])
    assert (still.duration, still.goal) == (0.0, pytest.approx(START))
    for rounding in (-0.001, math.inf, math.nan):
        with pytest.raises(UsageError, match="corners cannot be rounded by"):
            Lines(A, START, corners(*SQUARE), rounding=rounding)
    with pytest.raises(LimitError, match=r"at \d+% of the line: .*(out of reach|deg)"):
        Lines(A, START, corners((0.02, 0.0, 0.0), (0.0, 0.4, 0.0)))
