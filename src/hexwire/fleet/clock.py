"""The offset of another computer's clock, measured by exchanges.

Owns the estimate and its uncertainty. Pure. Must not know what is exchanged.

As with NTP: the other clock was read some time between sending and receiving, so one exchange gives the offset to
half its round trip. The exchange with the shortest round trip counts; an old one is worth less: clocks drift.
"""

from __future__ import annotations

import math
from collections import deque

__all__ = ["ClockOffset"]

_DRIFT = 1e-4
"""Difference in rate that two clocks may have: 100 ppm, twice that of a poor crystal."""
_KEPT = 32
_JUMP = 3.0
"""An exchange that contradicts the estimate by more than so many uncertainties shows a clock that jumped."""


class ClockOffset:
    """Relates the clock of this program to another one.

    Attributes:
        jumps: Number of times that the other clock jumped: its computer was restarted or suspended.
    """

    def __init__(self) -> None:
        self.jumps = 0
        self._samples: deque[tuple[float, float, float]] = deque(maxlen=_KEPT)

    @property
    def known(self) -> bool:
        """Whether there was an exchange."""
        return bool(self._samples)

    def add(self, sent: float, other: float, received: float) -> None:
        """Add an exchange.

        Args:
            sent: Here, when the question was sent, seconds.
            other: The other clock, when it answered, seconds.
            received: Here, when the answer came, seconds.
        """
        half = 0.5 * (received - sent)
        if not (half >= 0.0 and math.isfinite(other)):
            return
        middle = sent + half
        if self._samples:
            offset, doubt = self.at(middle)
            if abs(other - middle - offset) > _JUMP * (doubt + half) + 1e-3:
                self.jumps += 1
                self._samples.clear()
        self._samples.append((middle, other - middle, half))

    def at(self, now: float) -> tuple[float, float]:
        """Offset of the other clock (other = here + offset) and its uncertainty, seconds.

        Without an exchange the offset is 0 and the uncertainty infinite.
        """
        if not self._samples:
            return 0.0, math.inf
        when, offset, half = min(self._samples, key=lambda row: row[2] + _DRIFT * abs(now - row[0]))
        return offset, half + _DRIFT * abs(now - when)
