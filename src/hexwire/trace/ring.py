"""The newest traffic of a link, kept while an arm is open, for whoever wants to look at it later.

Owns its bounds, in time and in bytes, and that keeping costs the link's owner next to nothing: one append, without
a lock that a reader could hold. Must not know what the bytes mean.
"""

from __future__ import annotations

from collections import deque
from itertools import islice

from hexwire.link.tap import Passed

__all__ = ["TrafficRing"]

_OVERHEAD = 256
"""Memory of a transfer beside its bytes, about."""


class TrafficRing:
    """The newest transfers. One thread at a time feeds it; any thread may read.

    Args:
        seconds: Age of the oldest transfer at most, counted from the newest.
        size: Bytes of memory, about.
    """

    def __init__(self, seconds: float = 120.0, size: int = 16 * 1024 * 1024) -> None:
        self._seconds, self._size = seconds, size
        self._kept: deque[tuple[int, Passed]] = deque()
        self._bytes = 0
        self._number = 0

    def feed(self, passed: Passed) -> None:
        """Keep a transfer; an observer for `TapLink`."""
        kept = self._kept
        self._number += 1
        self._bytes += len(passed.data) + _OVERHEAD
        kept.append((self._number, passed))
        oldest = passed.time - self._seconds
        while len(kept) > 1 and (self._bytes > self._size or kept[0][1].time < oldest):
            self._bytes -= len(kept.popleft()[1].data) + _OVERHEAD

    @property
    def newest(self) -> int:
        """Number of the newest transfer; they are counted from 1."""
        return self._number

    def since(self, number: int) -> list[tuple[int, Passed]]:
        """The transfers after a number, oldest first, as far as they are still kept."""
        # Reading the newest from the end takes time for these only. CPython makes the list without letting the
        # feeding thread in between; where that does not hold, the next call has them.
        kept = self._kept
        try:
            last = kept[-1][0]
            found = list(islice(reversed(kept), max(0, last - number)))
        except (IndexError, RuntimeError):
            return []
        found.reverse()
        return [each for each in found if each[0] > number]
