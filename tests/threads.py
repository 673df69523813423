"""Threads that a test has left behind."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Collection

from tests.waits import PATIENCE

__all__ = ["left_behind"]


def left_behind(
    before: Collection[threading.Thread], fine: Callable[[threading.Thread], bool] = lambda thread: False
) -> list[str]:
    """Names of threads that have begun since then and do not end.

    Args:
        before: Those that there were.
        fine: Whether another one may stay.
    """
    left = [t for t in threading.enumerate() if t not in before and not fine(t) and not _of_a_server(t)]
    deadline = time.monotonic() + PATIENCE
    # Not `join`: one that is just being started cannot be joined yet.
    while (stay := set(left).intersection(threading.enumerate())) and time.monotonic() < deadline:
        time.sleep(0.005)
    return [thread.name for thread in stay]


def _of_a_server(thread: threading.Thread) -> bool:
    """Whether it belongs to a server of a wider fixture: such threads begin with a job and end when idle."""
    module = sys.modules.get("hexwire.control.loop.workers")
    worker = getattr(getattr(thread, "_target", None), "__self__", None)
    return module is not None and isinstance(worker, module.Worker) and not worker._closed
