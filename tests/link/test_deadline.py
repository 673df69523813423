from __future__ import annotations

import math
import os
import select
import threading
import time

from hexwire.link.base import LONGEST_POLL, lock_timeout, poll_timeout


def test_no_deadline_is_no_end() -> None:
    assert poll_timeout(None) is None
    assert lock_timeout(None) == -1.0


def test_what_is_past_does_not_wait() -> None:
    for past in (0.0, time.monotonic() - 1.0, -math.inf):
        assert poll_timeout(past) == 0.0
        assert lock_timeout(past) == 0.0


def test_what_is_to_come_has_the_right_unit() -> None:
    wait = poll_timeout(time.monotonic() + 500.0)
    assert wait is not None
    assert 400_000.0 < wait <= 500_000.0
    assert 400.0 < lock_timeout(time.monotonic() + 500.0) <= 500.0


def test_what_is_far_away_is_within_what_the_system_takes() -> None:
    for far in (math.inf, time.monotonic() + 1e15):
        assert poll_timeout(far) == LONGEST_POLL * 1000.0
        assert lock_timeout(far) == threading.TIMEOUT_MAX
    read_end, write_end = os.pipe()
    poll = select.poll()
    poll.register(write_end, select.POLLOUT)
    assert poll.poll(poll_timeout(math.inf)), "taken, and ended by the event"
    os.close(read_end)
    os.close(write_end)
    lock = threading.Lock()
    assert lock.acquire(timeout=lock_timeout(math.inf))
