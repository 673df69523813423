"""Warns once when the states of a shared arm stop arriving.

Owns how long a pause may last without a warning. Must not know its cause, nor Zenoh.
"""

from __future__ import annotations

import logging
import math

__all__ = ["Silence"]

_log = logging.getLogger(__name__)

_QUIET = 0.8
"""Seconds without a state before the warning: a server sends at least one every 0.4 s."""
_STALLED = 0.5
"""A longer time between two calls of `look`, in seconds, means that this program itself was halted."""


class Silence:
    """Logs a warning when the states of an arm stop arriving, once for each pause.

    Args:
        url: Address of the arm, for the text.
        since: When the first state could have come, seconds of this program's monotonic clock.
    """

    def __init__(self, url: str, since: float) -> None:
        self._url, self._since = url, since
        self._looked, self._told = since, False

    def look(self, now: float, arrived: float) -> None:
        """Check for a pause; to be called several times a second.

        Args:
            now: Seconds of this program's monotonic clock.
            arrived: When the newest state arrived; minus infinity if none has.
        """
        stalled, self._looked = now - self._looked > _STALLED, now
        silent = now - max(arrived, self._since)
        if silent < _QUIET:
            if self._told:
                _log.warning("%s: its states arrive again", self._url)
            self._told = False
        elif not self._told and not stalled:
            self._told = True
            none = "no state has arrived" if arrived == -math.inf else "its states have stopped arriving"
            _log.warning("%s: %s for %.1f s; is its server halted, or the network down?", self._url, none, silent)
