"""The points as which a trajectory is sent to a robot that interpolates it with cubics.

Owns how close together they must be. Pure. Must not know robots or clocks.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from hexwire.errors import UsageError

from .trajectory import Sample, Trajectory

__all__ = ["path_points"]

_TICK = 1e-4
"""Seconds: times are multiples of this, since a time rounded later would change the speed between two points."""
_PLACES = (0.25, 0.5, 0.75)
"""Where the cubic is compared with the trajectory, as parts of its time."""


def path_points(
    trajectory: Trajectory, error: Sequence[float], *, longest: float = 0.05, shortest: float = 0.01
) -> Iterator[tuple[float, Sample]]:
    """Times and samples from start to end, between which cubics with the same velocities follow the trajectory.

    Args:
        trajectory: The trajectory.
        error: Greatest distance from it between two points, radians by joint. At a corner, where the velocity
            jumps, it may be greater.
        longest: Most seconds between two points.
        shortest: Least seconds; only a trajectory that is shorter has closer ones. All times are multiples of
            0.1 ms; the last is not before the end.

    Raises:
        UsageError: The times are not above 0, or in the wrong order.
    """
    if not 0.0 < shortest <= longest < math.inf:
        raise UsageError(f"points cannot be {shortest:g} to {longest:g} s apart")
    here = trajectory.sample(0.0)
    yield 0.0, here
    most, least = max(1, round(longest / _TICK)), max(1, round(shortest / _TICK))
    # Slightly less, so that rounding adds no tick.
    done, end = 0, math.ceil(trajectory.duration / _TICK - 1e-6)
    while done < end:
        left = end - done
        # What is left at the end must not be too short for a point of its own.
        step = left if left <= most or left < 2 * least else min(most, left - least)
        there = _at(trajectory, done + step, end)
        while step > least and left >= 2 * least:
            if _fits(trajectory, done * _TICK, step * _TICK, here, there, error):
                break
            step = max(least, step // 2)
            there = _at(trajectory, done + step, end)
        done += step
        here = there
        yield done * _TICK, here


def _at(trajectory: Trajectory, ticks: int, end: int) -> Sample:
    return trajectory.sample(trajectory.duration if ticks == end else min(ticks * _TICK, trajectory.duration))


def _fits(trajectory: Trajectory, t: float, step: float, a: Sample, b: Sample, error: Sequence[float]) -> bool:
    rows = list(zip(a.position, b.position, a.velocity, b.velocity, error, strict=True))
    for u in _PLACES:
        exact = trajectory.sample(t + u * step).position
        for (p, q, v, w, most), m in zip(rows, exact, strict=True):
            # The cubic with these ends.
            c2, c3 = 3.0 * (q - p) - step * (2.0 * v + w), step * (v + w) - 2.0 * (q - p)
            if not abs(p + u * (step * v + u * (c2 + u * c3)) - m) <= most:
                return False
    return True
