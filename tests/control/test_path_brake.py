"""The brake of a path on the robot, in its points."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import pytest
from tests.control.unused_path import UnusedPath
from tests.motion.arms import HOME

from hexwire.control.path_brake import PathBrake, plan_points
from hexwire.drivers.timed_path import REST_POINTS, TimedPoint
from hexwire.errors import CommandRefusedError, StoppedError, UsageError
from hexwire.model.hex7bot import HEX7BOT
from hexwire.motion.waypoints import Spline, Waypoint

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
        self.error = error
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
    found = brake.end(path, plan(), TIMES[4:], 4, 0.33)
    assert found is not None
    count, points = found
    # The joints move towards the point at 0.35 s, which is number 7: those from 8 on are replaced.
    assert TIMES[4:][count - 1] == pytest.approx(0.35)
    assert path.sent == [(8, True, points)]
    assert points == brake.after(plan(), TIMES[7])


def test_where_nothing_is_open_or_the_robot_refuses_it_brakes_by_itself() -> None:
    brake = PathBrake(HEX7BOT, ("J1", "J2"))
    assert brake.end(Path(), plan(), TIMES[:6], 0, 0.5) is None
    for error in (CommandRefusedError("points", 2, "bad range"), UsageError("the robot has none of these")):
        assert brake.end(Path(error), plan(), TIMES, 0, 0.3) is None
    with pytest.raises(StoppedError):
        brake.end(Path(StoppedError("points", 3, "stopped")), plan(), TIMES, 0, 0.3)


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
