"""Converts a deadline to the timeouts of the system's blocking calls.

Owns their units and bounds. Deadlines are values of `time.monotonic`; None waits forever.
"""

from __future__ import annotations

import threading
from time import monotonic

__all__ = ["LONGEST_POLL", "lock_timeout", "poll_timeout"]

# poll() takes milliseconds as a C int; longer waits are split into parts of this many seconds.
LONGEST_POLL = 1_000_000.0


def poll_timeout(deadline: float | None) -> float | None:
    """For `poll`: milliseconds. `poll` rounds them up, so that nothing returns early."""
    return None if deadline is None else max(0.0, min(deadline - monotonic(), LONGEST_POLL)) * 1000.0


def lock_timeout(deadline: float | None) -> float:
    """For `Lock.acquire`: seconds, -1 for no limit."""
    return -1.0 if deadline is None else max(0.0, min(deadline - monotonic(), threading.TIMEOUT_MAX))
