"""The rounds of a gateway's loop: what is old after a halt of the program, and when a lost board is looked for."""

from __future__ import annotations

import logging
import math
import threading
from collections.abc import Iterator
from types import SimpleNamespace

import pytest
from tests.gateway.tcp_boards import LONG, wait
from tests.link.far_ends import free_port

from hexwire.errors import LinkNotFoundError
from hexwire.gateway import service as module
from hexwire.gateway.host import Host
from hexwire.gateway.service import GatewayService
from hexwire.link.base import Link
from hexwire.link.listener import Listener
from hexwire.link.open import make_link

HALT = module._STALL + module._IDLE


class Rounds:
    """A gateway whose board is not there.

    Attributes:
        heard: What the machine was given: bytes, and whether they are old.
        opened: How often the board's link was opened.
        may_open: Until it is set, opening waits.
    """

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.link = make_link(f"tcp://127.0.0.1:{free_port()}")
        self.opened, self.is_there = 0, False
        self.may_open = threading.Event()
        self.may_open.set()
        monkeypatch.setattr(self.link, "open", self._open)
        self.service = GatewayService(Listener(), {8: self.link}, local=8)
        self.service.open()
        (self.board,) = self.service._boards.values()
        self.heard: list[tuple[bytes, bool]] = []
        monkeypatch.setattr(self.service.machine, "receive_host", self._hear)

    def _open(self) -> None:
        assert self.may_open.wait(LONG)
        self.opened += 1
        if not self.is_there:
            raise LinkNotFoundError("it is not there")

    def _hear(self, host: Host, data: bytes, now: float, *, stale: bool = False) -> list[int]:
        self.heard.append((data, stale))
        return []

    def halt(self) -> None:
        """The next round comes a minute late."""
        self.service._round -= HALT + 60.0

    def until(self, what: bytes) -> None:
        """Rounds that are in time, however busy the machine is."""

        def came() -> bool:
            self.service._round = math.inf
            self.service.run_once()
            return b"".join(data for data, _ in self.heard) == what

        wait(came)


@pytest.fixture
def rounds(monkeypatch: pytest.MonkeyPatch) -> Iterator[Rounds]:
    rounds = Rounds(monkeypatch)
    yield rounds
    rounds.service.close()


@pytest.fixture
def host(rounds: Rounds) -> Iterator[Link]:
    with make_link(rounds.service.url.replace("-listen", "")) as link:
        wait(lambda: (rounds.service.run_once(), bool(rounds.service._guests))[1])
        yield link


def test_only_what_has_waited_during_a_halt_of_the_program_is_old(rounds: Rounds, host: Link) -> None:
    host.write(b"new")
    rounds.until(b"new")
    assert {stale for _, stale in rounds.heard} == {False}
    rounds.heard.clear()
    host.write(b"old")
    (guest,) = rounds.service._guests.values()
    wait(lambda: rounds.service._wait(rounds.service._round) >= {guest.fd})
    rounds.halt()
    rounds.service.run_once()
    assert rounds.heard == [(b"old", True)]
    rounds.heard.clear()
    host.write(b"new again")
    rounds.until(b"new again")
    assert {stale for _, stale in rounds.heard} == {False}


def test_all_that_has_waited_is_old_however_many_reads_it_takes(rounds: Rounds, host: Link) -> None:
    (guest,) = rounds.service._guests.values()
    parts = [b"a", b"b", b"c"]
    reads = iter([*parts, b""])
    rounds.service._wait = lambda until: set()  # type: ignore[method-assign]  # its socket is not ready
    guest.link.read = lambda deadline=None: next(reads)  # type: ignore[method-assign,assignment,misc]
    rounds.halt()
    rounds.service.run_once()
    assert rounds.heard == [(part, True) for part in parts]


@pytest.mark.parametrize(("halt", "old"), [(HALT - 0.001, False), (HALT + 0.001, True)])
def test_a_program_that_was_busy_for_a_moment_was_not_halted(
    rounds: Rounds, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, halt: float, old: bool
) -> None:
    caplog.set_level(logging.WARNING, logger="hexwire")
    caplog.clear()
    now = rounds.service._round + halt
    monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=lambda: now))
    rounds.board.again_at = now + 100.0
    rounds.service._wait = lambda until: set()  # type: ignore[method-assign]  # nothing has come
    rounds.service.run_once()
    assert ["suspended" in line for line in caplog.messages] == [True] * old
    rounds.service.run_once()
    assert len(caplog.messages) == old, "the next round was in time"


