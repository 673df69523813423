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
_LET_THROUGH_LISTENING, _ROUNDS = 0.0001, 100


class Turn:
    """A lock that an urgent caller gets before all others.

    The same thread may acquire it again, for example in a signal handler or in a request that reopens the port.

    Attributes:
        owner: The thread that has it; 0 if it is free.
        urgent_waiting: Number of waiting urgent callers. The owner should release the lock soon if there are any.
        waiting: Number of other callers that wait for a listener, see `listening`. The listener should release the
            lock soon if there are any.
        listening: Set by an owner that only waits for unsolicited frames: how to wake it. None otherwise.
    """

    def __init__(self) -> None:
        self.owner = 0
        self.urgent_waiting = 0
        self.waiting = 0
        self.listening: Callable[[], None] | None = None
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
            if not self._lock.acquire(blocking=False):
                self._wait_for_listener()
            while self.urgent_waiting and not mine:
                # Let the urgent caller go first: it counts itself before it waits for the lock.
                self._lock.release()
                time.sleep(_LET_THROUGH)
                self._lock.acquire()
        self.owner = threading.get_ident()
        self._depth += 1

    def begin_listening(self, wake: Callable[[], None]) -> bool:
        """Acquire the lock to wait for unsolicited frames, after everybody else who wants it; end with `end`.

        Args:
            wake: Ends the wait from another thread.

        Returns:
            Whether to release the lock for waiting callers; False if this thread had the lock before.
        """
        self.begin()
        if self._depth > 1:
            return False
        for _ in range(_ROUNDS):
            if not self.waiting:
                break
            # The lock is not fair: without a pause, this thread would get it again at once.
            self.end()
            time.sleep(_LET_THROUGH_LISTENING)
            self.begin()
        self.listening = wake
        return True

    def _wait_for_listener(self) -> None:
        """Acquire the lock; a listener that has it is woken."""
        self._change_waiting(1)
        try:
            wake = self.listening
            if wake is not None:
                wake()
            self._lock.acquire()
        finally:
            self._change_waiting(-1)

    def end(self) -> None:
        """Release the lock."""
        self._depth -= 1
        if not self._depth:
            self.owner, self.listening = 0, None
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

    def _change_waiting(self, change: int) -> None:
        with self._counting:
            self.waiting += change
