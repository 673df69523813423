"""How long a call holds the interpreter while another thread waits for it."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable

__all__ = ["longest_hold"]

_SWITCH = 0.00002


def longest_hold(call: Callable[[], object]) -> float:
    """Seconds of processor time that a call took at a stretch, in another thread than this one, which waited.

    On a busy machine it is a little more than the call held the interpreter, never less.
    """
    clock, done = list[int](), threading.Event()
    begun = threading.Event()

    def run() -> None:
        clock.append(time.pthread_getcpuclockid(threading.get_ident()))
        begun.set()
        call()
        found.append(time.thread_time())
        done.set()
        ended.wait()

    found, ended = list[float](), threading.Event()
    before = sys.getswitchinterval()
    sys.setswitchinterval(_SWITCH)
    thread = threading.Thread(target=run)
    try:
        thread.start()
        begun.wait()
        last, longest = time.clock_gettime(clock[0]), 0.0
        while not done.is_set():
            now = time.clock_gettime(clock[0])
            last, longest = now, max(longest, now - last)
            time.sleep(0.0001)
        return max(longest, found[0] - last) if found else longest
    finally:
        ended.set()
        thread.join()
        sys.setswitchinterval(before)
