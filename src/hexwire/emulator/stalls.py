"""When this program did not get to run, so that an arm emulated inside it could not run either.

Owns the thread that notices: one for all such arms, while one of them is open. It sleeps and looks at the clock, so
that a program that only sleeps is no stall, but a computer that is too slow is one, and so is a program that is
suspended or holds the interpreter's lock. Must not know arms.
"""

from __future__ import annotations

import threading
import time
import weakref
from collections import deque

__all__ = ["STALLS", "Stalls"]

_PERIOD = 0.05
"""Seconds between two looks at the clock."""
_LATE = 0.1
"""Seconds by which a look must be late to be a stall: less than any watchdog waits."""
_MOST = 256


class Stalls:
    """Begin and end of stalls, as far as somebody wants to know."""

    def __init__(self) -> None:
        self._users: weakref.WeakSet[object] = weakref.WeakSet()
        self._looked = 0.0
        self._found: deque[tuple[float, float]] = deque(maxlen=_MOST)
        self._thread: threading.Thread | None = None
        # Notified when nobody wants to know any more; guards all of the above.
        self._changed = threading.Condition()

    def open(self, user: object) -> None:
        """Look from now on, as long as this object exists, or until `close`."""
        with self._changed:
            self._users.add(user)
            # A process that was forked has this object, but not the thread.
            if self._thread is None or not self._thread.is_alive():
                self._looked = time.monotonic()
                self._thread = threading.Thread(target=self._run, name="hexwire-stalls", daemon=True)
                self._thread.start()

    def close(self, user: object) -> None:
        """This one does not want to know any more."""
        with self._changed:
            self._users.discard(user)
            self._changed.notify_all()

    def seconds(self, since: float) -> float:
        """Seconds of stalls from a time on.

        Args:
            since: On the monotonic clock.
        """
        with self._changed:
            # One may have ended right now.
            self._look()
            return sum(end - max(begin, since) for begin, end in self._found if end > since)

    def _look(self) -> None:
        now = time.monotonic()
        begin = self._looked + _PERIOD
        if self._thread is not None and now - begin > _LATE:
            self._found.append((begin, now))
        self._looked = now

    def _run(self) -> None:
        with self._changed:
            while self._users:
                self._look()
                self._changed.wait(_PERIOD)
            self._thread = None


STALLS = Stalls()
"""Those of this program."""
