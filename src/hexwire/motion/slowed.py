"""A trajectory on which the joints come to rest, or begin from rest, without leaving it: its time changes its rate.

Owns how the rate changes, and how long that takes within the limits. Must not know robots, clocks, nor where an
arm may go: it goes where the trajectory goes, which was checked.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from itertools import accumulate
from typing import NamedTuple

from .moving import braking_time
from .speed_profile import JointLimits
from .trajectory import Sample, Tail, Trajectory

__all__ = ["Slowed", "SpeedStage", "slow_down", "start_on"]

_FACTORS = (1.25, 1.6, 2.0, 2.5, 3.2, 5.0)
"""How much longer than a brake that may leave the trajectory it may take."""
_LEAST = 0.1
"""Seconds that it takes at least: joints may rest while the trajectory is about to move them."""
_SAMPLES = 40
"""Of it, when it is compared with the limits."""
_KEPT = 0.95
"""Share of a limit that counts as kept: samples miss the peaks at both ends."""


class SpeedStage(NamedTuple):
    """A part of a time whose rate changes smoothly.

    Attributes:
        seconds: How long.
        begin: The rate at its begin.
        end: And at its end.
    """

    seconds: float
    begin: float
    end: float

    @property
    def way(self) -> float:
        """Seconds that pass on the trajectory."""
        return 0.5 * self.seconds * (self.begin + self.end)

    def place(self, u: float) -> float:
        """Those of them that have passed when a part `u` of the stage is over, 0..1."""
        return self.seconds * u * (self.begin + (self.end - self.begin) * u * u * (1.0 - 0.5 * u))

    def rates(self, u: float) -> tuple[float, float, float]:
        """The rate then, and its first and second derivative."""
        # The rate is flat at both ends, so the acceleration does not jump.
        change, seconds = self.end - self.begin, self.seconds
        rate = self.begin + change * u * u * (3.0 - 2.0 * u)
        return rate, 6.0 * change * u * (1.0 - u) / seconds, 6.0 * change * (1.0 - 2.0 * u) / (seconds * seconds)


class Slowed(Trajectory):
    """A trajectory whose time slows down until it stands still, or is at its end.

    Args:
        path: The trajectory.
        stages: At least one; each begins with the rate with which the one before ends, the first with 1.
    """

    def __init__(self, path: Trajectory, stages: Sequence[SpeedStage]) -> None:
        self.names, self._path, self._stages = path.names, path, tuple(stages)
        self._begins = (0.0, *accumulate(stage.seconds for stage in stages))
        self._places = (0.0, *accumulate(stage.way for stage in stages))
        self.duration = self._begins[-1]

    def at(self, t: float) -> Sample:
        i = min(max(0, bisect_right(self._begins, t) - 1), len(self._stages) - 1)
        stage = self._stages[i]
        u = min(1.0, max(0.0, (t - self._begins[i]) / stage.seconds))
        rate, slope, _ = stage.rates(u)
        return _at_rate(self._path.sample(self._places[i] + stage.place(u)), rate, slope)


class _Started(Trajectory):
    """A trajectory whose time begins to run from standstill.

    Args:
        path: The trajectory.
        seconds: In which its time comes to its rate; half of them pass on the trajectory.
    """

    def __init__(self, path: Trajectory, seconds: float) -> None:
        self.names, self.path, self._stage = path.names, path, SpeedStage(seconds, 0.0, 1.0)
        self.duration = max(seconds, path.duration + 0.5 * seconds)

    def at(self, t: float) -> Sample:
        u = t / self._stage.seconds
        rate, slope, _ = self._stage.rates(u) if u < 1.0 else (1.0, 0.0, 0.0)
        return _at_rate(self.path.sample(self.place(t)), rate, slope)

    def place(self, t: float) -> float:
        """Seconds that have passed on the trajectory at a time."""
        seconds = self._stage.seconds
        return self._stage.place(t / seconds) if t < seconds else t - 0.5 * seconds


def _at_rate(place: Sample, rate: float, slope: float) -> Sample:
    """How joints move at a place of a trajectory whose time has another rate, and a slope of it."""
    position, velocity, acceleration = place
    return Sample(
        position,
        tuple([rate * v for v in velocity]),
        tuple([rate * rate * a + slope * v for v, a in zip(velocity, acceleration, strict=True)]),
    )


def slow_down(path: Trajectory, limits: Sequence[JointLimits]) -> Slowed:
    """Bring joints to rest on a trajectory in a bounded time, also where that cannot keep the limits.

    Args:
        path: What they follow, from now on.
        limits: Of the joints: five times as long as they would need for a brake that may leave the trajectory.
    """
    return Slowed(path, (SpeedStage(_FACTORS[-1] * _least(path, limits), 1.0, 0.0),))


def start_on(path: Trajectory, limits: Sequence[JointLimits]) -> Trajectory:
    """Begin in the middle of a trajectory, from rest.

    Args:
        path: What they are to follow.
        limits: Of the joints.

    Returns:
        How they do, in the shortest of some times that keeps the limits as well as the trajectory does, or the
        longest of them.
    """
    if isinstance(path, Tail) and isinstance(started := path.whole, _Started):
        # They were stopped on it before, and begin once more.
        path = Tail(started.path, started.place(path.begin))
    least = _least(path, limits)
    # Where the trajectory itself goes beyond a limit, somebody asked for that.
    own = _shares(path, min(path.duration, 0.5 * _FACTORS[-1] * least), limits)
    most = [max(_KEPT, share) for share in own]
    for factor in _FACTORS[:-1]:
        found = _Started(path, factor * least)
        shares = _shares(found, factor * least, limits)
        if all(share <= allowed for share, allowed in zip(shares, most, strict=True)):
            return found
    return _Started(path, _FACTORS[-1] * least)


def _least(path: Trajectory, limits: Sequence[JointLimits]) -> float:
    return max(_LEAST, braking_time(path.sample(0.0), limits))


def _shares(path: Trajectory, seconds: float, limits: Sequence[JointLimits]) -> tuple[float, float, float]:
    """The greatest shares of the limits of velocity, acceleration and jerk until a time."""
    step = seconds / _SAMPLES
    fastest = hardest = roughest = 0.0
    before = None
    for i in range(_SAMPLES + 1 if step > 0.0 else 0):
        _, velocity, acceleration = path.sample(i * step)
        for v, a, b, limit in zip(velocity, acceleration, before or acceleration, limits, strict=True):
            fastest = max(fastest, abs(v) / limit.speed)
            hardest = max(hardest, abs(a) / limit.acceleration)
            roughest = max(roughest, abs(a - b) / (limit.jerk * step))
        before = acceleration
    return fastest, hardest, roughest
