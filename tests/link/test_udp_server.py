from __future__ import annotations

import errno
import os
import select
import socket

import pytest

from hexwire.errors import LinkBusyError, LinkClosedError, LinkNotFoundError, UsageError
from hexwire.link.udp import MAX_DATAGRAM, Peer, UdpServer
from hexwire.testing.link import PATIENCE


def caller(server: UdpServer, address: str = "127.0.0.1") -> socket.socket:
    made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    made.bind((address, 0))
    made.connect(("127.0.0.1", server.port))
    made.settimeout(PATIENCE)
    return made


def take(server: UdpServer) -> tuple[Peer, bytes]:
    assert select.select([server.fileno()], [], [], PATIENCE)[0]
    came = server.receive()
    assert came is not None
    return came


def test_each_port_is_a_peer_of_its_own() -> None:
    with UdpServer() as server, caller(server) as one, caller(server) as other:
        one.send(b"1")
        other.send(b"2")
        (first, a), (second, b) = take(server), take(server)
        assert (a, b) == (b"1", b"2")
        assert first != second
        assert server.send(first, b"for one")
        assert server.send(second, b"for other")
        assert (one.recv(100), other.recv(100)) == (b"for one", b"for other")
        assert server.receive() is None


def test_other_hosts_are_dropped_and_counted() -> None:
    with UdpServer() as server, caller(server, "127.0.0.2") as stranger:
        stranger.send(b"move!")
        assert select.select([server.fileno()], [], [], PATIENCE)[0]
        assert server.receive() is None
        assert server.dropped == 1
    with UdpServer(peer="127.0.0.2") as server, caller(server, "127.0.0.2") as known:
        known.send(b"hello")
        assert take(server)[1] == b"hello"


def test_a_datagram_that_is_not_a_frame_is_dropped_and_counted() -> None:
    with UdpServer() as server, caller(server) as one:
        for size in (0, MAX_DATAGRAM + 1):
            one.send(bytes(size))
            assert select.select([server.fileno()], [], [], PATIENCE)[0]
            assert server.receive() is None
        assert server.dropped == 2
        one.send(bytes(MAX_DATAGRAM))
        assert take(server)[1] == bytes(MAX_DATAGRAM)


def test_an_answer_to_one_who_is_gone_ends_nothing() -> None:
    with UdpServer() as server:
        with caller(server) as one:
            one.send(b"1")
            peer, _ = take(server)
        for _ in range(3):
            server.send(peer, b"answer")
        assert server.receive() is None
        assert not server.send(peer, bytes(100_000)), "too long for any datagram"
        assert server.dropped == 0


@pytest.mark.parametrize(
    "number", [errno.EAGAIN, errno.ENOBUFS, errno.EPERM, errno.EMSGSIZE, errno.ECONNREFUSED, errno.EHOSTUNREACH]
)
def test_a_datagram_that_does_not_get_out_is_lost_and_nothing_else(
    number: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Full:
        def sendto(self, *_: object) -> int:
            raise OSError(number, os.strerror(number))

    with UdpServer() as server, monkeypatch.context() as patch:
        patch.setattr(server, "_socket", Full())
        assert not server.send(("127.0.0.1", 9), b"x")


@pytest.mark.parametrize("number", [errno.ECONNREFUSED, errno.EHOSTUNREACH])
def test_an_error_about_an_earlier_datagram_is_no_datagram(number: int, monkeypatch: pytest.MonkeyPatch) -> None:
    class Away:
        def recvfrom(self, size: int) -> object:
            raise OSError(number, os.strerror(number))

    with UdpServer() as server, monkeypatch.context() as patch:
        patch.setattr(server, "_socket", Away())
        assert server.receive() is None
        assert server.dropped == 0


class _Broken:
    def sendto(self, *_: object) -> int:
        raise OSError(errno.EBADF, os.strerror(errno.EBADF))

    recvfrom = sendto


def test_other_errors_are_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    with UdpServer() as server:
        real = server._socket
        monkeypatch.setattr(server, "_socket", _Broken())
        with pytest.raises(OSError, match="Bad file descriptor"):
            server.send(("127.0.0.1", 9), b"x")
        with pytest.raises(OSError, match="Bad file descriptor"):
            server.receive()
        server._socket = real


def test_what_cannot_be_bound() -> None:
    with pytest.raises(UsageError, match=r"name the host to accept, as in \?peer=192.168.1.20"):
        UdpServer("0.0.0.0", 5)
    away = UdpServer("192.0.2.1", 9, peer="127.0.0.1")
    with pytest.raises(LinkNotFoundError, match="no such address") as caught:
        away.open()
    assert caught.value.url == away.url == "udp-listen://192.0.2.1:9?peer=127.0.0.1"
    unknown = UdpServer(peer="x" * 70)
    with pytest.raises(LinkNotFoundError, match="there is no host") as caught:
        unknown.open()
    assert caught.value.url == unknown.url
    server = UdpServer()
    with pytest.raises(LinkClosedError):
        server.receive()
    with server:
        assert server.url == f"udp-listen://127.0.0.1:{server.port}?peer=127.0.0.1"
        with pytest.raises(LinkBusyError, match="is already listening"):
            server.open()
        with pytest.raises(LinkBusyError, match="that port is in use"):
            UdpServer(port=server.port).open()
    server.close()
