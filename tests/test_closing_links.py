"""Connections of Zenoh, each of which would let a receiving thread wait in `close` if its computer vanished.

That nothing else arrives meanwhile shows only where a computer vanishes; here, that no connection would wait.
"""

from __future__ import annotations

import os
import socket
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import pytest
from tests.fleet.conftest import runtime  # noqa: F401  # a fixture
from tests.link.far_ends import free_port
from tests.waits import eventually

from hexwire import system
from hexwire.fleet.endpoints import endpoints_of, local_socket
from hexwire.fleet.network import Network, open_router_file
from hexwire.ros2.wire import RouterSettings


@contextmanager
def connected(port: int) -> Iterator[list[socket.socket]]:
    """This process's TCP sockets at a port and those connected to it, as copies."""
    with ExitStack() as stack:
        found = []
        for path in Path("/proc/self/fd").iterdir():
            # Any of them may be closed meanwhile. A copy of what is no socket would never be closed.
            with suppress(OSError):
                if not str(path.readlink()).startswith("socket:"):
                    continue
                end = stack.enter_context(socket.socket(fileno=os.dup(int(path.name))))
                if end.family == socket.AF_INET and port in (end.getsockname()[1], end.getpeername()[1]):
                    found.append(end)
        yield found


def waiting(port: int) -> list[bool]:
    """Of each of them, whether `close` would wait."""
    with connected(port) as ends:
        return [any(end.getsockopt(socket.SOL_SOCKET, socket.SO_LINGER, 8)[:4]) for end in ends]


def test_no_end_of_a_connection_of_the_fleet_waits_in_close() -> None:
    port = free_port()
    where = (f"tcp/127.0.0.1:{port}",)
    with ExitStack() as stack:
        router = Network(listen=where, router=True).open()
        stack.callback(router.close)
        for number in range(1, 4):
            stack.callback(Network(connect=where).open().close)
            eventually(lambda number=number: waiting(port) == [False] * 2 * number)


def test_no_connection_of_a_router_with_zenohs_own_settings_waits_in_close(tmp_path: Path) -> None:
    port = free_port()
    file = tmp_path / "router.json5"
    file.write_text(f'{{mode: "router", listen: {{endpoints: ["tcp/127.0.0.1:{port}"]}}}}')
    router, _ = open_router_file(str(file))
    client = Network(connect=(f"tcp/127.0.0.1:{port}",)).open()
    try:
        eventually(lambda: waiting(port) == [False] * 2)
    finally:
        client.close()
        router.close()


def test_no_connection_of_a_ros_node_waits_in_close() -> None:
    port = free_port()
    where = (f"tcp/127.0.0.1:{port}",)
    with ExitStack() as stack:
        stack.callback(Network(listen=where, router=True).open().close)
        for number in range(1, 3):
            stack.callback(RouterSettings(connect=where).open().close)
            eventually(lambda number=number: waiting(port) == [False] * 2 * number)


def test_a_session_of_this_machine_needs_no_look_at_its_connections(
    runtime: Path,  # noqa: F811
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(system, "close_at_once", lambda ports: pytest.fail("looked"))
    where = endpoints_of([local_socket("a")])
    server = Network(listen=where).open(wait=False)
    client = Network(connect=where).open()
    try:
        assert client.connections == 1
    finally:
        client.close()
        server.close()
