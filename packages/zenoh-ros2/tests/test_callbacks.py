from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Iterator

import pytest

from zenoh_ros2.callbacks import Callbacks


@pytest.fixture
def callbacks() -> Iterator[Callbacks]:
    callbacks = Callbacks("test")
    yield callbacks
    callbacks.stop()


def test_items_are_handled_in_order_of_arrival_in_one_thread(callbacks: Callbacks) -> None:
    seen: list[tuple[str, bool]] = []
    done = threading.Event()
    first = callbacks.inbox(10, lambda item: seen.append((item, callbacks.is_current)))
    second = callbacks.inbox(
        10, lambda item: (seen.append((item, callbacks.is_current)), item == "d" and done.set())
    )
    for inbox, item in ((first, "a"), (second, "b"), (first, "c"), (second, "d")):
        assert inbox.put(item) is None
    callbacks.start()
    assert done.wait(30)
    assert seen == [("a", True), ("b", True), ("c", True), ("d", True)]


def test_a_full_inbox_drops_its_oldest(callbacks: Callbacks) -> None:
    seen: list[int] = []
    inbox = callbacks.inbox(2, seen.append)
    assert [inbox.put(number) for number in range(4)] == [None, None, 0, 1]
    assert inbox.dropped == 2
    done = threading.Event()
    callbacks.inbox(1, lambda item: done.set()).put(None)
    callbacks.start()
    assert done.wait(30)
    assert seen == [2, 3]


def test_a_callback_that_raises_is_logged_and_the_next_one_runs(
    callbacks: Callbacks, caplog: pytest.LogCaptureFixture
) -> None:
    done = threading.Event()

    def fail(item: str) -> None:
        raise RuntimeError("a fault in the program")

    callbacks.inbox(1, fail).put("x")
    callbacks.inbox(1, lambda item: done.set()).put("y")
    callbacks.start()
    assert done.wait(30)
    assert "a fault in the program" in caplog.text


def test_after_the_end_nothing_is_taken(callbacks: Callbacks) -> None:
    callbacks.start()
    callbacks.stop()
    assert callbacks.inbox(1, print).put("x") == "x"


def test_a_callback_may_end_its_own_thread(callbacks: Callbacks) -> None:
    done = threading.Event()
    callbacks.inbox(1, lambda item: (callbacks.stop(), done.set())).put("x")
    callbacks.start()
    assert done.wait(30)


@pytest.mark.parametrize("waits_already", [True, False])
def test_while_a_callback_hangs_another_thread_goes_on(callbacks: Callbacks, waits_already: bool) -> None:
    hangs, free, done = threading.Event(), threading.Event(), threading.Event()
    seen: list[object] = []

    def hang(item: str) -> None:
        with callbacks.may_hang():
            hangs.set()
            free.wait(30)
        seen.append(callbacks.is_current)

    others = callbacks.inbox(10, lambda item: (seen.append(item), item == "last" and done.set()))
    callbacks.inbox(1, hang).put("x")
    if waits_already:
        others.put("waits")
    callbacks.start()
    assert hangs.wait(30)
    others.put("stop")
    others.put("last")
    assert done.wait(30)
    assert seen == ["waits", "stop", "last"][not waits_already :]
    free.set()
    done.clear()
    others.put("last")
    assert done.wait(30)


def test_a_callback_that_hangs_for_a_moment_only_keeps_the_order(callbacks: Callbacks) -> None:
    seen: list[object] = []
    done = threading.Event()

    def handle(item: int) -> None:
        with callbacks.may_hang():
            seen.append((item, callbacks.is_current))
        if item == 499:
            done.set()

    inbox = callbacks.inbox(1000, handle)
    callbacks.start()
    for number in range(500):
        inbox.put(number)
    assert done.wait(30)
    assert seen == [(number, True) for number in range(500)]


@pytest.mark.system
def test_a_program_may_end_while_a_callback_hangs() -> None:
    program = """
import threading
from zenoh_ros2.callbacks import Callbacks

callbacks, hangs = Callbacks("test"), threading.Event()

def hang(item):
    hangs.set()
    threading.Event().wait()

callbacks.inbox(1, hang).put(None)
callbacks.start()
hangs.wait()
"""
    subprocess.run([sys.executable, "-c", program], check=True, timeout=30)


def test_other_threads_may_hang_without_relief(callbacks: Callbacks) -> None:
    callbacks.start()
    with callbacks.may_hang():
        assert not callbacks.is_current
