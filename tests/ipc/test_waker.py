from __future__ import annotations

import os
import select
import sys
import threading

import pytest

from hexwire.ipc import waker as waker_module
from hexwire.ipc.waker import Waker


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
    thread.join(10.0)
    assert not thread.is_alive()
    waker.close()
