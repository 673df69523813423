"""Answer times on a servo bus: length, line rate and return delay, plus the delay of the adapter.

Owns the window of a request and the measured allowance. No I/O: the caller measures the times, in seconds.

The time on the line follows from arithmetic. The delay of the adapter, its driver and the scheduler is measured as
a TCP sender measures its round trip (RFC 6298): a smoothed mean and deviation of the time beyond that on the line.
"""

from __future__ import annotations

__all__ = ["RETURN_DELAY", "LineTiming"]

BITS_A_BYTE = 10
RETURN_DELAY = 500e-6
"""Seconds until a servo with unknown setting begins its answer: the factory setting of an SCS (250 steps of 2 us).
On STS the register has no effect, HLS has none, and both are faster."""

_FIRST_ALLOWANCE = 0.060
"""Allowance before the first measurement: twice FTDI's 16 ms timer, and a slow computer."""
_LEAST_ALLOWANCE = 0.001
_MOST_ALLOWANCE = 0.100
_GAIN = 1 / 16
_DEVIATIONS = 4.0
_LATENCY_TIMER = 0.004
"""Overhead of every answer from which an adapter's timer is the cause."""
_ENOUGH_ANSWERS = 16


class LineTiming:
    """Timing of one bus.

    Args:
        baud: Bits per second; 0 for a line without transmission time.

    Attributes:
        allowance: Seconds allowed for the adapter in addition to the time on the line.
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
        """Return the seconds that `size` bytes take on the wire."""
        return size * self.byte_time

    def linger(self, size: int) -> float:
        """Return the seconds to wait for an answer delayed by noise, after as many bytes as it has arrived."""
        return (size + 8) * self.byte_time + min(self.allowance, 4 * _LEAST_ALLOWANCE)

    def measured(self, elapsed: float, size: int) -> None:
        """Add a measurement: the duration of an answered request, and the bytes of request and answers."""
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
        """Add a late answer, and extend the allowance so that such an answer arrives in time.

        Args:
            elapsed: Seconds from the request until the answer was found, an upper bound.
            size: Bytes of request and answer.
        """
        over = min(max(0.0, elapsed - size * self.byte_time), _FIRST_ALLOWANCE)
        self._deviation = max(self._deviation, over / _DEVIATIONS)
        self.allowance = max(self.allowance, over)

    @property
    def overhead(self) -> float:
        """Mean time of an answer beyond the time on the line, seconds; NaN before the first answer."""
        return self._mean if self.answers else float("nan")

    @property
    def round_trips(self) -> tuple[float, ...]:
        """The overhead as the one value that is known of round trips; empty before the first answer."""
        return (self._mean,) if self.answers else ()

    @property
    def holds_back(self) -> bool:
        """Whether every answer is delayed, as by an adapter's latency timer."""
        return self.answers >= _ENOUGH_ANSWERS and self._least >= _LATENCY_TIMER
