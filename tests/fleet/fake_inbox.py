"""An inbox of states without a network."""

from __future__ import annotations

import queue
import threading

__all__ = ["PATIENCE", "FakeInbox"]

PATIENCE = 30.0


class FakeInbox:
    """An inbox that the test fills with payloads, or with an exception that a signal handler raises."""

    def __init__(self) -> None:
        self.rows = queue.Queue[bytes | BaseException]()
        self.waiting = threading.Semaphore(0)
        self.receivers: set[int] = set()

    def wait(self) -> bytes:
        self.receivers.add(threading.get_ident())
        self.waiting.release()
        return self._value(self.rows.get(timeout=PATIENCE))

    def poll(self) -> bytes | None:
        try:
            return self._value(self.rows.get_nowait())
        except queue.Empty:
            return None

    def wake(self) -> None:
        self.rows.put(b"")

    @staticmethod
    def _value(row: bytes | BaseException) -> bytes:
        if isinstance(row, BaseException):
            raise row
        return row
