from __future__ import annotations

import builtins
import errno
import fcntl
import itertools
import os
import pwd
from collections.abc import Iterator
from pathlib import Path

import posix_ipc
import pytest

from hexwire.errors import (
    LinkBusyError,
    LinkError,
    LinkPermissionError,
    LinkTimeoutError,
    UsageError,
)
from hexwire.link import mqueue as mqueue_module
from hexwire.link.base import Link
from hexwire.link.mqueue import QueueLink
from hexwire.link.open import make_link
from hexwire.testing.link import LinkConformance, in_a_moment, soon

_numbers = itertools.count()


@pytest.fixture
def name() -> Iterator[str]:
    made = f"/hexwire-test-{os.getpid()}-{next(_numbers)}"
    yield made
    removed(made + ".tx")
    removed(made + ".rx")


def removed(queue: str) -> bool:
    """Remove a queue; whether it was there."""
    try:
        posix_ipc.unlink_message_queue(queue)
    except posix_ipc.ExistentialError:
        return False
    return True


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
        ("mq:///arm?depth=0", "depth must be an integer from 1"),
        ("mq:///arm?mode=1", "unknown option 'mode'; options of mq://: role, depth, size, unlink, trust"),
    ],
)
def test_wrong_addresses(url: str, words: str) -> None:
    with pytest.raises(UsageError) as caught:
        make_link(url)
    assert words in str(caught.value)


def test_ten_messages_wait_for_a_reader(name: str) -> None:
    with QueueLink(name, server=True) as server, QueueLink(name) as client:
        for number in range(10):
            client.write(bytes([number]), soon())
        with pytest.raises(LinkTimeoutError, match="the other side is not reading"):
            client.write(b"one too many", in_a_moment())
        assert [server.read(soon()) for _ in range(10)] == [bytes([number]) for number in range(10)]
        assert server.read(in_a_moment()) == b""


def test_messages_of_a_closed_client_do_not_reach_a_server_started_later(name: str) -> None:
    with QueueLink(name) as client:
        for number in range(10):
            client.write(bytes([number]), soon())
    with QueueLink(name, server=True) as server:
        assert server.dropped == 10
        assert server.read(in_a_moment()) == b""
        for number in range(10):
            server.write(bytes([number]), soon())
        with QueueLink(name) as later:
            assert later.dropped == 10
            assert later.read(in_a_moment()) == b""
            server.write(b"for you", soon())
            assert later.read(soon()) == b"for you"


def as_another_user(monkeypatch: pytest.MonkeyPatch) -> str:
    """From here on this user's queues are somebody else's; returns the name of their owner."""
    me = os.geteuid()
    monkeypatch.setattr(os, "geteuid", lambda: me + 1)
    return pwd.getpwuid(me).pw_name


