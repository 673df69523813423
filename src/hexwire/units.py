"""Conversions between what people type and read, what servos count, and SI.

Owns factors and how a number is written for people, and nothing else. The API of hexwire is SI: radians, seconds,
volts, amperes, fractions of full scale. Degrees are for people; counts live in `wire` and in the joint model.
"""

from __future__ import annotations

import math

__all__ = ["CHAPTER_RADIANS_PER_COUNT", "NSEC", "decimal", "deg", "degrees", "mm", "plain", "radians", "split_time"]

NSEC = 1_000_000_000

CHAPTER_RADIANS_PER_COUNT = 0.001534
"""Angle of one encoder count as the chapter's host computes it: the rounded constant, not 2 pi / 4096.
Every angle printed in its log confirms it to six digits."""

_LONG = 1e15
"""From here on an exponent reads better than a row of digits."""

degrees = math.degrees
radians = math.radians


def deg(angle: float) -> float:
    """An angle in degrees, in radians."""
    return math.radians(angle)


def mm(length: float) -> float:
    """A length in millimetres, in metres."""
    return length / 1000


def decimal(value: float, digits: int = 4) -> str:
    """A number for people: so many digits that count, at most six decimals, no exponent, no minus before a zero."""
    if not math.isfinite(value) or abs(value) >= _LONG:
        return f"{value:g}"
    before = math.floor(math.log10(abs(value))) + 1 if value else 1
    text = f"{value:.{min(max(digits - before, 0), 6)}f}"
    if "." in text:
        text = text.rstrip("0").rstrip(".")
    return "0" if text == "-0" else text


def plain(value: float, digits: int, *, sign: bool = False) -> str:
    """A number with `digits` decimals, without exponent and negative zero; ``-`` if it is unknown."""
    return f"{round(value, digits) + 0.0:{'+' if sign else ''}.{digits}f}" if math.isfinite(value) else "-"


def split_time(seconds: float) -> tuple[int, int]:
    """Split a time into whole seconds and nanoseconds, both unsigned as the session header wants them.

    Negative times, which a clock may give before it is set, become zero.
    """
    if seconds <= 0:
        return 0, 0
    whole = int(seconds)
    # Rounded, so that 14.356 s is 356 ms and not a nanosecond less, which would cut to 355.
    nsec = round((seconds - whole) * NSEC)
    if nsec == NSEC:
        whole, nsec = whole + 1, 0
    return whole & 0xFFFFFFFF, nsec
