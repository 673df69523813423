"""Threads of a server that answer: one job after the other, and stops together.

Owns the queues and their bounds. Must not know what is asked.
"""

from __future__ import annotations

import contextlib
import logging
import queue
import threading
from collections.abc import Callable
from typing import Generic, TypeVar

__all__ = ["Gathering", "Worker"]

_log = logging.getLogger(__name__)

_T = TypeVar("_T")

_MOST = 64
"""Jobs that may wait; more are refused."""
_MOST_GATHERED = 1000


class Worker:
    """Runs jobs one after the other in a thread of its own.

    Args:
        name: Of the thread.
        most: Jobs that may wait.
    """

    def __init__(self, name: str, most: int = _MOST) -> None:
        self._jobs: queue.Queue[Callable[[], object] | None] = queue.Queue(most)
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def put(self, job: Callable[[], object]) -> bool:
        """Add a job; False if too many wait."""
        try:
            self._jobs.put_nowait(job)
        except queue.Full:
            return False
        return True

    def close(self, timeout: float) -> None:
        """End after the jobs that wait."""
        with contextlib.suppress(queue.Full):
            self._jobs.put(None, timeout=timeout)
            self._thread.join(timeout)

    def _run(self) -> None:
        while (job := self._jobs.get()) is not None:
            try:
                job()
            except Exception:  # noqa: BLE001  # the next job must still be done
                _log.exception("an answer failed")


class Gathering(Generic[_T]):
    """Collects items and handles all of them at once in a thread of its own, so that one stop answers many.

    Args:
        name: Of the thread.
        act: Called with the collected items, oldest first.
    """

    def __init__(self, name: str, act: Callable[[list[_T]], object]) -> None:
        self._act = act
        self._waiting: list[_T] = []
        self._changed = threading.Condition()
        self._closed = False
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def put(self, item: _T) -> bool:
        """Add an item; False if too many wait. The action still takes place, but this item gets no answer."""
        with self._changed:
            if len(self._waiting) >= _MOST_GATHERED:
                return False
            self._waiting.append(item)
            self._changed.notify()
        return True

    def close(self, timeout: float) -> None:
        """End after handling the items that wait."""
        with self._changed:
            self._closed = True
            self._changed.notify()
        self._thread.join(timeout)

    def _run(self) -> None:
        while True:
            with self._changed:
                while not self._waiting and not self._closed:
                    self._changed.wait()
                items, self._waiting = self._waiting, []
            if not items:
                return
            try:
                self._act(items)
            except Exception:  # noqa: BLE001  # the next stop must still be sent
                _log.exception("an answer failed")
