"""When Python's garbage collector looks through everything: where it keeps no moving arm waiting.

Owns the collector of the studio's process. Must not know what fills the memory.
"""

from __future__ import annotations

import gc

__all__ = ["FullPasses", "pass_by_hand"]

_YOUNG = (700, 10)
"""Python's own thresholds for what is new; a pass of that takes less than a millisecond."""
_NEVER = 2**31 - 1
_EVERY, _LATEST = 30.0, 600.0
"""Seconds between two full passes, and after which one is made although the arm moves."""


def pass_by_hand() -> None:
    """Look through everything now, leave that alone for good, and make no full pass unasked.

    A full pass holds the interpreter for 60 ms with all that is there at the start, and for 12 ms with a large file
    of the page Wire. What pages compute brings it about at any time.
    """
    gc.collect()
    gc.freeze()
    gc.set_threshold(*_YOUNG, _NEVER)


class FullPasses:
    """Decides when a full pass is made: from time to time, while nothing moves.

    Args:
        now: Seconds; the first one is due a while later.
    """

    def __init__(self, now: float) -> None:
        self._last = now

    def due(self, now: float, *, moving: bool) -> bool:
        """Whether to make one now; it counts as made.

        Args:
            now: Seconds.
            moving: The arm moves, as far as is known.
        """
        waited = now - self._last
        if waited < (_LATEST if moving else _EVERY):
            return False
        self._last = now
        return True