def test_a_round_waits_a_quarter_of_a_second_for_something_to_do(
    rounds: Rounds, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert rounds.service._wait(0.0) == set(), "with nothing to do"
    waits: list[float] = []
    monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=lambda: rounds.service._round))
    rounds.service._wait = lambda until: (waits.append(until - rounds.service._round), set())[1]  # type: ignore[method-assign,func-returns-value]
    rounds.service.run_once()
    assert waits == [pytest.approx(0.25)]


def test_a_wait_ends_with_the_first_thing_that_is_due(rounds: Rounds, monkeypatch: pytest.MonkeyPatch) -> None:
    wait(lambda: (rounds.service.run_once(), rounds.board.opener is None)[1])
    waits: list[float] = []
    poll = SimpleNamespace(register=lambda fd, events: None, poll=lambda wait: (waits.append(wait), [])[1])
    monkeypatch.setattr(module, "make_poll", lambda: poll)
    monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=lambda: 100.0))
    for due, again in ((None, 200.0), (100.05, 200.0), (None, 100.1), (99.0, 200.0)):
        monkeypatch.setattr(rounds.service.machine, "next_timeout", lambda due=due: due)
        rounds.board.again_at = again
        rounds.service._wait(100.25)
    assert waits == pytest.approx([250.0, 50.0, 100.0, 0.0])


def test_whoever_wakes_the_gateway_ends_one_wait(rounds: Rounds) -> None:
    wait(lambda: (rounds.service.run_once(), rounds.board.opener is None)[1])
    rounds.board.again_at = math.inf
    waker = rounds.service._waker
    waker.set()
    assert waker.fileno() in rounds.service._wait(0.0)
    rounds.service.run_once()
    assert waker.fileno() not in rounds.service._wait(0.0)


def test_queues_alone_need_no_port() -> None:
    service = GatewayService(None, {8: make_link(f"tcp://127.0.0.1:{free_port()}")}, local=8)
    service.open()
    service._wait = lambda until: set()  # type: ignore[method-assign]  # nothing has come
    service.run_once()
    service.close()


def test_a_lost_board_is_looked_for_every_half_second_by_one_thread_at_a_time(
    rounds: Rounds, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.WARNING, logger="hexwire")
    board, look = rounds.board, rounds.service._look_for
    assert rounds.opened == 1, "at the beginning"

    def tried(now: float, again: float) -> None:
        """It is tried now and not before; the thread ends, and that is seen at `again`."""
        before = rounds.opened
        look(board, now - 0.001)
        assert (board.opener, rounds.opened) == (None, before)
        rounds.may_open.clear()
        look(board, now)
        opener = board.opener
        assert opener is not None
        look(board, now + 10.0)
        assert board.opener is opener, "it is not done, and no second one begins"
        rounds.may_open.set()
        opener.join(LONG)
        look(board, again)
        assert (board.opener, rounds.opened) == (None, before + 1)

    first = board.again_at
    tried(first, first + 3.0)
    assert board.again_at == first + 3.0 + 0.5, "half a second after its end"
    assert not board.line.up
    rounds.is_there = True
    caplog.clear()
    tried(first + 3.5, first + 4.0)
    assert board.line.up
    assert caplog.messages == ["module 8 is back"]
    assert not board.opened, "the next loss begins anew"


def test_a_loss_is_said_once_and_looked_for_half_a_second_later(
    rounds: Rounds, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.WARNING, logger="hexwire")
    caplog.clear()
    monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=lambda: 5000.0))
    board = rounds.board
    board.said = ""
    board.line.back(4999.0)
    for why in ("unplugged", "unplugged", "gone"):
        rounds.service._lose(board, why)
    assert caplog.messages == ["module 8 is not there: unplugged", "module 8 is not there: gone"]
    assert (board.line.up, board.again_at) == (False, 5000.5)
