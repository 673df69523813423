"""When Python's garbage collector looks through everything: where it keeps no moving arm waiting.

Owns the collector of the studio's process.
"""

from __future__ import annotations

import gc
import sys

__all__ = ["FullPasses", "pass_by_hand"]

_YOUNG = (700, 10)
"""Python's own thresholds for what is new; a pass of that takes 1 to 3 ms at most."""
_NEVER = 2**31 - 1
_GROWN, _LARGE = 500_000, 3_000_000
"""Pieces of memory, of 100 bytes or so, by which the program has grown since the last full pass: then one is made
while nothing moves, and although something moves. Only rings that have lived for long need a full pass; other
memory is freed at once."""


def pass_by_hand() -> None:
    """Look through everything now; from now on look through what is new only, and never again at what stays.

    A full pass holds the interpreter for 60 ms with all that is there at the start, and for 1 ms more for each open
    page. What pages compute brings it about at any time.
    """
    _look_through()
    gc.set_threshold(*_YOUNG, _NEVER)
    if _leave not in gc.callbacks:
        gc.callbacks.append(_leave)


def _look_through() -> None:
    gc.unfreeze()
    gc.collect()
    gc.freeze()


def _leave(phase: str, info: dict[str, int]) -> None:
    """Leave alone what has survived two young passes: nothing is ever old enough for a full pass."""
    if phase == "stop" and info["generation"] == 1:
        gc.freeze()


class FullPasses:
    """Makes a full pass where memory has grown, rather while nothing moves."""

    def __init__(self) -> None:
        self._least = sys.getallocatedblocks()

    def look(self, *, moving: bool) -> bool:
        """Make one if it is due; whether it was.

        Args:
            moving: The arm moves, as far as is known.
        """
        blocks = sys.getallocatedblocks()
        self._least = min(self._least, blocks)
        if blocks - self._least < (_LARGE if moving else _GROWN):
            return False
        _look_through()
        self._least = sys.getallocatedblocks()
        return True
