"""A megabyte there and back over every link, in fragments, with loss and disorder where a line has them."""

from __future__ import annotations

import random
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from far_ends import PtyEnd, free_port
from test_mqueue import name

from hexwire.ipc.connections import random_number
from hexwire.link.base import Link, LinkKind
from hexwire.link.certs import issue_certificate, make_authority
from hexwire.link.impair import ImpairedLink, Impairment
from hexwire.link.listen import TcpListenLink
from hexwire.link.memory import memory_pair
from hexwire.link.mqueue import QueueLink
from hexwire.link.serial import SerialLink
from hexwire.link.tcp import TcpLink
from hexwire.link.tls import TlsFiles
from hexwire.link.udp import UdpLink, UdpListenLink
from hexwire.session.connection import Connection, Role
from hexwire.session.events import Reply, Request, TimedOut
from hexwire.testing.link import Background
from hexwire.wire import tables
from hexwire.wire.command_frame import Command

__all__ = ["name"]

SIZE = 1_000_000
BODY = random.Random(1).randbytes(SIZE)
COMMAND = 0x55
# A slow machine may take long; a line that hangs takes for ever.
PATIENCE = 30.0


class End:
    """One side: a connection and the link it speaks over."""

    def __init__(self, role: Role, link: Link) -> None:
        local, remote = (7, 8) if role is Role.HOST else (8, 7)
        serial = isinstance(link, SerialLink | PtyEnd)
        self.link = link
        self.connection = Connection(
            role,
            local=local,
            remote=remote,
            type=3,
            max_frame=tables.MAX_SERIAL_FRAME if serial else tables.MAX_NETWORK_FRAME,
            numbers=random_number if link.kind is LinkKind.DATAGRAM else None,
        )

    def step(self) -> None:
        connection, link = self.connection, self.link
        for frame in connection.data_to_send():
            link.write(frame, time.monotonic() + PATIENCE)
        due = connection.next_timeout()
        soon = time.monotonic() + 0.05
        data = link.read(soon if due is None else min(due, soon))
        now = time.monotonic()
        if data:
            connection.receive(data, now, end_of_message=link.kind is LinkKind.DATAGRAM)
        if due is not None and now >= due:
            connection.handle_timeout(now)


@contextmanager
def echo_board(link: Link) -> Iterator[End]:
    """A board that sends each body back, in a thread of its own."""
    end, stop = End(Role.BOARD, link), threading.Event()

    def run() -> None:
        while not stop.is_set():
            end.step()
            while (event := end.connection.next_event()) is not None:
                if isinstance(event, Request):
                    end.connection.reply(event, 0, event.frame.body, time.monotonic())

    board = Background(run)
    try:
        yield end
    finally:
        stop.set()
        board.outcome()


def ask(end: End, body: bytes) -> Reply:
    if not end.connection.in_conversation:
        ask_for(end, Command.IDENTIFY, b"", window=0.2, attempts=100)
    return ask_for(end, COMMAND, body, window=PATIENCE, attempts=1)


def ask_for(end: End, command: int, body: bytes, *, window: float, attempts: int) -> Reply:
    ticket = end.connection.request(command, body, time.monotonic(), window=window, attempts=attempts)
    deadline = time.monotonic() + PATIENCE
    while time.monotonic() < deadline:
        end.step()
        while (event := end.connection.next_event()) is not None:
            if isinstance(event, Reply | TimedOut) and event.ticket == ticket:
                assert isinstance(event, Reply), event
                for frame in end.connection.data_to_send():
                    end.link.write(frame, time.monotonic() + PATIENCE)
                return event
    raise AssertionError(f"no answer; {end.connection.counters}")


def there_and_back(near: Link, far: Link) -> tuple[End, End]:
    host = End(Role.HOST, near)
    with echo_board(far) as board:
        assert ask(host, BODY).body == BODY
        assert ask(host, b"and a short one").body == b"and a short one"
    return host, board


def test_memory() -> None:
    for kind in LinkKind:
        near, far = memory_pair(kind)
        with near, far:
            there_and_back(near, far)


def test_serial(tmp_path: Path) -> None:
    with PtyEnd(tmp_path / "tty") as far, SerialLink(str(tmp_path / "tty")) as near:
        there_and_back(near, far)


def test_tcp() -> None:
    with TcpListenLink() as far, TcpLink("127.0.0.1", far.listener.port) as near:
        there_and_back(near, far)


def test_tls(tmp_path: Path) -> None:
    make_authority(tmp_path)
    server, client = (issue_certificate(tmp_path, kind, kind) for kind in ("server", "client"))
    ca = str(tmp_path / "ca.pem")
    with TcpListenLink(tls=TlsFiles(ca, str(server.cert), str(server.key))) as far:
        near = TcpLink("127.0.0.1", far.listener.port, tls=TlsFiles(ca, str(client.cert), str(client.key)))
        opener = Background(near.open)
        # Both ends have to be at it for the handshake.
        while far._peer is None:
            far._meet(time.monotonic() + PATIENCE)
        opener.outcome()
        there_and_back(near, far)
        near.close()


def test_message_queues(name: str) -> None:
    with QueueLink(name, server=True) as far, QueueLink(name) as near:
        there_and_back(near, far)


def test_udp() -> None:
    port = free_port(socket.SOCK_DGRAM)
    with UdpListenLink(port=port) as far, UdpLink("127.0.0.1", port) as near:
        there_and_back(near, far)


@pytest.mark.parametrize("seed", [1, 2])
def test_udp_with_loss_doubles_and_disorder(seed: int) -> None:
    port = free_port(socket.SOCK_DGRAM)
    bad = Impairment(drop=0.05, duplicate=0.05, reorder=0.05, flip=0.02, delay=0.05, delay_time=0.01)
    with (
        UdpListenLink(port=port) as far,
        ImpairedLink(UdpLink("127.0.0.1", port), sending=bad, receiving=bad, seed=seed) as near,
    ):
        host = End(Role.HOST, near)
        with echo_board(far):
            assert ask(host, BODY).body == BODY
        assert isinstance(near, ImpairedLink)
        for lane in (near.sent, near.received):
            counters = lane.counters
            assert min(counters.dropped, counters.duplicated, counters.reordered, counters.delayed) > 0


def test_a_stream_that_loses_bytes() -> None:
    near, far = memory_pair()
    bad = Impairment(split=0.2, drop=0.01, duplicate=0.01, flip=0.01)
    with far, ImpairedLink(near, sending=bad, receiving=bad, seed=5) as worse:
        host = End(Role.HOST, worse)
        with echo_board(far):
            assert ask(host, BODY[:200_000]).body == BODY[:200_000]
