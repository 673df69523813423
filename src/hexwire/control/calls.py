"""Calls queued for the thread that owns the robot.

Owns the queue and its time limits, so that no caller waits forever. Must not know what the calls do.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, wait
from typing import TYPE_CHECKING, Any, TypeVar

from hexwire.errors import DeviceError, LinkError, PreemptedError

if TYPE_CHECKING:
    from hexwire.epochs import Epochs

__all__ = ["QueuedCalls", "voided_by_stop"]

_T = TypeVar("_T")


def voided_by_stop(call: Callable[[], _T], epochs: Epochs | None) -> Callable[[], _T]:
    """Wrap a call so that a stop between now and its execution voids it.

    Args:
        call: The call.
        epochs: The stops of the robot, if it has any.
    """
    if epochs is None:
        return call
    # Perhaps part of an earlier call, such as an order that arrived before the stop.
    asked = epochs.of_this_call or epochs.mark()

    def dated() -> _T:
        with epochs.using(asked):
            return call()

    return dated


class QueuedCalls:
    """Calls from other threads that wait for the owner.

    Args:
        timeout: Seconds that a caller waits until its call begins, and then until it ends.
    """

    def __init__(self, timeout: float = 10.0) -> None:
        self._timeout = timeout
        self._waiting: deque[tuple[Callable[[], Any], Future[Any]]] = deque()

    def call(self, call: Callable[[], _T]) -> _T:
        """Queue a call and wait for its result.

        Raises:
            DeviceError: It did not begin in time and was dropped; or it did not end in time.
            Exception: What the call raised, or the error passed to `fail`.
        """
        future: Future[_T] = Future()
        self._waiting.append((call, future))
        # Not `result(timeout)`, whose timeout looks like one raised by the call.
        wait((future,), self._timeout)
        if future.cancel():
            raise DeviceError(f"the robot was busy for {self._timeout:g} s; nothing was done")
        # It is running or done.
        wait((future,), self._timeout)
        if not future.done():
            raise DeviceError(f"the robot has not finished within {self._timeout:g} s")
        return future.result()

    def run(self) -> None:
        """Run all queued calls, in the owner's thread.

        Raises:
            LinkError: A call found the line lost; both its caller and the owner get the error.
            PreemptedError: A stop interrupted a call; likewise.
        """
        while self._waiting:
            call, future = self._waiting.popleft()
            if not future.set_running_or_notify_cancel():
                continue
            try:
                result = call()
            except BaseException as error:
                future.set_exception(error)
                # A lost line concerns the owner too, and so does an error that is not an Exception.
                if isinstance(error, LinkError | PreemptedError) or not isinstance(error, Exception):
                    raise
            else:
                future.set_result(result)

    def fail(self, error: Exception) -> None:
        """Raise an error in all queued callers; none of their calls runs."""
        while self._waiting:
            _, future = self._waiting.popleft()
            if future.set_running_or_notify_cancel():
                future.set_exception(error)
