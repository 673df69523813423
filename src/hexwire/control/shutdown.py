"""When the node is to end, as signals tell it; and that it does end, whatever hangs.

Owns the handlers of the signals and the last resort. Must not know ROS, nor what is done at the end.
"""

from __future__ import annotations

import faulthandler
import math
import signal
import threading
from contextlib import suppress
from types import FrameType

__all__ = ["Ending"]

_LAST = 2
"""Whole seconds after the patience until the kernel ends what cannot even say where it hangs."""


class Ending:
    """Tells the threads of a program that it is to end.

    Args:
        patience: Seconds from there on in which it must have ended. Else it ends hard, with status 1, and says on
            standard error where each of its threads hung; or by SIGALRM where it cannot say that. A watchdog of the
            board stops the arm, which is more than a program does that nobody can end. Nothing takes this back.

    Attributes:
        asked: It is to end.
        interrupts: A signal raises KeyboardInterrupt as well: for work that may take long and can be left as it is.
    """

    def __init__(self, patience: float) -> None:
        self.asked = self.interrupts = False
        self._patience = patience
        # Not an Event: a handler runs in the middle of what it interrupts, which may be this very wait, and would
        # then wait for ever for a lock that its own thread holds. Nor a SimpleQueue, whose wait may never end if it
        # is interrupted when its time is up (CPython 3.11). Releasing a bare lock waits for nothing.
        self._asleep = threading.Lock()
        self._asleep.acquire()

    def listen(self) -> None:
        """Take the signals that end programs; the main thread only."""
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            # What `nohup` starts lives on. SIGINT is another matter: what a script starts behind it has it
            # ignored, and roslaunch ends its nodes by it all the same.
            if number is not signal.SIGHUP or signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, self._on_signal)

    def ask(self) -> None:
        """End, please; from any thread or signal handler."""
        if self.asked:
            return
        # Without a standard error nobody can say where it hangs, and one that takes no more hangs whoever says it:
        # then the kernel ends it, by SIGALRM.
        signal.alarm(math.ceil(self._patience) + _LAST)
        with suppress(RuntimeError, ValueError, OSError):
            faulthandler.dump_traceback_later(self._patience, exit=True)
        # Last: another signal in between must find all of this undone, and do it.
        self.asked = True
        # Somebody else may have asked in this very moment.
        with suppress(RuntimeError):
            self._asleep.release()

    def wait(self, seconds: float) -> bool:
        """Wait until it is asked for, for so long at most; returns whether it is. Any thread may."""
        if not self.asked and self._asleep.acquire(timeout=seconds):
            self._asleep.release()
        return self.asked

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        self.ask()
        if self.interrupts:
            raise KeyboardInterrupt
