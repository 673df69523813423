"""Connections: bounded in number and time, and what has asked for something is kept longest."""

from __future__ import annotations

import asyncio
import contextlib
import json
import socket
import ssl
import time
from asyncio import sslproto
from typing import TYPE_CHECKING, Any

import pytest
from tests.studio.running import Visitor, serve, until

from hexwire.studio import connections
from hexwire.studio.access import Access, Limits
from hexwire.studio.app import Studio
from hexwire.studio.connections import read_little

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from tests.studio.running import RunningStudio


@pytest.fixture
def own(tmp_path: Path) -> Iterator[RunningStudio]:
    """A server of this test alone: what other tests have connected to that of the worker would count.

    It does not take a connection that a busy machine has made slowly for one that asks too late.
    """
    with serve(Studio(Access(frozenset(), limits=Limits(request=300.0)), tmp_path)) as running:
        yield running


@pytest.fixture
def idle(own: RunningStudio) -> Iterator[list[socket.socket]]:
    """Connections that ask for nothing: twice as many as are allowed."""
    port = int(own.url.rpartition(":")[2])
    made: list[socket.socket] = []
    try:
        most = own.studio.access.limits.connections
        made.extend(socket.create_connection(("127.0.0.1", port), timeout=30) for _ in range(2 * most))
        yield made
    finally:
        for each in made:
            each.close()


def _is_closed(each: socket.socket) -> bool:
    each.setblocking(False)
    try:
        return each.recv(1) == b""
    except BlockingIOError:
        return False
    except ConnectionResetError:
        return True


def test_too_many_idle_connections_end_the_oldest(own: RunningStudio, idle: list[socket.socket]) -> None:
    most = own.studio.access.limits.connections
    until(lambda: sum(map(_is_closed, idle[:most])) == most, "the end of the oldest")
    assert not any(map(_is_closed, idle[-most:]))


def test_a_request_comes_through_a_crowd(own: RunningStudio, idle: list[socket.socket]) -> None:
    port = int(own.url.rpartition(":")[2])
    with socket.create_connection(("127.0.0.1", port), timeout=30) as asking:
        time.sleep(0.05)
        asking.sendall(f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n\r\n".encode())
        assert asking.recv(100).startswith(b"HTTP/1.1 401")


def test_a_head_without_end_is_refused(served: RunningStudio) -> None:
    port, most = int(served.url.rpartition(":")[2]), served.studio.access.limits.head
    sent = 0
    with socket.create_connection(("127.0.0.1", port), timeout=30) as asking:
        asking.sendall(f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nX: ".encode())
        with contextlib.suppress(ConnectionError):
            while sent < 100 * most:
                asking.sendall(b"x" * 4096)
                sent += 4096
            asking.recv(1)
    assert sent < 100 * most


def test_a_long_body_is_no_head(served: RunningStudio) -> None:
    port, most = int(served.url.rpartition(":")[2]), served.studio.access.limits.head
    with socket.create_connection(("127.0.0.1", port), timeout=30) as asking:
        for _ in range(2):
            head = f"POST /stop HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nContent-Length: {4 * most}\r\n\r\n"
            asking.sendall(head.encode() + b"x" * 4 * most)
            answer = b""
            while not answer.endswith(b"0\r\n\r\n"):
                answer += asking.recv(1000)
            assert answer.startswith(b"HTTP/1.1 403")


def test_a_socket_over_tls_is_read_in_small_pieces_too() -> None:
    loop = asyncio.new_event_loop()
    try:
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        tls = sslproto.SSLProtocol(loop, asyncio.Protocol(), context, None, server_side=True)
        assert len(tls.get_buffer(-1)) > 4096
        transport = tls._get_app_transport()
        read_little(transport)
        assert len(tls.get_buffer(-1)) == len(tls.get_buffer(100_000)) == 4096
        transport.close()
    finally:
        loop.close()


def test_a_socket_is_read_in_small_pieces(studio: RunningStudio, monkeypatch: pytest.MonkeyPatch) -> None:
    """The loop takes apart what was read before it does anything else: a STOP would wait for 16,000 messages."""
    made: list[Any] = []

    def read(transport: Any) -> None:
        made.append(transport)
        read_little(transport)

    monkeypatch.setattr(connections, "read_little", read)
    owner = Visitor(studio, studio.studio.access.operate_token)
    with owner.socket(f"/live?tab={owner.page()}") as line:
        line.recv(timeout=30)
        sizes = [each.max_size for each in made if each.get_extra_info("peername") == line.local_address]
        assert sizes == [4096]
        line.send(json.dumps({"do": "x", "args": "x" * 60_000}))
        line.send(json.dumps({"do": "stop"}))
        until(lambda: '"stopping"' in str(line.recv(timeout=30)), "the answer to the stop")
