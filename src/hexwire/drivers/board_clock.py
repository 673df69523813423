"""When a board sent a frame, by the host's clock.

Owns the relation of the two clocks. Pure. Must not know frames.

A frame arrives some time after it was sent: a millisecond later, or seconds if this program was stopped meanwhile
and the frame waited in the port. The frame with the shortest transit time gives the best relation, so the
smallest difference counts, as far as the clocks may have drifted apart since.
"""

from __future__ import annotations

import math

__all__ = ["BoardClock"]

_DRIFT = 0.01
"""Difference in rate that the clocks may have. Boards with a ceramic resonator are specified to 0.5 %."""
_WAITED = 10.0
"""Longest time that a report waits, seconds, while a later answer is taken before it."""
_AT_ONCE = 1.0
"""Seconds in which all that waited are taken; a board that was reset needs longer to be back."""


class BoardClock:
    """Relates the clock of one board to the host's."""

    def __init__(self) -> None:
        self._clock = self._arrived = math.inf
        self._difference = 0.0

    def sent(self, clock: float, arrived: float) -> float:
        """When a frame was sent, in seconds of the host's clock; at the latest when it arrived.

        Args:
            clock: The board's clock at sending, seconds.
            arrived: The host's clock at arrival, seconds.
        """
        difference = arrived - clock
        if clock > self._clock:
            drift = _DRIFT * max(0.0, arrived - self._arrived)
            self._set(clock, arrived, min(difference, self._difference + drift))
        elif self._waited(clock, arrived):
            # A frame with a shorter transit time than those before also gives a better relation.
            self._difference = min(difference, self._difference)
        else:
            # The board was reset; or it has no clock.
            self._set(clock, arrived, difference)
        return clock + self._difference

    def _waited(self, clock: float, arrived: float) -> bool:
        """Whether a frame that is not newer than the newest one is a report that waited."""
        return (
            self._clock - _WAITED < clock <= self._clock < math.inf
            and clock != 0.0
            and arrived - self._arrived < _AT_ONCE
        )

    def _set(self, clock: float, arrived: float, difference: float) -> None:
        self._clock, self._arrived, self._difference = clock, arrived, difference
