"""The rate of an emulated board's host line: raised by HOST_BAUD, and back when nothing valid is heard.

PROTOCOL.md, section 6.8.

Owns when the rate changes. Must not know frames, nor whether a change is safe; whoever serves the board applies the
rate to the bytes.
"""

from __future__ import annotations

from hexwire.wire import tables

__all__ = ["KNOWN_RATES", "LineRate"]

KNOWN_RATES = (115_200, 250_000, 500_000, 1_000_000)
"""The rates that HOST_BAUD may name, besides the board's own."""
_BITS = 10
_LAST_BYTES = 0.002
"""Seconds after the last byte until the rate changes."""


class LineRate:
    """The rate of one line.

    Args:
        own: The rate at which the board starts, bits per second; 0 if the line has none.

    Attributes:
        own: The rate at which the board starts, bits per second; 0 if the line has none.
        now: The present rate.
    """

    def __init__(self, own: int) -> None:
        self.own = self.now = own
        self._next: int | None = None
        self._change_at: float | None = None
        self._silent_at: float | None = None

    def knows(self, rate: int) -> bool:
        """Whether the line can have this rate."""
        return rate == self.own or rate in KNOWN_RATES

    @property
    def changing(self) -> bool:
        """A change has been answered but not done; until then no request but a stop is executed."""
        return self._next is not None

    @property
    def leaves(self) -> bool:
        """The last bytes at the present rate are leaving: nothing else may be sent."""
        return self._change_at is not None

    @property
    def due(self) -> float | None:
        """When `step` has something to do; None if never."""
        return self._change_at if self._next is not None else self._silent_at

    def change(self, rate: int) -> None:
        """Change to a rate after the bytes that are sent next."""
        if rate != self.now:
            self._next, self._change_at = rate, None

    def sent(self, count: int, now: float) -> None:
        """So many bytes begin to leave."""
        if self._next is not None and self._change_at is None:
            self._change_at = now + count * _BITS / self.now + _LAST_BYTES

    def heard(self, now: float) -> None:
        """A valid frame arrived."""
        if self._next is None and self.now != self.own:
            self._silent_at = now + tables.HOST_BAUD_SILENCE

    def step(self, now: float) -> bool:
        """Do what is due; True if the rate has changed, so that an unfinished frame is void."""
        due = self.due
        if due is None or now < due:
            return False
        self.now = self.own if self._next is None else self._next
        self._next = self._change_at = None
        self._silent_at = None if self.now == self.own else now + tables.HOST_BAUD_TRIAL
        return True
