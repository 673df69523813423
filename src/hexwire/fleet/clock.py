"""The offset of another computer's clock, measured by exchanges.

Owns the estimate and its uncertainty. Pure.

As with NTP: the other clock was read some time between sending and receiving, so one exchange gives the offset to
half its round trip. The exchange with the shortest round trip counts; an old one is worth less: clocks drift.
"""

from __future__ import annotations

import math

__all__ = ["ClockOffset"]

_DRIFT = 1e-4
"""Difference in rate that two clocks may have: 100 ppm, twice that of a poor crystal."""
_KEPT = 32
_SEARCH = 1.0
"""Seconds until the best exchange is searched for again; another one improves by at most 0.1 ms in that time."""
_PERIOD, _SOON, _KNOWN = 5.0, 0.5, 0.005
"""Seconds between two exchanges, and between two until the offset is known to so many seconds."""
_ROUNDING = 1e-6
"""Rounding error of sums of clocks that run for years, seconds."""
_LARGEST = 1e12
"""Seconds; a greater value is not a valid clock."""

_Sample = tuple[float, float, float]
"""When it was measured here, the offset and its uncertainty, seconds."""


class ClockOffset:
    """Relates the clock of this program to another one. One thread adds, any thread reads.

    Attributes:
        jumps: Number of times that one of the clocks jumped: its computer was restarted or suspended.
    """

    def __init__(self) -> None:
        self.jumps = 0
        # Here, offset, uncertainty. Replaced as a whole, since one thread adds while others read.
        self._samples: tuple[_Sample, ...] = ()
        # When the best was searched, among which samples, and which it was.
        self._best: tuple[float, tuple[_Sample, ...], _Sample] | None = None

    @property
    def known(self) -> bool:
        """Whether there was an exchange."""
        return bool(self._samples)

    def add(self, sent: float, other: float, received: float) -> None:
        """Add an exchange; impossible values are ignored.

        Args:
            sent: Here, when the question was sent, seconds.
            other: The other clock, when it answered, seconds.
            received: Here, when the answer came, seconds.
        """
        half = 0.5 * (received - sent)
        if not (0.0 <= half < math.inf and abs(other) < _LARGEST):
            return
        middle = sent + half
        # The clocks also drifted during the exchange.
        doubt = half * (1.0 + _DRIFT) + _ROUNDING
        rows = self._samples
        if rows:
            before, so_far = self.at(middle)
            if abs(other - middle - before) > so_far + doubt:
                # Both cannot be true: the earlier measurement no longer holds.
                self.jumps += 1
                rows = ()
        self._samples = (*rows[1 - _KEPT :], (middle, other - middle, doubt))

    def at(self, now: float) -> tuple[float, float]:
        """Offset of the other clock (other = here + offset) and its uncertainty, seconds.

        Without an exchange the offset is 0 and the uncertainty infinite.
        """
        rows, best = self._samples, self._best
        if best is None or best[1] is not rows or not 0.0 <= now - best[0] < _SEARCH:
            if not rows:
                return 0.0, math.inf
            best = self._best = (now, rows, min(rows, key=lambda row: row[2] + _DRIFT * abs(now - row[0])))
        when, offset, doubt = best[2]
        return offset, doubt + _DRIFT * abs(now - when)

    def period(self, now: float) -> float:
        """Seconds until the next exchange; few while little is known, as after poor ones on a busy machine."""
        return _PERIOD if self.at(now)[1] < _KNOWN else _SOON
