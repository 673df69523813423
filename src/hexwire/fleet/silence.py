"""Whether the states of a shared arm have ceased to come, and saying so once.

Owns how long a silence is worth a word. Must not know why it is silent, nor Zenoh.
"""

from __future__ import annotations

import logging
import math

__all__ = ["Silence"]

_log = logging.getLogger(__name__)

_QUIET = 0.8
"""Seconds without a state that are worth a word: whatever its robot does, a server sends one every 0.4 s."""
_STALLED = 0.5
"""Seconds between two looks after which this program was halted itself, and takes now what has arrived."""


class Silence:
    """Tells when the states of an arm cease to come, once for each silence.

    Args:
        url: Address of the arm, for the text.
        since: When the first state could have come, seconds of this program's monotonic clock.
    """

    def __init__(self, url: str, since: float) -> None:
        self._url, self._since = url, since
        self._looked, self._told = since, False

    def look(self, now: float, arrived: float) -> None:
        """Look; several times a second.

        Args:
            now: Seconds of this program's monotonic clock.
            arrived: When the newest state arrived; minus infinity if none has.
        """
        stalled, self._looked = now - self._looked > _STALLED, now
        silent = now - max(arrived, self._since)
        if silent < _QUIET:
            if self._told:
                _log.warning("%s: its states come again", self._url)
            self._told = False
        elif not self._told and not stalled:
            self._told = True
            none = "no state has come" if arrived == -math.inf else "its states have ceased to come"
            _log.warning("%s: %s for %.1f s; is its program halted, or the network cut?", self._url, none, silent)
