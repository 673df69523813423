"""Waiting for the end of a thread, and an exclusive lock that fails instead of waiting.

Owns only the waiting.
"""

from __future__ import annotations

import threading
from collections.abc import Callable

from hexwire.errors import UsageError

__all__ = ["TryLock", "join_or_abort"]

_ABORTS = 20


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
