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
import uvicorn
from tests.studio.running import Visitor, serve, until

from hexwire.studio import connections
from hexwire.studio.access import Access, Limits
from hexwire.studio.app import Studio
from hexwire.studio.connections import make_protocol, read_little

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


class _Transport(asyncio.Transport):
    """A connection's other end, which only notes that it was cut off."""

    cut = False

    def abort(self) -> None:
        self.cut = True

    def close(self) -> None:
        pass

    def write(self, data: bytes | bytearray | memoryview) -> None:
        pass

    def pause_reading(self) -> None:
        pass

    def resume_reading(self) -> None:
        pass

    def is_closing(self) -> bool:
        return self.cut


def test_what_asks_for_nothing_gives_way_first_and_what_waits_for_its_answer_last() -> None:
    """Of those alike, what has asked for nothing longest; never the newest, whoever holds all others."""

    async def app(scope: Any, receive: Any, send: Any) -> None:
        if scope["path"] == "/slow":
            await asyncio.Event().wait()
        await send({"type": "http.response.start", "status": 200, "headers": [(b"content-length", b"0")]})
        await send({"type": "http.response.body"})

    async def order() -> list[str]:
        config = uvicorn.Config(app, ws="none", lifespan="off", log_level="critical")
        config.load()
        made, given = dict[str, Any](), dict[str, _Transport]()
        kind, state = make_protocol(Limits(connections=6)), uvicorn.server.ServerState()

        def begin(name: str) -> None:
            made[name] = kind(config=config, server_state=state, app_state={})  # type: ignore[call-arg]
            given[name] = _Transport()
            made[name].connection_made(given[name])

        async def ask(name: str, path: str = "/") -> None:
            made[name].data_received(f"GET {path} HTTP/1.1\r\nHost: x\r\n\r\n".encode())
            for _ in range(5):
                await asyncio.sleep(0)

        for name in ("slow", "slower", "mute", "answered", "again", "mute too"):
            begin(name)
        await ask("slower", "/slow")
        await ask("slow", "/slow")
        for name in ("again", "answered", "again"):
            await ask(name)
        found = []
        for number in range(6):
            begin(f"new {number}")
            await ask(f"new {number}", "/slow")
            found += [name for name, transport in given.items() if transport.cut and name not in found]
            assert sum(not transport.cut for transport in given.values()) == 6
        for task in state.tasks:
            task.cancel()
        for each in made.values():
            each.connection_lost(None)
        return found

    assert asyncio.run(order()) == ["mute", "mute too", "answered", "again", "slower", "slow"]


@pytest.mark.parametrize("ending", ["\r\n", "Content-Length: 10\r\n\r\n"], ids=["whole", "without end"])
def test_a_crowd_whose_each_one_has_asked_keeps_no_stop_away(own: RunningStudio, ending: str) -> None:
    most, address = own.studio.access.limits.connections, ("127.0.0.1", int(own.url.rpartition(":")[2]))
    head = f"POST /stop HTTP/1.1\r\nHost: {address[0]}:{address[1]}\r\n"
    with contextlib.ExitStack() as crowd:
        for _ in range(most):
            each = crowd.enter_context(socket.create_connection(address, timeout=30))
            each.sendall((head + ending).encode())
            assert each.recv(1)
        with socket.create_connection(address, timeout=30) as asking:
            asking.sendall((head + "\r\n").encode())
            assert asking.recv(100).startswith(b"HTTP/1.1 403")


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
