from __future__ import annotations

import errno
import os
import select
import socket
import time
from pathlib import Path

import pytest
from far_ends import free_port

from hexwire.errors import (
    LinkError,
    LinkLostError,
    LinkNotFoundError,
    LinkPermissionError,
    LinkTimeoutError,
    UsageError,
)
from hexwire.link import tcp as tcp_module
from hexwire.link.base import Link
from hexwire.link.listen import TcpListenLink
from hexwire.link.listener import Listener
from hexwire.link.open import make_link
from hexwire.link.tcp import PeerLink, PlainStream, TcpLink, host_and_port
from hexwire.testing.link import Background, LinkConformance, descriptors, in_a_moment, soon


class TestTcp(LinkConformance):
    def make_pair(self, tmp_path: Path) -> tuple[Link, Link]:
        port = free_port()
        return TcpLink("127.0.0.1", port), TcpListenLink(port=port)


class TestTcpOnIpv6(LinkConformance):
    def make_pair(self, tmp_path: Path) -> tuple[Link, Link]:
        port = free_port()
        return TcpLink("::1", port), TcpListenLink("::1", port)


def test_addresses() -> None:
    link = make_link("tcp://192.168.1.175:15030?timeout=0.5")
    assert isinstance(link, TcpLink)
    assert link.url == "tcp://192.168.1.175:15030"
    assert make_link("tcp://[::1]:5").url == "tcp://[::1]:5"
    assert host_and_port("fd00::1", 1) == "[fd00::1]:1"


@pytest.mark.parametrize(
    ("url", "words"),
    [
        ("tcp://h:1/path", "'/path' is not allowed"),
        ("tcp://h:1?timeout=0", "timeout must be a time in seconds above 0"),
        ("tcp://h:1?cert=x", "unknown option 'cert'; options of tcp://: timeout"),
        ("tcp://h", "the port is missing"),
    ],
)
def test_wrong_addresses(url: str, words: str) -> None:
    with pytest.raises(UsageError) as caught:
        make_link(url)
    assert words in str(caught.value)


def test_nobody_listens() -> None:
    link = TcpLink("127.0.0.1", free_port())
    with pytest.raises(LinkNotFoundError, match="no server listens there; start it, or check the port") as caught:
        link.open()
    assert caught.value.url == link.url
    assert not link.is_open


def test_no_such_host(monkeypatch: pytest.MonkeyPatch) -> None:
    def unknown(*_: object, **__: object) -> object:
        raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")

    monkeypatch.setattr(socket, "getaddrinfo", unknown)
    with pytest.raises(LinkNotFoundError, match="there is no host 'arm-9'; check its name"):
        TcpLink("arm-9", 15030).open()
    monkeypatch.undo()
    with pytest.raises(LinkNotFoundError, match="there is no host"):
        TcpLink("a" * 70 + ".b", 15030).open()


@pytest.mark.parametrize(
    ("number", "kind", "words"),
    [
        (errno.EHOSTUNREACH, LinkNotFoundError, r"no route to that host \(No route to host\)"),
        (errno.ENETUNREACH, LinkNotFoundError, "check the address and the cable"),
        (errno.ETIMEDOUT, LinkNotFoundError, "no route to that host"),
        (errno.EPERM, LinkPermissionError, "firewall"),
        (errno.EIO, LinkError, "cannot be reached: Input/output error"),
    ],
)
def test_what_the_network_says(
    number: int, kind: type[LinkError], words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(self: TcpLink, *_: object) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(TcpLink, "_connect", refuse)
    with pytest.raises(kind, match=words) as caught:
        TcpLink("127.0.0.1", 15030).open()
    assert caught.value.url == "tcp://127.0.0.1:15030"


def test_a_host_that_does_not_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(TcpLink, "_wait_for", lambda self, fd, events, deadline: False)
    monkeypatch.setattr(socket.socket, "connect_ex", lambda self, address: errno.EINPROGRESS)
    with pytest.raises(LinkTimeoutError, match=r"does not answer within 0\.5 s"):
        TcpLink("127.0.0.1", 15030, timeout=0.5).open()


def test_every_address_of_a_name_is_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    with Listener() as listener:
        monkeypatch.setattr(
            tcp_module,
            "find_addresses",
            lambda *_: [(socket.AF_INET6, ("::1", listener.port)), (socket.AF_INET, ("127.0.0.1", listener.port))],
        )
        with TcpLink("localhost", listener.port) as link:
            peer = listener.accept(soon())
            assert peer is not None
            link.write(b"x", soon())
            assert peer.read(soon()) == b"x"
            peer.close()


def test_a_call_that_reaches_itself_is_nobody() -> None:
    # Calling a free port of the range that the system takes own ports from may connect a socket to itself.
    port = free_port()

    class SelfCaller(TcpLink):
        def _connect(self, connected: socket.socket, address: tuple[object, ...], deadline: float) -> None:
            connected.bind(("127.0.0.1", port))
            super()._connect(connected, address, deadline)

    with pytest.raises(LinkNotFoundError, match="no server listens"):
        SelfCaller("127.0.0.1", port).open()


def test_small_writes_go_out_at_once_and_dead_peers_are_noticed() -> None:
    with Listener() as listener, TcpLink("127.0.0.1", listener.port) as link:
        peer = listener.accept(soon())
        assert peer is not None
        for end in (link, peer):
            with socket.socket(fileno=os.dup(end.fileno())) as view:
                assert view.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY) == 1
                assert view.getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE) == 1
                assert view.getsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPIDLE) == 5
                assert not os.get_blocking(view.fileno())
        peer.close()


