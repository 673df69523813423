"""One joint from one point to the next, under limits of speed, acceleration and jerk.

Owns the profile: a change of speed, a constant speed, another change of speed. The joint moves one way only, and
does not accelerate at either point. Must not know other joints, nor how speeds at points are chosen.

All values are magnitudes: a distance and speeds in its direction. A change of speed begins and ends without
acceleration, and takes the shortest time: at full jerk and, if it is long, full acceleration. It is symmetric: its
mean speed is the mean of both.
"""

from __future__ import annotations

import math
from typing import NamedTuple

__all__ = ["JointLimits", "Piece", "change_time", "profile", "time_window"]

_HALVINGS = 50
"""Of an interval of speeds: the rest is far below the resolution of any servo."""
_ROUNDING = 1e-12
_LONGER = 1.09
"""Slowing down to some speed needs at most so many times the distance of stopping: 4/3 of the root of 2/3."""


class JointLimits(NamedTuple):
    """Limits of one joint, each above 0.

    Attributes:
        speed: Radians per second.
        acceleration: Radians per second squared.
        jerk: Radians per second cubed.
    """

    speed: float
    acceleration: float
    jerk: float


class Piece(NamedTuple):
    """A time of constant jerk.

    Attributes:
        seconds: How long.
        jerk: Radians per second cubed.
    """

    seconds: float
    jerk: float


def change_time(change: float, limits: JointLimits) -> float:
    """Seconds in which the speed changes by so many radians per second, 0 or more."""
    _, most, jerk = limits
    if change * jerk > most * most:
        return change / most + most / jerk
    return 2.0 * math.sqrt(change / jerk) if change > 0.0 else 0.0


def time_window(distance: float, begin: float, end: float, limits: JointLimits) -> tuple[float, float]:
    """The shortest and the longest time for a distance; it can be covered in any time between.

    Args:
        distance: Radians, at least 1e-12.
        begin: Speed at the first point, at most the limit.
        end: Speed at the second point, at most the limit.
        limits: Of the joint.

    Returns:
        Seconds, the longest infinite if the joint can stop on its way. Infinite and 0 if the distance is too short
        for the change of speed.
    """
    low, high = (begin, end) if begin < end else (end, begin)
    if 0.5 * (low + high) * change_time(high - low, limits) > distance * (1.0 + _ROUNDING):
        return math.inf, 0.0
    shortest = _extreme(distance, begin, end, high, limits.speed, limits)
    stopping = _needed(begin, end, 0.0, limits)
    if _LONGER * stopping <= distance:
        return shortest, math.inf
    slowest = 0.0
    if stopping <= distance:
        # It could stop, but not be slowed down to every speed before that: times beyond a gap are left out.
        slowest = _longest(begin, end, limits)
        if _needed(begin, end, slowest, limits) <= distance:
            return shortest, math.inf
    return shortest, _extreme(distance, begin, end, low, slowest, limits)


def profile(distance: float, begin: float, end: float, seconds: float, limits: JointLimits) -> list[Piece]:
    """The pieces of constant jerk that cover a distance in a time.

    Args:
        distance: Radians, at least 1e-12.
        begin: Speed at the first point.
        end: Speed at the second point.
        seconds: A time within `time_window`.
        limits: Of the joint.
    """
    low, high = (begin, end) if begin < end else (end, begin)
    if distance >= _covered(begin, end, high, seconds, limits):
        between = _between(distance, begin, end, seconds, high, limits.speed, limits)
    elif distance <= _covered(begin, end, low, seconds, limits):
        between = _between(distance, begin, end, seconds, low, 0.0, limits)
    else:
        # At the speed of the first point, then at that of the second.
        change = change_time(high - low, limits)
        first = (end * (seconds - change) + 0.5 * (begin + end) * change - distance) / (end - begin)
        first = min(max(0.0, first), seconds - change)
        return [Piece(first, 0.0), *_change(begin, end, limits), Piece(seconds - change - first, 0.0)]
    changes = change_time(abs(between - begin), limits) + change_time(abs(between - end), limits)
    return [
        *_change(begin, between, limits),
        Piece(max(0.0, seconds - changes), 0.0),
        *_change(between, end, limits),
    ]


def _change(begin: float, end: float, limits: JointLimits) -> list[Piece]:
    seconds = change_time(abs(end - begin), limits)
    if not seconds:
        return []
    jerk = math.copysign(limits.jerk, end - begin)
    ramp = min(0.5 * seconds, limits.acceleration / limits.jerk)
    return [Piece(ramp, jerk), Piece(max(0.0, seconds - 2.0 * ramp), 0.0), Piece(ramp, -jerk)]


def _needed(begin: float, end: float, between: float, limits: JointLimits) -> float:
    """Distance that both changes of speed need."""
    return 0.5 * (begin + between) * change_time(abs(between - begin), limits) + 0.5 * (
        end + between
    ) * change_time(abs(between - end), limits)


def _longest(begin: float, end: float, limits: JointLimits) -> float:
    """The speed, below those at both points, whose changes of speed need the greatest distance.

    The distance is concave in that speed, so its derivative changes its sign once.
    """
    low, high = 0.0, min(begin, end)
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        growth = 0.0
        for speed in (begin, end):
            change = speed - middle
            seconds = change_time(change, limits)
            # Of the time by the change.
            slope = max(1.0 / limits.acceleration, 1.0 / math.sqrt(max(change, _ROUNDING) * limits.jerk))
            growth += (speed - 0.5 * change) * slope - 0.5 * seconds
        low, high = (middle, high) if growth < 0.0 else (low, middle)
    return 0.5 * (low + high)


def _extreme(distance: float, begin: float, end: float, near: float, far: float, limits: JointLimits) -> float:
    """Seconds with the speed between that is furthest from `near` towards `far`, as far as the distance allows."""
    if _needed(begin, end, far, limits) <= distance:
        near = far
    else:
        for _ in range(_HALVINGS):
            middle = 0.5 * (near + far)
            if _needed(begin, end, middle, limits) > distance:
                far = middle
            else:
                near = middle
    changes = change_time(abs(near - begin), limits) + change_time(abs(near - end), limits)
    left = distance - _needed(begin, end, near, limits)
    return changes + (left / near if left > 0.0 else 0.0)


def _covered(begin: float, end: float, between: float, seconds: float, limits: JointLimits) -> float:
    """Distance in a time with a constant speed between the changes."""
    return (
        between * seconds
        + 0.5 * (begin - between) * change_time(abs(between - begin), limits)
        + 0.5 * (end - between) * change_time(abs(between - end), limits)
    )


def _between(
    distance: float, begin: float, end: float, seconds: float, near: float, far: float, limits: JointLimits
) -> float:
    """The constant speed, from `near` towards `far`, with which a distance takes a time."""
    rising = far > near
    for _ in range(_HALVINGS):
        middle = 0.5 * (near + far)
        changes = change_time(abs(middle - begin), limits) + change_time(abs(middle - end), limits)
        # Where there is no time for both changes, the speed is too far from those at the points.
        beyond = changes > seconds or (_covered(begin, end, middle, seconds, limits) > distance) is rising
        near, far = (near, middle) if beyond else (middle, far)
    return near
