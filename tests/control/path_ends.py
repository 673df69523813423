"""What a host means by the points that end a path."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

from tests.motion.arms import cubic_at

from hexwire.drivers.timed_path import TimedPoint
from hexwire.motion.trajectory import Trajectory


def rested(
    plan: Trajectory, begin: float, points: list[TimedPoint], names: tuple[str, ...]
) -> Callable[[float], list[tuple[float, float, float]]]:
    """A plan up to a time, and then the cubics of a brake."""
    order_of = [plan.names.index(name) for name in names]
    here = plan.sample(begin)
    first = TimedPoint(begin, tuple(here.position[i] for i in order_of), tuple(here.velocity[i] for i in order_of))

    def at(t: float) -> list[tuple[float, float, float]]:
        if t <= begin:
            sample = plan.sample(t)
            return [(sample.position[i], sample.velocity[i], sample.acceleration[i]) for i in order_of]
        for a, b in pairwise((first, *points)):
            if t <= b.time or b is points[-1]:
                h, u = b.time - a.time, min(t, b.time) - a.time
                rows = []
                for p, q, v, w in zip(
                    a.positions, b.positions, a.velocities or (), b.velocities or (), strict=True
                ):
                    rows.append(cubic_at(p, q, v, w, h, u)[:3])
                return rows
        raise AssertionError

    return at
