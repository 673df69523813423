"""A turn that one call takes at a time, such as the reading side of a link.

Owns the lock, and the rule by which no exception from a signal handler leaves it taken. Must not know links.

A handler may raise at almost any step of a call, as Ctrl-C does. The interpreter runs handlers, and lets other
threads run, only at calls, at the start of a function and at jumps back. Neither happens between a look at `taken`
and the next line. So a call is written like this::

    if turn.taken:
        return turn.later(timeout, call)
    turn.taken = 1
    try:
        turn.lock.acquire()
        return call()
    finally:
        turn.taken -= 1
        turn.lock.release()

The lock is free while `taken` is 0, so `acquire` does not wait, and a handler comes before the first line or after
`acquire`. The lock alone keeps other calls out. `with` would do the same, at four times the cost.
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
        taken: Number of calls that have the turn or wait for it.
    """

    __slots__ = ("_condition", "lock", "taken")

    def __init__(self) -> None:
        self.lock = threading.RLock()
        self.taken = 0
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
        # Counted while it waits: after the holder's release it may have the lock, but not run yet.
        self.taken += 1
        got = False
        try:
            # Unpacking calls `acquire`, and no handler runs before the result is stored.
            (got,) = map(self.lock.acquire, (True,), (timeout,))
            if not got:
                return None
            return call()
        finally:
            self.taken -= 1
            if got:
                self.lock.release()
