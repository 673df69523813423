"""Motion through points: hexwire beside TOPP-RA and ruckig, on the same points under the same limits.

TOPP-RA finds the best timing of a given path, here a cubic spline through the points, and knows no limit of jerk.
ruckig limits jerk, and stops at every point: its free version passes none. Both are used if they are installed
(`uv sync --group planners`; ruckig is there where it has wheels).
"""

from __future__ import annotations

import logging
import math
import random
import statistics
import time
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

from hexwire.motion.joined import Joined
from hexwire.motion.optimal import Trapezoid
from hexwire.motion.through import Through

try:
    import ruckig
except ImportError:  # no wheel for Linux on ARM
    ruckig = None

__all__ = ["compare"]

_JOINTS = 6
_NAMES = tuple(f"J{i + 1}" for i in range(_JOINTS))
_SPEED = (1.3, 1.3, 1.3, 1.3, 1.75, 1.75)
"""Half the speed limits of the Hex7Bot, as `hexwire goto` has it."""
_ACCELERATION = (6.0,) * _JOINTS
_JERK = (60.0,) * _JOINTS
_NO_LIMIT = 1e6
_SEEDS = range(8)
_LOOK = 1e-3
"""Seconds between two accelerations from which the jerk is computed."""

Points = list[tuple[float, ...]]
Sampled = Callable[[float], tuple[Sequence[float], Sequence[float]]]
"""Positions and accelerations at a time."""


class _Result(NamedTuple):
    seconds: float
    computing: float
    jerk: float
    outside: float


def compare() -> list[str]:
    """Measure; returns the lines to print."""
    lines = [
        (
            f"through points, {_JOINTS} joints at {_ACCELERATION[0]:g} rad/s^2 and {_JERK[0]:g} rad/s^3, "
            f"mean of {len(_SEEDS)} motions; durations over that of TOPP-RA without a limit of jerk"
        )
    ]
    planners: dict[str, Callable[[Points], tuple[float, Sampled]]] = {
        "hexwire, limited jerk": lambda points: _ours(points, _JERK),
        "hexwire, any jerk": lambda points: _ours(points, (_NO_LIMIT,) * _JOINTS),
        "hexwire, a stop at each": lambda points: _stops(points, jerk=True),
        "trapezoids, a stop at each": lambda points: _stops(points, jerk=False),
    }
    if ruckig is not None:
        planners["ruckig, a stop at each"] = _ruckig
    reference = _toppra()
    if reference is None:
        lines.append("  TOPP-RA is not installed: durations over those of hexwire (uv sync --group planners)")
    else:
        planners["TOPP-RA, any jerk"] = reference
    for title, make in (("points of a smooth motion", _smooth), ("random postures", _random)):
        for count in (3, 6, 12):
            lines.append(f"  {count} {title}")
            rows = {name: [_measure(plan, make(count, seed)) for seed in _SEEDS] for name, plan in planners.items()}
            base = rows["hexwire, limited jerk" if reference is None else "TOPP-RA, any jerk"]
            lines += [f"    {name:27}{_words(row, base)}" for name, row in rows.items()]
    return lines


def _words(row: Sequence[_Result], base: Sequence[_Result]) -> str:
    ratio = statistics.fmean(one.seconds / other.seconds for one, other in zip(row, base, strict=True))
    jerk = max(one.jerk for one in row)
    outside = math.degrees(max(one.outside for one in row))
    return (
        f"duration {ratio:5.2f}   peak jerk {jerk:6.0f} rad/s^3   outside the points {outside:5.1f} deg   "
        f"computed in {1e3 * statistics.median(one.computing for one in row):6.1f} ms"
    )


