"""The path of a trajectory on an emulated board: its points, its own time, and where the joints are at a time.

Owns points and their checks, what may be replaced, interpolation, running dry and braking, as in PROTOCOL.md
section 6.7. Pure: moments are arguments, in seconds of the board's clock. Knows joints only as columns of counts;
must not know servos or commands.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from hexwire.wire.board_trajectory import POINT_TIME, PathPoint, point_size
from hexwire.wire.command_frame import Status
from hexwire.wire.commands import LimitRow

from .gate import RefusedError

__all__ = ["FINE", "MEMORY", "BoardPath"]

FINE = 8
"""Parts of a count in which fine positions are."""

MEMORY = 1920
"""Bytes for points, packed as on the wire: 64 points of seven joints with velocities."""
_INDEXES = 0x10000
_TICKS_PER_SECOND = round(1 / POINT_TIME)


@dataclass(frozen=True, slots=True)
class _Knot:
    """A point, with the time of the path at which it is reached, in ticks since point 0."""

    at: int
    positions: tuple[int, ...]
    velocities: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class _Braking:
    """Braking: when it begins, where on the path, and how many ticks it takes; infinite if it follows the path."""

    moment: float
    ticks: float
    length: float

    def way(self, moment: float) -> float:
        """Ticks of the path since it began: the rate is 1 - 3 u^2 + 2 u^3, so it begins and ends without a jump."""
        passed = max((moment - self.moment) / POINT_TIME, 0.0)
        if not self.length or math.isinf(self.length):
            return passed if self.length else 0.0
        u = min(passed / self.length, 1.0)
        return self.length * (u - u**3 + u**4 / 2)


class BoardPath:
    """One path, from the first point to rest.

    Points are counted from 0 without end here; on the wire the index is modulo 65536.

    Args:
        joints: How many joints follow it.
        hermite: Points have velocities.
        brake: Seconds that braking takes.
        fine: Positions of points are in eighths of a count.

    Attributes:
        capacity: Points that fit.
        hermite: Points have velocities.
        whole: The last point has arrived.
        towards: Index of the point towards which the joints move; 0 before the start.
        dry: It brakes because points are missing.
    """

    def __init__(self, joints: int, *, hermite: bool, brake: float, fine: bool = False) -> None:
        self.capacity = MEMORY // point_size(joints, hermite=hermite)
        self.hermite = hermite
        self._unit = FINE if fine else 1
        self._coming: list[_Knot] | None = None
        self.whole = False
        self.towards = 0
        self.dry = False
        self._brake_ticks = brake / POINT_TIME
        self._knots: list[_Knot] = []
        self._oldest = 0
        self._start: float | None = None
        self._ticks = 0.0
        self._braking: _Braking | None = None

    @property
    def next(self) -> int:
        """Index of the next point."""
        return self._oldest + len(self._knots)

    @property
    def free(self) -> int:
        """How many points fit now."""
        return self.capacity - len(self._knots)

    @property
    def first_positions(self) -> tuple[int, ...]:
        """Positions of point 0 in counts, before the start; halves upwards."""
        return tuple((2 * place + self._unit) // (2 * self._unit) for place in self._knots[0].positions)

    @property
    def can_start(self) -> bool:
        """Whether it has two points, and is whole or lasts longer than braking."""
        return len(self._knots) >= 2 and (self.whole or self._end > self._brake_ticks / 2)

    @property
    def braking(self) -> bool:
        """Whether it brakes, or has."""
        return self._braking is not None

    @property
    def _end(self) -> int:
        """Ticks of the path at the newest point."""
        return self._knots[-1].at if self._knots else 0

    # -- points -------------------------------------------------------------------------------------

    def put(self, first: int, points: Sequence[PathPoint], limits: Sequence[LimitRow], *, last: bool) -> None:
        """Add points, in place of those from `first` on.

        Args:
            first: Index of the first of them, modulo 65536.
            points: At least one.
            limits: Limits of the joints.
            last: They are the last.

        Raises:
            RefusedError: `bad_range` or `busy`; nothing has changed.
        """
        place = self.next - (self.next - first) % _INDEXES
        fixed = 0 if self._start is None else self.towards + 1
        if place < fixed or (place == self.next and self.whole):
            raise RefusedError(Status.BAD_RANGE)
        kept = self._knots[: place - self._oldest]
        knots = list(kept)
        for point in points:
            knots.append(_next_knot(knots[-1] if knots else None, point, limits, self._unit))
        if len(knots) > self.capacity or self._coming is not None:
            raise RefusedError(Status.BUSY)
        self._knots = knots
        self.whole = last

    def begin_coming(self, first: int, count: int) -> None:
        """Expect points that come one after the other and count when all are there.

        Args:
            first: Index of the first, modulo 65536.
            count: How many.

        Raises:
            RefusedError: `bad_range` unless it is the next one, `busy` if they do not fit.
        """
        if (self.next - first) % _INDEXES or self.whole:
            raise RefusedError(Status.BAD_RANGE)
        if count > self.free:
            raise RefusedError(Status.BUSY)
        self._coming = []

    def come(self, points: Sequence[PathPoint], limits: Sequence[LimitRow]) -> None:
        """Take some of these points.

        Raises:
            RefusedError: `bad_range`.
        """
        assert self._coming is not None
        for point in points:
            before = self._coming[-1] if self._coming else self._knots[-1] if self._knots else None
            self._coming.append(_next_knot(before, point, limits, self._unit))

    def end_coming(self, *, last: bool) -> None:
        """All of them have come."""
        assert self._coming is not None
        self._knots += self._coming
        self._coming = None
        self.whole = last

    def drop_coming(self) -> None:
        """They will not all come."""
        self._coming = None

    # -- time ---------------------------------------------------------------------------------------

    def start(self, moment: float) -> None:
        """Let its time run from a moment on."""
        self._start = moment
        self.towards = 1

    def brake(self, moment: float) -> None:
        """Brake from a moment on, unless it brakes already."""
        self.advance(moment)
        if self._braking is None:
            left = self._end - self._ticks
            length = self._brake_ticks
            if 2 * left <= length:
                # Nothing brakes better than the path itself, if it leads to its end.
                length = math.inf if self.whole else 2 * left
            self._braking = _Braking(moment, self._ticks, length)

    def advance(self, moment: float) -> None:
        """Let its time run up to a moment: points that it is past are forgotten, and it may run dry."""
        if self._start is None:
            return
        if self._braking is None and not self.whole:
            self._watch_end(moment, self._start)
        self._ticks = max(self._ticks, min(self._ticks_at(moment, self._start), self._end))
        while self.towards < self.next - 1 and self._knots[self.towards - self._oldest].at <= self._ticks:
            self.towards += 1
        del self._knots[: self.towards - 1 - self._oldest]
        self._oldest = self.towards - 1

    def _watch_end(self, moment: float, start: float) -> None:
        """Brake in time to be at rest at the newest point."""
        latest = self._end - self._brake_ticks / 2
        if (moment - start) / POINT_TIME < latest:
            return
        begin = max(latest, self._ticks)
        # Points may have been replaced by fewer: then there is less time, but it still ends at rest.
        length = min(self._brake_ticks, 2 * (self._end - begin))
        self._braking = _Braking(start + begin * POINT_TIME, begin, length)
        self.dry = True

    def _ticks_at(self, moment: float, start: float) -> float:
        if self._braking is not None:
            return self._braking.ticks + self._braking.way(moment)
        return (moment - start) / POINT_TIME

    @property
    def rest_at(self) -> float | None:
        """The moment from which on the joints are at rest at its end, as far as it is known."""
        braking = self._braking
        if braking is None:
            return self._start + self._end * POINT_TIME if self.whole and self._start is not None else None
        length = self._end - braking.ticks if math.isinf(braking.length) else braking.length
        return braking.moment + length * POINT_TIME

    # -- places -------------------------------------------------------------------------------------

    def positions(self, moment: float) -> tuple[int, ...]:
        """Where the joints are at a moment, rounded to counts, once; time does not go back."""
        self.advance(moment)
        before, after = self._knots[:2] if len(self._knots) > 1 else (self._knots[0], self._knots[0])
        ticks = after.at - before.at
        share = (self._ticks - before.at) / ticks if ticks else 1.0
        if not self.hermite:
            pairs = zip(before.positions, after.positions, strict=True)
            return tuple(round((a + (b - a) * share) / self._unit) for a, b in pairs)
        rows = zip(before.positions, before.velocities, after.positions, after.velocities, strict=True)
        seconds = ticks * POINT_TIME * self._unit
        return tuple(round(_cubic(share, seconds, *row) / self._unit) for row in rows)


def _next_knot(before: _Knot | None, point: PathPoint, limits: Sequence[LimitRow], unit: int) -> _Knot:
    """Check a point, whose positions are in parts of a count, and place it after another one.

    Raises:
        RefusedError: `bad_range`.
    """
    sound = (point.ticks == 0) == (before is None)
    for position, limit in zip(point.positions, limits, strict=True):
        sound &= limit.minimum * unit <= position <= limit.maximum * unit
    for velocity, limit in zip(point.velocities, limits, strict=bool(point.velocities)):
        sound &= abs(velocity) <= limit.speed
    if before is not None:
        for a, b, limit in zip(before.positions, point.positions, limits, strict=True):
            # Positions are rounded, so an even motion at the limit may need one unit more.
            sound &= (abs(b - a) - 1) * _TICKS_PER_SECOND <= limit.speed * unit * point.ticks
    if not sound:
        raise RefusedError(Status.BAD_RANGE)
    return _Knot((before.at if before else 0) + point.ticks, point.positions, point.velocities)


def _cubic(share: float, seconds: float, place: int, speed: int, end: int, end_speed: int) -> float:
    """The cubic with these places and speeds (per second) at both ends, at a share of its time."""
    rest = 1 - share
    from_places = rest * rest * (1 + 2 * share) * place + share * share * (3 - 2 * share) * end
    return from_places + share * rest * seconds * (rest * speed - share * end_speed)
