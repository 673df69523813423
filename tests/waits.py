"""How tests wait: for what they are about; in simulated time while another thread waits, not while it is slow."""

from __future__ import annotations

import gc
import sys
import threading
import time
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")
PATIENCE = 30.0
"""Seconds that a test waits at most: these machines stall."""
_WAIT = threading.Condition.wait.__code__
# A thread that hangs at a lock does not show it. Time passes for it too, but slowly.
_RARELY = 0.05


def eventually(what: Callable[[], T]) -> T:
    """The first true answer; fails if there is none for long."""
    return until(lambda: what() or None, "it happens")


def until(
    condition: Callable[[], T | None], what: str, explain: Callable[[], str] = str, patience: float = PATIENCE
) -> T:
    """Wait until something is neither None nor False; returns it.

    Args:
        condition: Asked again and again.
        what: What is waited for, in words.
        explain: What is known if that does not come.
        patience: Seconds.
    """
    deadline = time.monotonic() + patience
    while (found := condition()) is None or found is False:
        assert time.monotonic() < deadline, f"waited in vain until {what}\n{explain()}"
        time.sleep(0.02)
    return found


def waits(thread: threading.Thread) -> bool:
    """Whether a thread waits for an event, a condition or a future that has not come."""
    # Python 3.11 holds a lock meanwhile that what the collector frees may want, too: it would wait for itself.
    gc.disable()
    try:
        frame = sys._current_frames().get(thread.ident or 0)
    finally:
        gc.enable()
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
