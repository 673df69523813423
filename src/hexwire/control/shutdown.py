"""The shutdown of a program: signals request it, and a program that hangs is ended hard.

Owns the signal handlers and the last resort. Must not know what is done at a shutdown.
"""

from __future__ import annotations

import faulthandler
import math
import signal
import threading
from contextlib import suppress
from types import FrameType

__all__ = ["Shutdown"]

_LAST = 2
"""Whole seconds after the patience until the kernel ends what cannot even say where it hangs."""


class Shutdown:
    """Tells the threads of a program that it is to shut down.

    Args:
        patience: Seconds from the request in which the program must end by itself. After them it is ended with
            status 1, and standard error says where each thread hangs; if even that hangs, SIGALRM ends it. The
            board's watchdog then stops the arm. A request cannot be withdrawn.

    Attributes:
        requested: The program is to shut down.
        interrupts: A signal raises KeyboardInterrupt as well: for work that takes long and may be broken off.
    """

    def __init__(self, patience: float) -> None:
        self.requested = self.interrupts = False
        self._patience = patience
        # Not an Event: a handler runs in the middle of what it interrupts, which may be this very wait, and would
        # then wait for ever for a lock that its own thread holds. Nor a SimpleQueue, whose wait may never end if it
        # is interrupted when its time is up (CPython 3.11). Releasing a bare lock waits for nothing.
        self._asleep = threading.Lock()
        self._asleep.acquire()

    def listen(self) -> None:
        """Handle the signals that end programs; the main thread only."""
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            # A program that `nohup` started must live on. An ignored SIGINT is handled all the same: scripts start
            # background programs that way, and launchers end them by it.
            if number is not signal.SIGHUP or signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, self._on_signal)

    def request(self) -> None:
        """Request the shutdown; any thread or signal handler may."""
        if self.requested:
            return
        # Without a standard error nobody can say where it hangs, and one that takes no more hangs whoever says it:
        # then the kernel ends it, by SIGALRM.
        signal.alarm(math.ceil(self._patience) + _LAST)
        with suppress(RuntimeError, ValueError, OSError):
            faulthandler.dump_traceback_later(self._patience, exit=True)
        # Last: another signal in between must find all of this undone, and do it.
        self.requested = True
        # Somebody else may have requested it in this very moment.
        with suppress(RuntimeError):
            self._asleep.release()

    def wait(self, seconds: float) -> bool:
        """Wait for the request, so many seconds at most; returns whether it has come. Any thread may."""
        if not self.requested and self._asleep.acquire(timeout=seconds):
            self._asleep.release()
        return self.requested

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        self.request()
        if self.interrupts:
            raise KeyboardInterrupt
