"""How long something holds the interpreter at a time, so that no other thread can go on."""

from __future__ import annotations

import contextlib
import os
import threading
import time
from types import TracebackType
from typing import Self

__all__ = ["Held"]

_PERIOD = 0.0003


class Held:
    """A thread that wants to go on every 0.3 ms, and sees how long it cannot.

    A machine that is busy keeps it waiting too, and a system call keeps nobody: so a wait counts only as far as the
    process has computed meanwhile.

    Attributes:
        longest: Seconds.
    """

    def __init__(self) -> None:
        self.longest = 0.0
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, name="held", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._over.set()
        self._thread.join()

    def _run(self) -> None:
        # It is about the interpreter: this thread waits for no processor where it may say so.
        with contextlib.suppress(PermissionError):
            os.sched_setscheduler(threading.get_native_id(), os.SCHED_FIFO, os.sched_param(1))
        while not self._over.is_set():
            began, computed = time.monotonic(), time.process_time()
            time.sleep(_PERIOD)
            late = min(time.monotonic() - began - _PERIOD, time.process_time() - computed)
            self.longest = max(self.longest, late)
