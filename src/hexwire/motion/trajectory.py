"""Trajectories of joints over time: the interface, splines through waypoints, scaling.

Owns what a trajectory is. Time is seconds from its start and comes in as an argument: a sample depends on that
time alone, so sampling does not drift. Must not know clocks, robots or files.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from hexwire.errors import UsageError
from hexwire.model.state import LONGEST
from hexwire.units import decimal

__all__ = ["Sample", "Scaled", "Spline", "Tail", "Trajectory", "Waypoint"]

Values = tuple[float, ...]

_MOST_SAMPLES = 10_000_000
_SHORTEST = 1e-9
"""Seconds between two points below which there is no curve between them."""


class Sample(NamedTuple):
    """Joint values at one time, in the order of the trajectory's names.

    Attributes:
        position: Radians.
        velocity: Radians per second.
        acceleration: Radians per second squared.
    """

    position: Values
    velocity: Values
    acceleration: Values


class Trajectory(ABC):
    """Joint values as a function of time.

    Attributes:
        names: Joint names.
        duration: Seconds from start to end.
    """

    names: tuple[str, ...]
    duration: float

    @abstractmethod
    def at(self, t: float) -> Sample:
        """Values at `t` seconds, 0..duration."""

    def sample(self, t: float) -> Sample:
        """Values at any time: before the start and after the end the arm rests there."""
        if 0.0 <= t < self.duration:
            return self.at(t)
        rest = (0.0,) * len(self.names)
        return Sample(self.at(0.0 if t < 0.0 else self.duration).position, rest, rest)

    def samples(self, period: float) -> Iterator[tuple[float, Sample]]:
        """Times and samples from start to end; each time is a multiple of the period, the last one the end.

        Raises:
            UsageError: The period is not above 0, or the trajectory has more than ten million of them.
        """
        if not 0 < period < math.inf:
            raise UsageError(f"a period must be finite and above 0 s, not {period:g}")
        if not self.duration / period <= _MOST_SAMPLES:
            raise UsageError(f"{decimal(self.duration)} s in steps of {decimal(period)} s give too many samples")
        # Slightly less, so that rounding adds no sample just before the end; but the start is always a sample.
        count = max(math.ceil(self.duration / period - 1e-9), int(self.duration > 0))
        for i in range(count):
            yield i * period, self.sample(i * period)
        yield self.duration, self.sample(self.duration)

    @property
    def start(self) -> Values:
        """Positions at the start."""
        return self.at(0.0).position

    @property
    def goal(self) -> Values:
        """Positions at the end."""
        return self.at(self.duration).position


@dataclass(frozen=True, slots=True)
class Waypoint:
    """Values that a spline passes through.

    Attributes:
        time: Seconds from the start.
        position: Radians.
        velocity: Radians per second, or None.
        acceleration: Radians per second squared, or None; only with a velocity.
    """

    time: float
    position: Values
    velocity: Values | None = None
    acceleration: Values | None = None

    @property
    def order(self) -> int:
        """Degree of the polynomial that these values allow: 1, 3 or 5."""
        if self.velocity is None:
            return 1
        return 3 if self.acceleration is None else 5


class Spline(Trajectory):
    """A spline through waypoints, as in ROS's joint trajectory controller.

    Between two points it is linear if they have positions only, cubic if they have velocities, quintic if they also
    have accelerations; if two neighbours differ, the lower order counts.

    Args:
        names: Joint names.
        waypoints: At least one; times start at 0 and rise.
        checked: They are known to be right, and are not looked at again, which takes long for many.
    """

    def __init__(self, names: Sequence[str], waypoints: Sequence[Waypoint], *, checked: bool = False) -> None:
        self.names = tuple(names)
        if not checked:
            self._check(waypoints)
        self.waypoints = tuple(waypoints)
        self.duration = waypoints[-1].time
        self._times = [point.time for point in waypoints]

    def _check(self, waypoints: Sequence[Waypoint]) -> None:
        if not waypoints:
            raise UsageError("a trajectory without a point")
        if waypoints[0].time != 0.0:
            raise UsageError(f"the first point is at {waypoints[0].time:g} s; it must be the start, at 0 s")
        for i, point in enumerate(waypoints):
            if i and not waypoints[i - 1].time < point.time < math.inf:
                raise UsageError(f"point {i + 1} is at {point.time:g} s, not after the one before it")
            if point.acceleration is not None and point.velocity is None:
                raise UsageError(f"point {i + 1} has accelerations but no velocities")
            for values in (point.position, point.velocity, point.acceleration):
                if values is not None and len(values) != len(self.names):
                    raise UsageError(f"point {i + 1} has {len(values)} values for {len(self.names)} joints")
                if values is not None and not all(map(math.isfinite, values)):
                    raise UsageError(f"point {i + 1} has a value that is not a number")

    def at(self, t: float) -> Sample:
        points = self.waypoints
        if len(points) == 1:
            rest = (0.0,) * len(self.names)
            return Sample(points[0].position, points[0].velocity or rest, points[0].acceleration or rest)
        # bisect, written out where both ends belong to a segment.
        low, high = 0, len(points) - 1
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (middle, high) if self._times[middle] <= t else (low, middle)
        return _between(points[low], points[high], t)


def _between(a: Waypoint, b: Waypoint, t: float) -> Sample:
    order = min(a.order, b.order)
    long = b.time - a.time
    u = t - a.time
    if order == 1:
        rows = [(q, (r - q) / long) for q, r in zip(a.position, b.position, strict=True)]
        share = min(1.0, u / long)
        # Exactly the waypoint at the end, despite rounding.
        position = b.position if share == 1.0 else tuple(q + k * u for q, k in rows)
        return Sample(position, tuple(k for _, k in rows), (0.0,) * len(rows))
    if long < _SHORTEST:
        # The coefficients of a polynomial over such a short time would overflow: use a step.
        share = min(1.0, u / long)
        steps = [
            (r if share == 1.0 else q + (r - q) * share, (r - q) / long)
            for q, r in zip(a.position, b.position, strict=True)
        ]
        return Sample(tuple(q for q, _ in steps), tuple(k for _, k in steps), (0.0,) * len(steps))
    values, velocity, acceleration = [], [], []
    for i, (q, r) in enumerate(zip(a.position, b.position, strict=True)):
        v, w = (a.velocity or ())[i], (b.velocity or ())[i]
        way = r - q - v * long
        if order == 3:
            turn = w - v
            k: tuple[float, ...] = (q, v, 3 * way / long**2 - turn / long, -2 * way / long**3 + turn / long**2)
        else:
            c, d = (a.acceleration or ())[i], (b.acceleration or ())[i]
            k = _quintic(q, r, v, w, c, d, long)
        value, first, second = _polynomial(k, u)
        values.append(value)
        velocity.append(first)
        acceleration.append(second)
    # Exactly the waypoint at the end, despite rounding.
    return Sample(b.position if t >= b.time else tuple(values), tuple(velocity), tuple(acceleration))


def _quintic(q: float, r: float, v: float, w: float, c: float, d: float, long: float) -> tuple[float, ...]:
    way = r - q - v * long - c * long**2 / 2
    turn = (w - v - c * long) * long
    bend = (d - c) * long**2
    return (
        q,
        v,
        c / 2,
        (10 * way - 4 * turn + bend / 2) / long**3,
        (-15 * way + 7 * turn - bend) / long**4,
        (6 * way - 3 * turn + bend / 2) / long**5,
    )


def _polynomial(k: Sequence[float], u: float) -> tuple[float, float, float]:
    """Value, first and second derivative."""
    value = first = second = 0.0
    for factor in reversed(k):
        second = second * u + 2 * first
        first = first * u + value
        value = value * u + factor
    return value, first, second


class Scaled(Trajectory):
    """The same trajectory at another speed.

    Args:
        other: The trajectory.
        speed: Factor of its speed, above 0.
    """

    def __init__(self, other: Trajectory, speed: float) -> None:
        if not 0 < speed < math.inf:
            raise UsageError(f"a speed factor must be finite and above 0, not {speed:g}")
        self._other, self._speed = other, speed
        self.names = other.names
        self.duration = other.duration / speed
        if not self.duration <= LONGEST:
            raise UsageError(f"{decimal(self.duration)} s is too long for a motion; it may take {LONGEST:g} s")

    def at(self, t: float) -> Sample:
        k = self._speed
        position, velocity, acceleration = self._other.at(min(t * k, self._other.duration))
        return Sample(position, tuple(k * v for v in velocity), tuple(k * k * a for a in acceleration))


class Tail(Trajectory):
    """The rest of a trajectory.

    Args:
        whole: The trajectory.
        begin: Seconds from its start; before it the joints rest there.
        longest: Maximum duration in seconds.

    Attributes:
        whole: The trajectory; not a rest itself, or a motion that is often interrupted would be a tower of them.
        begin: Seconds from its start.
    """

    def __init__(self, whole: Trajectory, begin: float, longest: float = math.inf) -> None:
        self.names, self.duration = whole.names, min(longest, max(0.0, whole.duration - begin))
        self.whole: Trajectory = whole
        self.begin = begin
        if isinstance(whole, Tail) and begin >= 0.0:
            self.whole, self.begin = whole.whole, whole.begin + begin

    def at(self, t: float) -> Sample:
        return self.whole.sample(self.begin + t)
