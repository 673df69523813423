"""Waiting: for the end of goals, for the end of a thread, and an exclusive lock that fails instead of waiting.

Owns only the waiting.
"""

from __future__ import annotations

import threading
from collections.abc import Callable

from hexwire.errors import UsageError

from .outcomes import Ended, Outcome

__all__ = ["TryLock", "Waiter", "join_or_abort"]

_ABORTS = 20


class Waiter:
    """A listener with which a thread waits for goals.

    Args:
        count: Number of goals.

    Attributes:
        end: End of the first goal that failed, or of the last goal; None while they are active.
        off: How far off their goals those have come to rest that succeeded, in words; empty for exactly there.
    """

    def __init__(self, count: int = 1) -> None:
        self.end: Ended | None = None
        self.off: tuple[str, ...] = ()
        self._missing = count
        self._lock = threading.Lock()
        self._over = threading.Event()

    def ended(self, ended: Ended) -> None:
        """Take the end of a goal."""
        with self._lock:
            self._missing -= 1
            if ended.outcome is Outcome.SUCCEEDED and ended.text:
                self.off += (ended.text,)
            if self.end is None and (ended.outcome is not Outcome.SUCCEEDED or self._missing == 0):
                self.end = ended
                self._over.set()

    def is_over(self) -> bool:
        """Whether all goals have ended, or one has failed."""
        return self.end is not None

    def wait(self, timeout: float) -> Ended:
        """Wait for the end of all goals, or of the first that fails.

        Raises:
            UsageError: A goal did not succeed in time; the text says why.
        """
        self._over.wait(timeout)
        end = self.end
        if end is None:
            raise UsageError(f"not arrived after {timeout:.0f} s; the arm holds")
        if end.outcome is not Outcome.SUCCEEDED:
            raise UsageError(end.text or end.outcome.value)
        return end


class TryLock:
    """Holds a lock; refuses if another thread holds it."""

    def __init__(self, lock: threading.Lock) -> None:
        self._lock = lock

    def __enter__(self) -> None:
        if not self._lock.acquire(blocking=False):
            raise UsageError("the arm is busy with another request; wait, or stop it")

    def __exit__(self, *_: object) -> None:
        self._lock.release()


def join_or_abort(thread: threading.Thread, patience: float, abort: Callable[[], object], more: float) -> bool:
    """Wait for a thread to end; if it does not, abort its blocking operation.

    Args:
        thread: The thread.
        patience: Seconds to wait first.
        abort: Aborts the operation. Called repeatedly, since the thread may be about to start another one.
        more: Seconds to wait while aborting.

    Returns:
        Whether the thread has ended.
    """
    thread.join(patience)
    for _ in range(_ABORTS):
        if not thread.is_alive():
            return True
        abort()
        thread.join(more / _ABORTS)
    return not thread.is_alive()
