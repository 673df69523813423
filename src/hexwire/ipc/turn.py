"""The lock of a line: one user at a time, urgent callers first.

Owns the lock of a session, the count of waiting urgent callers, and what its owner does for others meanwhile. Must
not know links or frames.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

__all__ = ["Turn"]

_LET_THROUGH = 0.001
_LET_THROUGH_LISTENING, _ROUNDS = 0.0001, 100
_LOOK = 0.002
"""Seconds between two looks whether the owner has done meanwhile what the lock is wanted for."""


@dataclass(slots=True, eq=False)
class _Job:
    run: Callable[[], None]
    over: bool = False
    error: Exception | None = None


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
        self._jobs: deque[_Job] = deque()
        # Re-entrant for the same reason; a signal handler undoes its own count before it returns.
        self._counting = threading.RLock()

    def begin(self, interrupt: Callable[[], None] | None = None, *, within: float = -1.0) -> bool:
        """Acquire the lock.

        Args:
            interrupt: If given, the caller is urgent and goes before all others. Called after it is counted, to
                wake the owner.
            within: Seconds in which a caller that is not urgent gives up; negative for never.

        Returns:
            Whether it was acquired.
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
            if not self._lock.acquire(blocking=False) and not self._wait_for_listener(within):
                return False
            while self.urgent_waiting and not mine:
                # Let the urgent caller go first: it counts itself before it waits for the lock.
                self._lock.release()
                time.sleep(_LET_THROUGH)
                self._lock.acquire()
        self.owner = threading.get_ident()
        self._depth += 1
        return True

    def begin_listening(self, wake: Callable[[], None], ready: Callable[[], object]) -> bool | None:
        """Acquire the lock to wait for unsolicited frames, after everybody else who wants it; end with `end`.

        Args:
            wake: Ends the wait from another thread.
            ready: Whether there is one, which an owner that waits for its answer has received.

        Returns:
            Whether to release the lock for waiting callers; False if this thread had the lock before. None if there
            is a frame, and the lock was not acquired.
        """
        rounds = 0
        while True:
            while not self.begin(within=_LOOK):
                if ready():
                    return None
            if self._depth > 1:
                return False
            if not self.waiting or rounds == _ROUNDS:
                break
            # The lock is not fair: without a pause, this thread would get it again at once.
            self.end()
            time.sleep(_LET_THROUGH_LISTENING)
            rounds += 1
        self.listening = wake
        return True

    def _wait_for_listener(self, within: float) -> bool:
        """Acquire the lock; a listener that has it is woken."""
        self._change_waiting(1)
        try:
            wake = self.listening
            if wake is not None:
                wake()
            return self._lock.acquire(timeout=within)
        finally:
            self._change_waiting(-1)

    def run(self, job: Callable[[], None], wake: Callable[[], None]) -> None:
        """Run a short job with the lock, here or in the thread of an owner that calls `run_jobs` while it waits.

        Two ends of a line that ask each other at once would else wait for each other: each has its lock until it is
        answered.

        Args:
            job: Must not wait.
            wake: Ends the wait of an owner, so that it looks.
        """
        mine = _Job(job)
        self._jobs.append(mine)
        while not mine.over:
            if self.owner not in (0, threading.get_ident()):
                wake()
            if self.begin(within=_LOOK):
                try:
                    self.run_jobs()
                finally:
                    self.end()
        if mine.error is not None:
            raise mine.error

    def run_jobs(self) -> None:
        """Run the jobs that wait for the lock, in their order, by its owner."""
        while self._jobs:
            job = self._jobs.popleft()
            try:
                job.run()
            except Exception as error:  # noqa: BLE001  # whoever wanted it gets it
                job.error = error
            finally:
                job.over = True

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
