"""A small wave that shows the backlash of a joint, and the backlash from its samples.

Owns the wave and the formula. Pure: time is an argument. Must not know servos.

The joint goes to its start again and again, from above and from below, and rests there. Between the two it comes to
rest at different places if its gears or its horn have play, or if it sticks: what is measured is how far the place
depends on the side from which it was reached.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

__all__ = ["BACKLASH_AMPLITUDE", "BACKLASH_SECONDS", "backlash", "backlash_angle"]

BACKLASH_AMPLITUDE = math.radians(3.0)
"""Distance to either side, radians."""
_LEG = 0.6
"""Seconds for a way of one amplitude and the rest after it."""
_MOVING = 0.25
_READ = 0.4
"""Seconds of a leg after which the joint is at rest."""
_SIDES = (1, 0, -1, 0)
_ROUNDS = 3
BACKLASH_SECONDS = _LEG * len(_SIDES) * _ROUNDS
"""Duration, seconds."""


def backlash_angle(t: float) -> float:
    """Goal relative to the start at a time since the beginning, radians."""
    leg, within = divmod(t, _LEG)
    here, there = _SIDES[int(leg - 1) % 4] if leg >= 1 else 0, _SIDES[int(leg) % 4]
    if t >= BACKLASH_SECONDS:
        return 0.0
    return BACKLASH_AMPLITUDE * (here + (there - here) * min(1.0, within / _MOVING))


def backlash(samples: Iterable[tuple[float, float]]) -> float:
    """The backlash, radians, up to the amplitude; NaN if there are too few samples.

    Args:
        samples: Times since the beginning, and positions in radians.
    """
    rests: dict[int, list[float]] = {1: [], -1: []}
    for t, position in samples:
        leg, within = divmod(t, _LEG)
        side = _SIDES[int(leg) % 4]
        # The first round is for settling in.
        if side == 0 and within >= _READ and len(_SIDES) <= leg < len(_SIDES) * _ROUNDS:
            rests[_SIDES[int(leg - 1) % 4]].append(position)
    if not rests[1] or not rests[-1]:
        return math.nan
    above, below = (sum(rows) / len(rows) for rows in (rests[1], rests[-1]))
    return abs(above - below)
