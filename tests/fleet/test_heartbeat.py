"""How a driver of a shared arm keeps its lease and follows the owner's clock without a call, in simulated time."""

from __future__ import annotations

import logging
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import pytest
from tests.fleet.fake_inbox import FakeInbox
from tests.fleet.fake_server import FACTS, TARGET, FakeServer

from hexwire.errors import LeaseError
from hexwire.fleet import messages as m
from hexwire.fleet import remote as module
from hexwire.fleet.address import Address
from hexwire.fleet.names import ClientRole, Keys
from hexwire.fleet.node import NoAnswerError
from hexwire.fleet.remote import RemoteRobot
from hexwire.fleet.states import ArrivedStates

KEYS = Keys("lab/arm1")
LEASE = 17
START, AHEAD = 1000.0, 50.0
"""This program's clock at the beginning, and how far the owner's is ahead, seconds."""


class Kept:
    """A heartbeat whose time passes while it waits and while an answer is under way.

    Args:
        timeout: Of the lease, seconds.
        held: The driver has the lease.

    Attributes:
        sent: When each message was sent, its key, the message and its time-out.
        trip: Seconds that an answer takes.
        answer: What the server says, or None if it says nothing in time.
        before: Called before each look.
    """

    def __init__(self, monkeypatch: pytest.MonkeyPatch, timeout: float = 1.0, *, held: bool = True) -> None:
        self.now, self.trip = START, 0.0
        monkeypatch.setattr(module, "time", self)
        self.server = FakeServer()
        facts = m.decode(m.encode(FACTS), m.Facts)
        facts.timeout = timeout
        self.robot = RemoteRobot(Address("lab/arm1", role=ClientRole.OPERATOR), facts)
        # As after `attach`.
        self.robot._node, self.robot._commands_as = self.server, ClientRole.OPERATOR  # type: ignore[assignment]
        self.inbox = FakeInbox()
        self.robot._states = ArrivedStates("zenoh:lab/arm1", self.robot._clock, self.inbox, now=self.monotonic)
        self.sent: list[tuple[float, str, Any, float]] = []
        self.answer: Callable[[], m.Answer | bytes | None] = lambda: m.Answer("", value=LEASE, clock=self.owners())
        self.before: Callable[[], object] = lambda: None
        if held:
            self.robot._lease = self.robot._last_lease = LEASE
        self.server.ask = self.ask  # type: ignore[method-assign]

    def monotonic(self) -> float:
        return self.now

    def owners(self) -> float:
        """The owner's clock in the middle of an exchange."""
        return self.now - 0.5 * self.trip + AHEAD

    def ask(self, key: str, payload: bytes, timeout: float, *, urgent: bool = False) -> bytes:
        kind = m.Envelope if key.endswith("order") else m.LeaseRequest if key.endswith("lease") else m.Question
        self.sent.append((self.now, key, m.decode(payload, kind), timeout))  # type: ignore[arg-type]
        self.now += self.trip
        answer = self.answer()
        if answer is None:
            self.now += timeout - self.trip
            raise NoAnswerError(absent=False)
        return answer if isinstance(answer, bytes) else m.encode(answer)

    def wait(self, seconds: float) -> bool:
        """In place of the event that ends it."""
        self.now += seconds
        self.before()
        return self.now >= self._end

    def run(self, seconds: float) -> None:
        self._end = self.now + seconds
        self.robot._keep(self.server, self)  # type: ignore[arg-type]  # a session and an event

    def state(self, server: int, sequence: int) -> None:
        """A state arrives."""
        row = (0.0,)
        stamp = self.now + AHEAD
        values = (*(row,) * 6, (0,), row)
        state = m.State(server, sequence, stamp, stamp, 0.0, ("J1",), *values, 0.0, False, False, False)
        self.inbox.rows.put(m.encode(state))

    def gaps(self) -> list[float]:
        return [b[0] - a[0] for a, b in pairwise(self.sent)]


