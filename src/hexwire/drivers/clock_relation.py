"""The relation of a board's clock to the host's, from exchanges, with bounds that hold.

Owns offset and drift of two clocks. Pure. Must not know boards or requests.

The board read its clock between the times of a request and of its reply, so every exchange bounds the difference
of the clocks from both sides. Two of them bound the drift. Together they give an interval for any time, which is
right as long as the drift is even over the exchanges that are kept; its middle is the estimate, half its width the
uncertainty.
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

from hexwire.errors import UsageError

__all__ = ["ClockRelation", "HostTime", "WrappingClock"]

_DRIFT = 0.01
"""Difference in rate that the clocks may have before two exchanges tell. A ceramic resonator is good to 0.5 %."""
_KEPT = 24
"""Exchanges that are kept."""
_SPAN = 60.0
"""Seconds for which one is kept: with a change of temperature the drift changes."""
_SLOT = 1.0
"""Seconds in which only the shortest exchange is kept, apart from the newest."""


class HostTime(NamedTuple):
    """A time of the host's clock, seconds, and how far off it may be."""

    time: float
    uncertainty: float


class _Exchange(NamedTuple):
    board: float
    earliest: float
    latest: float


class WrappingClock:
    """Makes a clock of 32 bits in microseconds, which wraps after 71.6 minutes, one that does not; in seconds."""

    def __init__(self) -> None:
        self._last: int | None = None

    def read(self, time_us: int) -> float:
        """The time that a board has sent; at most half a wrap before or after the one before."""
        self._last = self._near(time_us)
        return self._last * 1e-6

    def near(self, time_us: int) -> float:
        """Another time, at most half a wrap before or after the last one that was read."""
        return self._near(time_us) * 1e-6

    def _near(self, time_us: int) -> int:
        last = time_us if self._last is None else self._last
        return last + ((time_us - last + 0x80000000) & 0xFFFFFFFF) - 0x80000000


class ClockRelation:
    """Relates the clock of one board to the host's. All times are in seconds."""

    def __init__(self) -> None:
        self._exchanges: deque[_Exchange] = deque()
        self._slowest, self._fastest = 1.0 - _DRIFT, 1.0 + _DRIFT

    def __bool__(self) -> bool:
        """Whether there was an exchange."""
        return bool(self._exchanges)

    @property
    def drift(self) -> float:
        """How much faster the host's clock runs than the board's; 1e-6 is a millionth."""
        return (self._slowest + self._fastest) / 2.0 - 1.0

    def add(self, sent: float, received: float, board: float) -> None:
        """Note an exchange.

        Args:
            sent: Host's clock when the request began; plus the time that it takes on the line, if that is known.
            received: Host's clock when the reply was there; minus the time that it takes on the line.
            board: The board's clock when it made the reply.

        Raises:
            UsageError: The reply came before the request.
        """
        if not sent <= received:
            raise UsageError(f"an exchange cannot end ({received:g} s) before it begins ({sent:g} s)")
        kept = self._exchanges
        if kept and board < kept[-1].board:
            # The board was reset.
            kept.clear()
        # In a slot of time only the shortest one tells something; but never without the newest.
        while len(kept) > 1 and board - kept[-2].board < _SLOT:
            a, b = kept[-2], kept[-1]
            if a.latest - a.earliest <= b.latest - b.earliest:
                kept.pop()
            else:
                del kept[-2]
        kept.append(_Exchange(board, sent, received))
        while len(kept) > _KEPT or kept[-1].board - kept[0].board > _SPAN:
            kept.popleft()
        self._bound_drift()
        while self._is_contradiction():
            # The drift was not even, or the host's clock was set.
            kept.popleft()
            self._bound_drift()

    def host_time(self, board: float) -> HostTime:
        """The host's time at a time of the board's clock.

        Raises:
            UsageError: There was no exchange yet.
        """
        earliest, latest = self._interval(board)
        return HostTime((earliest + latest) / 2.0, (latest - earliest) / 2.0)

    def board_time(self, host: float) -> float:
        """The board's time at a time of the host's clock, as good as `host_time` there; raises likewise."""
        if not self._exchanges:
            raise UsageError("the clocks were not compared yet")
        guess = self._exchanges[-1].board
        # The relation bends a little at each exchange, so the first step is not exact.
        for _ in range(3):
            guess += (host - self.host_time(guess).time) / (1.0 + self.drift)
        return guess

    def _interval(self, board: float) -> tuple[float, float]:
        if not self._exchanges:
            raise UsageError("the clocks were not compared yet")
        slow, fast = self._slowest, self._fastest
        ways = [(each, board - each.board) for each in self._exchanges]
        earliest = max(each.earliest + (slow if way >= 0.0 else fast) * way for each, way in ways)
        latest = min(each.latest + (fast if way >= 0.0 else slow) * way for each, way in ways)
        return earliest, latest

    def _bound_drift(self) -> None:
        slow, fast = 1.0 - _DRIFT, 1.0 + _DRIFT
        kept = list(self._exchanges)
        for i, a in enumerate(kept):
            for b in kept[i + 1 :]:
                if (span := b.board - a.board) > 0.0:
                    slow = max(slow, (b.earliest - a.latest) / span)
                    fast = min(fast, (b.latest - a.earliest) / span)
        self._slowest, self._fastest = slow, fast

    def _is_contradiction(self) -> bool:
        if len(self._exchanges) < 2:
            return False
        if self._slowest > self._fastest:
            return True
        return any(earliest > latest for earliest, latest in (self._interval(e.board) for e in self._exchanges))
