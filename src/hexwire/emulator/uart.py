"""What a serial receiver hears: bytes sent at another rate, or by several senders at once.

Owns the arithmetic of start bit, eight data bits and stop bit. Knows no packets and no servos; times are seconds.

A line is described by the times at which it is low: it rests high, and a 0 of any sender pulls it down. A receiver
waits for a falling edge and samples the middle of each bit at its own rate, as the hardware does. So a rate that is
a few per cent off is understood, and any other gives the same wrong bytes as on a real line.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable

__all__ = ["heard_at", "listen", "same_rate"]

_BITS = 10
_TOLERANCE = 0.03
"""Largest relative difference at which two rates understand each other. The stop bit is sampled after 9.5 bits, by
when sender and receiver may be half a bit apart (5 %); the rest is a margin for slow edges."""
_SAME = 1e-9
"""Edges that are no further apart than this, in seconds, are one."""


def same_rate(one: int, other: int) -> bool:
    """Whether a sender at one rate is understood at the other, both in bits a second."""
    return one == other or abs(one - other) <= _TOLERANCE * max(one, other)


def heard_at(data: bytes, sent: int, heard: int, *, whole: bool = False) -> bytes:
    """What a receiver hears of bytes that follow each other without a pause.

    Args:
        data: The bytes.
        sent: Rate they are sent at, bits a second.
        heard: Rate of the receiver.
        whole: See `listen`.
    """
    if same_rate(sent, heard):
        return data
    return listen([(data, 0.0)], sent, heard, whole=whole)


def listen(
    sent: Iterable[tuple[bytes, float]], baud: int, heard: int | None = None, *, whole: bool = False
) -> bytes:
    """What a receiver hears of several senders on one line.

    Args:
        sent: Bytes of each sender, and the time of its first start bit.
        baud: Rate of the senders.
        heard: Rate of the receiver; the senders' if None.
        whole: Leave out bytes without a stop bit, as a servo does; a serial driver passes them on as sampled.
    """
    lows = _merged(low for data, start in sent for low in _lows(data, start, baud))
    starts = [begin for begin, _ in lows]
    bit = 1.0 / (heard or baud)
    out = bytearray()
    at = 0
    while at < len(lows):
        edge = lows[at][0]
        if lows[at][1] - edge <= bit / 2:
            at += 1  # too short for a start bit
            continue
        byte = 0
        for place in range(8):
            if not _is_low(lows, starts, edge + (place + 1.5) * bit):
                byte |= 1 << place
        stop = edge + 9.5 * bit
        if not (whole and _is_low(lows, starts, stop)):
            out.append(byte)
        # The next start bit is a falling edge after the stop bit was sampled.
        at = bisect_right(starts, stop)
    return bytes(out)


def _lows(data: bytes, start: float, baud: int) -> Iterable[tuple[float, float]]:
    """Start and end of each time in which a sender pulls the line down."""
    for place, byte in enumerate(data):
        frame = byte << 1 | 1 << _BITS - 1
        first = place * _BITS
        bit = 0
        while bit < _BITS:
            if frame >> bit & 1:
                bit += 1
                continue
            end = bit
            while not frame >> end & 1:
                end += 1
            yield start + (first + bit) / baud, start + (first + end) / baud
            bit = end


def _merged(lows: Iterable[tuple[float, float]]) -> list[tuple[float, float]]:
    merged: list[tuple[float, float]] = []
    for begin, end in sorted(lows):
        if merged and begin <= merged[-1][1] + _SAME:
            if end > merged[-1][1]:
                merged[-1] = (merged[-1][0], end)
        else:
            merged.append((begin, end))
    return merged


def _is_low(lows: list[tuple[float, float]], starts: list[float], time: float) -> bool:
    at = bisect_right(starts, time) - 1
    return at >= 0 and time < lows[at][1]
