"""Threads of a server that answer: one job after the other, and stops together.

Owns the queues and their bounds. Must not know what is asked.
"""

from __future__ import annotations

import logging
import queue
import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import Generic, TypeVar

from hexwire.errors import UsageError

__all__ = ["MOST_GATHERED", "Gathering", "Together", "Worker"]

_log = logging.getLogger(__name__)

_T = TypeVar("_T")
_R = TypeVar("_R")

_MOST = 64
"""Jobs that may wait; more are refused."""
MOST_GATHERED = 1000
"""Items that may wait; they are handled together, so that more would only take memory."""


class Worker:
    """Runs jobs one after the other in a thread of its own.

    Args:
        name: Of the thread.
        most: Jobs that may wait.
    """

    def __init__(self, name: str, most: int = _MOST) -> None:
        self._jobs: queue.SimpleQueue[Callable[[], object] | None] = queue.SimpleQueue()
        self._most = most
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def put(self, job: Callable[[], object]) -> bool:
        """Add a job; False if too many wait."""
        if self._jobs.qsize() >= self._most:
            return False
        self._jobs.put(job)
        return True

    def close(self, timeout: float) -> None:
        """End after the jobs that wait."""
        self._jobs.put(None)
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
        """Add an item; False if too many wait, or after `close`.

        If too many wait, the action still takes place, but this item gets no answer.
        """
        with self._changed:
            if self._closed or len(self._waiting) >= MOST_GATHERED:
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


class Together(Generic[_T, _R]):
    """Makes a call in a thread of its own, once for all who have asked for it before it begins.

    Args:
        name: Of the thread.
        call: What is asked for, such as a stop; gets what those said who asked, such as their names, each once. If
            it gets `MOST_GATHERED`, others may have said something else.
    """

    def __init__(self, name: str, call: Callable[[list[_T]], _R]) -> None:
        self._call = call
        self._lock = threading.Lock()
        self._next: _Asked[_T, _R] | None = None
        self._gathering: Gathering[_Asked[_T, _R]] = Gathering(name, self._answer)

    def ask(self, said: _T) -> Future[_R]:
        """Ask for the call; does not wait. The result, which all share, is that of a call which begins after this.

        After `close` it is a `UsageError`.
        """
        with self._lock:
            asked = self._next
            if asked is None:
                asked = _Asked[_T, _R]()
                # Nobody who loses interest cancels it for the others.
                asked.future.set_running_or_notify_cancel()
                if not self._gathering.put(asked):
                    asked.future.set_exception(UsageError("this is not done: the program ends"))
                    return asked.future
                self._next = asked
            if len(asked.said) < MOST_GATHERED:
                asked.said[said] = None
            return asked.future

    def close(self, timeout: float) -> None:
        """End after answering those who wait."""
        self._gathering.close(timeout)

    def _answer(self, waiting: list[_Asked[_T, _R]]) -> None:
        with self._lock:
            self._next = None
        (asked,) = waiting
        try:
            value = self._call(list(asked.said))
        except BaseException as error:  # noqa: BLE001  # it is that of all who wait
            asked.future.set_exception(error)
        else:
            asked.future.set_result(value)


class _Asked(Generic[_T, _R]):
    """A call that has not begun: what was said by those who ask for it, and its result."""

    def __init__(self) -> None:
        self.said: dict[_T, None] = {}
        self.future: Future[_R] = Future()
