"""The gateway over real queues: hosts that come, go, and let go of the queue without a word."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable, Iterator

import posix_ipc
import pytest
from tests.defaults import default
from tests.gateway.tcp_boards import Running, connect_to, tcp_boards, wait

from hexwire.drivers.hex7bot import Hex7BotDriver
from hexwire.errors import LinkBusyError, LinkError, UsageError
from hexwire.gateway.service import GatewayService
from hexwire.ipc.connections import random_number
from hexwire.ipc.session import Session
from hexwire.link.listener import Listener
from hexwire.link.mqueue import QueueLink
from hexwire.link.open import make_link
from hexwire.model.state import JointTarget
from hexwire.session.policy import RetryPolicy
from hexwire.wire.command_frame import Command, Status

A_MINUTE = b"\x60\xea\0"
_numbers = itertools.count()


def queue_name() -> str:
    return f"hexwire-gateway-{os.getpid()}-{next(_numbers)}"


def make_queue() -> QueueLink:
    # Few messages: the system limits the memory that all queues of a user take together.
    return QueueLink(queue_name(), server=True, unlink=True, depth=3)


@pytest.fixture(autouse=True)
def _patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Boards and gateway are threads of this process: they may wait for a busy machine."""
    default(monkeypatch, RetryPolicy, attempts=150)


@pytest.fixture
def queues() -> list[QueueLink]:
    return [make_queue(), make_queue()]


@pytest.fixture
def gateway(queues: list[QueueLink]) -> Iterator[Running]:
    with tcp_boards(2) as boards:
        running = Running(boards, queues)
        yield running
        running.end()


def url(queue: QueueLink, module: int) -> str:
    return f"{queue.url.partition('?')[0]}?to={module}"


def test_a_driver_moves_the_board_that_its_address_names(gateway: Running, queues: list[QueueLink]) -> None:
    for module, moved in ((9, [0.0, 0.2]), (8, [0.2, 0.2])):
        with Hex7BotDriver.from_url(url(queues[0], module)) as arm:
            before = arm.read()["J4"].position
            arm.torque(True)
            arm.write(JointTarget.of({"J4": before + 0.2}, duration=0.3))
            wait(lambda arm=arm, before=before: round(arm.read()["J4"].position - before, 1) == 0.2)  # type: ignore[misc]
            arm.detach()
        on = [any(j.torque_on for j in board.state.joints) for board in gateway.boards.boards]
        assert on == [bool(turned) for turned in moved]
        assert gateway.boards.stopped() == [False, False]


def test_a_stop_reaches_the_board(gateway: Running, queues: list[QueueLink]) -> None:
    with Hex7BotDriver.from_url(url(queues[0], 9)) as arm:
        arm.torque(True)
        arm.stop()
        assert gateway.boards.stopped() == [False, True]
        arm.resume()
        assert gateway.boards.stopped() == [False, False]


def test_a_host_that_lets_go_of_the_queue_in_the_middle_stops_its_board(
    gateway: Running, queues: list[QueueLink]
) -> None:
    session = connect_to(url(queues[0], 9))
    session.request(Command.WATCHDOG, A_MINUTE)
    session.close()
    gateway.boards.wait_until_stopped(1)
    assert gateway.boards.stopped() == [False, True]


def test_a_host_that_takes_the_queue_at_once_after_another_finds_the_boards_free(
    gateway: Running, queues: list[QueueLink]
) -> None:
    for module in (8, 9, 8, 9):
        session = connect_to(url(queues[0], module))
        assert session.request(Command.STATS).status == Status.OK
        session.close()
    assert gateway.boards.stopped() == [False, False]


def test_the_end_of_the_gateway_stops_what_a_host_has_left(gateway: Running, queues: list[QueueLink]) -> None:
    session = connect_to(url(queues[0], 8))
    session.request(Command.WATCHDOG, A_MINUTE)
    gateway.end()
    gateway.boards.wait_until_stopped(0)
    session.close()


def test_a_second_host_is_told_why_it_may_not_enter(gateway: Running, queues: list[QueueLink]) -> None:
    session = connect_to(url(queues[0], 8))
    with pytest.raises(LinkBusyError, match=f"{queues[0].name} already has a client: this program"):
        connect_to(url(queues[0], 9))
    # By another door: the board is taken, and by whom.
    for other in (f"{gateway.url}?to=8", url(queues[1], 8)):
        with pytest.raises(LinkBusyError, match=rf"module 8 has another host, mq://{queues[0].name}, this program"):
            connect_to(other)
    two = connect_to(url(queues[1], 9))
    two.request(Command.WATCHDOG, A_MINUTE)
    # The end of one is not that of the other.
    session.request(Command.WATCHDOG, A_MINUTE)
    session.close()
    gateway.boards.wait_until_stopped(0)
    assert gateway.boards.stopped() == [True, False]
    two.request(Command.WATCHDOG, b"\0\0\0")
    two.close()


