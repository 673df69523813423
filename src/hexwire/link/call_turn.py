"""A turn that one call takes at a time, such as the reading side of a link.

Owns the lock, and the rule by which no exception from a signal handler leaves it taken. Must not know links.

A handler may raise at almost any step of a call, as Ctrl-C does. The interpreter runs handlers, and lets other
threads run, only at calls, at the start of a function and at jumps back. Neither happens between a look at `taken`
and the `with` after it, nor while `with` takes a free lock. So a call is written like this::

    if turn.taken:
        return turn.later(timeout, call)
    with turn.lock:
        turn.taken = True
        try:
            return call()
        finally:
            turn.taken = False
"""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["CallTurn"]

_T = TypeVar("_T")


class CallTurn:
    """The turn of one call at a time. A call that a signal handler makes inside another one has the turn as well.

    Attributes:
        lock: Held by the call. Re-entrant.
        taken: Whether a call has the turn.
    """

    __slots__ = ("_condition", "lock", "taken")

    def __init__(self) -> None:
        self.lock = threading.RLock()
        self.taken = False
        self._condition = threading.Condition(self.lock)

    def is_mine(self) -> bool:
        """Whether a call of this thread has the turn: in a signal handler, the call that it interrupts."""
        try:
            self._condition.notify(0)
        except RuntimeError:
            return False
        return True

    def later(self, timeout: float, call: Callable[[], _T]) -> _T | None:
        """Wait for the turn, then make a call; None if the turn was not free within `timeout` seconds.

        Args:
            timeout: Seconds, -1.0 for no limit.
            call: The call; it must not return None.
        """
        got = False
        try:
            # Unpacking calls `acquire`, and no handler runs before the result is stored.
            (got,) = map(self.lock.acquire, (True,), (timeout,))
            if not got:
                return None
            outer, self.taken = self.taken, True
            try:
                return call()
            finally:
                self.taken = outer
        finally:
            if got:
                self.lock.release()
