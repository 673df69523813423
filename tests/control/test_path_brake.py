"""The brake of a path on the robot, in its points."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Sequence
from typing import Any

import pytest
from tests.control.path_ends import rested
from tests.control.unused_path import UnusedPath
from tests.few import few
from tests.motion.arms import HOME, cubic_at
from tests.motion.fastest import fastest, keeps

from hexwire.control.motion import board_path_feeder
from hexwire.control.motion.board_path_feeder import PathBrake, plan_points
from hexwire.drivers.board2_path import MOST_BODY
from hexwire.drivers.timed_path import REST_POINTS, TimedPoint
from hexwire.errors import CommandRefusedError, StoppedError, UsageError
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.motion.eased import ease_out
from hexwire.motion.moving import joint_limits
from hexwire.motion.trajectory import Spline, Trajectory, Waypoint
from hexwire.wire.board_trajectory import point_size

NAMES = ("J2", "J1")
TIMES = [0.05 * i for i in range(21)]


def plan(speed: float = 0.5) -> Spline:
    """J2 turns evenly, J1 stands."""
    a, b = HOME["J2"], HOME["J1"]
    rows = ((0.0, (a, b), (speed, 0.0)), (1.0, (a + speed, b), (speed, 0.0)))
    return Spline(NAMES, [Waypoint(*row) for row in rows])


class Path(UnusedPath):
    """Remembers what it is sent."""

    def __init__(self, error: Exception | None = None) -> None:
        self.error, self.capacity = error, 64
        self.sent: list[tuple[int | None, bool, list[TimedPoint]]] = []

    def send(
        self,
        points: Sequence[TimedPoint],
        *,
        last: bool = False,
        first: int | None = None,
        rest: Callable[[TimedPoint], Sequence[TimedPoint]] | None = None,
    ) -> int:
        if self.error is not None:
            raise self.error
        self.sent.append((first, last, list(points)))
        return len(points)


def test_a_brake_is_in_the_order_of_the_path_on_the_robot() -> None:
    points = PathBrake(HEX7BOT, ("J1", "J2")).after(plan(), 0.5)
    assert 1 <= len(points) <= REST_POINTS
    assert points[-1].velocities == (0.0, 0.0)
    assert all(point.positions[0] == pytest.approx(HOME["J1"]) for point in points)
    assert HOME["J2"] + 0.25 < points[-1].positions[1] < HOME["J2"] + 0.4
    assert all(abs(point.time * 1e4 - round(point.time * 1e4)) < 1e-6 for point in points)


def test_a_path_is_ended_at_the_first_place_that_is_still_open() -> None:
    brake, path = PathBrake(HEX7BOT, ("J1", "J2")), Path()
    found = brake.end(path, plan(), TIMES[4:], 4, lambda: 0.31)
    assert found is not None
    count, points = found
    # The joints move towards the point at 0.35 s, which is number 7: those from 8 on are replaced.
    assert TIMES[4:][count - 1] == pytest.approx(0.35)
    assert path.sent == [(8, True, points)]
    assert points == brake.after(plan(), TIMES[7])


def test_where_nothing_is_open_or_the_robot_refuses_it_brakes_by_itself() -> None:
    brake = PathBrake(HEX7BOT, ("J1", "J2"))
    assert brake.end(Path(), plan(), TIMES[:6], 0, lambda: 0.5) is None
    for error in (CommandRefusedError("points", 2, "bad range"), UsageError("the robot has none of these")):
        assert brake.end(Path(error), plan(), TIMES, 0, lambda: 0.3) is None
    with pytest.raises(StoppedError):
        brake.end(Path(StoppedError("points", 3, "stopped")), plan(), TIMES, 0, lambda: 0.3)


def test_the_points_of_a_plan_are_its_own_from_any_time_on_and_within_limits() -> None:
    path = plan()
    for begin in (0.0, 0.4):
        points = list(plan_points(HEX7BOT, ("J1", "J2"), path, begin, 0.02, 0.1))
        assert points[0].time == begin
        assert points[-1].time == pytest.approx(1.0)
        for point in points:
            sample = path.sample(point.time)
            assert point.positions == pytest.approx(sample.position[::-1])
            assert point.velocities == pytest.approx(sample.velocity[::-1])
    fast = HEX7BOT.joint("J2").max_speed
    points = list(plan_points(HEX7BOT, ("J1", "J2"), plan(1.5 * fast), 0.0, 0.02, 0.1))
    assert points[0].velocities == (0.0, fast)
    assert max(point.positions[1] for point in points) == HEX7BOT.joint("J2").maximum


@few("seed", range(30), 0)
def test_every_path_at_its_limits_is_ended_on_it_or_beside_it_within_them(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    draw, slowed = random.Random(seed), list[Trajectory]()

    def noted(*given: Any) -> Trajectory | None:
        if (found := ease_out(*given)) is not None:
            slowed.append(found)
        return found

    monkeypatch.setattr(board_path_feeder, "ease_out", noted)
    for _ in range(5):
        way = fastest(draw, HEX7BOT)
        names = way.names
        scales = [HEX7BOT.joint(name).scale for name in names]
        rows = list(plan_points(HEX7BOT, names, way, 0.0, 0.02, 0.03))
        times, now = [row.time for row in rows[:64]], draw.uniform(0.0, 0.6) * way.duration
        times = [time for time in times if time > now - 0.1] or [rows[-1].time]
        slowed.clear()
        path = Path()
        found = PathBrake(HEX7BOT, names).end(path, way, times, 4, lambda now=now: now)  # type: ignore[misc]
        if now >= times[-1] - 0.02:
            assert found is None
            continue
        assert found is not None
        count, points = found
        (first, last, sent), begin = path.sent[0], times[count - 1]
        assert first == 4 + count
        assert last
        assert len(sent) <= 48
        assert points[-1].velocities == (0.0,) * len(names)
        limits, here = joint_limits(HEX7BOT, names), way.sample(begin)
        if len(points) > REST_POINTS:
            # The robot is told of the path as it slows down, within half a count and at most 3.5 s.
            meant = slowed[-1]
            assert keeps(meant, limits, here)
            assert points[-1].time - begin == pytest.approx(meant.duration, abs=2e-4)
            before = TimedPoint(begin, here.position, here.velocity)
            for point in points:
                _compare(before, point, meant, begin, scales)
                before = point
            # The first request lasts until the next one comes: the robot needs 0.44 s to brake by itself.
            request = points[: (MOST_BODY - 5) // point_size(len(names), hermite=True)]
            assert len(request) == len(points) or request[-1].time - begin > 0.55
        else:
            samples = rested(way, begin, points, names)
            for i in range(math.ceil((points[-1].time - begin) * 1000.0)):
                for (_, v, a), limit in zip(samples(begin + 0.001 * (i + 1)), limits, strict=True):
                    assert abs(v) <= 1.001 * limit.speed
                    assert abs(a) <= 1.001 * limit.acceleration


def _compare(a: TimedPoint, b: TimedPoint, meant: Trajectory, begin: float, scales: Sequence[float]) -> None:
    """The cubic between two points against what is meant."""
    h = b.time - a.time
    for i in range(10):
        exact = meant.sample(a.time - begin + 0.1 * i * h).position
        rows = zip(a.positions, b.positions, a.velocities or (), b.velocities or (), exact, scales, strict=True)
        for p, q, v, w, place, scale in rows:
            assert abs(cubic_at(p, q, v, w, h, 0.1 * i * h)[0] - place) <= 0.6 * scale


def test_a_search_that_took_too_long_is_made_again_for_a_later_place() -> None:
    brake, path, times = PathBrake(HEX7BOT, ("J1", "J2")), Path(), iter((0.30, 0.36, 0.40, 0.41))
    found = brake.end(path, plan(), TIMES, 0, lambda: next(times))
    assert found is not None
    # Asked at 0.30 s it was the point at 0.35 s, and that was passed meanwhile.
    assert TIMES[found[0] - 1] == pytest.approx(0.55)
    assert len(path.sent) == 1
