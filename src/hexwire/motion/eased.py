"""The rate of a trajectory's time with which joints come to rest on it, soon and within all limits.

Owns the search for its stages. A trajectory that is at a limit cannot be slowed down everywhere: where a joint
brakes as hard as it may, it would have to brake harder still. But at any constant rate below 1 it keeps the limits,
and is further from them. So the rate falls where it can and stays where it cannot; at worst the trajectory is
followed to its end. Pure. Must not know robots, nor where an arm may go: it goes where the trajectory goes, which
was checked.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterator, Sequence
from itertools import pairwise

from .slowed import Slowed, SpeedStage
from .speed_profile import JointLimits
from .trajectory import Sample, Trajectory

__all__ = ["LONGEST", "ease_out"]

LONGEST = 3.5
"""Seconds in which nearly every trajectory at its limits can be brought to rest; see `ease_out`."""
_STEP = 0.004
"""Seconds between two places of a trajectory that are compared with its limits."""
_COARSE = 8
"""Every so many of them are compared first: most stages that do not suit are found so."""
_RATES = (1.0, 0.8, 0.55, 0.3, 0.0)
"""Rates at which the time may stay; the last is rest."""
_SECONDS = (0.1, 0.15, 0.2, 0.3, 0.45, 0.65, 1.0)
"""In which the rate may fall from one to another."""
_STAYS = 0.04
"""Seconds for which it stays at once."""
_KEPT = 1.0005
"""Share of a limit that counts as kept: rounding, and what is between two places."""
_STILL = 1e-9
"""Radians per second that count as none."""

_MOMENT = 1e-6
"""Seconds before its end at which a trajectory that leads to rest is as slow as this allows."""

_Row = tuple[float, float, float, float, float, float]
"""Of a joint at a place, as shares of its limits: its velocity by the limits of acceleration and jerk, its
acceleration by the same, and the least and the greatest jerk nearby."""


class _Places:
    """Places of a trajectory, made when they are asked for."""

    def __init__(self, path: Trajectory, limits: Sequence[JointLimits]) -> None:
        self._path, self._limits = path, limits
        self._samples: list[Sample] = []
        self._rows: list[list[_Row]] = []

    def keep(self, place: float, rate: float, slope: float, bend: float) -> bool:
        """Whether the limits are kept near a place with a rate and its first and second derivative."""
        square, cube, mixed = rate * rate, rate * rate * rate, 3.0 * rate * slope
        k = int(place / _STEP)
        for v, w, a, b, least, most in (*self._at(k), *self._at(k + 1)):
            # Where the trajectory itself goes beyond a limit, somebody asked for that. No joint is faster than on
            # it, since the rate is at most 1.
            if abs(a * square + v * slope) > max(_KEPT, abs(a)):
                return False
            more, allowed = mixed * b + w * bend, max(_KEPT, most, -least)
            if cube * most + more > allowed or cube * least + more < -allowed:
                return False
        return True

    def _at(self, k: int) -> list[_Row]:
        while len(self._rows) <= k:
            i = len(self._rows)
            near = [self._sample(max(0, j)) for j in range(i - 2, i + 3)]
            rows = []
            for j, limit in enumerate(self._limits):
                v, around = near[2].velocity[j], [sample.acceleration[j] for sample in near]
                if abs(v) <= _STILL and not any(around):
                    continue
                # Before the begin there is nothing.
                jerks = [(y - x) / (_STEP * limit.jerk) for x, y in pairwise(around[max(0, 2 - i) :])]
                rows.append(
                    (
                        v / limit.acceleration,
                        v / limit.jerk,
                        around[2] / limit.acceleration,
                        around[2] / limit.jerk,
                        min(jerks),
                        max(jerks),
                    )
                )
            self._rows.append(rows)
        return self._rows[k]

    def _sample(self, k: int) -> Sample:
        while len(self._samples) <= k:
            # At its very end a trajectory is as it was right before.
            self._samples.append(self._path.at(min(len(self._samples) * _STEP, self._path.duration)))
        return self._samples[k]


def _falls(places: _Places, place: float, stage: SpeedStage) -> bool:
    """Whether the limits are kept in a stage that begins at a place."""
    count = math.ceil(stage.seconds / _STEP)
    coarse = range(0, count + 1, _COARSE)
    for i in (*coarse, *(i for i in range(count + 1) if i % _COARSE)):
        u = min(1.0, i * _STEP / stage.seconds)
        if not places.keep(place + stage.place(u), *stage.rates(u)):
            return False
    return True


def _next_stages(places: _Places, place: float, rate: int, end: float) -> Iterator[tuple[int, SpeedStage]]:
    """The stages that may follow at a place, each with the number of the rate at its end."""
    begin = _RATES[rate]
    yield rate, SpeedStage(min(_STAYS, (end - place) / begin), begin, begin)
    for lower in range(rate + 1, len(_RATES)):
        for seconds in _SECONDS:
            stage = SpeedStage(seconds, begin, _RATES[lower])
            if place + stage.way <= end and _falls(places, place, stage):
                yield lower, stage
                break


def ease_out(path: Trajectory, limits: Sequence[JointLimits], longest: float = LONGEST) -> Slowed | None:
    """Bring joints to rest on a trajectory, as soon as stages of a few rates and times allow.

    Velocity, acceleration and jerk stay within the limits, or within what the trajectory itself has at that place.

    Args:
        path: What they follow, from now on.
        limits: Of the joints.
        longest: Seconds that it may take.

    Returns:
        How they do; None if it takes longer.
    """
    places = _Places(path, limits)
    # A trajectory that ends at speed is not followed to its end.
    last = path.at(max(0.0, path.duration - _MOMENT)).velocity
    rests = all(abs(v) <= 2.0 * _MOMENT * limit.acceleration for v, limit in zip(last, limits, strict=True))
    seen, made = set[tuple[int, int]](), 0
    heap: list[tuple[float, int, float, int, tuple[SpeedStage, ...]]] = [(0.0, 0, 0.0, 0, ())]
    while heap:
        seconds, _, place, rate, stages = heapq.heappop(heap)
        ends = path.duration - place <= _STILL
        if stages and (rate == len(_RATES) - 1 or (ends and rests)):
            return Slowed(path, stages)
        key = rate, round(place / (0.5 * _STAYS))
        if key in seen or ends:
            continue
        seen.add(key)
        for after, stage in _next_stages(places, place, rate, path.duration):
            if seconds + stage.seconds <= longest:
                made += 1
                entry = seconds + stage.seconds, made, place + stage.way, after, (*stages, stage)
                heapq.heappush(heap, entry)
    return None
