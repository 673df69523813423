"""Trajectories made of others: one after the other, and with joints added that rest.

Owns these two, and the points that a trajectory is sent as. Must not know clocks, robots or checks.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

from hexwire.errors import UsageError

from .trajectory import Sample, Trajectory

__all__ = ["Joined", "WithResting", "sampled"]


class Joined(Trajectory):
    """Trajectories of the same joints, one after the other.

    Args:
        legs: At least one; each begins where the one before it ends, at rest.

    Raises:
        UsageError: There is no leg, or the legs move different joints.
    """

    def __init__(self, legs: Sequence[Trajectory]) -> None:
        if not legs:
            raise UsageError("a motion without a part")
        self.names = legs[0].names
        if any(leg.names != self.names for leg in legs):
            raise UsageError("the parts of a motion must move the same joints")
        self._legs = tuple(legs)
        self.duration = sum(leg.duration for leg in legs)

    def at(self, t: float) -> Sample:
        for leg in self._legs[:-1]:
            if t < leg.duration:
                return leg.sample(t)
            t -= leg.duration
        return self._legs[-1].sample(t)


class WithResting(Trajectory):
    """A trajectory with the joints in another order, and with joints added that rest.

    Args:
        moving: The trajectory.
        names: Joints in the new order; those of the trajectory among them.
        rest: Positions of the joints that it does not move, radians.
    """

    def __init__(self, moving: Trajectory, names: Sequence[str], rest: Mapping[str, float]) -> None:
        lost = [name for name in moving.names if name not in names]
        if lost:
            raise UsageError(f"nothing moves {', '.join(lost)}; there are {', '.join(names)}")
        self.names, self.duration = tuple(names), moving.duration
        self._moving = moving
        self._places = [moving.names.index(name) if name in moving.names else None for name in names]
        self._rest = [rest[name] if name not in moving.names else 0.0 for name in names]

    def at(self, t: float) -> Sample:
        position, velocity, acceleration = self._moving.at(t)
        places = self._places
        return Sample(
            tuple(r if i is None else position[i] for i, r in zip(places, self._rest, strict=True)),
            tuple(0.0 if i is None else velocity[i] for i in places),
            tuple(0.0 if i is None else acceleration[i] for i in places),
        )


def sampled(trajectory: Trajectory, step: float, most: int) -> Iterator[tuple[float, Sample]]:
    """Times and samples of a trajectory without its start, evenly spaced, the last one at its end.

    Args:
        trajectory: The trajectory.
        step: Least seconds between two samples.
        most: Most samples; a longer trajectory gets longer steps.
    """
    count = max(1, min(most, math.floor(trajectory.duration / step)))
    for i in range(1, count + 1):
        t = trajectory.duration if i == count else trajectory.duration * i / count
        yield t, trajectory.sample(t)
