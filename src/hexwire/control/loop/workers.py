"""Threads of a server that answer: one job after the other, and stops together.

Owns the queues and their bounds.
"""

from __future__ import annotations

import logging
import queue
import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import Generic, TypeVar

from hexwire.errors import UsageError
from hexwire.system import next_within

__all__ = ["MOST_GATHERED", "Gathering", "MergedCalls", "Worker"]

_log = logging.getLogger(__name__)

_T = TypeVar("_T")
_R = TypeVar("_R")

_MOST = 64
"""Jobs that may wait; more are refused."""
MOST_GATHERED = 1000
"""Items that may wait; they are handled together, so that more would only take memory."""


_IDLE = 1.0
"""Seconds without a job after which a thread ends."""


class Worker:
    """Runs jobs one after the other in a thread of its own, which begins with a job and ends when it is idle.

    Args:
        name: Of the thread.
        most: Jobs that may wait.
        lasting: The thread begins now and stays: a job that must be done does not need a new one.
    """

    def __init__(self, name: str, most: int = _MOST, *, lasting: bool = False) -> None:
        self._jobs: queue.SimpleQueue[Callable[[], object] | None] = queue.SimpleQueue()
        self._name, self._most, self._patience = name, most, None if lasting else _IDLE
        # A signal handler may come here while its thread is here.
        self._lock = threading.RLock()
        self._thread: threading.Thread | None = None
        self._closed = False
        if lasting:
            self._begin()

    def put(self, job: Callable[[], object]) -> bool:
        """Add a job; False if too many wait, after `close`, or if no thread can begin."""
        with self._lock:
            if self._closed or self._jobs.qsize() >= self._most:
                return False
            if self._thread is None:
                try:
                    self._begin()
                except RuntimeError:
                    _log.exception("no thread can begin")
                    return False
            self._jobs.put(job)
        return True

    def close(self, timeout: float) -> None:
        """End after the jobs that wait."""
        with self._lock:
            self._closed, thread = True, self._thread
        if thread is not None:
            self._jobs.put(None)
            if thread is not threading.current_thread():
                thread.join(timeout)

    def _begin(self) -> None:
        thread = threading.Thread(target=self._run, name=self._name, daemon=True)
        thread.start()
        self._thread = thread

    def _run(self) -> None:
        while True:
            try:
                job = next_within(self._jobs, self._patience)
            except queue.Empty:
                with self._lock:
                    if not self._jobs.empty():
                        continue
                    self._thread = None
                return
            if job is None:
                return
            try:
                job()
            except Exception:  # noqa: BLE001  # the next job must still be done
                _log.exception("an answer failed")


class Gathering(Generic[_T]):
    """Collects items and handles all of them at once in a thread of its own, so that one stop answers many.

    Args:
        name: Of the thread.
        act: Called with the collected items, oldest first.
        lasting: As for `Worker`.
    """

    def __init__(self, name: str, act: Callable[[list[_T]], object], *, lasting: bool = False) -> None:
        self._act = act
        self._waiting: list[_T] = []
        self._lock = threading.RLock()
        self._worker = Worker(name, lasting=lasting)

    def put(self, item: _T) -> bool:
        """Add an item; False if too many wait, after `close`, or if no thread can begin.

        If too many wait, the action still takes place, but this item gets no answer.
        """
        with self._lock:
            if len(self._waiting) >= MOST_GATHERED:
                return False
            self._waiting.append(item)
            # Those that wait already have a job, which takes this one, too.
            if len(self._waiting) == 1 and not self._worker.put(self._handle):
                self._waiting.clear()
                return False
        return True

    def close(self, timeout: float) -> None:
        """End after handling the items that wait."""
        self._worker.close(timeout)

    def _handle(self) -> None:
        with self._lock:
            items, self._waiting = self._waiting, []
        self._act(items)


class MergedCalls(Generic[_T, _R]):
    """Makes a call in a thread of its own, once for all who have asked for it before it begins.

    Args:
        name: Of the thread.
        call: What is asked for, such as a stop; gets what those said who asked, such as their names, each once. If
            it gets `MOST_GATHERED`, others may have said something else.
    """

    def __init__(self, name: str, call: Callable[[list[_T]], _R]) -> None:
        self._call = call
        self._lock = threading.Lock()
        self._next: _MergedCall[_T, _R] | None = None
        # What is asked for may be a stop.
        self._gathering: Gathering[_MergedCall[_T, _R]] = Gathering(name, self._answer, lasting=True)

    def ask(self, said: _T) -> Future[_R]:
        """Ask for the call; does not wait. The result, which all share, is that of a call which begins after this.

        After `close` it is a `UsageError`.
        """
        with self._lock:
            asked = self._next
            if asked is None:
                asked = _MergedCall[_T, _R]()
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

    def _answer(self, waiting: list[_MergedCall[_T, _R]]) -> None:
        with self._lock:
            self._next = None
        (asked,) = waiting
        try:
            value = self._call(list(asked.said))
        except BaseException as error:  # noqa: BLE001  # it is that of all who wait
            asked.future.set_exception(error)
        else:
            asked.future.set_result(value)


class _MergedCall(Generic[_T, _R]):
    """A call that has not begun: what was said by those who ask for it, and its result."""

    def __init__(self) -> None:
        self.said: dict[_T, None] = {}
        self.future: Future[_R] = Future()
