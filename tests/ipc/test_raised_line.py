from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest
from tests.waits import PATIENCE

from hexwire.emulator.board import EmulatedBoard, make_hex7bot_board
from hexwire.emulator.serve import BoardLink, FakeClock, PacedLine
from hexwire.errors import ReplyTimeoutError, UsageError
from hexwire.ipc import raised_line
from hexwire.ipc.handle import IpcHandle
from hexwire.ipc.session import Session
from hexwire.wire.command_frame import Command, Status

OWN, FAST = 115_200, 500_000
STILL = (FAST).to_bytes(4, "little")


class RatedLink(BoardLink):
    """A serial port in simulated time whose bytes arrive as others unless both ends have one rate.

    Attributes:
        most: The highest rate at which the line works.
        limit: The highest rate of the port.
        lost: Called with the bytes of each end; returns those that arrive.
    """

    def __init__(self, board: EmulatedBoard, clock: FakeClock, raise_to: int = FAST) -> None:
        super().__init__(board, clock, baud=OWN)
        self.url = "serial:///dev/ttyUSB7?baud=115200"
        self.baud, self.raise_to, self.most, self.limit = OWN, raise_to, 10**7, 10**7
        self.board = board
        self.rates: list[int] = []
        self.deaf: Callable[[bytes], bool] = lambda data: False

    def set_rate(self, baud: int) -> None:
        if baud > self.limit:
            raise UsageError(f"/dev/ttyUSB7 cannot do {baud} baud")
        self.baud = baud
        self.rates.append(baud)
        self._to_board, self._to_host = PacedLine(baud), PacedLine(baud)

    def _passed(self, data: bytes) -> bytes:
        good = self.baud == self.board.host_rate <= self.most
        return data if good else bytes(byte ^ 0x5B for byte in data)

    def write(self, data: bytes, deadline: float | None = None) -> None:
        super().write(self._passed(data), deadline)

    def read(self, deadline: float | None) -> bytes:
        data = self._passed(super().read(deadline))
        return b"" if self.deaf(data) else data


@contextmanager
def line(raise_to: int = FAST, *, host_rate: int = OWN) -> Iterator[tuple[Session, RatedLink]]:
    """A session on a line with a rate; not negotiated."""
    clock = FakeClock(1000.0)
    board = make_hex7bot_board(start=clock.time, baud=OWN, host_rate=host_rate)
    link = RatedLink(board, clock, raise_to)
    with Session(IpcHandle.from_link(link)) as session:
        yield session, link


@pytest.fixture(autouse=True)
def no_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    """In simulated time nothing happens by itself."""
    monkeypatch.setattr(raised_line.RaisedLine, "_keep", lambda self: None)


def warnings(caplog: pytest.LogCaptureFixture) -> list[str]:
    return [record.getMessage() for record in caplog.records if record.levelno >= logging.WARNING]


def test_the_rate_is_raised_once_the_board_is_known(caplog: pytest.LogCaptureFixture) -> None:
    with line() as (session, link):
        session.negotiate()
        assert (link.baud, link.board.host_rate) == (FAST, FAST)
        assert session.request(Command.STATS).status == Status.OK
        # A stop is found by the address.
        assert link.url == "serial:///dev/ttyUSB7?baud=115200"
    assert not warnings(caplog)


def test_nothing_is_asked_without_the_option() -> None:
    for wanted in (0, OWN):
        with line(wanted) as (session, link):
            session.negotiate()
            assert (link.baud, link.board.host_rate, link.rates) == (OWN, OWN, [])


def test_the_next_program_finds_the_board_at_its_own_rate() -> None:
    with line() as (session, link):
        session.negotiate()
        session.close()
        assert link.baud == OWN
        link.clock.advance(0.02)
        link.board.step(link.clock.time)
        assert link.board.host_rate == OWN


def stays(session: Session, link: RatedLink, caplog: pytest.LogCaptureFixture, why: str) -> None:
    """The session goes on at the board's own rate, and says why in one line."""
    session.negotiate()
    assert (link.baud, link.board.host_rate) == (OWN, OWN)
    assert session.request(Command.STATS, attempts=1).status == Status.OK
    assert warnings(caplog) == [
        f"serial:///dev/ttyUSB7: the rate stays at {OWN} baud instead of {link.raise_to}: {why}"
    ]


def test_a_board_that_cannot(caplog: pytest.LogCaptureFixture) -> None:
    with line(host_rate=0) as (session, link):
        link.board.line_rate.now = OWN
        stays(session, link, caplog, "the board cannot change it")


def test_a_rate_that_the_board_refuses(caplog: pytest.LogCaptureFixture) -> None:
    with line(921_600) as (session, link):
        stays(session, link, caplog, "the board refuses it (bad range)")


