"""The gateway over real sockets: hosts and boards that come, go and hang."""

from __future__ import annotations

import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator

import pytest
from tests.gateway.tcp_boards import LONG, Running, tcp_boards
from tests.link.far_ends import free_port

from hexwire.drivers.hex7bot import Hex7BotDriver
from hexwire.errors import LinkError, LinkNotFoundError, ReplyTimeoutError, UsageError
from hexwire.gateway import service as module
from hexwire.gateway.service import GatewayService
from hexwire.ipc.session import Session
from hexwire.link.listener import Listener
from hexwire.link.open import make_link
from hexwire.wire.addresses import Broadcast
from hexwire.wire.command_frame import Command, Status


@pytest.fixture
def gateway() -> Iterator[Running]:
    with tcp_boards(2) as boards:
        running = Running(boards)
        yield running
        running.end()


def connect(gateway: Running) -> Session:
    session = Session.from_url(gateway.url)
    session.open()
    session.negotiate(look=False)

    def found() -> bool:
        # A broadcast for who is there takes all of its time, so that it is short.
        session.request_all(Command.IDENTIFY, window=0.3, attempts=1)
        return session.modules == {8, 9}

    wait(found)
    return session


def hang_up(session: Session) -> None:
    """End the connection as a machine that crashed does: by a reset."""
    link = session.ipc.link
    connected = link._stream.socket  # type: ignore[attr-defined]  # the socket itself
    connected.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    session.close()


def wait(condition: Callable[[], bool]) -> None:
    end = time.monotonic() + LONG
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


def test_a_driver_reaches_the_board_that_its_address_names(gateway: Running) -> None:
    with Hex7BotDriver.from_url(f"{gateway.url}?to=9") as arm:
        arm.torque(True)
        assert arm.read().torque_on == arm.model.names
        ready = [any(j.torque_on for j in board.state.joints) for board in gateway.boards.boards]
        assert ready == [False, True]
    # What its end stops is stopped when the gateway has ended.
    gateway.end()
    assert gateway.boards.stopped() == [False, False], "it has left in order"


def test_one_frame_stops_all(gateway: Running) -> None:
    session = connect(gateway)
    answers = session.request_all(Command.STOP, b"\0", Broadcast())
    assert {m: r.status for m, r in answers.replies.items()} == {8: Status.OK, 9: Status.OK}
    assert gateway.boards.stopped() == [True, True]
    session.close()


def test_a_link_that_breaks_stops_every_board(gateway: Running) -> None:
    hang_up(connect(gateway))
    gateway.boards.wait_until_stopped(0, 1)


def test_a_host_that_dies_during_a_motion_stops_every_board(gateway: Running) -> None:
    session = connect(gateway)
    session.request(Command.WATCHDOG, b"\x60\xea\0")
    session.close()
    gateway.boards.wait_until_stopped(0, 1)


def test_the_end_of_the_gateway_stops_what_its_host_has_not_ended(gateway: Running) -> None:
    session = connect(gateway)
    session.request(Command.WATCHDOG, b"\x60\xea\0")
    gateway.end()
    gateway.boards.wait_until_stopped(0, 1)
    session.close()


def test_there_is_one_host_at_a_time(gateway: Running) -> None:
    session = connect(gateway)
    second = Session.from_url(gateway.url)
    second.open()
    with pytest.raises(LinkError):
        second.negotiate(look=False, boot_window=LONG)
    second.close()
    assert session.request(Command.STATS).status == Status.OK
    session.close()


def test_bytes_before_its_end_do_not_let_a_host_keep_the_next_one_out() -> None:
    """As after a stall of the gateway, in which one program has ended and another one has begun."""
    service = GatewayService(Listener(), {8: make_link(f"tcp://127.0.0.1:{free_port()}")}, local=8)
    service.open()
    url = service.url.replace("-listen", "")
    try:
        with make_link(url) as first:
            wait(lambda: (service.run_once(), service._host is not None)[1])
            first.write(b"x")
        with make_link(url) as second:
            for _ in range(2):
                service.run_once()
            # Else the end of its line would be read.
            assert second.read(time.monotonic() + 0.1) == b""
    finally:
        service.close()


def test_a_lost_board_is_silence_and_comes_back(gateway: Running) -> None:
    session = connect(gateway)
    gateway.boards.unplug(1)
    wait(lambda: not gateway.service.machine.lines[9].up)
    answers = session.request_all(Command.STOP, b"\0", attempts=1)
    assert (list(answers.replies), answers.silent) == ([8], {9})
    gateway.boards.plug_in(1)
    gateway.boards.wait_until_stopped(1)
    assert not session.request_all(Command.STATS).silent
    session.close()


def test_a_gateway_starts_without_its_boards(gateway: Running) -> None:
    gateway.boards.unplug(0)
    wait(lambda: not gateway.service.machine.lines[8].up)
    session = Session.from_url(gateway.url)
    session.open()
    with pytest.raises(ReplyTimeoutError):
        session.negotiate(look=False, boot_window=0.3)
    session.close()


def test_a_link_that_opens_while_the_gateway_ends_is_closed_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_OPEN_AGAIN", 0.02)
    with tcp_boards(1) as boards:
        link = make_link(boards.urls[0])
        service = GatewayService(Listener(), {8: link}, local=8)
        opens, closes = link.open, link.close
        tried, closed = threading.Event(), threading.Event()

        def missing() -> None:
            raise LinkNotFoundError("it is not there yet")

        def slow() -> None:
            tried.set()
            assert closed.wait(LONG)
            opens()

        def close() -> None:
            closes()
            closed.set()

        monkeypatch.setattr(link, "open", missing)
        service.open()
        monkeypatch.setattr(link, "open", slow)
        wait(lambda: (service.run_once(), tried.is_set())[1])
        monkeypatch.setattr(link, "close", close)
        service.close()
        assert not link.is_open


@pytest.mark.parametrize("url", ["mq:///arm", "udp://127.0.0.1:15040"])
def test_a_link_of_messages_is_refused(url: str) -> None:
    with pytest.raises(UsageError, match="serial or TCP"):
        GatewayService(Listener(), {8: make_link(url)}, local=8)
