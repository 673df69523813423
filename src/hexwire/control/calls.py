"""What other threads want done by the one that owns something, and wait for.

Owns the queue, and that nobody waits in it for ever. Must not know what is done.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, wait
from typing import TYPE_CHECKING, Any, TypeVar

from hexwire.errors import DeviceError, LinkError, PreemptedError

if TYPE_CHECKING:
    from hexwire.epochs import Epochs

__all__ = ["Jobs", "of_now"]

_T = TypeVar("_T")


def of_now(job: Callable[[], _T], epochs: Epochs | None) -> Callable[[], _T]:
    """A job that is of this moment however long it waits: a stop that comes before it is done voids it.

    Args:
        job: What is to be done.
        epochs: The stops of the robot, if it has any.
    """
    if epochs is None:
        return job
    asked = epochs.mark()

    def dated() -> _T:
        with epochs.using(asked):
            return job()

    return dated


class Jobs:
    """Calls that wait for their owner.

    Args:
        timeout: Seconds that a caller waits for its turn, and then for the job itself.
    """

    def __init__(self, timeout: float = 10.0) -> None:
        self._timeout = timeout
        self._waiting: deque[tuple[Callable[[], Any], Future[Any]]] = deque()

    def call(self, job: Callable[[], _T]) -> _T:
        """Wait until the owner has done a job.

        Raises:
            DeviceError: It was not begun in time, and never will be; or it was not done in time.
            Exception: What the job raised, or what `fail` was given.
        """
        future: Future[_T] = Future()
        self._waiting.append((job, future))
        # Not `result(timeout)`, whose time-out cannot be told from one that the job raises.
        wait((future,), self._timeout)
        if future.cancel():
            raise DeviceError(f"the robot was busy for {self._timeout:g} s; nothing was done")
        # It is done, or being done this moment.
        wait((future,), self._timeout)
        if not future.done():
            raise DeviceError(f"the robot has not done it within {self._timeout:g} s")
        return future.result()

    def run(self) -> None:
        """Do all that waits; the owner calls this.

        Raises:
            LinkError: A job found the line lost, or a stop took it: the caller hears of it, and so does the owner.
            PreemptedError: Likewise.
        """
        while self._waiting:
            job, future = self._waiting.popleft()
            if not future.set_running_or_notify_cancel():
                continue
            try:
                result = job()
            except BaseException as error:
                future.set_exception(error)
                # What no job is meant to raise ends the owner, too; a fault of one job alone is its caller's.
                if isinstance(error, LinkError | PreemptedError) or not isinstance(error, Exception):
                    raise
            else:
                future.set_result(result)

    def fail(self, error: Exception) -> None:
        """Nothing that waits will be done."""
        while self._waiting:
            _, future = self._waiting.popleft()
            if future.set_running_or_notify_cancel():
                future.set_exception(error)
