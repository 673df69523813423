"""One joint from one point to the next, under limits of speed, acceleration and jerk.

Owns the profile: a change of speed, a constant speed, another change of speed. The joint moves one way only. Must
not know other joints.

All values are magnitudes: a distance and speeds in its direction. A change of speed begins and ends without
acceleration, and takes the shortest time: at full jerk and, if it is long, full acceleration. It is symmetric: its
mean speed is the mean of both.

A joint that turns back at a point may do so without a pause: it has no speed there, but an acceleration. Then that
point is inside a change of speed which begins at a speed in the other direction.
"""

from __future__ import annotations

import math
from typing import NamedTuple

__all__ = ["JointLimits", "Passing", "SpeedPiece", "change_time", "profile", "time_window"]

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


class Passing(NamedTuple):
    """How a joint passes a point.

    Attributes:
        speed: Radians per second, 0 or more.
        turn: Its acceleration where it turns back, radians per second squared, at most the limit; otherwise 0. Only
            without a speed.
    """

    speed: float = 0.0
    turn: float = 0.0

    def before(self, limits: JointLimits) -> float:
        """The speed from which the change begins that has this speed and acceleration on its way."""
        return self.speed - self.after(limits) if self.turn else self.speed

    def after(self, limits: JointLimits) -> float:
        """The speed at which the acceleration could be over."""
        return self.speed + 0.5 * self.turn * self.turn / limits.jerk

    def cut(self, limits: JointLimits) -> tuple[float, float]:
        """Seconds of that change that are over at the point, and the distance that is."""
        return self.turn / limits.jerk, -(self.turn**3) / (3.0 * limits.jerk * limits.jerk)


class SpeedPiece(NamedTuple):
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


def time_window(distance: float, begin: Passing, end: Passing, limits: JointLimits) -> tuple[float, float]:
    """The shortest and the longest time for a distance; it can be covered in any time between.

    Args:
        distance: Radians, at least 1e-12.
        begin: At the first point.
        end: At the second point.
        limits: Of the joint.

    Returns:
        Seconds, the longest infinite if the joint can stop on its way; with a turn, longer times are left out.
        Infinite and 0 if the distance is too short for the change of speed.
    """
    first, last = begin.before(limits), end.before(limits)
    low, high = sorted((begin.after(limits), end.after(limits)))
    (cut, gone), (left, more) = begin.cut(limits), end.cut(limits)
    distance += gone + more
    if _needed(first, last, high, limits) > distance * (1.0 + _ROUNDING):
        return math.inf, 0.0
    shortest = _extreme(distance, first, last, high, limits.speed, limits) - cut - left
    if begin.turn or end.turn:
        return shortest, _extreme(distance, first, last, high, high, limits) - cut - left
    stopping = _needed(first, last, 0.0, limits)
    if _LONGER * stopping <= distance:
        return shortest, math.inf
    slowest = 0.0
    if stopping <= distance:
        # It could stop, but not be slowed down to every speed before that: times beyond a gap are left out.
        slowest = _longest(first, last, limits)
        if _needed(first, last, slowest, limits) <= distance:
            return shortest, math.inf
    return shortest, _extreme(distance, first, last, low, slowest, limits)


def profile(distance: float, begin: Passing, end: Passing, seconds: float, limits: JointLimits) -> list[SpeedPiece]:
    """The pieces of constant jerk that cover a distance in a time.

    Args:
        distance: Radians, at least 1e-12.
        begin: At the first point.
        end: At the second point.
        seconds: A time within `time_window`.
        limits: Of the joint.
    """
    first, last = begin.before(limits), end.before(limits)
    low, high = sorted((begin.after(limits), end.after(limits)))
    (cut, gone), (left, more) = begin.cut(limits), end.cut(limits)
    distance, seconds = distance + gone + more, seconds + cut + left
    if begin.turn or end.turn or distance >= _covered(first, last, high, seconds, limits):
        between = _between(distance, first, last, seconds, high, limits.speed, limits)
    elif distance <= _covered(first, last, low, seconds, limits):
        between = _between(distance, first, last, seconds, low, 0.0, limits)
    else:
        # At the speed of the first point, then at that of the second.
        change = change_time(high - low, limits)
        wait = (last * (seconds - change) + 0.5 * (first + last) * change - distance) / (last - first)
        wait = min(max(0.0, wait), seconds - change)
        return [SpeedPiece(wait, 0.0), *_change(first, last, limits), SpeedPiece(seconds - change - wait, 0.0)]
    changes = change_time(abs(between - first), limits) + change_time(abs(between - last), limits)
    up, down = _change(first, between, limits), _change(between, last, limits)
    if cut:
        up[0] = SpeedPiece(max(0.0, up[0].seconds - cut), up[0].jerk)
    if left:
        down[-1] = SpeedPiece(max(0.0, down[-1].seconds - left), down[-1].jerk)
    return [*up, SpeedPiece(max(0.0, seconds - changes), 0.0), *down]


def _change(begin: float, end: float, limits: JointLimits) -> list[SpeedPiece]:
    seconds = change_time(abs(end - begin), limits)
    if not seconds:
        return []
    jerk = math.copysign(limits.jerk, end - begin)
    ramp = min(0.5 * seconds, limits.acceleration / limits.jerk)
    return [SpeedPiece(ramp, jerk), SpeedPiece(max(0.0, seconds - 2.0 * ramp), 0.0), SpeedPiece(ramp, -jerk)]


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
    if left <= 0.0:
        return changes
    return changes + left / near if near > 0.0 else math.inf


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
