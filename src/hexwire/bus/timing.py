"""How long an answer takes on a servo bus: from length, line rate and return delay, plus what the adapter adds.

Owns the window of a request and the measured allowance. Sans I/O: times are seconds that the caller measured.

The line itself is exact arithmetic. What the adapter, its driver and the scheduler add is measured as a TCP sender
measures its round trip (RFC 6298): a smoothed mean and deviation of what was left over after the arithmetic.
"""

from __future__ import annotations

__all__ = ["RETURN_DELAY", "LineTiming"]

BITS_A_BYTE = 10
RETURN_DELAY = 500e-6
"""Seconds a servo may take to begin its answer where its own setting is not known: what an SCS leaves the factory
with (250 steps of 2 us). On STS the register is without effect, HLS have none, and both are quicker."""

_FIRST_ALLOWANCE = 0.060
"""Before anything was measured: FTDI's 16 ms timer, twice, and a slow machine."""
_LEAST_ALLOWANCE = 0.001
_MOST_ALLOWANCE = 0.100
_GAIN = 1 / 16
_DEVIATIONS = 4.0
_LATENCY_TIMER = 0.004
"""Overhead of every answer that only an adapter's timer explains."""
_ENOUGH_ANSWERS = 16


class LineTiming:
    """Timing of one bus.

    Args:
        baud: Bits a second; 0 for a line that costs no time.

    Attributes:
        allowance: Seconds granted to the adapter on top of the line's own time.
        answers: Answers measured so far.
    """

    def __init__(self, baud: int) -> None:
        self.baud = baud
        self.byte_time = BITS_A_BYTE / baud if baud > 0 else 0.0
        self.allowance = _FIRST_ALLOWANCE
        self.answers = 0
        self._mean = 0.0
        self._deviation = 0.0
        self._least = float("inf")

    def line_time(self, size: int) -> float:
        """Seconds that many bytes take on the wire."""
        return size * self.byte_time

    def linger(self, size: int) -> float:
        """Seconds to wait for an answer that noise pushed back, once as many bytes are here as it has."""
        return (size + 8) * self.byte_time + min(self.allowance, 4 * _LEAST_ALLOWANCE)

    def measured(self, elapsed: float, size: int) -> None:
        """Take in an answered request: how long it took, and the bytes of request and answers."""
        over = elapsed - size * self.byte_time
        if over < 0.0:
            over = 0.0
        self._least = min(self._least, over)
        if not self.answers:
            self._mean, self._deviation = over, over / 2
        else:
            off = over - self._mean
            self._mean += _GAIN * off
            self._deviation += _GAIN * (abs(off) - self._deviation)
        self.answers += 1
        if self.answers >= _ENOUGH_ANSWERS or self.allowance < _FIRST_ALLOWANCE:
            allowance = self._mean + _DEVIATIONS * self._deviation
            self.allowance = min(max(allowance, _LEAST_ALLOWANCE), _MOST_ALLOWANCE)

    def late(self, elapsed: float, size: int) -> None:
        """Take in an answer that came after its request was given up: from now on it would be waited for.

        Args:
            elapsed: Seconds from the request to the moment at which the answer was found, at most.
            size: Bytes of request and answer.
        """
        over = min(max(0.0, elapsed - size * self.byte_time), _FIRST_ALLOWANCE)
        self._deviation = max(self._deviation, over / _DEVIATIONS)
        self.allowance = max(self.allowance, over)

    @property
    def overhead(self) -> float:
        """Mean seconds an answer takes beyond the line's own time; NaN before any came."""
        return self._mean if self.answers else float("nan")

    @property
    def holds_back(self) -> bool:
        """Whether something on the way holds every answer back, as an adapter's latency timer does."""
        return self.answers >= _ENOUGH_ANSWERS and self._least >= _LATENCY_TIMER
