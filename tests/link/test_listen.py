from __future__ import annotations

import time
from pathlib import Path

import pytest
from far_ends import free_port

from hexwire.errors import LinkClosedError, LinkLostError, LinkTimeoutError, UsageError
from hexwire.link.base import Link
from hexwire.link.listen import TcpListenLink
from hexwire.link.open import make_link
from hexwire.link.tcp import TcpLink
from hexwire.testing.link import Background, LinkConformance, in_a_moment, soon


class TestTcpListen(LinkConformance):
    def make_pair(self, tmp_path: Path) -> tuple[Link, Link]:
        port = free_port()
        return TcpListenLink(port=port), TcpLink("127.0.0.1", port)

    def open_pair(self, near: Link, far: Link) -> None:
        near.open()
        far.open()
        self.greet(near, far)

    def second_owner(self, near: Link) -> Link:
        return make_link(near.url)

    def wait_readable(self, link: Link) -> None:
        assert isinstance(link, TcpListenLink)
        assert link._peer is not None
        super().wait_readable(link._peer)

    # The context manager test opens the far end first, which a caller cannot do.
    def test_it_is_a_context_manager(self, tmp_path: Path) -> None:
        near, far = self.make_pair(tmp_path)
        with near, far:
            assert near.is_open
            assert near.url in repr(near)
        assert not near.is_open


def test_addresses() -> None:
    assert make_link("tcp-listen://0.0.0.0:15030").url == "tcp-listen://0.0.0.0:15030"
    assert make_link("tcp-listen://:15030").url == "tcp-listen://127.0.0.1:15030", "loopback unless told"
    for url, words in (
        ("tcp-listen://h", "the port is missing"),
        ("tcp-listen://h:1?timeout=1", "unknown option 'timeout'; options of tcp-listen://: none"),
        ("tcp-listen://h:1/x", "is not allowed"),
    ):
        with pytest.raises(UsageError, match=words):
            make_link(url)


def test_before_anybody_calls() -> None:
    with TcpListenLink() as link:
        assert link.is_open
        deadline = in_a_moment()
        assert link.read(deadline) == b""
        assert time.monotonic() >= deadline
        assert link.flush_input() == 0
        link.write(b"", 0.0)
        with pytest.raises(LinkTimeoutError, match="no client has connected yet"):
            link.write(b"x", in_a_moment())
        assert link.is_open


def test_a_write_waits_for_the_caller() -> None:
    with TcpListenLink() as link:
        writer = Background(lambda: link.write(b"welcome", soon()))
        writer.let_it_block()
        with TcpLink("127.0.0.1", link.listener.port) as caller:
            writer.outcome()
            assert caller.read(soon()) == b"welcome"


def test_waking_and_closing_before_anybody_calls() -> None:
    link = TcpListenLink()
    link.open()
    reader = Background(lambda: link.read(None))
    reader.let_it_block()
    link.wake()
    assert reader.outcome() == b""
    for use in (lambda: link.read(None), lambda: link.write(b"x", None)):
        waiter = Background(use)
        waiter.let_it_block()
        link.close()
        with pytest.raises(LinkClosedError):
            waiter.outcome()
        link.open()
    link.close()


def test_a_second_caller_is_hung_up_on_while_the_first_is_served() -> None:
    with TcpListenLink() as link, TcpLink("127.0.0.1", link.listener.port) as first:
        first.write(b"1", soon())
        assert link.read(soon()) == b"1"
        with TcpLink("127.0.0.1", link.listener.port) as second:
            assert link.read(in_a_moment()) == b""
            with pytest.raises(LinkLostError, match="disconnects others"):
                second.read(soon())
        assert link.listener.refused == 1
        assert "busy with another client" in link.listener.last_refusal
        first.write(b"2", soon())
        assert link.read(soon()) == b"2"
        link.write(b"3", soon())
        assert first.read(soon()) == b"3"


def test_the_next_caller_is_served_after_a_loss() -> None:
    with TcpListenLink() as link:
        port = link.listener.port
        for number in range(3):
            with TcpLink("127.0.0.1", port) as caller:
                caller.write(b"x", soon())
                assert link.read(soon()) == b"x"
            with pytest.raises(LinkLostError):
                link.read(soon())
            assert not link.is_open
            for use in (lambda: link.read(0.0), lambda: link.write(b"x", 0.0), link.flush_input):
                with pytest.raises(LinkLostError):
                    use()
            link.wake()  # meant for the line that is gone
            link.open()
            assert link.is_open
            assert link.listener.port == port, f"round {number}"


def test_a_writer_is_told_of_a_loss() -> None:
    with TcpListenLink() as link:
        with TcpLink("127.0.0.1", link.listener.port) as caller:
            caller.write(b"x", soon())
            assert link.read(soon()) == b"x"

        def write_on() -> None:
            while True:
                link.write(b"x", soon())

        with pytest.raises(LinkLostError):
            write_on()
        assert not link.is_open


def test_a_caller_who_never_says_a_word_does_not_keep_others_out() -> None:
    now = [5.0]
    with (
        TcpListenLink(clock=lambda: now[0]) as link,
        TcpLink("127.0.0.1", link.listener.port) as silent,
    ):
        assert link.read(in_a_moment()) == b""
        now[0] += 4.9
        with TcpLink("127.0.0.1", link.listener.port) as early:
            assert link.read(in_a_moment()) == b""
            with pytest.raises(LinkLostError):
                early.read(soon())
        now[0] += 0.2
        with TcpLink("127.0.0.1", link.listener.port) as caller:
            caller.write(b"hello", soon())
            assert link.read(soon()) == b"hello"
            with pytest.raises(LinkLostError):
                silent.read(soon())
            # Who has spoken keeps his place, however quiet he is then.
            now[0] += 3600.0
            with TcpLink("127.0.0.1", link.listener.port) as late:
                assert link.read(in_a_moment()) == b""
                with pytest.raises(LinkLostError):
                    late.read(soon())
            link.write(b"there", soon())
            assert caller.read(soon()) == b"there"
