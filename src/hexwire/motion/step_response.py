"""How a joint answers a step of its goal: rise, overshoot, settling and the error that stays.

Owns the figures, as control engineering defines them. Pure: samples in, figures out.

The definitions: *delay* and *rise* are the times to 10 %, and from 10 % to 90 % of the way; *overshoot* is how far
the joint goes beyond its **final** position, as a fraction of the way to it; *settled* is the time after which it
stays within a band about the final position; *steady error* is goal minus final position. The final position is the
mean of the last tenth of the samples. For a second-order system they equal the closed forms that textbooks give.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

__all__ = ["BAND", "StepFigures", "step_figures"]

BAND = 0.02
"""Half the width of the settling band, as a fraction of the way."""
_LEAST_SAMPLES = 5
_TAIL = 0.1


@dataclass(frozen=True, slots=True)
class StepFigures:
    """The answer to one step. NaN where a figure does not exist, such as the settling of a joint that swings on.

    Attributes:
        at: Time of the step, seconds.
        size: From the old goal to the new one, radians, signed.
        delay: Seconds until 10 % of the way.
        rise: Seconds from 10 % to 90 % of the way.
        overshoot: Farthest beyond the final position, as a fraction of the way; 0.0 without overshoot.
        peak: Seconds until then; NaN without overshoot.
        settled: Seconds until it stays within `BAND` of the final position.
        steady_error: Goal minus final position, radians.
    """

    at: float
    size: float
    delay: float
    rise: float
    overshoot: float
    peak: float
    settled: float
    steady_error: float


def step_figures(samples: Sequence[tuple[float, float, float]], *, least: float = 1e-6) -> list[StepFigures]:
    """Find the steps in the goal and return the figures of each.

    Args:
        samples: Time in seconds, goal and position in radians, in the order of time.
        least: Smallest change of the goal between two samples that counts as a step, radians. The goal must be
            constant between steps: a sine is a long row of small steps.

    Returns:
        One row for each step with enough samples after it.
    """
    jumps = [i for i in range(1, len(samples)) if abs(samples[i][1] - samples[i - 1][1]) > least]
    ends = [*jumps, len(samples)][1:]
    figures = []
    for first, end in zip(jumps, ends, strict=True):
        # The goal jumps somewhere between two samples; the earlier one is the last from before it.
        if end - first >= _LEAST_SAMPLES:
            figures.append(_figures(samples[first - 1], samples[first:end]))
    return figures


def _figures(before: tuple[float, float, float], after: Sequence[tuple[float, float, float]]) -> StepFigures:
    at, old_goal, start = before
    goal = after[0][1]
    times = [at, *(t for t, _, _ in after)]
    tail = max(1, math.ceil(len(after) * _TAIL))
    final = math.fsum(position for _, _, position in after[-tail:]) / tail
    way = final - start
    nothing = StepFigures(at, goal - old_goal, math.nan, math.nan, 0.0, math.nan, math.nan, goal - final)
    if abs(way) < 1e-9:
        return nothing
    # The way as a fraction: 0.0 at the start and 1.0 at the final position, whatever the direction.
    path = [0.0, *((position - start) / way for _, _, position in after)]
    low, high = _first_crossing(times, path, 0.1), _first_crossing(times, path, 0.9)
    top, place = _peak(times, path)
    return StepFigures(
        at,
        goal - old_goal,
        low - at,
        high - low,
        max(0.0, top - 1.0),
        place - at if top > 1.0 else math.nan,
        _settled(times, path) - at,
        goal - final,
    )


def _first_crossing(times: Sequence[float], path: Sequence[float], level: float) -> float:
    for i in range(1, len(path)):
        if path[i] >= level:
            return _between(times, path, i, level)
    return math.nan


def _between(times: Sequence[float], path: Sequence[float], i: int, level: float) -> float:
    """The time between samples i - 1 and i at which the path has a level, on a straight line."""
    before, after = path[i - 1], path[i]
    share = (level - before) / (after - before) if after != before else 1.0
    return times[i - 1] + share * (times[i] - times[i - 1])


def _peak(times: Sequence[float], path: Sequence[float]) -> tuple[float, float]:
    """The highest point, by a parabola through the highest sample and its neighbours."""
    i = max(range(len(path)), key=path.__getitem__)
    if not 0 < i < len(path) - 1:
        return path[i], times[i]
    left, top, right = path[i - 1], path[i], path[i + 1]
    bend = left - 2 * top + right
    even = math.isclose(times[i + 1] - times[i], times[i] - times[i - 1], rel_tol=0.25)
    if bend >= 0.0 or not even:
        return top, times[i]
    shift = 0.5 * (left - right) / bend
    return top - 0.25 * (left - right) * shift, times[i] + shift * (times[i + 1] - times[i - 1]) / 2


def _settled(times: Sequence[float], path: Sequence[float]) -> float:
    """The time from which all samples are within the band; NaN if the last ones are not all within it."""
    outside = [i for i, value in enumerate(path) if abs(value - 1.0) > BAND]
    if not outside:
        return times[0]
    last = outside[-1]
    if last >= len(path) - max(2, math.ceil(len(path) * _TAIL)):
        return math.nan
    level = 1.0 + math.copysign(BAND, path[last] - 1.0)
    return _between(times, path, last + 1, level)
