from __future__ import annotations

import os
import queue
import signal
import socket
import struct
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import pytest
from tests.waits import PATIENCE

from hexwire import system
from hexwire.system import READABLE, WRITABLE, make_poll


def test_users_and_groups_have_names(monkeypatch: pytest.MonkeyPatch) -> None:
    assert system.user_id() == os.geteuid()
    assert system.user_name(0) == "root"
    assert system.user_name(54321) == "user 54321"
    assert system.group_name(0) == "root"
    assert system.group_name(54321) == ""
    monkeypatch.delattr(os, "geteuid")
    assert system.user_id() == 0


def test_devices_have_numbers_where_the_system_numbers_them(monkeypatch: pytest.MonkeyPatch) -> None:
    number = system.device_number(Path("/dev/null").stat())
    assert system.device_parts(number) == (1, 3)
    monkeypatch.delattr(os, "major")
    assert system.device_parts(number) == (0, 0)


def test_a_file_is_locked_for_one_program(tmp_path: Path) -> None:
    path = tmp_path / "lock"
    with path.open("w") as first, path.open("w") as second:
        assert system.lock_file(first.fileno())
        assert not system.lock_file(second.fileno())
        first.close()
        assert system.lock_file(second.fileno())


def test_the_alarm_is_set_where_there_is_one(monkeypatch: pytest.MonkeyPatch) -> None:
    system.end_by_alarm(1000)
    assert signal.alarm(0) > 0
    monkeypatch.delattr(signal, "alarm")
    system.end_by_alarm(1000)
    assert signal.SIGTERM in system.END_SIGNALS


@pytest.fixture(params=["poll", "select"])
def poll(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> system.Poll:
    if request.param == "select":
        monkeypatch.delattr(system.select, "poll")
    return make_poll()


def test_waiting_reports_what_is_ready(poll: system.Poll) -> None:
    near, far = socket.socketpair()
    with near, far:
        poll.register(near.fileno(), READABLE)
        assert poll.poll(0) == []
        far.send(b"x")
        assert poll.poll(None) == [(near.fileno(), READABLE)]
        poll.register(near.fileno(), READABLE | WRITABLE)
        assert poll.poll(-1) == [(near.fileno(), READABLE | WRITABLE)]


def test_waiting_for_nothing_takes_its_time(poll: system.Poll) -> None:
    start = time.monotonic()
    assert poll.poll(20.0) == []
    assert time.monotonic() - start >= 0.02


def test_a_system_without_numbers_of_devices_gives_0() -> None:
    assert system.device_number(object()) == 0  # type: ignore[arg-type]


@pytest.mark.parametrize("platform", ["linux", "win32"])
def test_enter_is_awaited_at_a_pipe_as_at_a_keyboard_until_the_input_ends(
    platform: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    reader, writer = os.pipe()
    with os.fdopen(reader) as stdin:
        monkeypatch.setattr(system, "sys", SimpleNamespace(platform=platform, stdin=stdin))
        typed = system.TypedLines()
        assert typed.entered(0.0) is False
        assert typed.entered(0.0) is False
        os.write(writer, b"\n")
        assert typed.entered(PATIENCE) is True
        assert typed.entered(0.0) is False
        os.close(writer)
        # As without a console: nobody can press Enter, and who waits for it must not wait for ever.
        assert typed.entered(PATIENCE) is None


def test_a_connection_that_would_wait_in_close_does_not_and_others_are_left_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def lingers(end: socket.socket) -> tuple[int, int]:
        return struct.unpack("=ii", end.getsockopt(socket.SOL_SOCKET, socket.SO_LINGER, 8))

    with socket.create_server(("127.0.0.1", 0)) as door, socket.socket(socket.AF_UNIX) as other:
        ends = [socket.create_connection(door.getsockname()) for _ in range(2)]
        try:
            for end in (*ends, other):
                end.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("=ii", 1, 10))
            ports = {(ends[0].getsockname()[1], ends[0].getpeername()[1]), (0, 0)}
            with monkeypatch.context() as patch:
                patch.setattr(system.sys, "platform", "win32")
                assert system.close_at_once(ports) == 0
            assert system.close_at_once([]) == 0
            assert lingers(ends[0])[0]
            assert system.close_at_once(ports) == 1
            assert not lingers(ends[0])[0]
            assert [lingers(end) for end in (ends[1], other)] == [(1, 10)] * 2
            assert system.close_at_once(ports) == 0
            # They are open, and wait for nothing in between.
            assert [end.getblocking() for end in ends] == [True, True]
            ends[0].sendall(b"a")
        finally:
            for end in ends:
                end.close()


def test_an_item_of_a_queue_is_waited_for_as_long_as_one_says() -> None:
    items: queue.SimpleQueue[int] = queue.SimpleQueue()
    items.put(1)
    items.put(2)
    for seconds in (0.001, None):
        assert system.next_within(items, seconds) in (1, 2)
    with pytest.raises(queue.Empty):
        system.next_within(items, 0.001)
    for seconds in (PATIENCE, None):
        threading.Timer(0.01, items.put, (3,)).start()
        assert system.next_within(items, seconds) == 3
