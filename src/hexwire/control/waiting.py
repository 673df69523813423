"""How a thread waits: for goals, for another thread's end, and how only one at a time takes the arm for longer.

Owns nothing but the waiting. Must not know what is waited for, nor who ends it.
"""

from __future__ import annotations

import threading
from collections.abc import Callable

from hexwire.errors import UsageError

from .outcomes import Ended, Outcome

__all__ = ["Alone", "Waiter", "join_or_hang_up"]

_HANG_UPS = 20


class Waiter:
    """Goals that a thread waits for, instead of being told.

    Args:
        count: Controllers that have it for a goal.

    Attributes:
        end: Of the first that failed, or of the last; None while they are under way.
    """

    def __init__(self, count: int = 1) -> None:
        self.end: Ended | None = None
        self._missing = count
        self._lock = threading.Lock()
        self._over = threading.Event()

    def ended(self, ended: Ended) -> None:
        """One is over."""
        with self._lock:
            self._missing -= 1
            if self.end is None and (ended.outcome is not Outcome.SUCCEEDED or self._missing == 0):
                self.end = ended
                self._over.set()

    def is_over(self) -> bool:
        """All are over, or one that failed."""
        return self.end is not None

    def wait(self, timeout: float) -> Ended:
        """The end of all, or of the first that fails.

        Raises:
            UsageError: One did not succeed, or not in time; the text says why.
        """
        self._over.wait(timeout)
        end = self.end
        if end is None:
            raise UsageError(f"not there after {timeout:.0f} s; the arm holds")
        if end.outcome is not Outcome.SUCCEEDED:
            raise UsageError(end.text or end.outcome.value)
        return end


class Alone:
    """Nobody else takes the arm meanwhile; whoever tries is told."""

    def __init__(self, lock: threading.Lock) -> None:
        self._lock = lock

    def __enter__(self) -> None:
        if not self._lock.acquire(blocking=False):
            raise UsageError("the arm is on its way for somebody else; wait, or stop it")

    def __exit__(self, *_: object) -> None:
        self._lock.release()


def join_or_hang_up(thread: threading.Thread, patience: float, hang_up: Callable[[], object], more: float) -> bool:
    """Wait for a thread to end; take from it what it waits for, if it does not.

    Args:
        thread: Which.
        patience: Seconds to wait at first.
        hang_up: Ends what it waits for. Called again and again, since it may be about to begin once more.
        more: Seconds to go on for with that.

    Returns:
        Whether it has ended.
    """
    thread.join(patience)
    for _ in range(_HANG_UPS):
        if not thread.is_alive():
            return True
        hang_up()
        thread.join(more / _HANG_UPS)
    return not thread.is_alive()
