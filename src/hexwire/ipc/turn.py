"""Who may use the line: one at a time, and what is urgent first.

Owns the lock of a session and the count of urgent callers that wait for it. Must not know links or frames.
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

    The same thread may take it again, as a signal handler does, or a request that opens the port anew.

    Attributes:
        owner: The thread that has it; 0 if nobody has.
        urgent_waiting: How many urgent callers wait. Who has the turn should give it up soon if there are any.
    """

    def __init__(self) -> None:
        self.owner = 0
        self.urgent_waiting = 0
        self._lock = threading.RLock()
        self._depth = 0
        # Re-entrant for the same reason; what a signal handler counts in between it has counted back as well.
        self._counting = threading.RLock()

    def begin(self, interrupt: Callable[[], None] | None = None) -> None:
        """Wait for the turn.

        Args:
            interrupt: Given, the caller is urgent: it goes before all who are not. Called once it is counted,
                to wake the one who has the turn.
        """
        if interrupt is not None:
            self._count(1)
            try:
                interrupt()
                self._lock.acquire()
            finally:
                self._count(-1)
        else:
            # Who has the turn already must not wait for an urgent caller who waits for it.
            mine = self.owner == threading.get_ident()
            self._lock.acquire()
            while self.urgent_waiting and not mine:
                # Let it through: it counts itself before it waits for the lock.
                self._lock.release()
                time.sleep(_LET_THROUGH)
                self._lock.acquire()
        self.owner = threading.get_ident()
        self._depth += 1

    def end(self) -> None:
        """Give the turn back."""
        self._depth -= 1
        if not self._depth:
            self.owner = 0
        self._lock.release()

    @contextmanager
    def taken(self) -> Iterator[None]:
        """Have the turn, as one who is not urgent."""
        self.begin()
        try:
            yield
        finally:
            self.end()

    def _count(self, change: int) -> None:
        with self._counting:
            self.urgent_waiting += change
