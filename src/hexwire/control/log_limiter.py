"""Which warnings are logged again, and which would only fill the log.

Owns the memory of what was logged. Time comes in as an argument. Must not know who logs, nor why.
"""

from __future__ import annotations

import math
import re

__all__ = ["LogLimiter"]

_NUMBER = re.compile(r"[+-]?\d[\d.e+-]*")
_KINDS = 100
"""Texts that are remembered."""


class LogLimiter:
    """Decides whether to log a text again: a fault that comes fifty times a second must not fill the log.

    Texts that differ only in their numbers count as one: a client that streams what is refused sends other numbers
    each time.
    """

    def __init__(self) -> None:
        self._logged: dict[str, float] = {}

    def due(self, text: str, now: float, period: float = 1.0) -> bool:
        """Whether to log `text` now; the answer True counts as logged.

        Args:
            text: What is to be logged.
            now: Seconds.
            period: Between two times, seconds.
        """
        kind = _NUMBER.sub("#", text)
        if now - self._logged.get(kind, -math.inf) < period:
            return False
        # The newest last, and the oldest forgotten: names in a text may be made up, too.
        self._logged.pop(kind, None)
        self._logged[kind] = now
        while len(self._logged) > _KINDS:
            del self._logged[next(iter(self._logged))]
        return True