def _measure(plan: Callable[[Points], tuple[float, Sampled]], points: Points) -> _Result:
    begin = time.process_time()
    seconds, at = plan(points)
    computing = time.process_time() - begin
    low, high = ([f(column) for column in zip(*points, strict=True)] for f in (min, max))
    jerk = outside = 0.0
    last: Sequence[float] | None = None
    for k in range(int(seconds / _LOOK) + 1):
        position, acceleration = at(min(k * _LOOK, seconds))
        if last is not None:
            jerk = max(jerk, *(abs(b - a) / _LOOK for a, b in zip(last, acceleration, strict=True)))
        last = acceleration
        for x, a, b in zip(position, low, high, strict=True):
            outside = max(outside, a - x, x - b)
    return _Result(seconds, computing, jerk, outside)


def _random(count: int, seed: int) -> Points:
    dice = random.Random(seed)
    return [tuple(dice.uniform(-1.0, 1.0) for _ in range(_JOINTS)) for _ in range(count)]


def _smooth(count: int, seed: int) -> Points:
    """Points of a motion of 4.5 s in which each joint turns back once or twice at its own times."""
    dice = random.Random(seed)
    waves = [(dice.uniform(0.3, 1.0), dice.uniform(0.5, 1.2), dice.uniform(0.0, 2.0 * math.pi)) for _ in _NAMES]
    times = [4.5 * k / (count - 1) for k in range(count)]
    return [tuple(size * math.sin(rate * t + phase) for size, rate, phase in waves) for t in times]


def _ours(points: Points, jerk: Sequence[float]) -> tuple[float, Sampled]:
    path = Through(_NAMES, points, _SPEED, _ACCELERATION, jerk)
    return path.duration, lambda t: path.at(t)[::2]


def _stops(points: Points, *, jerk: bool) -> tuple[float, Sampled]:
    path = Joined(
        [
            Through(_NAMES, (a, b), _SPEED, _ACCELERATION, _JERK)
            if jerk
            else Trapezoid(_NAMES, a, b, _SPEED, _ACCELERATION)
            for a, b in pairwise(points)
        ]
    )
    return path.duration, lambda t: path.at(t)[::2]


def _ruckig(points: Points) -> tuple[float, Sampled]:
    legs = []
    for a, b in pairwise(points):
        request = ruckig.InputParameter(_JOINTS)
        request.current_position, request.target_position = list(a), list(b)
        request.max_velocity, request.max_acceleration = list(_SPEED), list(_ACCELERATION)
        request.max_jerk = list(_JERK)
        leg = ruckig.Trajectory(_JOINTS)
        ruckig.Ruckig(_JOINTS).calculate(request, leg)
        legs.append(leg)

    def at(t: float) -> tuple[Sequence[float], Sequence[float]]:
        for leg in legs:
            if t <= leg.duration or leg is legs[-1]:
                position, _, acceleration = leg.at_time(t)
                return position, acceleration
            t -= leg.duration
        raise AssertionError

    return sum(leg.duration for leg in legs), at


def _toppra() -> Callable[[Points], tuple[float, Sampled]] | None:
    try:
        import numpy as np
        import toppra
        from toppra import algorithm, constraint
    except ImportError:
        return None
    logging.getLogger("toppra").setLevel(logging.ERROR)

    def plan(points: Points) -> tuple[float, Sampled]:
        places = [0.0]
        for a, b in pairwise(points):
            places.append(places[-1] + math.dist(a, b))
        # Without a third derivative at the second point where there are enough; it stays near the points.
        ends = "not-a-knot" if len(points) > 3 else "natural"
        path = toppra.SplineInterpolator(np.array(places), np.array(points), bc_type=ends)
        limits = [
            constraint.JointVelocityConstraint(np.array([[-v, v] for v in _SPEED])),
            constraint.JointAccelerationConstraint(np.array([[-a, a] for a in _ACCELERATION])),
        ]
        found: Any = algorithm.TOPPRA(limits, path, solver_wrapper="seidel").compute_trajectory()
        return float(found.duration), lambda t: (found(t), found(t, 2))

    return plan
