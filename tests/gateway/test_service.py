"""The gateway over real sockets: hosts and boards that come, go and hang."""

from __future__ import annotations

import select
import socket
import struct
import threading
import time
from collections.abc import Iterator

import pytest
from click.testing import CliRunner
from tests.defaults import default
from tests.gateway.tcp_boards import LONG, Running, connect_to, tcp_boards, wait
from tests.link.far_ends import free_port

from hexwire.cli.main import cli
from hexwire.drivers.hex7bot import Hex7BotDriver
from hexwire.errors import LinkBusyError, LinkNotFoundError, ReplyTimeoutError, UsageError
from hexwire.gateway import service as module
from hexwire.gateway.service import GatewayService
from hexwire.ipc.session import Session
from hexwire.link.listener import Listener
from hexwire.link.open import make_link
from hexwire.model.state import JointTarget
from hexwire.session.policy import RetryPolicy
from hexwire.wire.addresses import Broadcast
from hexwire.wire.command_frame import Command, Status


@pytest.fixture(autouse=True)
def _patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Boards and gateway are threads of this process: they may wait for a busy machine."""
    default(monkeypatch, RetryPolicy, attempts=150)


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
        answers = session.request_all(Command.IDENTIFY, window=0.3, attempts=1)
        return session.modules == {8, 9} and not answers.silent

    wait(found)
    # From now on they are its own.
    assert not session.request_all(Command.STATS).silent
    return session


def hang_up(session: Session) -> None:
    """End the connection as a machine that crashed does: by a reset."""
    link = session.ipc.link
    connected = link._stream.socket  # type: ignore[attr-defined]  # the socket itself
    connected.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    session.close()


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


def test_two_drivers_in_one_program_have_a_board_each(gateway: Running) -> None:
    with Hex7BotDriver.from_url(f"{gateway.url}?to=8") as one, Hex7BotDriver.from_url(f"{gateway.url}?to=9") as two:
        one.torque(True)
        two.torque(True)
        for arm, angle in ((one, 0.2), (two, -0.2)):
            arm.watchdog(5.0)
            arm.write(JointTarget.of({"J4": angle}, duration=0.3))
        wait(lambda: [round(arm.read()["J4"].position, 1) for arm in (one, two)] == [0.2, -0.2])
        # The end of one stops nothing of the other.
        one.watchdog(0.0)
        one.detach()
        assert two.read().torque_on == two.model.names
        assert gateway.boards.stopped() == [False, False]
        # And a program that dies is the matter of its own board alone.
        dies = connect_to(f"{gateway.url}?to=8")
        dies.request(Command.WATCHDOG, b"\x60\xea\0")
        hang_up(dies)
        gateway.boards.wait_until_stopped(0)
        assert gateway.boards.stopped() == [True, False]
        two.watchdog(0.0)


def test_a_second_host_of_a_board_is_told_why_it_may_not_enter(gateway: Running) -> None:
    session = connect_to(f"{gateway.url}?to=8")
    host = session.ipc.link._stream.socket.getsockname()  # type: ignore[attr-defined]  # the socket itself
    with pytest.raises(LinkBusyError, match=f"module 8 has another host, 127.0.0.1:{host[1]}"):
        connect_to(f"{gateway.url}?to=8")
    # It can stop the board all the same, by the command that the error names.
    done = CliRunner().invoke(cli, ["stop", "--all", "--port", gateway.url], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    assert gateway.boards.stopped() == [True, True]
    assert session.request(Command.STATS).status == Status.OK
    session.close()
    connect_to(f"{gateway.url}?to=8").close()


def test_bytes_before_its_end_do_not_let_a_host_keep_the_next_one_out() -> None:
    """As after a stall of the gateway, in which one program has ended and another one has begun."""
    service = GatewayService(Listener(), {8: make_link(f"tcp://127.0.0.1:{free_port()}")}, local=8)
    service.open()
    url = service.url.replace("-listen", "")
    try:
        with make_link(url) as first:
            wait(lambda: (service.run_once(), bool(service._guests))[1])
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

    def only_the_other_hears() -> bool:
        # One that is lost takes all of the time, so that it is short.
        answers = session.request_all(Command.STOP, b"\0", attempts=1)
        assert 9 in answers.silent
        return list(answers.replies) == [8]

    wait(only_the_other_hears)
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
        before: list[str] = []
        service = GatewayService(Listener(), {8: link}, local=8, before_open=lambda link: before.append(link.url))
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
        assert before == [link.url] * 2, "before each attempt"
        monkeypatch.setattr(link, "close", close)
        service.close()
        assert not link.is_open


@pytest.mark.parametrize("url", ["mq:///arm", "udp://127.0.0.1:15040"])
def test_a_link_of_messages_is_refused(url: str) -> None:
    with pytest.raises(UsageError, match="serial or TCP"):
        GatewayService(Listener(), {8: make_link(url)}, local=8)


class Talker:
    """The link of a host that has sent several pieces, and is gone."""

    peer = "somewhere"
    closed = False

    def __init__(self, pieces: list[bytes]) -> None:
        self.pieces = pieces

    def read(self, deadline: float | None) -> bytes:
        return self.pieces.pop(0) if self.pieces else b""

    def leftovers(self) -> Iterator[None]:
        while self.pieces:
            yield

    def write(self, data: bytes, deadline: float | None = None) -> None:
        raise LinkNotFoundError("it is gone")

    def close(self) -> None:
        self.closed = True

    def fileno(self) -> int:
        return 5


@pytest.mark.parametrize("stale", [False, True])
def test_all_that_a_host_has_sent_is_as_old_as_its_first_byte(monkeypatch: pytest.MonkeyPatch, stale: bool) -> None:
    service = GatewayService(None, {8: make_link("tcp://127.0.0.1:1")}, local=8)
    taken: list[tuple[bytes, bool]] = []
    monkeypatch.setattr(
        service.machine, "receive_host", lambda host, data, now, *, stale=False: taken.append((data, stale))
    )
    host = service.machine.host_came("a host")
    guest = module._Guest(3, Talker([b"one", b"two"]), host)  # type: ignore[arg-type]
    service._host_round(guest, stale=stale)
    assert taken == [(b"one", stale), (b"two", stale)]


def test_a_board_that_is_not_there_is_looked_for_again_after_a_while(monkeypatch: pytest.MonkeyPatch) -> None:
    link = make_link("tcp://127.0.0.1:1")
    service = GatewayService(None, {8: link}, local=8)
    there, tries, back = [False], list[float](), list[float]()

    def look() -> None:
        tries.append(now)
        if not there[0]:
            raise LinkNotFoundError("it is not there yet")

    monkeypatch.setattr(link, "open", look)
    (board,) = service._boards.values()
    monkeypatch.setattr(board.line, "back", back.append)
    service._waker.open()
    board.again_at, times = 5.0, [4.9, 5.0, 5.1, 5.2, 5.1 + module._OPEN_AGAIN, 6.0 + module._OPEN_AGAIN]
    for now in times:
        there[0] = now > 5.2
        service._look_for(board, now)
        if board.opener is not None:
            board.opener.join(LONG)
        assert bool(select.select([service._waker.fileno()], [], [], 0.0)[0]) == bool(tries), (
            "it is told of the end"
        )
    service._waker.close()
    # At the second time it is tried, at the third that has failed, and at the fifth it is tried again.
    assert tries == [times[1], times[4]]
    assert back == [times[5]]


def test_a_host_that_cannot_be_answered_is_broken(monkeypatch: pytest.MonkeyPatch) -> None:
    service = GatewayService(None, {8: make_link("tcp://127.0.0.1:1")}, local=8)
    guests = {fd: module._Guest(fd, Talker([]), service.machine.host_came(str(fd))) for fd in (3, 4)}  # type: ignore[arg-type]
    service._guests = dict(guests)
    gone: list[tuple[str, bool]] = []
    monkeypatch.setattr(
        service.machine, "host_gone", lambda host, now, *, broken: gone.append((host.name, broken)) or []
    )
    monkeypatch.setattr(service.machine, "host_data", lambda host: b"x" if host.name == "3" else b"")
    for guest in guests.values():
        service._to_host(guest)
    assert gone == [("3", True)]
    assert list(service._guests) == [4]


def test_one_host_too_many_takes_the_place_of_one_without_a_board(monkeypatch: pytest.MonkeyPatch) -> None:
    service = GatewayService(None, {8: make_link("tcp://127.0.0.1:1")}, local=8)
    links = {fd: Talker([]) for fd in (3, 4)}
    service._guests = {
        fd: module._Guest(fd, link, service.machine.host_came(str(fd)))  # type: ignore[arg-type]
        for fd, link in links.items()
    }
    service.machine._held[8] = service._guests[3].host
    monkeypatch.setattr(module, "_MOST_HOSTS", 2)
    caller = Talker([])

    class Door:
        url = "tcp://127.0.0.1:2"

        def accept(self, now: float) -> Talker:
            return caller

    service._let_in(Door())  # type: ignore[arg-type]
    assert list(service._guests) == [3, 5]
    assert (links[3].closed, links[4].closed, caller.closed) == (False, True, False)
