"""Compares two motions of the same joints: aligned in time, with the differences of each joint.

Owns the alignment and the figures. Pure; must not know files, robots or clocks.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass

from hexwire.errors import UsageError

__all__ = ["Comparison", "Difference", "best_lag", "compare"]

_POINTS = 300
"""Points at which a lag is judged: enough for a curve, few enough for a search."""
_STEP = 0.01
"""Seconds between two points of a comparison."""
_MOST_POINTS = 20_000
_LEAST_SHARE = 0.5
"""Part of the shorter motion that must overlap: a small overlap is always alike."""
_FINEST = 0.002
"""Seconds to which a lag is found."""
_HOLLOWS = 3
"""Lags around which the search goes on: so many of the best, and so many of the shortest."""
_NOISE = math.radians(0.2) ** 2
"""Mean square of differences that mean nothing: two counts of an encoder."""

Row = tuple[float, Sequence[float]]
Rows = Sequence[Row]
"""Pairs of time (seconds, rising) and positions (radians; NaN where unknown)."""


@dataclass(frozen=True, slots=True)
class Difference:
    """How far a joint of the second motion is from the first, radians.

    Attributes:
        name: The joint.
        rms: Root mean square.
        largest: The greatest difference, with its sign.
        at: When that is, seconds of the first motion.
    """

    name: str
    rms: float
    largest: float
    at: float


@dataclass(frozen=True, slots=True)
class Comparison:
    """Two motions on one time axis, that of the first.

    Attributes:
        lag: Seconds that the second one is later; it is moved back by this.
        times: Seconds of the overlap.
        first: Positions of the first motion then, radians.
        differences: Second minus first, one row of radians for each time.
        joints: Figures of each joint.
    """

    lag: float
    times: tuple[float, ...]
    first: tuple[tuple[float, ...], ...]
    differences: tuple[tuple[float, ...], ...]
    joints: tuple[Difference, ...]


def compare(names: Sequence[str], first: Rows, second: Rows, lag: float = 0.0) -> Comparison:
    """Compare two motions.

    Args:
        names: The joints, in the order of the rows of both.
        first: The one that sets the time.
        second: The other one.
        lag: Seconds that the second one is later; see `best_lag`.

    Raises:
        UsageError: A motion is empty, or they do not overlap.
    """
    begin, end = _overlap(first, second, lag)
    if end <= begin:
        raise UsageError(f"the two motions do not overlap when one is moved by {lag:.2f} s")
    count = max(2, min(_MOST_POINTS, round((end - begin) / _STEP) + 1))
    times = tuple(begin + (end - begin) * i / (count - 1) for i in range(count))
    a, b = _sampled(first, times), _sampled(second, [t + lag for t in times])
    rows = tuple(tuple(q - p for p, q in zip(one, two, strict=True)) for one, two in zip(a, b, strict=True))
    return Comparison(
        lag, times, tuple(a), rows, tuple(_figures(name, i, times, rows) for i, name in enumerate(names))
    )


def best_lag(first: Rows, second: Rows, most: float = 10.0) -> float:
    """Seconds by which the second motion is later, so that both agree best.

    The lag with the least mean square of all differences, to 2 ms, among those with enough overlap.

    Args:
        first: Rows of the one.
        second: Rows of the other, with the same joints.
        most: Longest lag, seconds.

    Raises:
        UsageError: A motion is empty.
    """
    durations = [rows[-1][0] - rows[0][0] if rows else 0.0 for rows in (first, second)]
    _overlap(first, second, 0.0)
    least = _LEAST_SHARE * min(durations)
    # By start: the lag is that of the second motion's time axis.
    centre = second[0][0] - first[0][0]
    reach = min(most, max(durations))
    step = max(_FINEST, reach / 50)
    scores = [_score(first, second, centre + step * i, least) for i in range(-50, 51)]
    # A motion that repeats itself has many good lags, and which looks best depends on where the search looked.
    hollows = [i for i in range(101) if scores[i] < math.inf and scores[i] == min(scores[max(0, i - 1) : i + 2])]
    found = []
    deepest = sorted(hollows, key=lambda i: (scores[i], abs(i - 50)))[:_HOLLOWS]
    nearest = sorted(hollows, key=lambda i: abs(i - 50))[:_HOLLOWS]
    for i in dict.fromkeys(deepest + nearest):
        lag, fine = centre + step * (i - 50), step
        while fine > _FINEST:
            fine /= 4
            around = [lag + fine * k for k in range(-4, 5)]
            lag = min(around, key=lambda lag: (round(_score(first, second, lag, least), 12), abs(lag - centre)))
        found.append((_score(first, second, lag, least), lag))
    if not found:
        return centre
    best = min(found)[0]
    # Of those that are as good, the shortest.
    return min((lag for score, lag in found if score <= 1.2 * best + _NOISE), key=lambda lag: abs(lag - centre))


def _score(first: Rows, second: Rows, lag: float, least: float) -> float:
    """Mean square of all differences at a lag; infinite with too little overlap."""
    begin, end = _overlap(first, second, lag)
    if end - begin < least or end <= begin:
        return math.inf
    times = [begin + (end - begin) * i / (_POINTS - 1) for i in range(_POINTS)]
    a, b = _sampled(first, times), _sampled(second, [t + lag for t in times])
    squares = [
        (q - p) ** 2
        for one, two in zip(a, b, strict=True)
        for p, q in zip(one, two, strict=True)
        if math.isfinite(q - p)
    ]
    return sum(squares) / len(squares) if squares else math.inf


def _overlap(first: Rows, second: Rows, lag: float) -> tuple[float, float]:
    if not first or not second:
        raise UsageError("an empty motion cannot be compared")
    return max(first[0][0], second[0][0] - lag), min(first[-1][0], second[-1][0] - lag)


def _sampled(rows: Rows, times: Sequence[float]) -> list[tuple[float, ...]]:
    """Positions at rising times, on straight lines between the rows."""
    found = []
    at = 0
    for t in times:
        at = bisect_right(rows, t, at, key=_time)
        low, high = max(0, at - 1), min(at, len(rows) - 1)
        (t0, a), (t1, b) = rows[low], rows[high]
        share = min(1.0, max(0.0, (t - t0) / (t1 - t0))) if t1 > t0 else 0.0
        found.append(tuple(p + share * (q - p) for p, q in zip(a, b, strict=True)))
    return found


def _time(row: Row) -> float:
    return row[0]


def _figures(name: str, i: int, times: Sequence[float], rows: Sequence[Sequence[float]]) -> Difference:
    known = [(row[i], t) for row, t in zip(rows, times, strict=True) if math.isfinite(row[i])]
    if not known:
        return Difference(name, math.nan, math.nan, math.nan)
    largest, at = max(known, key=lambda pair: abs(pair[0]))
    return Difference(name, math.sqrt(sum(d * d for d, _ in known) / len(known)), largest, at)