def lost(text: str = "Eve holds the lease", *, lost: bool = True) -> m.Answer:
    return m.Answer("LeaseError", text, {"holder": "Eve", "lost": lost})


# -- the lease -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("timeout", "watchdog", "gap"),
    [(1.0, 0.0, 0.2), (1.0, 60.0, 0.2), (1000.0, 0.5, 0.1), (2.0, 0.2, 0.04), (10.0, 0.0, 2.0)],
)
def test_a_lease_is_renewed_five_times_in_its_timeout_or_that_of_the_watchdog(
    monkeypatch: pytest.MonkeyPatch, timeout: float, watchdog: float, gap: float
) -> None:
    """The heartbeats alone tell of calls that only read, as while a board follows a path."""
    kept = Kept(monkeypatch, timeout)
    kept.robot._watchdog = watchdog
    kept.run(20 * gap + 0.1)
    assert {(key, beat.key) for _, key, beat, _ in kept.sent} == {(KEYS.lease(ClientRole.OPERATOR), LEASE)}
    # The first at once, whenever the lease was taken; then each in time, and none more often than that.
    assert kept.sent[0][0] - START < 0.11
    assert kept.gaps() == pytest.approx([gap] * len(kept.gaps()), abs=0.02)
    assert len(kept.sent) >= 19
    # A missed answer is over before the lease is.
    assert [wait for *_, wait in kept.sent] == pytest.approx([2.5 * gap] * len(kept.sent))


def test_a_heartbeat_says_for_how_long_the_program_has_not_used_the_arm(monkeypatch: pytest.MonkeyPatch) -> None:
    kept = Kept(monkeypatch)
    kept.run(2.0)
    assert [beat.idle for _, _, beat, _ in kept.sent] == pytest.approx([when - START for when, *_ in kept.sent])
    kept.robot._use()
    used = kept.now
    kept.sent.clear()
    kept.run(1.0)
    assert [beat.idle for _, _, beat, _ in kept.sent] == pytest.approx([when - used for when, *_ in kept.sent])


def test_an_order_that_was_done_renews_the_lease_in_place_of_a_heartbeat(monkeypatch: pytest.MonkeyPatch) -> None:
    kept = Kept(monkeypatch)
    kept.run(1.1)
    assert len(kept.sent) == 5
    kept.sent.clear()
    heartbeats, orders = [], 0

    def order() -> None:
        nonlocal orders
        orders += 1
        kept.robot.cancel(1)
        heartbeats.extend(row for row in kept.sent if isinstance(row[2], m.Beat))
        kept.sent.clear()

    kept.before = order
    kept.run(12.0)
    assert orders >= 119
    # Those that compare the clocks.
    assert len(heartbeats) == 2
    kept.before = lambda: None
    kept.run(1.0)
    assert len(kept.sent) == 4, "in time after the last order"


def test_a_lost_heartbeat_is_followed_by_the_next_one_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    kept = Kept(monkeypatch)
    kept.answer = lambda: None
    searched: list[str] = []
    kept.server.visible = lambda key, timeout: searched.append(key) or []  # type: ignore[method-assign,func-returns-value]
    kept.run(6.0)
    assert kept.gaps() == pytest.approx([0.6] * len(kept.gaps()))
    assert kept.robot._lease == LEASE, "only the server ends it"
    assert not searched, "while the reason of a missing answer is looked for, the lease runs out"
    assert not kept.robot._clock.known


@pytest.mark.parametrize("answer", [b"", b"\x02\x90", b"\x01" + bytes(40)], ids=["nothing", "cut", "zeros"])
def test_whatever_is_answered_the_heartbeat_goes_on(monkeypatch: pytest.MonkeyPatch, answer: bytes) -> None:
    kept = Kept(monkeypatch)
    kept.answer = lambda: answer
    kept.run(2.0)
    assert len(kept.sent) >= 9
    assert kept.robot._lease == LEASE


