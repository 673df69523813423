"""Points in eighths of a count (PROTOCOL.md section 6.7), of the firmware's core."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from fractions import Fraction

import pytest
from tests.conformance_board.test_trajectory import START, Rider
from tests.few import few

from hexwire.wire import tables
from hexwire.wire.board_trajectory import BeginRequest, PathPoint, PathState
from hexwire.wire.command_frame import Command, Status

# The first one builds.

FINE = tables.TRAJECTORY_FLAG_FINE
HERMITE = tables.TRAJECTORY_FLAG_HERMITE
SPEED = 4096  # the default limit, counts/s


@pytest.fixture
def rider() -> Iterator[Rider]:
    made = Rider("core", ())
    yield made
    made.board.close()


def begin(rider: Rider, flags: int = FINE, mask: int = 1) -> int:
    rider.next = 0
    return rider.ask(Command.TRAJECTORY_BEGIN, BeginRequest(5, flags, mask, 200).serialize()).status


def point(ticks: int, *counts: float, velocities: Sequence[float] = ()) -> PathPoint:
    return PathPoint(ticks, tuple(round(8 * each) for each in counts), tuple(round(v) for v in velocities))


def test_targets_are_rounded_once(rider: Rider) -> None:
    """Of a slow path with positions between counts no target is further off than rounding and clock allow."""
    begin(rider, FINE | HERMITE)
    way, period = 20.0, 1.0
    points = []
    for n in range(21):
        angle = 2 * math.pi * n / 20
        place = START[0] + 0.375 + way * (1 - math.cos(angle)) / 2
        speed = way * math.pi / period * math.sin(angle)
        points.append(point(500 if n else 0, place, velocities=(speed,)))
    assert rider.add(points, last=True) == Status.OK
    since = rider.machine.now
    assert rider.start() == Status.OK
    rider.until(PathState.DONE)
    own = rider.sent(since)
    begun = next(n for n, each in enumerate(own) if each.target != own[0].target)

    def off(lead: float) -> float:
        worst = 0.0
        for each in own[begun:]:
            angle = 2 * math.pi * min(max(each.time - own[begun].time + lead, 0.0), period) / period
            worst = max(worst, abs(each.target - START[0] - 0.375 - way * (1 - math.cos(angle)) / 2))
        return worst

    # 63 counts/s at most: the clock's part is below 0.06. Rounded twice, it would be 0.8.
    assert min(off(0.0005 * n) for n in range(300)) < 0.56


def test_limits_are_exact(rider: Rider) -> None:
    limits = b"\7" + b"\x64\0\xb8\x0b\x00\x10" * 7  # 100 to 3000
    assert rider.ask(Command.LIMITS, limits).status == Status.OK
    for eighths, expected in ((799, 0), (800, 1), (24000, 1), (24001, 0), (-32768, 0), (32767, 0)):
        begin(rider)
        status = rider.add([PathPoint(0, (eighths,))])
        assert status == (Status.OK if expected else Status.BAD_RANGE), eighths


@pytest.mark.parametrize("sign", [1, -1])
def test_a_way_may_be_one_eighth_longer_than_the_speed_limit_allows(rider: Rider, sign: int) -> None:
    ticks = 333
    most = math.floor(8 * Fraction(SPEED * ticks, 10000)) + 1
    origin = 8 * START[0]
    for eighths, expected in ((most, Status.OK), (most + 1, Status.BAD_RANGE)):
        begin(rider)
        points = [PathPoint(0, (origin,)), PathPoint(ticks, (origin + sign * eighths,))]
        assert rider.add(points) == expected


@pytest.mark.parametrize(
    ("away", "expected"),
    [(64.375, Status.OK), (64.5, Status.BAD_RANGE), (-64.5, Status.OK), (-64.625, Status.BAD_RANGE)],
)
def test_the_start_is_near_to_the_count_that_is_nearest(rider: Rider, away: float, expected: Status) -> None:
    begin(rider)
    origin = START[0] + away
    assert rider.add([point(0, origin), point(1000, origin)], last=True) == Status.OK
    assert rider.start() == expected


def test_as_many_points_fit(rider: Rider) -> None:
    assert begin(rider, FINE | HERMITE, 0x7F) == Status.OK
    assert rider.status().free == 64
    assert begin(rider, 8) == Status.BAD_RANGE


@few("flags", [0, FINE], FINE)
def test_a_way_from_limit_to_limit_overflows_nowhere(rider: Rider, flags: int) -> None:
    begin(rider, flags | HERMITE)
    unit = 8 if flags & FINE else 1
    points = [
        PathPoint(0, (unit * START[0],), (0,)),
        PathPoint(65535, (0,), (-SPEED + 1,)),
        PathPoint(65535, (4095 * unit,), (SPEED - 1,)),
    ]
    assert rider.add(points) == Status.OK
    since = rider.machine.now
    assert rider.start() == Status.OK
    rider.run(3.0)
    own = rider.sent(since)
    seconds = 6.5535
    for each in own[5::20]:
        s = (each.time - since) / seconds
        way, slope = -START[0], (-SPEED + 1) * seconds
        ideal = START[0] + s * s * ((3 * way - slope) + s * (slope - 2 * way))
        assert each.target == pytest.approx(min(max(ideal, 0), 4095), abs=150)
