from __future__ import annotations

import threading

import pytest

from hexwire.control.loop.owner import join_or_abort


@pytest.mark.parametrize("calls", [1, 3])
def test_a_thread_that_waits_again_is_hung_up_on_again(calls: int) -> None:
    bell = threading.Semaphore(0)
    thread = threading.Thread(target=lambda: [bell.acquire() for _ in range(calls)], daemon=True)
    thread.start()
    assert join_or_abort(thread, 0.0, bell.release, 10.0)
    assert not thread.is_alive()


def test_a_thread_that_never_ends_is_given_up() -> None:
    free = threading.Event()
    thread = threading.Thread(target=free.wait, args=(60,), daemon=True)
    thread.start()
    hung_up: list[bool] = []
    assert not join_or_abort(thread, 0.0, lambda: hung_up.append(True), 0.0)
    assert len(hung_up) > 1
    free.set()
    assert join_or_abort(thread, 30.0, lambda: None, 0.0)
