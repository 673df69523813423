"""The shutdown of a program: signals request it, and a program that hangs is killed.

Owns the signal handlers and the time limit.
"""

from __future__ import annotations

import faulthandler
import math
import signal
import threading
from contextlib import suppress
from types import FrameType

from hexwire.system import END_SIGNALS, end_by_alarm

__all__ = ["Shutdown"]

_LAST = 2
"""Whole seconds after the patience until SIGALRM ends a program that cannot even print its traceback."""


class Shutdown:
    """Asks the threads of a program to shut down.

    Args:
        patience: Seconds from the request in which the program must end. After them it exits with status 1, and the
            traceback of each thread goes to standard error; if even that blocks, SIGALRM ends it. The board's
            watchdog then stops the arm. A request cannot be withdrawn.

    Attributes:
        requested: A shutdown was requested.
        interrupts: A signal also raises KeyboardInterrupt: for long work that may be interrupted.
    """

    def __init__(self, patience: float) -> None:
        self.requested = self.interrupts = False
        self._patience = patience
        # Not an Event: a signal handler may interrupt its wait, and would deadlock on a lock that its own thread
        # holds. Nor a SimpleQueue, whose wait may never end if it is interrupted at its timeout (CPython 3.11).
        # Releasing a bare lock never blocks.
        self._asleep = threading.Lock()
        self._asleep.acquire()

    def listen(self) -> None:
        """Handle the signals that end programs; the main thread only."""
        for number in (signal.SIGINT, *END_SIGNALS):
            # A program started by `nohup` must continue. An ignored SIGINT is handled nevertheless: scripts start
            # background programs with it ignored, and launchers send it to end them.
            if number.name != "SIGHUP" or signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, self._on_signal)

    def request(self) -> None:
        """Request the shutdown, from any thread or signal handler."""
        if self.requested:
            return
        # If standard error is closed or blocked, the traceback cannot be printed: then SIGALRM ends the program.
        end_by_alarm(math.ceil(self._patience) + _LAST)
        with suppress(RuntimeError, ValueError, OSError):
            faulthandler.dump_traceback_later(self._patience, exit=True)
        # Last, so that another signal before this line repeats all of it.
        self.requested = True
        # Another thread may have released the lock at the same time.
        with suppress(RuntimeError):
            self._asleep.release()

    def wait(self, seconds: float) -> bool:
        """Wait for the request, at most so many seconds, in any thread; returns whether it was made."""
        if not self.requested and self._asleep.acquire(timeout=seconds):
            self._asleep.release()
        return self.requested

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        self.request()
        if self.interrupts:
            raise KeyboardInterrupt
