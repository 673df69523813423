from __future__ import annotations

import builtins
import errno
import fcntl
import itertools
import os
from collections.abc import Iterator
from pathlib import Path

import posix_ipc
import pytest
from conformance import LinkConformance, in_a_moment, soon

from hexwire.errors import (
    LinkBusyError,
    LinkError,
    LinkNotFoundError,
    LinkPermissionError,
    LinkTimeoutError,
    UsageError,
)
from hexwire.ipc import mqueue as mqueue_module
from hexwire.ipc.link import Link
from hexwire.ipc.mqueue import QueueInfo, QueueLink, list_queues, remove_queue
from hexwire.ipc.open import make_link

_numbers = itertools.count()


@pytest.fixture
def name() -> Iterator[str]:
    made = f"/hexwire-test-{os.getpid()}-{next(_numbers)}"
    yield made
    remove_queue(made + ".tx")
    remove_queue(made + ".rx")


class TestQueue(LinkConformance):
    detects_loss = False

    @pytest.fixture(autouse=True)
    def _name(self, name: str) -> None:
        self.name = name

    def make_pair(self, tmp_path: Path) -> tuple[Link, Link]:
        return QueueLink(self.name), QueueLink(self.name, server=True)

    def open_pair(self, near: Link, far: Link) -> None:
        far.open()
        near.open()
        # What an earlier life left unread would be taken for an answer.
        for link in (near, far):
            link.flush_input()
        self.greet(near, far)

    def second_owner(self, near: Link) -> Link:
        return make_link(near.url)


class TestQueueServer(TestQueue):
    def make_pair(self, tmp_path: Path) -> tuple[Link, Link]:
        return QueueLink(self.name, server=True), QueueLink(self.name)


def test_addresses() -> None:
    client = make_link("mq:///arm")
    assert isinstance(client, QueueLink)
    assert (client.name, client.url, client.max_message) == ("/arm", "mq:///arm", 8192)
    server = make_link("mq:///arm?role=server&depth=5&size=100&unlink=1")
    assert (server.url, server.max_message) == ("mq:///arm?role=server", 100)


@pytest.mark.parametrize(
    ("url", "words"),
    [
        ("mq://arm", "three slashes, as in mq:///arm"),
        ("mq:///", "is not a queue name"),
        ("mq:///a/b", "is not a queue name"),
        ("mq:///arm?role=boss", "role must be one of client, server, not 'boss'"),
        ("mq:///arm?depth=0", "depth must be a whole number from 1"),
        ("mq:///arm?mode=1", "unknown option 'mode'; mq:// knows: role, depth, size, unlink"),
    ],
)
def test_wrong_addresses(url: str, words: str) -> None:
    with pytest.raises(UsageError) as caught:
        make_link(url)
    assert words in str(caught.value)


def test_ten_messages_wait_for_the_other_end(name: str) -> None:
    with QueueLink(name) as client:
        for number in range(10):
            client.write(bytes([number]), soon())
        with pytest.raises(LinkTimeoutError, match="the other side is not reading"):
            client.write(b"one too many", in_a_moment())
    # They outlive the program that sent them.
    with QueueLink(name, server=True) as server:
        assert [server.read(soon()) for _ in range(10)] == [bytes([number]) for number in range(10)]
        assert server.read(in_a_moment()) == b""


def test_the_owner_of_an_end_is_named(name: str) -> None:
    with QueueLink(name, server=True), pytest.raises(LinkBusyError) as caught:
        QueueLink(name, server=True).open()
    assert str(caught.value) == f"mq://{name}?role=server has a server already: this program; close that first"


def test_a_queue_that_exists_keeps_its_own_limits(name: str) -> None:
    with QueueLink(name, depth=2, size=64), QueueLink(name, server=True) as server:
        assert server.max_message == 64
        with pytest.raises(UsageError, match="at most 64 bytes, not 65"):
            server.write(bytes(65))
        server.write(bytes(64), soon())
        server.write(bytes(64), soon())
        with pytest.raises(LinkTimeoutError):
            server.write(bytes(64), in_a_moment())


def test_only_this_user_may_use_it(name: str) -> None:
    with QueueLink(name) as client:
        assert os.fstat(client.fileno()).st_mode & 0o777 == 0o600