def test_a_lease_that_its_server_says_is_lost_is_given_up_and_not_taken_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    kept = Kept(monkeypatch)
    kept.answer = lost
    kept.run(1.0)
    assert (kept.robot._lease, kept.robot._lost) == (0, "Eve holds the lease")
    assert [key for _, key, *_ in kept.sent[:1]] == [KEYS.lease(ClientRole.OPERATOR)]
    assert {key for _, key, *_ in kept.sent[1:]} <= {KEYS.ask}, "without a lease there is none to renew"
    with pytest.raises(LeaseError, match="Eve holds the lease; take the lease again"):
        kept.robot.write(TARGET)
    kept.robot._lose("")
    assert kept.robot._lost == "the lease was lost"


@pytest.mark.parametrize(
    "answer", [lost(lost=False), m.Answer("StoppedError", "stopped"), m.Answer("Nothing", "lost")]
)
def test_another_error_does_not_cost_the_lease(monkeypatch: pytest.MonkeyPatch, answer: m.Answer) -> None:
    kept = Kept(monkeypatch)
    kept.answer = lambda: answer
    kept.run(1.0)
    assert (kept.robot._lease, kept.robot._lost) == (LEASE, "")
    assert {key for _, key, *_ in kept.sent} == {KEYS.lease(ClientRole.OPERATOR)}


def test_the_refusal_of_a_former_lease_does_not_cost_the_one_that_was_taken_meanwhile(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    kept = Kept(monkeypatch)

    def taken() -> m.Answer:
        kept.robot._lease = LEASE + 1
        return lost()

    kept.answer = taken
    kept.run(0.15)
    assert (kept.robot._lease, kept.robot._lost) == (LEASE + 1, "")


# -- the clock -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("trip", "gap"), [(0.001, 5.0), (0.02, 0.5)])
def test_without_a_lease_the_clock_is_asked_for_seldom_once_it_is_known_well(
    monkeypatch: pytest.MonkeyPatch, trip: float, gap: float
) -> None:
    kept = Kept(monkeypatch, held=False)
    kept.trip = trip
    kept.run(5.0 * gap)
    assert {(key, ask.what) for _, key, ask, _ in kept.sent} == {(KEYS.ask, "clock")}
    # The next time that it looks anyway.
    assert all(gap <= each <= gap + 0.25 for each in kept.gaps()), kept.gaps()
    assert len(kept.sent) >= 4


@pytest.mark.parametrize("held", [True, False])
def test_each_answer_tells_the_owners_clock(monkeypatch: pytest.MonkeyPatch, held: bool) -> None:
    kept = Kept(monkeypatch, held=held)
    kept.trip = 0.02
    kept.run(2.0)
    offset, doubt = kept.robot.clock_offset
    assert offset == pytest.approx(AHEAD, abs=1e-6), "it was read between sending and receiving"
    assert 0.01 <= doubt < 0.011


def test_the_refusal_of_a_question_tells_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    kept = Kept(monkeypatch, held=False)
    kept.answer = lost
    kept.run(2.0)
    assert not kept.robot._clock.known
    assert kept.robot._lost == ""


def test_a_server_that_was_started_anew_is_asked_for_its_clock_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    kept = Kept(monkeypatch, held=False)
    numbers = iter(range(1, 1000))
    kept.before = lambda: kept.state(1 if kept.now < START + 3.0 else 2, next(numbers))
    kept.run(4.8)
    # Of the first and of the second one once each, within the next look.
    first, second = (when - START for when, *_ in kept.sent)
    assert first <= 0.35
    assert 3.0 <= second <= 3.35


# -- the states ----------------------------------------------------------------------------------------------------


def test_what_has_arrived_is_taken_and_a_pause_is_told_once(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.WARNING, logger="hexwire")
    kept = Kept(monkeypatch)
    numbers = iter(range(1, 1000))
    kept.before = lambda: kept.state(1, next(numbers)) if kept.now < START + 2.0 else None
    kept.run(2.5)
    assert kept.robot._states.seen == next(numbers) - 1
    assert not caplog.messages
    kept.run(2.5)
    (said,) = caplog.messages
    assert "its states have stopped arriving" in said
