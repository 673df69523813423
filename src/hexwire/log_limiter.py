"""Limits how often a warning is repeated in the log.

Owns the record of logged texts. Time comes in as an argument.
"""

from __future__ import annotations

import math
import re

__all__ = ["LogLimiter"]

_NUMBER = re.compile(r"[+-]?\d[\d.e+-]*")
_KINDS = 100
"""Most texts remembered."""


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
