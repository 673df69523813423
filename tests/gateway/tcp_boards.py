"""Emulated boards on TCP ports of this machine, served by one thread, and a gateway to them in another."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from hexwire.emulator.board import EmulatedBoard, make_hex7bot_board
from hexwire.emulator.serve_tcp import TcpServer
from hexwire.gateway.service import GatewayService
from hexwire.ipc.connections import random_number
from hexwire.ipc.session import Session
from hexwire.link.listener import Listener
from hexwire.link.mqueue import QueueLink
from hexwire.link.open import make_link

LONG = 30.0
ARDUINO = 8


def wait(condition: Callable[[], bool]) -> None:
    """Wait for what other threads do."""
    end = time.monotonic() + LONG
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


def connect_to(address: str) -> Session:
    """A host at an address of a gateway; raises as `negotiate`."""
    session = Session.from_url(address)
    session.open()
    try:
        session.negotiate(look=False, boot_window=LONG)
    except BaseException:
        session.close()
        raise
    return session


class TcpBoards:
    """Boards, each on a port of its own.

    Attributes:
        boards: The boards.
        urls: Their addresses.
    """

    def __init__(self, count: int) -> None:
        self.boards: list[EmulatedBoard] = [make_hex7bot_board(start=time.monotonic()) for _ in range(count)]
        self.servers: list[TcpServer | None] = [TcpServer(board, "127.0.0.1", 0) for board in self.boards]
        self.urls = [server.open() for server in self.servers if server is not None]
        self.doing = threading.Lock()

    def serve_once(self) -> None:
        with self.doing:
            for server in self.servers:
                if server is not None:
                    server.run_once(0.002)

    def unplug(self, index: int) -> None:
        """Close the port of a board."""
        with self.doing:
            server, self.servers[index] = self.servers[index], None
            assert server is not None
            server.close()

    def plug_in(self, index: int) -> None:
        """Open it again."""
        port = int(self.urls[index].rpartition(":")[2])
        with self.doing:
            server = TcpServer(self.boards[index], "127.0.0.1", port)
            server.open()
            self.servers[index] = server

    def stopped(self) -> list[bool]:
        return [board.state.stopped for board in self.boards]

    def wait_until_stopped(self, *indexes: int) -> None:
        wait(lambda: all(self.boards[i].state.stopped for i in indexes))


@contextmanager
def tcp_boards(count: int) -> Iterator[TcpBoards]:
    """Boards that are served as long as the context lasts."""
    boards = TcpBoards(count)
    ended = threading.Event()

    def serve() -> None:
        while not ended.is_set():
            boards.serve_once()

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield boards
    finally:
        ended.set()
        thread.join(LONG)
        for server in boards.servers:
            if server is not None:
                server.close()


class Running:
    """A gateway in a thread, with the boards."""

    def __init__(self, boards: TcpBoards, queues: Sequence[QueueLink] = ()) -> None:
        self.boards = boards
        links = {number: make_link(url) for number, url in enumerate(boards.urls, ARDUINO)}
        self.service = GatewayService(Listener(), links, local=ARDUINO, queues=queues, numbers=random_number)
        self.service.open()
        self.url = self.service.url.replace("-listen", "")
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        self.service.run(self._ended.is_set)
        self.service.close()

    def end(self) -> None:
        self._ended.set()
        self._thread.join(LONG)
        assert not self._thread.is_alive()