@pytest.mark.parametrize("server", [True, False])
def test_queues_that_another_user_made_are_not_used(
    name: str, server: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    with QueueLink(name), QueueLink(name, server=True):
        pass
    owner = as_another_user(monkeypatch)
    link = QueueLink(name, server=server)
    with pytest.raises(LinkPermissionError) as caught:
        link.open()
    assert not link.is_open
    first = name + (".tx" if server else ".rx")
    assert str(caught.value) == (
        f"{link.url}: queue {first} belongs to {owner}, who could read and write its messages; choose another "
        f"name, or add trust={owner} to the address"
    )


def test_queues_of_one_who_is_trusted_by_name_are_used(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    with QueueLink(name), QueueLink(name, server=True):
        pass
    owner = as_another_user(monkeypatch)
    with (
        make_link(f"mq://{name}?trust={owner}") as client,
        make_link(f"mq://{name}?role=server&trust={owner}") as far,
    ):
        client.write(b"hello", soon())
        assert far.read(soon()) == b"hello"
    with pytest.raises(UsageError, match="trust=no-such-user, but there is no such user"):
        QueueLink(name, trust=["no-such-user"]).open()


@pytest.mark.parametrize(
    ("mode", "trusted", "words"),
    [
        (0o666, False, r"\.rx is open to all users \(mode 666\); have it removed, or choose another name"),
        (0o602, True, r"\.rx is open to all users \(mode 602\)"),
        (0o660, False, r"\.rx is open to a group \(mode 660\)"),
        (0o660, True, ""),
    ],
)
def test_queues_that_others_may_use_are_not_used(name: str, mode: int, trusted: bool, words: str) -> None:
    made = posix_ipc.MessageQueue(name + ".rx", posix_ipc.O_CREX, mode=0o600, max_messages=10)
    os.fchmod(made.mqd, mode)
    made.close()
    link = QueueLink(name, trust=[pwd.getpwuid(os.geteuid()).pw_name] if trusted else [])
    if words:
        with pytest.raises(LinkPermissionError, match=words):
            link.open()
        assert not link.is_open
    else:
        with link:
            assert link.is_open


def test_a_queue_that_is_removed_while_it_is_opened_is_made_anew(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    real, tries = posix_ipc.MessageQueue, []

    def vanishing(wanted: str, flags: int = 0, **rest: object) -> object:
        tries.append(flags)
        if len(tries) < 3:
            raise posix_ipc.ExistentialError("x")
        return real(wanted, flags, **rest)

    monkeypatch.setattr(posix_ipc, "MessageQueue", vanishing)
    with QueueLink(name) as link:
        assert link.is_open
    assert tries[:3] == [posix_ipc.O_CREX, 0, posix_ipc.O_CREX]


def test_the_owner_of_an_end_is_named(name: str) -> None:
    with QueueLink(name, server=True), pytest.raises(LinkBusyError) as caught:
        QueueLink(name, server=True).open()
    assert str(caught.value) == f"mq://{name}?role=server already has a server: this program; close that first"


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


def test_a_client_removes_its_queues_only_on_request(name: str) -> None:
    with QueueLink(name):
        pass
    assert removed(name + ".rx")
    assert removed(name + ".tx")
    assert not removed(name + ".rx")
    with QueueLink(name, unlink=True), QueueLink(name, server=True, unlink=True):
        pass
    assert not removed(name + ".rx")
    assert not removed(name + ".tx")


@pytest.mark.parametrize("query", ["role=server", "role=server&unlink=1"])
def test_a_server_leaves_no_queues(name: str, query: str) -> None:
    # Whoever made them.
    with QueueLink(name):
        pass
    for _ in range(2):
        with make_link(f"mq://{name}?{query}"), QueueLink(name):
            pass
        assert not removed(name + ".rx")
        assert not removed(name + ".tx")
    with make_link(f"mq://{name}?role=server&unlink=0"):
        pass
    assert removed(name + ".tx")


def test_a_client_that_stays_is_served_by_the_next_server(name: str) -> None:
    with QueueLink(name) as client:
        for text in (b"one", b"two"):
            with QueueLink(name, server=True) as server:
                client.write(text, soon())
                assert server.read(soon()) == text
                server.write(text, soon())
                assert client.read(soon()) == text
    with QueueLink(name, server=True):
        pass
    assert not removed(name + ".rx")


def test_queues_of_another_user_are_kept(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    with QueueLink(name, server=True):
        monkeypatch.setattr(mqueue_module, "user_id", lambda: os.getuid() + 1)
    assert removed(name + ".tx")


@pytest.mark.parametrize("role", ["client", "server"])
def test_whoever_opens_queues_while_a_server_removes_them_makes_new_ones(
    name: str, role: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    first, lock = QueueLink(name, server=True), QueueLink._lock
    first.open()

    def closes_first(descriptor: int) -> None:
        first.close()
        lock(descriptor)

    link = QueueLink(name, server=role == "server")
    other = QueueLink(name, server=role == "client")
    monkeypatch.setattr(QueueLink, "_lock", staticmethod(closes_first))
    with link, other:
        link.write(b"x", soon())
        assert other.read(soon()) == b"x"


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
        (OSError(errno.ENOSPC, "x"), LinkError, "256 queues are all in use; raise fs.mqueue"),
        (OSError(errno.EMFILE, "x"), LinkError, r"used up \(ulimit -q\)"),
        (
            OSError("This process already has the maximum number of files open"),
            LinkError,
            r"used up \(ulimit -q\)",
        ),
        (
            OSError("Insufficient space for a new queue"),
            LinkError,
            "queues are all in use",
        ),
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
    with pytest.raises(kind, match=words) as caught:
        link.open()
    if isinstance(caught.value, LinkError):
        assert caught.value.url == link.url
    assert not link.is_open


def test_limits_that_the_system_really_refuses(name: str) -> None:
    # Beyond what even root may have.
    with pytest.raises(UsageError, match="65536 messages of 16777216 bytes are refused; this system allows"):
        QueueLink(name, depth=65536, size=1 << 24).open()


def test_without_the_package_the_remedy_is_named(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
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


def test_who_has_the_other_end_is_known_until_it_lets_go(name: str) -> None:
    server = QueueLink(name, server=True)
    with server:
        assert server.other_end() == ""
        with QueueLink(name) as client:
            assert (server.other_end(), client.other_end()) == ("this program", "this program")
        assert server.other_end() == ""


def test_a_look_at_a_queue_keeps_nobody_out(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    with QueueLink(name, server=True) as server:
        assert server._outbox is not None
        held = server._outbox.mqd
        fcntl.flock(held, fcntl.LOCK_SH)
        monkeypatch.setattr(mqueue_module, "sleep", lambda seconds: fcntl.flock(held, fcntl.LOCK_UN))
        with QueueLink(name):
            assert server.other_end() == "this program"
