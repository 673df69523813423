"""How the firmware brakes on a path: targets on the servo line against what the host has planned, and the law.

The emulator is compared with the firmware in `tests/conformance_board`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import pytest
from tests.conformance_board.test_trajectory import NUMBER, START, Rider, Sent

from hexwire.motion.moving import reach
from hexwire.motion.path_points import path_points, path_rest
from hexwire.motion.speed_profile import JointLimits
from hexwire.motion.trajectory import Sample, Trajectory
from hexwire.wire.board_trajectory import PathPoint, PathState
from hexwire.wire.command_frame import Command, Status

# The first one builds.

LEGACY, HLS = 0, 4
NAMES = ("J1", "J5")
COUNT = 0.0015339807878856412
"""Radians."""
LIMITS = [JointLimits(2.0, 6.0, 60.0)] * 2
OFF = 1.6
"""Counts: rounding, and 0.4 ms at 2 rad/s."""


@pytest.fixture(params=["core", "chip"])
def rider(request: pytest.FixtureRequest) -> Iterator[Rider]:
    made = Rider(request.param, ())
    yield made
    made.board.close()


def way() -> Trajectory:
    """Both joints by 1.2 rad, as fast as their limits allow."""
    rest = (0.0, 0.0)
    found = reach(NAMES, Sample(rest, rest, rest), Sample((1.2, -1.2), rest, rest), LIMITS, 0.01, longer=True)
    assert found is not None
    return found


def row(ticks: int, position: Sequence[float], velocity: Sequence[float]) -> PathPoint:
    places = [8 * (START[i] + p / COUNT) for i, p in zip((LEGACY, HLS), position, strict=True)]
    return PathPoint(ticks, tuple(round(each) for each in places), tuple(round(v / COUNT) for v in velocity))


def rows(points: Sequence[tuple[float, Sequence[float], Sequence[float]]]) -> list[PathPoint]:
    found, before = [], 0
    for time, position, velocity in points:
        ticks = round(time * 1e4)
        found.append(row(ticks - before, position, velocity))
        before = ticks
    return found


def begin(rider: Rider, points: Sequence[tuple[float, Sequence[float], Sequence[float]]]) -> float:
    """Start a path; when."""
    assert rider.begin(1 << LEGACY | 1 << HLS, hermite=True, fine=True, brake=500) == Status.OK
    assert rider.add(rows(points), last=True) == Status.OK
    since = rider.machine.now
    assert rider.start() == Status.OK
    return since


def off(targets: Sequence[Sent], ideal: Callable[[float], Sequence[float]], start: float) -> float:
    """Most counts by which a target is beside a path that has begun at a time."""
    joints = (LEGACY, HLS)
    return max(
        abs(each.target - START[each.joint] - ideal(each.time - start)[joints.index(each.joint)] / COUNT)
        for each in targets
    )


def best(low: float, high: float, error: Callable[[float], float]) -> float:
    """Where an error is least."""
    for step in (2e-3, 2e-4):
        count = round((high - low) / step)
        middle = min((low + step * n for n in range(count + 1)), key=error)
        low, high = middle - step, middle + step
    return middle


@pytest.mark.parametrize("rider", ["core", pytest.param("chip", marks=pytest.mark.slow)], indirect=True)
def test_the_chip_comes_to_rest_as_the_host_has_planned(rider: Rider) -> None:
    """The points end with a brake from full speed, and the host is silent: nobody is needed for it."""
    plan, points, left = way(), [], 0.0
    for time, (position, velocity, _) in path_points(plan, [COUNT / 2] * 2, longest=0.03, shortest=0.02):
        points.append((time, position, velocity))
        left = time
        if time > 0.45 * plan.duration:
            break
    assert abs(points[-1][2][0]) > 1.5
    rest = path_rest(plan, left, LIMITS, [(-9.0, 9.0)] * 2)
    assert rest is not None
    since = begin(rider, [*points, *rest])
    rider.run(2.0)
    assert rider.state() is PathState.DONE
    here = Sample(*plan.sample(left))

    def ideal(t: float) -> Sequence[float]:
        if t <= left:
            return plan.sample(max(t, 0.0)).position
        before = (left, here.position, here.velocity)
        for after in rest:
            if t <= after.time or after is rest[-1]:
                h, u = after.time - before[0], min(t, after.time) - before[0]
                found = []
                for p, q, v, w in zip(before[1], after.position, before[2], after.velocity, strict=True):
                    c2 = (3.0 * (q - p) - h * (2.0 * v + w)) / h**2
                    c3 = (h * (v + w) - 2.0 * (q - p)) / h**3
                    found.append(p + u * (v + u * (c2 + u * c3)))
                return found
            before = after
        raise AssertionError

    targets = rider.sent(since)
    start = best(since - 0.1, since + 0.2, lambda start: off(targets, ideal, start))
    assert off(targets, ideal, start) <= OFF
    assert targets[-1].target == pytest.approx(START[HLS] + rest[-1].position[1] / COUNT, abs=1)


def test_an_abort_is_braked_by_the_law_of_the_protocol(rider: Rider) -> None:
    plan = way()
    found = path_points(plan, [COUNT / 2] * 2, longest=0.05, shortest=0.02)
    since = begin(rider, [(time, position, velocity) for time, (position, velocity, _) in found])
    rider.run(0.4)
    asked = rider.machine.now
    assert rider.ask(Command.TRAJECTORY_ABORT, bytes((NUMBER,))).status == Status.OK
    rider.until(PathState.ABORTED)
    targets = rider.sent(since)
    before = [each for each in targets if each.time < asked]
    start = best(
        since - 0.1, since + 0.2, lambda start: off(before, lambda t: plan.sample(max(t, 0.0)).position, start)
    )
    begun = asked - start

    def braked(t: float, begin: float) -> Sequence[float]:
        u = min(max(t - begin, 0.0) / 0.5, 1.0)
        return plan.sample(max(0.0, min(t, begin) + 0.5 * (u - u**3 + u**4 / 2))).position

    when = best(begun, begun + 0.06, lambda begin: off(targets, lambda t: braked(t, begin), start))
    assert off(targets, lambda t: braked(t, when), start) <= OFF
