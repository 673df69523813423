"""Limits an action to once per period and how often a warning is repeated, and measures the rate of events.

Owns the due times, which never lead to bursts, the record of logged texts, and the count behind a rate. Time comes
in as an argument. Must not know who logs, nor why.
"""

from __future__ import annotations

import math
import re
from collections import deque

__all__ = ["LogLimiter", "Periodic", "RateMeter"]

_NUMBER = re.compile(r"[+-]?\d[\d.e+-]*")
_KINDS = 100
"""Most texts remembered."""


class Periodic:
    """Is due once per period. Missed periods are not made up for.

    One thread calls `due` and `done`; any thread may call `hurry`.
    """

    def __init__(self) -> None:
        self._due = -math.inf
        self._done = -math.inf
        self._hurried = False

    def hurry(self) -> None:
        """Be due at once, if nothing was done for a period."""
        self._hurried = True

    def due(self, now: float, period: float, early: float = 0.0) -> bool:
        """Whether the action is due; if so, the next due time is set.

        Args:
            now: Seconds.
            period: Seconds.
            early: Seconds before the due time from which the action is due; less than half a period.
        """
        if now + early >= self._due:
            # After a late cycle, the due times stay; after a delay of more than a period, they start from now.
            following = self._due + period if now < self._due + period else now + period
        elif self._hurried and now >= self._done + period:
            following = now + period
        else:
            return False
        # Before the caller reads its input: a `hurry` from here on may be for input that it does not see.
        self._hurried = False
        self._due = following
        return True

    def done(self, now: float) -> None:
        """Note that the action was done, not only due."""
        self._done = now


class RateMeter:
    """Measures events per second over a time window.

    Args:
        window: Seconds.
    """

    def __init__(self, window: float = 2.0) -> None:
        self._window = window
        self._times: deque[float] = deque()

    def count(self, now: float) -> None:
        """Count an event."""
        self._times.append(now)
        self._forget(now)

    def rate(self, now: float) -> float:
        """Events per second; 0 if there were fewer than two."""
        self._forget(now)
        times = self._times
        return (len(times) - 1) / max(times[-1] - times[0], 1e-9) if len(times) > 1 else 0.0

    def _forget(self, now: float) -> None:
        times, begins = self._times, now - self._window
        while times and times[0] < begins:
            times.popleft()


class LogLimiter:
    """Decides whether to log a text again: a fault that occurs fifty times per second must not fill the log.

    Texts that differ only in their numbers count as one: a client that streams refused values sends different
    numbers each time.
    """

    def __init__(self) -> None:
        self._logged: dict[str, float] = {}

    def due(self, text: str, now: float, period: float = 1.0) -> bool:
        """Whether to log `text` now; if true, it counts as logged.

        Args:
            text: The text.
            now: Seconds.
            period: Least seconds between two log entries.
        """
        kind = _NUMBER.sub("#", text)
        if now - self._logged.get(kind, -math.inf) < period:
            return False
        # Forget the oldest, since a client can also invent any number of names.
        self._logged.pop(kind, None)
        self._logged[kind] = now
        while len(self._logged) > _KINDS:
            del self._logged[next(iter(self._logged))]
        return True
