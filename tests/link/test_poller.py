from __future__ import annotations

import socket
from collections.abc import Callable, Iterator

import pytest

from hexwire.link import listener as listener_module
from hexwire.link.listener import Listener, PlainPoller, Poller, make_poller
from hexwire.link.tcp import TcpLink
from hexwire.link.waker import Waker
from hexwire.system import READABLE, WRITABLE

Make = Callable[[int], Poller]
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


@pytest.mark.parametrize("make", [make_poller, PlainPoller])
def test_what_is_ready_is_reported(make: Make, waker: Waker, pair: tuple[socket.socket, socket.socket]) -> None:
    near, far = pair
    poller = make(waker.fileno())
    try:
        poller.register(near.fileno(), READABLE)
        assert poller.wait(0.0) == []
        far.send(b"x")
        assert poller.wait(PATIENCE) == [near.fileno()]
        waker.set()
        assert sorted(poller.wait(PATIENCE)) == sorted([near.fileno(), waker.fileno()])
        waker.clear()
        near.recv(1)
        poller.modify(near.fileno(), WRITABLE)
        assert poller.wait(PATIENCE) == [near.fileno()]
        poller.unregister(near.fileno())
        assert poller.wait(0.0) == []
    finally:
        poller.close()


def test_a_server_without_epoll_lets_clients_in(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(listener_module, "make_poller", PlainPoller)
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
