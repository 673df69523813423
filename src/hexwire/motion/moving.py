"""Motion that begins while the joints move: from any position, velocity and acceleration within all limits.

Owns the jerk-limited profile from one moving state to another, and the brake. Must not know robots or clocks.

A change of speed takes the shortest time: at full jerk and, if it is long, full acceleration. A way from one state
to another is a change to some speed, a time at that speed, and a change to the speed at its end.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence

from hexwire.errors import LimitError
from hexwire.model.arm import ArmModel

from .speed_profile import JointLimits, SpeedPiece
from .trajectory import Sample, Trajectory

__all__ = ["Pieces", "Row", "State", "brake", "braking_time", "change", "joint_limits", "reach", "rest_range"]

Row = tuple[float, float, float, float, float]
"""Time, position, velocity, acceleration and jerk at the begin of a piece."""

State = tuple[float, float, float]
"""Position, velocity and acceleration of a joint."""

_ROUNDS = 60
"""Most steps of a search for a speed; a few are usual."""
_SLACK = 1e-3
"""Share of the limit of speed that counts as none, as in the check of a path."""
_HALVINGS = 32
_FINE = 1e-7
"""Radians per second: speeds that are closer are the same."""
_ROUNDING = 1e-6
_SAME = 1e-9
"""Radians per second that count as none."""
_EXACT = 1e-11
"""Radians, and seconds, that count as none."""
_GROWTH, _STEP = 1.03, 0.002
"""How much longer a time is tried next, as a factor and in seconds more."""
_TRIES = 300
"""Most times that are tried; the last is some thousand times as long as the shortest way takes, or a minute."""


def joint_limits(arm: ArmModel, names: Sequence[str]) -> list[JointLimits]:
    """The limits of planned motion of some joints."""
    joints = [arm.joint(name) for name in names]
    return [JointLimits(joint.max_speed, joint.max_acceleration, joint.max_jerk) for joint in joints]


class Pieces(Trajectory):
    """Joints that each move with pieces of constant jerk.

    Args:
        names: Joint names.
        rows: By joint, the pieces with their states at the begin, in the order of time, the first at 0.
        goal: Where it ends, exactly.
        duration: Seconds.
    """

    def __init__(
        self, names: Sequence[str], rows: Sequence[Sequence[Row]], goal: Sequence[float], duration: float
    ) -> None:
        self.names, self.duration = tuple(names), duration
        self._rows, self._end = rows, tuple(goal)
        self._begins = [[row[0] for row in some] for some in rows]

    def at(self, t: float) -> Sample:
        position, velocity, acceleration = [], [], []
        for begins, rows in zip(self._begins, self._rows, strict=True):
            since, p, v, a, j = rows[max(0, bisect_right(begins, t) - 1)]
            u = t - since
            position.append(p + u * (v + u * (0.5 * a + u * j / 6.0)))
            velocity.append(v + u * (a + 0.5 * u * j))
            acceleration.append(a + u * j)
        return Sample(self._end if t >= self.duration else tuple(position), tuple(velocity), tuple(acceleration))

    @property
    def pieces(self) -> Sequence[Sequence[Row]]:
        """By joint, the pieces of constant jerk."""
        return self._rows

    def ranges(self) -> list[tuple[float, float]]:
        """By joint, the least and the greatest position, radians."""
        found = []
        for rows, goal in zip(self._rows, self._end, strict=True):
            places = [goal]
            for (t, p, v, a, j), end in zip(rows, [*(row[0] for row in rows[1:]), self.duration], strict=True):
                places.append(p)
                # It turns back where it has no speed.
                turns = [u for u in _roots(0.5 * j, a, v) if 0.0 < u < end - t]
                places.extend([p + u * (v + u * (0.5 * a + u * j / 6.0)) for u in turns])
            found.append((min(places), max(places)))
        return found


def _roots(a: float, b: float, c: float) -> tuple[float, ...]:
    """Where a u^2 + b u + c is 0."""
    if not a:
        return (-c / b,) if b else ()
    inside = b * b - 4.0 * a * c
    if inside < 0.0:
        return ()
    q = -0.5 * (b + math.copysign(math.sqrt(inside), b))
    return (q / a, c / q) if q else (0.0,)


def _change(v: float, a: float, to: float, limits: JointLimits) -> list[SpeedPiece]:
    """From a speed and an acceleration to another speed without acceleration, in the shortest time."""
    _, most, jerk = limits
    sign = 1.0 if to >= v + 0.5 * a * abs(a) / jerk else -1.0
    a, change, jerk = sign * a, sign * (to - v), sign * jerk
    size = abs(jerk)
    square = 0.5 * a * a + size * change
    peak = math.sqrt(square) if square > 0.0 else 0.0
    if peak <= most:
        return [SpeedPiece(max(0.0, peak - a) / size, jerk), SpeedPiece(peak / size, -jerk)]
    # An acceleration that is above the limit is first brought back to it.
    ramp = (most - a) / size
    flat = (change - abs(ramp) * 0.5 * (most + a)) / most - 0.5 * most / size
    return [
        SpeedPiece(abs(ramp), math.copysign(jerk, jerk * ramp)),
        SpeedPiece(max(0.0, flat), 0.0),
        SpeedPiece(most / size, -jerk),
    ]


def _measure(v: float, a: float, to: float, limits: JointLimits) -> tuple[float, float]:
    """Seconds and radians of `_change`. Every search for a speed asks this many times, so it makes no pieces."""
    _, most, jerk = limits
    forward = to >= v + 0.5 * a * abs(a) / jerk
    # The distance beyond that at the old speed is the same in both directions, but for its sign.
    b, change = (a, to - v) if forward else (-a, v - to)
    square = 0.5 * b * b + jerk * change
    peak = math.sqrt(square) if square > 0.0 else 0.0
    if peak <= most:
        up, flat, top, slope = (peak - b) / jerk if peak > b else 0.0, 0.0, peak, jerk
    else:
        up, slope, top = (most - b) / jerk, jerk, most
        if up < 0.0:
            up, slope = -up, -jerk
        flat = (change - up * 0.5 * (most + b)) / most - 0.5 * most / jerk
        if flat < 0.0:
            flat = 0.0
    down = top / jerk
    w = up * (b + 0.5 * up * slope)
    far = up * up * (0.5 * b + up * slope / 6.0) + flat * (w + 0.5 * top * flat)
    w += top * flat
    far += down * (w + top * down / 3.0)
    seconds = up + flat + down
    return seconds, v * seconds + (far if forward else -far)


class _Way:
    """One joint from a state to another, in some time.

    Args:
        begin: Radians, radians per second, radians per second squared.
        end: The same, at its end.
        limits: Of the joint.
    """

    def __init__(
        self, begin: tuple[float, float, float], end: tuple[float, float, float], limits: JointLimits
    ) -> None:
        p, self._v, self._a = begin
        q, self._w, b = end
        # Time reversed, the end is the begin of a change of speed.
        self._b, self._distance, self._limits = -b, q - p, limits
        self._settle = self._v + 0.5 * self._a * abs(self._a) / limits.jerk
        self._leave = self._w + 0.5 * self._b * abs(self._b) / limits.jerk

    def soonest(self) -> float:
        """Seconds in which it can be done; it may be possible in slightly less."""
        low, high = sorted((self._settle, self._leave))
        most, found = self._limits.speed, math.inf
        for edge, end in ((high, most), (low, -most)):
            sign = math.copysign(1.0, end)
            seconds, way = self._changes(edge)
            found = min(found, seconds)
            if sign * (self._distance - way) <= 0.0:
                continue
            seconds, way = self._changes(end)
            if sign * (self._distance - way) >= 0.0:
                return seconds + (self._distance - way) / end
            near, far = edge, end
            for _ in range(_HALVINGS):
                middle = 0.5 * (near + far)
                seconds, way = self._changes(middle)
                near, far = (middle, far) if sign * (self._distance - way) > 0.0 else (near, middle)
            return seconds
        return found

    def _changes(self, speed: float) -> tuple[float, float]:
        """Seconds and radians of both changes, to a speed and from it."""
        first, gone = _measure(self._v, self._a, speed, self._limits)
        last, more = _measure(self._w, self._b, speed, self._limits)
        return first + last, gone + more

    def _ways(self, speed: float, seconds: float) -> tuple[float, float]:
        """Seconds that are left at a speed between the changes, and the distance in all."""
        changes, distance = self._changes(speed)
        return seconds - changes, distance + speed * (seconds - changes)

    def in_time(self, seconds: float) -> list[SpeedPiece] | None:
        """The pieces that take so many seconds, or None if these do not suit it."""
        low, high = sorted((self._settle, self._leave))
        distance, most = self._distance, self._limits.speed
        if abs(self._leave) > (1.0 + _SLACK) * most:
            return None  # whatever comes before, it would have been faster than the limit
        for edge, end in ((high, most), (low, -most)):
            left, way = self._ways(edge, seconds)
            if left < -_EXACT:
                return None
            if abs(way - distance) <= _EXACT:
                return self._pieces(edge, seconds)
            if (way < distance) is (end > 0.0):
                return self._towards(edge, end, seconds)
        return self._between(low, high, seconds)

    def _towards(self, near: float, far: float, seconds: float) -> list[SpeedPiece] | None:
        """With a speed further out than those at both ends."""
        if not (far - near) * far > 0.0:
            return None
        sign = math.copysign(1.0, far)
        speed = far
        while abs(far - near) > _FINE:
            left, way = self._ways(speed, seconds)
            if left < 0.0:
                far = speed  # there is no time for that speed
            elif sign * (way - self._distance) < 0.0:
                near = speed
            else:
                return self._solve(near, speed, seconds)
            speed = 0.5 * (near + far)
        return None

    def _between(self, low: float, high: float, seconds: float) -> list[SpeedPiece] | None:
        """With a speed between those at both ends: there may be no time for some of them."""
        found = self._solve(low, high, seconds)
        if found is not None:
            return found
        # At the speed of the begin first, then at that of the end.
        settle, leave = (
            _change(self._v, self._a, self._settle, self._limits),
            _change(self._w, self._b, self._leave, self._limits),
        )
        middle = _change(self._settle, 0.0, self._leave, self._limits)
        rest = seconds - sum(piece.seconds for piece in (*settle, *middle, *leave))
        _, gone = _measure(self._v, self._a, self._settle, self._limits)
        _, more = _measure(self._w, self._b, self._leave, self._limits)
        _, change = _measure(self._settle, 0.0, self._leave, self._limits)
        if rest < 0.0 or self._settle == self._leave:
            return None
        missing = self._distance - gone - more - change - self._leave * rest
        wait = missing / (self._settle - self._leave)
        if not -_EXACT <= wait <= rest + _EXACT:
            return None
        wait = min(max(0.0, wait), rest)
        return [*settle, SpeedPiece(wait, 0.0), *middle, SpeedPiece(rest - wait, 0.0), *reversed(leave)]

    def _solve(self, near: float, far: float, seconds: float) -> list[SpeedPiece] | None:
        """The speed between two with which the distance takes the time: regula falsi, with halving."""
        a, b = near, far
        fa, fb = (self._ways(x, seconds)[1] - self._distance for x in (a, b))
        speed, kept = a, 0
        for i in range(_ROUNDS):
            if fa == fb:
                break
            speed = 0.5 * (a + b) if i % 4 == 3 else (a * fb - b * fa) / (fb - fa)
            left, way = self._ways(speed, seconds)
            off = way - self._distance
            if abs(off) <= _EXACT:
                break
            if (off < 0.0) is (fa < 0.0):
                a, fa = speed, off
                fb, kept = (0.5 * fb, 1) if kept == 1 else (fb, 1)
            else:
                b, fb = speed, off
                fa, kept = (0.5 * fa, -1) if kept == -1 else (fa, -1)
        left, way = self._ways(speed, seconds)
        if left < -_EXACT or abs(way - self._distance) > 2.0 * _EXACT:
            return None
        return self._pieces(speed, seconds)

    def _pieces(self, speed: float, seconds: float) -> list[SpeedPiece]:
        left, _ = self._ways(speed, seconds)
        up, down = _change(self._v, self._a, speed, self._limits), _change(self._w, self._b, speed, self._limits)
        return [*up, SpeedPiece(max(0.0, left), 0.0), *reversed(down)]


def _rows(p: float, v: float, a: float, pieces: Sequence[SpeedPiece]) -> list[Row]:
    rows: list[Row] = []
    t = 0.0
    for u, j in pieces:
        if u <= 0.0:
            continue
        rows.append((t, p, v, a, j))
        t, p, v, a = t + u, p + u * (v + u * (0.5 * a + u * j / 6.0)), v + u * (a + 0.5 * u * j), a + u * j
    rows.append((t, p, v, a if rows else 0.0, 0.0))
    return rows


def _ends(begin: Sample, end: Sample, limits: Sequence[JointLimits]) -> list[_Way]:
    # Only what a client wants itself may be beyond the limits: it is met with what is possible.
    most = [limit.acceleration for limit in limits]
    there = [max(-x, min(x, a)) for a, x in zip(end.acceleration, most, strict=True)]
    return [
        _Way((p, v, a), (q, w, b), limit)
        for p, v, a, q, w, b, limit in zip(*begin, end.position, end.velocity, there, limits, strict=True)
    ]


def _straight(begin: Sample, end: Sample, limits: Sequence[JointLimits]) -> tuple[_Way, list[float]] | None:
    """The way of the joint with the longest one, and the shares of it that the joints have; None if they differ.

    So joints move that begin at rest and end so or straight on: straight, as a trajectory was checked.
    """
    ways = [b - a for a, b in zip(begin.position, end.position, strict=True)]
    far = max(ways, key=abs)
    if any(begin.velocity) or any(begin.acceleration) or any(end.acceleration) or abs(far) <= _EXACT:
        return None
    lead = ways.index(far)
    shares = [way / far for way in ways]
    if any(abs(v - end.velocity[lead] * share) > _SAME for v, share in zip(end.velocity, shares, strict=True)):
        return None
    rows = [
        [most / abs(way) for most in limit] for limit, way in zip(limits, ways, strict=True) if abs(way) > _EXACT
    ]
    most = JointLimits(*(min(column) * abs(far) for column in zip(*rows, strict=True)))
    return _Way((0.0, 0.0, 0.0), (far, end.velocity[lead], 0.0), most), shares


def reach(
    names: Sequence[str],
    begin: Sample,
    end: Sample,
    limits: Sequence[JointLimits],
    seconds: float,
    *,
    longer: bool = False,
) -> Pieces | None:
    """All joints from one state to another, at the same time.

    Args:
        names: Joint names.
        begin: Where they are and how they move.
        end: Where they are to be and how they are to move.
        limits: Of the joints.
        seconds: After this time.
        longer: Or as much later as they need; a speed at the end that is beyond the limits is that of the limits.

    Returns:
        None if the limits do not allow that time.

    Raises:
        LimitError: `longer`, and there is no way however long it takes: a state is not of numbers, for example.
    """
    known = all(math.isfinite(x) for column in (*begin, *end) for x in column)
    if longer:
        # There is a way to every speed within the limits, and none beyond them.
        slower = [max(-most.speed, min(w, most.speed)) for w, most in zip(end.velocity, limits, strict=True)]
        end = end._replace(velocity=tuple(slower))
    straight = _straight(begin, end, limits)
    ways = _ends(begin, end, limits) if straight is None else [straight[0]]
    if longer:
        seconds = max(seconds, *((1.0 + _ROUNDING) * way.soonest() for way in ways))
    for _ in range((_TRIES if longer else 1) if known else 0):
        found: list[list[SpeedPiece]] = []
        for way in ways:
            if (pieces := way.in_time(seconds)) is None:
                break
            found.append(pieces)
        else:
            if straight is not None:
                # A joint with next to nothing to go is no task of its own.
                found = [[SpeedPiece(u, share * j) for u, j in found[0]] for share in straight[1]]
            states = zip(*begin, found, strict=True)
            return Pieces(names, [_rows(*state) for state in states], end.position, seconds)
        seconds = _GROWTH * seconds + _STEP
    if longer:
        raise LimitError(f"no motion within the limits leads {', '.join(names)} from where they are to the goal")
    return None


def change(speed: tuple[float, float], to: float, limits: JointLimits, seconds: float) -> State:
    """Change a speed towards another one for a time, as fast as the limits allow.

    Args:
        speed: Velocity and acceleration at the begin.
        to: Velocity that is wanted.
        limits: Of acceleration and jerk.
        seconds: How long.

    Returns:
        The way, and velocity and acceleration after that time.
    """
    way, (v, a) = 0.0, speed
    for u, j in _change(v, a, to, limits):
        u = min(u, seconds)
        way += u * (v + u * (0.5 * a + u * j / 6.0))
        v, a, seconds = v + u * (a + 0.5 * u * j), a + u * j, seconds - u
    if seconds > 0.0:
        # It is there: rounding must not add up.
        way, v, a = way + seconds * to, to, 0.0
    return way, v, a


def rest_range(state: State, limits: JointLimits) -> tuple[float, float]:
    """The least and the greatest position of a joint that comes to rest in the shortest time."""
    rows = _rows(*state, _change(*state[1:], 0.0, limits))
    return Pieces(("",), [rows], [rows[-1][1]], rows[-1][0]).ranges()[0]


def brake(names: Sequence[str], begin: Sample, limits: Sequence[JointLimits], *, together: bool = True) -> Pieces:
    """All joints to rest in the shortest time.

    Args:
        names: Joint names.
        begin: Where they are and how they move.
        limits: Of the joints.
        together: All of them in the same time: a straight motion stays straight. Otherwise each in its own.
    """
    seconds = braking_time(begin, limits)
    moving = zip(*begin, limits, strict=True)
    rows = [
        _rows(p, v, a, _gently(v, a, seconds, limit) if together else _change(v, a, 0.0, limit))
        for p, v, a, limit in moving
    ]
    return Pieces(names, rows, [row[-1][1] for row in rows], seconds)


def braking_time(begin: Sample, limits: Sequence[JointLimits]) -> float:
    """Seconds in which all joints can come to rest; arguments as of `brake`."""
    moving = zip(begin.velocity, begin.acceleration, limits, strict=True)
    return max((_measure(v, a, 0.0, limit)[0] for v, a, limit in moving), default=0.0)


def _gently(v: float, a: float, seconds: float, limits: JointLimits) -> list[SpeedPiece]:
    """The brake of one joint in a time that is not shorter than it needs: with a share of its limits."""
    if not v and not a:
        return []
    share = _share(v, a, seconds, limits)
    if abs(v + 0.5 * a * abs(a) / (share * limits.jerk)) <= max(abs(v), limits.speed):
        return _change(v, a, 0.0, _less(share, limits))
    # With less jerk the acceleration that it has would take it beyond its speed: that is taken away first.
    first = abs(a) / limits.jerk
    settled = v + 0.5 * a * first
    share = _share(settled, 0.0, seconds - first, limits)
    return [SpeedPiece(first, math.copysign(limits.jerk, -a)), *_change(settled, 0.0, 0.0, _less(share, limits))]


def _share(v: float, a: float, seconds: float, limits: JointLimits) -> float:
    """The least share of the limits with which a joint comes to rest in a time."""
    low, high = 0.0, 1.0
    for _ in range(_HALVINGS):
        share = 0.5 * (low + high)
        low, high = (share, high) if _measure(v, a, 0.0, _less(share, limits))[0] > seconds else (low, share)
    return high


def _less(share: float, limits: JointLimits) -> JointLimits:
    return JointLimits(limits.speed, share * limits.acceleration, share * limits.jerk)
