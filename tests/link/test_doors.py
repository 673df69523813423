from __future__ import annotations

import socket
from collections.abc import Callable, Iterator

import pytest

from hexwire.link import listener as listener_module
from hexwire.link.doors import Doors, PlainDoors, make_doors
from hexwire.link.listener import Listener
from hexwire.link.tcp import TcpLink
from hexwire.link.waker import Waker
from hexwire.system import READABLE, WRITABLE

Make = Callable[[int], Doors]
PATIENCE = 10_000.0


@pytest.fixture
def waker() -> Iterator[Waker]:
    waker = Waker()
    waker.open()
    yield waker
    waker.close()


@pytest.fixture
def pair() -> Iterator[tuple[socket.socket, socket.socket]]:
    ends = socket.socketpair()
    yield ends
    for end in ends:
        end.close()


@pytest.mark.parametrize("make", [make_doors, PlainDoors])
def test_what_is_ready_is_reported(make: Make, waker: Waker, pair: tuple[socket.socket, socket.socket]) -> None:
    near, far = pair
    doors = make(waker.fileno())
    try:
        doors.register(near.fileno(), READABLE)
        assert doors.wait(0.0) == []
        far.send(b"x")
        assert doors.wait(PATIENCE) == [near.fileno()]
        waker.set()
        assert sorted(doors.wait(PATIENCE)) == sorted([near.fileno(), waker.fileno()])
        waker.clear()
        near.recv(1)
        doors.modify(near.fileno(), WRITABLE)
        assert doors.wait(PATIENCE) == [near.fileno()]
        doors.unregister(near.fileno())
        assert doors.wait(0.0) == []
    finally:
        doors.close()


def test_a_server_without_epoll_lets_clients_in(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(listener_module, "make_doors", PlainDoors)
    with Listener() as listener:
        url = f"tcp://127.0.0.1:{listener.port}"
        for _ in range(2):
            with TcpLink.from_url(_parse(url)) as client:
                peer = listener.accept(None)
                assert peer is not None
                try:
                    client.write(b"hello")
                    assert peer.read(None) == b"hello"
                finally:
                    peer.close()


def _parse(url: str) -> listener_module.LinkUrl:
    from hexwire.link.url import parse_url

    return parse_url(url)