def test_a_queue_is_removed_only_on_request(name: str) -> None:
    with QueueLink(name):
        pass
    assert remove_queue(name + ".rx")
    assert remove_queue(name.removeprefix("/") + ".tx")
    assert not remove_queue(name + ".rx")
    with QueueLink(name, unlink=True), QueueLink(name, server=True, unlink=True):
        pass
    assert not remove_queue(name + ".rx")
    assert not remove_queue(name + ".tx")


class _Fails:
    def __init__(self, error: Exception) -> None:
        self.error = error

    def __call__(self, *_: object, **__: object) -> object:
        raise self.error


@pytest.mark.parametrize(
    ("error", "kind", "words"),
    [
        (
            ValueError("Invalid parameter(s)"),
            UsageError,
            "this system allows queues of at most 10 messages of 8192",
        ),
        (posix_ipc.PermissionsError("x"), LinkPermissionError, "belongs to another user"),
        (OSError(errno.ENOSPC, "x"), LinkError, "256 queues are all in use; remove stale ones, or raise fs.mqueue"),
        (OSError(errno.EMFILE, "x"), LinkError, r"used up \(ulimit -q\)"),
        (
            OSError(errno.ENFILE, "Too many open files in system"),
            LinkError,
            "cannot be opened: .*Too many open files",
        ),
    ],
)
def test_what_the_system_says(
    error: Exception, kind: type[Exception], words: str, name: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    for setting, value in (("msg_max", "10\n"), ("msgsize_max", "8192\n"), ("queues_max", "256\n")):
        (tmp_path / setting).write_text(value)
    monkeypatch.setattr(mqueue_module, "_SETTINGS", tmp_path)
    monkeypatch.setattr(posix_ipc, "MessageQueue", _Fails(error))
    link = QueueLink(name, depth=5000, size=9_000_000)
    with pytest.raises(kind, match=words):
        link.open()
    assert not link.is_open


def test_limits_that_the_system_really_refuses(name: str) -> None:
    # Beyond what even root may have.
    with pytest.raises(UsageError, match="65536 messages of 16777216 bytes are refused; this system allows"):
        QueueLink(name, depth=65536, size=1 << 24).open()


def test_queues_are_listed_with_what_waits_and_who_reads(tmp_path: Path) -> None:
    (tmp_path / "arm.tx").write_text("QSIZE:129        NOTIFY:0     SIGNO:0     NOTIFY_PID:0\n")
    (tmp_path / "arm.rx").write_text("QSIZE:0          NOTIFY:0     SIGNO:0     NOTIFY_PID:0\n")
    (tmp_path / "other").write_text("")
    with (tmp_path / "arm.rx").open() as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        assert list_queues(tmp_path) == [
            QueueInfo("/arm.rx", 0, "this program"),
            QueueInfo("/arm.tx", 129, ""),
            QueueInfo("/other", -1, ""),
        ]
    assert [queue.is_stale for queue in list_queues(tmp_path)] == [True] * 3


def test_queues_that_are_not_mounted_cannot_be_listed(tmp_path: Path) -> None:
    with pytest.raises(LinkNotFoundError, match=r"queues cannot be listed; run 'sudo mkdir -p .*mount -t mqueue"):
        list_queues(tmp_path / "mqueue")


def test_a_queue_of_another_user_is_not_removed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(posix_ipc, "unlink_message_queue", _Fails(posix_ipc.PermissionsError("x")))
    with pytest.raises(LinkPermissionError, match="queue /x belongs to another user"):
        remove_queue("/x")


def test_without_the_package_the_way_out_is_named(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def refuse(wanted: str, *rest: object) -> object:
        if wanted == "posix_ipc":
            raise ImportError(wanted)
        return real(wanted, *rest)  # type: ignore[arg-type]  # passed on as it came

    with monkeypatch.context() as patch:
        patch.setattr(builtins, "__import__", refuse)
        with pytest.raises(UsageError, match=r"pip install 'hexwire\[mq\]'"):
            QueueLink(name).open()


def test_without_the_settings_limits_are_told_in_words(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mqueue_module, "_SETTINGS", tmp_path)
    assert mqueue_module._setting("msg_max") == "a few"