def test_a_reset_is_a_loss() -> None:
    with Listener() as listener, TcpLink("127.0.0.1", listener.port) as link:
        caller = listener.accept(soon())
        assert caller is not None
        with socket.socket(fileno=os.dup(caller.fileno())) as view:
            view.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
            caller.close()

        def talk_on() -> None:
            while True:
                link.write(b"x", soon())
                link.read(in_a_moment())

        with pytest.raises(LinkLostError):
            talk_on()


def test_an_accepted_link_does_not_come_back() -> None:
    near, far = socket.socketpair()
    near.setblocking(False)
    link = PeerLink("tcp-listen://x", PlainStream(near), "10.0.0.9:5")
    assert link.is_open
    assert link.peer == "10.0.0.9:5"
    far.close()
    with pytest.raises(LinkLostError, match="disconnects others"):
        link.read(soon())
    link.close()
    with pytest.raises(LinkNotFoundError, match=r"10\.0\.0\.9:5 has to connect again"):
        link.open()


def test_closing_ends_a_call_under_way(monkeypatch: pytest.MonkeyPatch) -> None:
    # An address that neither answers nor refuses: a listener whose queue of callers is full.
    with socket.socket() as full:
        full.bind(("127.0.0.1", 0))
        full.listen(0)
        address = full.getsockname()
        fillers = []
        for _ in range(4):
            filler = socket.socket()
            filler.setblocking(False)
            filler.connect_ex(address)
            fillers.append(filler)
        select.select([], [], [], 0.05)
        link = TcpLink(address[0], address[1], timeout=60.0)
        opener = Background(link.open)
        opener.let_it_block()
        start = time.monotonic()
        link.close()
        with pytest.raises(LinkError):
            opener.outcome()
        assert time.monotonic() - start < 30.0
        for filler in fillers:
            filler.close()


def test_a_system_without_an_option_is_no_reason_not_to_connect(monkeypatch: pytest.MonkeyPatch) -> None:
    set_option = socket.socket.setsockopt

    def refuse(self: socket.socket, level: int, option: int, value: int) -> None:
        if option in (socket.TCP_KEEPIDLE, socket.TCP_USER_TIMEOUT) and level == socket.IPPROTO_TCP:
            raise OSError(errno.ENOPROTOOPT, "Protocol not available")
        set_option(self, level, option, value)

    monkeypatch.setattr(socket.socket, "setsockopt", refuse)
    with Listener() as listener, TcpLink("127.0.0.1", listener.port) as link:
        with socket.socket(fileno=os.dup(link.fileno())) as view:
            assert view.getsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPINTVL) == 2, "the others are set"
            assert view.getsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPCNT) == 3
        peer = listener.accept(soon())
        assert peer is not None
        peer.close()


def test_an_opening_that_fails_leaves_no_descriptor(monkeypatch: pytest.MonkeyPatch) -> None:
    before = descriptors()
    with pytest.raises(LinkNotFoundError):
        TcpLink("127.0.0.1", free_port()).open()

    def broken(*_: object) -> None:
        raise ValueError("a fault of the program")

    monkeypatch.setattr(tcp_module, "prepare", broken)
    with pytest.raises(ValueError, match="a fault"):
        TcpLink("127.0.0.1", 15030).open()
    assert descriptors() <= before


def test_a_name_without_any_address_is_no_host(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tcp_module, "find_addresses", lambda *_: [])
    with pytest.raises(LinkNotFoundError, match=r"no route to that host \(no address\)"):
        TcpLink("localhost", 15030).open()


def test_an_accepted_link_that_is_closed_frees_its_socket() -> None:
    before = descriptors()
    near, far = socket.socketpair()
    link = PeerLink("tcp-listen://x", PlainStream(near), "10.0.0.9:5")
    link.close()
    assert far.recv(1) == b""
    far.close()
    assert descriptors() <= before
