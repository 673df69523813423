"""The lock of a line: one user at a time, urgent callers first.

Owns the lock of a session and the count of waiting urgent callers. Must not know links or frames.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

__all__ = ["Turn"]

_LET_THROUGH = 0.001


class Turn:
    """A lock that an urgent caller gets before all others.

    The same thread may acquire it again, for example in a signal handler or in a request that reopens the port.

    Attributes:
        owner: The thread that has it; 0 if it is free.
        urgent_waiting: Number of waiting urgent callers. The owner should release the lock soon if there are any.
    """

    def __init__(self) -> None:
        self.owner = 0
        self.urgent_waiting = 0
        self._lock = threading.RLock()
        self._depth = 0
        # Re-entrant for the same reason; a signal handler undoes its own count before it returns.
        self._counting = threading.RLock()

    def begin(self, interrupt: Callable[[], None] | None = None) -> None:
        """Acquire the lock.

        Args:
            interrupt: If given, the caller is urgent and goes before all others. Called after it is counted, to
                wake the owner.
        """
        if interrupt is not None:
            self._count(1)
            try:
                interrupt()
                self._lock.acquire()
            finally:
                self._count(-1)
        else:
            # The owner must not wait for an urgent caller that waits for the owner.
            mine = self.owner == threading.get_ident()
            self._lock.acquire()
            while self.urgent_waiting and not mine:
                # Let the urgent caller go first: it counts itself before it waits for the lock.
                self._lock.release()
                time.sleep(_LET_THROUGH)
                self._lock.acquire()
        self.owner = threading.get_ident()
        self._depth += 1

    def end(self) -> None:
        """Release the lock."""
        self._depth -= 1
        if not self._depth:
            self.owner = 0
        self._lock.release()

    @contextmanager
    def taken(self) -> Iterator[None]:
        """Hold the lock, as a caller that is not urgent."""
        self.begin()
        try:
            yield
        finally:
            self.end()

    def _count(self, change: int) -> None:
        with self._counting:
            self.urgent_waiting += change
