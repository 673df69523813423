"""A trajectory that begins while the joints move: how they join it, and how they come to rest after it.

Owns the choice of where the joints join and leave a trajectory. Must not know robots or clocks.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from .moving import Pieces, brake, braking_time, reach
from .speed_profile import JointLimits
from .trajectory import Sample, Spline, Trajectory

__all__ = ["Takeover", "take_over"]

_SAME = 1e-9
"""Greatest difference of states that are the same, in their units."""
_SOONEST, _LATER = 0.02, 1.25
"""Seconds after which a trajectory may be joined first, and the factor to the next time that is tried."""
_LATEST = 1.5
"""Seconds within which a trajectory that goes on in its own time is joined; later it is delayed instead."""
_DELAYS = (1.25, 1.6, 2.0, 2.5)
"""How much longer than in its own time the joints may need to where they join a trajectory."""
_APART = 0.15
"""Seconds that are left for the next point of a stream to come before the joints brake."""
_CLOSE = 0.15
"""Seconds before a point that is passed below which the way to it would be hurried."""
_JUMP = 1e-4
"""Share of the limit of acceleration by which it may change at once."""
_BEFORE = 1e-6
"""Share of a time that is just before its end."""
_SAMPLES = 40
"""Of the way to a first point, when it is compared with the limits."""


class Takeover(Trajectory):
    """A trajectory that the joints join while they move.

    Args:
        head: To where they join it.
        body: The trajectory.
        joined: Seconds from its start at which they do.
        left: Seconds from its start at which they leave it.
        tail: From there to rest, or None if it ends there.

    Attributes:
        head: To where the joints join the trajectory: the part that is on no checked path.
        tail: From where they leave it to rest, on no checked path either; None if it ends at rest.
    """

    def __init__(
        self, head: Pieces | None, body: Trajectory, joined: float, left: float, tail: Pieces | None
    ) -> None:
        self.names, self.head, self.tail = body.names, head, tail
        self._body, self._joined = body, joined
        self._head = 0.0 if head is None else head.duration
        self._tail = self._head + max(0.0, left - joined)
        self.duration = self._tail + (0.0 if tail is None else tail.duration)

    def at(self, t: float) -> Sample:
        if self.tail is not None and t >= self._tail:
            return self.tail.at(t - self._tail)
        # At its end too, where nothing of the trajectory is left to follow.
        if self.head is not None and (t < self._head or self._tail <= self._head):
            return self.head.at(t)
        return self._body.at(min(t - self._head + self._joined, self._body.duration))


def take_over(
    begin: Sample, body: Trajectory, limits: Sequence[JointLimits], *, passes: bool = False
) -> Takeover | Trajectory:
    """A trajectory as joints follow it that move otherwise when it begins.

    They join it as soon as their limits allow. What leads to its first point is free: a trajectory of one point is
    reached at its end, or as much later as that takes. Where it does not end at rest, they come to rest at its end.

    Args:
        begin: Where they are and how they move.
        body: The trajectory; after its end the joints rest.
        limits: Of the joints.
        passes: They pass its end with its velocity, and brake then: another one is to follow.
    """
    free = _free(body)
    last = body.at(body.duration)
    rest = (0.0,) * len(body.names)
    given = isinstance(body, Spline) and len(body.waypoints) > 1 and body.waypoints[-1].velocity is not None
    last = Sample(last.position, last.velocity if given and passes else rest, rest)
    left, tail = body.duration, None
    keeps = _keeps(body, limits, free)
    fits = keeps and _same(begin, body.at(0.0))
    one_point = free >= body.duration or (passes and body.duration < _CLOSE)
    if one_point and not (fits and not any(last.velocity)):
        seconds = body.duration
        if passes and not any(last.velocity):
            # Where the next point is to follow, the brake at this one must not begin before that.
            needed = braking_time(begin, limits)
            seconds = max(seconds + 0.5 * needed, needed + _APART)
        elif passes and seconds < _CLOSE:
            # So close a point is met where it will have gone on to.
            on = zip(last.position, last.velocity, strict=True)
            last = last._replace(position=tuple([p + v * (_CLOSE - seconds) for p, v in on]))
            seconds = _CLOSE
        head = reach(body.names, begin, last, limits, seconds, longer=True)
        assert head is not None
        if any(last.velocity):
            tail = brake(body.names, last, limits)
        return Takeover(head, body, left, left, tail)
    if not _ends_at_rest(body):
        left, tail = _tail(body, limits, given=given, passes=passes)
    if fits:
        return body if tail is None else Takeover(None, body, 0.0, left, tail)
    # The way to its first point is only followed if that keeps the limits.
    first, latest = 0.0 if keeps else free, min(free, left)
    if passes:
        # One of a stream is joined where that is not hurried: the next one begins before.
        first = latest = min(left, max(free, _CLOSE))
    joined, head = _join(begin, body, limits, first, latest, left, soonest=passes and given)
    return Takeover(head, body, joined, left, tail)


def _free(body: Trajectory) -> float:
    """Seconds from the start until the first point that somebody asked for."""
    if isinstance(body, Spline):
        return body.waypoints[min(1, len(body.waypoints) - 1)].time
    return 0.0


def _same(one: Sample, two: Sample) -> bool:
    return all(abs(a - b) <= _SAME for x, y in zip(one, two, strict=True) for a, b in zip(x, y, strict=True))


def _keeps(body: Trajectory, limits: Sequence[JointLimits], until: float) -> bool:
    """Whether a trajectory keeps the limits until a time."""
    step = until / _SAMPLES
    before = None
    for i in range(_SAMPLES + 1 if until > 0.0 else 0):
        _, velocity, acceleration = body.at(i * step)
        for v, a, b, limit in zip(velocity, acceleration, before or acceleration, limits, strict=True):
            if abs(v) > limit.speed or abs(a) > limit.acceleration or abs(a - b) > limit.jerk * step:
                return False
        before = acceleration
    # What comes then, which is rest or what was asked for, may begin with another acceleration.
    there = body.at((1.0 - _BEFORE) * until).acceleration
    then = body.at(until).acceleration if until < body.duration else (0.0,) * len(there)
    return all(abs(a - b) <= _JUMP * limit.acceleration for a, b, limit in zip(there, then, limits, strict=True))


def _ends_at_rest(body: Trajectory) -> bool:
    return not any(abs(v) > _SAME for v in body.at(body.duration).velocity)


def _tail(
    body: Trajectory, limits: Sequence[JointLimits], *, given: bool, passes: bool
) -> tuple[float, Pieces | None]:
    """When the joints leave a trajectory that does not end at rest, and how they come to rest."""
    end = body.at(body.duration)
    rest = (0.0,) * len(body.names)
    if given and passes:
        return body.duration, brake(body.names, end, limits)
    there = Sample(end.position, rest, rest)
    seconds = braking_time(end._replace(acceleration=rest), limits)
    begins = 0.0
    if isinstance(body, Spline) and len(body.waypoints) > 1:
        begins = body.waypoints[-2].time
    left = max(begins, body.duration - 0.5 * seconds)
    return left, reach(body.names, body.at(left), there, limits, seconds, longer=True)


def _join(
    begin: Sample,
    body: Trajectory,
    limits: Sequence[JointLimits],
    first: float,
    last: float,
    left: float,
    *,
    soonest: bool,
) -> tuple[float, Pieces]:
    """Where the joints join a trajectory, not before a first time, and how; late at the last if nothing suits.

    Those that are late join it at an even pace, or as soon as they can.
    """
    times = [t for t in _times(min(left, max(first, _LATEST))) if t >= first]
    for joined in times:
        if (head := reach(body.names, begin, body.at(joined), limits, joined)) is not None:
            return joined, head
    for joined in () if soonest else times:
        there = body.at(joined)
        for factor in _DELAYS:
            if (head := reach(body.names, begin, there, limits, factor * joined)) is not None:
                return joined, head
    there = body.at(last)._replace(acceleration=(0.0,) * len(body.names))
    head = reach(body.names, begin, there, limits, last, longer=True)
    assert head is not None
    return last, head


def _times(latest: float) -> Iterator[float]:
    t = _SOONEST
    while t < latest:
        yield t
        t *= _LATER
    yield latest
