"""Whether another thread waits: benches in simulated time let time pass only then, not while it is slow."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable

_WAIT = threading.Condition.wait.__code__
# A thread that hangs at a lock does not show it. Time passes for it too, but slowly.
_RARELY = 0.05


def waits(thread: threading.Thread) -> bool:
    """Whether a thread waits for an event, a condition or a future that has not come."""
    frame = sys._current_frames().get(thread.ident or 0)
    if frame is None or frame.f_code is not _WAIT:
        return False
    waiter = frame.f_locals.get("waiter")
    return waiter is not None and waiter.locked()


def turn_while_it_waits(thread: threading.Thread, turn: Callable[[], object]) -> None:
    """Let time pass until a thread ends, but hardly any while the machine keeps it from running."""
    rarely = time.monotonic() + _RARELY
    while thread.is_alive():
        if waits(thread) or time.monotonic() >= rarely:
            turn()
            rarely = time.monotonic() + _RARELY
        thread.join(0.0005)
