"""The points as which a trajectory is sent to a robot that interpolates it with cubics.

Owns how close together they must be. Pure. Must not know robots or clocks.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from hexwire.errors import UsageError

from .waypoints import Sample, Trajectory

__all__ = ["path_points"]


def path_points(
    trajectory: Trajectory, error: Sequence[float], *, longest: float = 0.05, shortest: float = 0.01
) -> Iterator[tuple[float, Sample]]:
    """Times and samples from start to end, between which cubics with the same velocities follow the trajectory.

    Args:
        trajectory: The trajectory.
        error: Greatest distance from it in the middle between two points, radians by joint. At a corner, where the
            velocity jumps, it may be greater.
        longest: Most seconds between two points.
        shortest: Least seconds; only the last two may be closer.

    Raises:
        UsageError: The times are not above 0, or in the wrong order.
    """
    if not 0.0 < shortest <= longest < math.inf:
        raise UsageError(f"points cannot be {shortest:g} to {longest:g} s apart")
    t, here = 0.0, trajectory.sample(0.0)
    yield t, here
    while t < trajectory.duration:
        step = min(longest, trajectory.duration - t)
        there = trajectory.sample(t + step)
        while step > shortest and not _fits(trajectory, t, step, here, there, error):
            step = max(shortest, step / 2.0)
            there = trajectory.sample(t + step)
        t = trajectory.duration if trajectory.duration - t - step < 1e-9 else t + step
        here = there
        yield t, here


def _fits(trajectory: Trajectory, t: float, step: float, a: Sample, b: Sample, error: Sequence[float]) -> bool:
    middle = trajectory.sample(t + step / 2.0).position
    return all(
        # The middle of a cubic with these ends.
        abs((p + q) / 2.0 + (v - w) * step / 8.0 - m) <= most
        for p, q, v, w, m, most in zip(a.position, b.position, a.velocity, b.velocity, middle, error, strict=True)
    )