def test_an_arm_that_moves(caplog: pytest.LogCaptureFixture) -> None:
    with line() as (session, link):
        link.raise_to = 0
        session.negotiate()
        session.request(Command.TORQUE, b"\1\x7f\0")
        session.request(Command.JOINT_MOVE, (3000).to_bytes(2, "little") + b"\1\0" + (2300).to_bytes(2, "little"))
        link.clock.advance(0.3)
        link.raise_to = FAST
        stays(session, link, caplog, "something moves")


def test_a_port_that_cannot(caplog: pytest.LogCaptureFixture) -> None:
    with line() as (session, link):
        link.limit = OWN
        stays(session, link, caplog, f"/dev/ttyUSB7 cannot do {FAST} baud")


def test_a_line_that_does_not_hold_the_rate(caplog: pytest.LogCaptureFixture) -> None:
    with line() as (session, link):
        link.most = OWN
        stays(session, link, caplog, "15 of 15 exchanges failed")


def test_a_line_that_holds_it_almost(caplog: pytest.LogCaptureFixture) -> None:
    """One exchange lost of fifteen is too many."""
    answers = []

    def sometimes(data: bytes) -> bool:
        answers.append(data)
        return link.baud == FAST and len(answers) % 12 == 0 and bool(data)

    with line() as (session, link):
        link.deaf = sometimes
        session.negotiate()
        assert link.baud == OWN
        assert len(warnings(caplog)) == 1
        assert "of 15 exchanges failed" in warnings(caplog)[0]


def test_an_answer_that_is_lost(caplog: pytest.LogCaptureFixture) -> None:
    """The board has raised its rate, the host has not heard that: it waits until the board is back."""
    with line() as (session, link):
        link.deaf = lambda data: link.board.line_rate.changing or link.board.host_rate != OWN
        stays(session, link, caplog, "the board did not answer the request for it")


def test_a_board_that_answers_at_neither_rate() -> None:
    with line() as (session, link):
        link.deaf = lambda data: bool(link.rates)
        with pytest.raises(ReplyTimeoutError):
            session.negotiate()


def test_a_board_that_was_reset_is_asked_at_its_own_rate(caplog: pytest.LogCaptureFixture) -> None:
    with line() as (session, link):
        session.negotiate()
        link.board.reset(link.clock.time)
        link.clock.advance(0.3)
        # At the third try, before the request counts as lost.
        reply = session.request(Command.STATS)
        assert (reply.status, reply.attempts, link.baud) == (Status.OK, 3, OWN)
        assert session.request(Command.STATS).attempts == 1
        assert warnings(caplog) == [
            f"serial:///dev/ttyUSB7: the board is back at {OWN} baud: it was reset, or this program stalled"
        ]


def test_a_stop_after_a_stall_reaches_the_board() -> None:
    with line() as (session, link):
        session.negotiate()
        session.request(Command.TORQUE, b"\1\x7f\0")
        # Nothing is sent for five seconds, as when this program is suspended.
        link.clock.advance(5.0)
        assert session.request(Command.STOP, b"\1").body[1:] == b"\x7f\0"
        assert not any(servo.torque_on for servo in link.board.wire.servos)


def test_one_lost_answer_does_not_lower_the_rate() -> None:
    lost = [True]
    with line() as (session, link):
        session.negotiate()
        link.deaf = lambda data: bool(data) and bool(lost) and lost.pop()
        reply = session.request(Command.STATS)
        assert (reply.status, reply.attempts, link.baud) == (Status.OK, 2, FAST)


def test_a_lost_port_is_opened_at_its_own_rate() -> None:
    with line() as (session, link):
        session.negotiate()
        assert link.baud == FAST
        link.board.reset(link.clock.time)
        session._forget_rate()
        session.ipc.close()
        assert link.baud == OWN
        session.open()
        session.negotiate()
        assert link.baud == FAST


def test_a_thread_keeps_the_rate_that_was_raised(monkeypatch: pytest.MonkeyPatch) -> None:
    begun = threading.Event()
    monkeypatch.setattr(raised_line.RaisedLine, "_keep", lambda self: begun.set())
    with line() as (session, _):
        session.negotiate()
        assert begun.wait(PATIENCE)


def test_the_rate_is_kept_while_nothing_else_is_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    """The loop of the thread, with its waits counted instead of waited for."""
    monkeypatch.undo()
    monkeypatch.setattr(
        raised_line.threading, "Thread", lambda **_: type("Never", (), {"start": lambda self: None})()
    )
    with line() as (session, link):
        session.negotiate()
        kept = session._raised
        assert kept is not None
        rounds = iter((0.5, 0.5, 0.5, 0.5, 0.5, 0.5))

        def wait(timeout: float) -> bool:
            if (step := next(rounds, None)) is None:
                return True
            link.clock.advance(step)
            return False

        monkeypatch.setattr(kept._ended, "wait", wait)
        link.written.clear()
        kept._keep()
        asked = [data for data in link.written if data[38] == Command.HOST_BAUD]
        assert len(asked) >= 3
        assert {data[40:44] for data in asked} == {STILL}
        assert link.board.host_rate == FAST
