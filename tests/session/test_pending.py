"""A request that waits: its attempts and their windows."""

from __future__ import annotations

from hexwire.session.connection import Pending


def test_each_attempt_has_its_window() -> None:
    pending = Pending(ticket=1, cmd=0x11, body=b"", seq=4, window=0.2, attempts=3)
    assert (pending.sent, pending.deadline) == (0, 0.0)
    pending.begin_attempt(10.0)
    assert (pending.sent, pending.sent_at, pending.deadline) == (1, 10.0, 10.0 + 0.2)
    pending.begin_attempt(10.2)
    assert (pending.sent, pending.sent_at, pending.deadline) == (2, 10.2, 10.2 + 0.2)


def test_a_busy_peer_gets_more_time_but_no_attempt() -> None:
    pending = Pending(ticket=1, cmd=0x11, body=b"", seq=4, window=0.2, attempts=3)
    pending.begin_attempt(10.0)
    pending.extend(10.1)
    assert (pending.sent, pending.sent_at) == (1, 10.0)
    assert abs(pending.deadline - 10.3) < 1e-9
