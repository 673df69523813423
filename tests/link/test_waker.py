from __future__ import annotations

import os
import select
import subprocess
import sys
import threading
from collections.abc import Callable
from typing import Any

import pytest

from hexwire.link import waker as waker_module
from hexwire.link.waker import Waker


def is_set(waker: Waker) -> bool:
    return bool(select.select([waker.fileno()], [], [], 0.0)[0])


@pytest.mark.parametrize("platform", [sys.platform, "darwin"])
def test_set_and_clear(platform: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(waker_module.sys, "platform", platform)
    waker = Waker()
    waker.open()
    waker.open()
    try:
        assert not is_set(waker)
        waker.clear()
        waker.set()
        waker.set()
        assert is_set(waker)
        waker.clear()
        assert not is_set(waker)
        for _ in range(100_000):  # more than a pipe holds
            waker.set()
        assert is_set(waker)
    finally:
        waker.close()


def test_between_close_and_open_it_touches_no_descriptor() -> None:
    waker = Waker()
    waker.set()
    waker.open()
    fd = waker.fileno()
    waker.close()
    waker.close()
    stranger = os.open("/dev/null", os.O_RDWR)
    assert stranger == fd, "the number is taken again"
    os.close(stranger)
    read_end, write_end = os.pipe()
    try:
        waker.set()
        waker.clear()
        assert not select.select([read_end], [], [], 0.0)[0]
    finally:
        os.close(read_end)
        os.close(write_end)


def test_it_ends_a_poll_of_another_thread() -> None:
    waker = Waker()
    waker.open()
    poll = select.poll()
    poll.register(waker.fileno(), select.POLLIN)
    thread = threading.Thread(target=lambda: poll.poll(None))
    thread.start()
    waker.set()
    thread.join(30)
    assert not thread.is_alive()
    waker.close()


def test_a_signal_handler_may_set_it_at_any_moment() -> None:
    code = """
import random, signal
from hexwire.link.waker import Waker

waker = Waker()
waker.open()
random.seed(1)
for _ in range(1000):
    done = []
    signal.signal(signal.SIGALRM, lambda *_: (waker.set(), done.append(1)))
    signal.setitimer(signal.ITIMER_REAL, random.uniform(0.00002, 0.0004))
    while not done:
        waker.clear()
        waker.set()
"""
    # In a process of its own: what hangs in a lock cannot be ended from inside.
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60.0)


@pytest.mark.parametrize("use", [Waker.set, Waker.clear])
def test_closed_in_the_middle_of_its_use(use: Callable[[Waker], None], monkeypatch: pytest.MonkeyPatch) -> None:
    """As by a signal handler, in the thread that uses it."""
    waker = Waker()
    waker.open()
    fd = waker.fileno()
    real = {"write": os.write, "read": os.read}

    def interrupted(name: str) -> Callable[..., object]:
        def call(*args: Any) -> object:
            waker.close()
            assert os.fstat(fd), "it is still in use"
            return real[name](*args)

        return call

    for name in real:
        monkeypatch.setattr(waker_module.os, name, interrupted(name))
    use(waker)
    assert waker.fileno() == -1
    with pytest.raises(OSError, match="Bad file descriptor"):
        os.fstat(fd)


@pytest.mark.parametrize("use", [Waker.set, Waker.clear])
@pytest.mark.parametrize("inner", [Waker.set, Waker.clear])
def test_used_and_closed_in_the_middle_of_its_use(
    use: Callable[[Waker], None], inner: Callable[[Waker], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    """As by a signal handler that wakes a link and closes it: the interrupted call needs the descriptor."""
    waker = Waker()
    waker.open()
    fd = waker.fileno()
    real, handled = {"write": os.write, "read": os.read}, []

    def interrupted(name: str) -> Callable[..., object]:
        def call(*args: Any) -> object:
            if not handled:
                handled.append(name)
                inner(waker)
                waker.close()
                assert os.fstat(fd), "it is still in use"
            return real[name](*args)

        return call

    for name in real:
        monkeypatch.setattr(waker_module.os, name, interrupted(name))
    use(waker)
    assert handled
    assert waker.fileno() == -1
    # A waker that was closed like this works again.
    waker.open()
    waker.set()
    assert is_set(waker)
    waker.clear()
    waker.close()
    assert waker.fileno() == -1


def test_it_works_in_a_program_without_standard_input() -> None:
    saved = os.dup(0)
    os.close(0)
    waker = Waker()
    try:
        waker.open()
        assert waker.fileno() == 0
        waker.open()
        waker.set()
        assert is_set(waker)
        waker.clear()
        assert not is_set(waker)
        waker.close()
        with pytest.raises(OSError, match="Bad file descriptor"):
            os.fstat(0)
    finally:
        os.dup2(saved, 0)
        os.close(saved)