def test_two_drivers_of_one_queue_have_a_board_each() -> None:
    with tcp_boards(2) as boards:
        queue = make_queue()
        running = Running(boards, [queue, queue.make_further(2)])
        try:
            assert running.service.urls.count(f"mq://{queue.name}") == 1
            nine = Hex7BotDriver.from_url(url(queue, 9))
            eight = Hex7BotDriver.from_url(url(queue, 8))
            with nine, eight:
                before = [arm.read()["J4"].position for arm in (eight, nine)]
                for arm, place in zip((eight, nine), before, strict=True):
                    arm.torque(True)
                    arm.write(JointTarget.of({"J4": place + 0.2}, duration=0.3))
                for arm, place in zip((eight, nine), before, strict=True):
                    wait(lambda arm=arm, place=place: round(arm.read()["J4"].position - place, 1) == 0.2)  # type: ignore[misc]
                with pytest.raises(LinkBusyError, match=f"{queue.name} already has a client: this program"):
                    connect_to(url(queue, 8))
                nine.session.request(Command.WATCHDOG, A_MINUTE)
                nine.session.close()
                # The end of one is not that of the other, and makes room for the next.
                boards.wait_until_stopped(1)
                assert boards.stopped() == [False, True]
                with pytest.raises(
                    LinkBusyError, match=rf"module 8 has another host, mq://{queue.name}, this program"
                ):
                    connect_to(url(queue, 8))
                session = connect_to(url(queue, 9))
                assert session.request(Command.RESUME).status == Status.OK
                session.close()
        finally:
            running.end()


def test_a_further_line_without_a_server_is_not_taken() -> None:
    queue = make_queue()
    left = queue.make_further(2)
    with queue, QueueLink(queue.name):
        left.open()
        with QueueLink(queue.name):
            pass
        # As after a server that was killed: its queues stay.
        left._unlink = False
        left.close()
        with pytest.raises(LinkBusyError, match="already has a client"):
            QueueLink(queue.name).open()
        left._unlink = True
        with left:
            pass


class Ended:
    """The server's end of a queue whose host ends at a moment of the test's choice."""

    def __init__(self, link: QueueLink, end: Callable[[], None]) -> None:
        self._link, self._end = link, end

    def __getattr__(self, name: str) -> object:
        return getattr(self._link, name)

    def other_end(self) -> str:
        """Everything that it has sent is there before it is seen to have gone."""
        self._end()
        return self._link.other_end()


def test_where_the_system_has_no_room_a_queue_has_fewer_lines(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    queue = make_queue()
    further = queue.make_further(2)

    def full() -> None:
        raise LinkError("this user's memory for queues is used up (ulimit -q)", url=further.url)

    monkeypatch.setattr(further, "_open", full)
    with tcp_boards(1) as boards:
        # Whichever it is, the others are opened.
        running = Running(boards, [further, queue])
        connect_to(url(queue, 8)).close()
        running.end()
    assert "fewer hosts at once: this user's memory for queues is used up" in caplog.text


def test_what_a_host_has_sent_before_its_end_still_counts() -> None:
    with tcp_boards(1) as boards:
        link = make_queue()
        sent: list[Session] = []

        def end() -> None:
            if sent:
                sent[0].send(Command.STOP, b"\0")
                sent.pop().close()

        running = Running(boards, [Ended(link, end)])  # type: ignore[list-item]  # by __getattr__
        session = connect_to(url(link, 8))
        sent.append(session)
        boards.wait_until_stopped(0)
        running.end()


def test_a_queue_without_room_for_a_frame_is_refused() -> None:
    link = QueueLink(queue_name(), server=True, unlink=True, size=1000)
    service = GatewayService(
        None, {8: make_link("tcp://127.0.0.1:1")}, local=8, queues=[link], numbers=random_number
    )
    with pytest.raises(UsageError, match="messages of 1000 bytes; a gateway needs 8192"):
        service.open()
    service.close()
    with pytest.raises(posix_ipc.ExistentialError):
        posix_ipc.unlink_message_queue(link.name + ".tx")


def test_it_says_where_it_listens() -> None:
    link = make_queue()
    service = GatewayService(Listener(), {8: make_link("tcp://127.0.0.1:1")}, local=8, queues=[link])
    assert service.urls == [service.url, f"mq://{link.name}"]
