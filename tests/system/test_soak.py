"""Tens of thousands of requests over a line with every fault, in simulated time; `make soak` asks more.

The board keeps a ledger of what it answered to which frame, so that each answer the host delivers can be told
right, wrong or somebody else's. Nothing sleeps: `pytest -s` shows the figures.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from dataclasses import dataclass, field

import pytest
from tests.soak import rounds

from hexwire.emulator.serve import BoardLink, FakeClock
from hexwire.errors import RemoteProtocolError, ReplyTimeoutError
from hexwire.ipc.handle import IpcHandle
from hexwire.ipc.session import Session
from hexwire.link.impair import ImpairedLink, Impairment
from hexwire.session.connection import Connection, Role
from hexwire.session.events import Request
from hexwire.wire import tables
from hexwire.wire.command_frame import Command, Frame
from hexwire.wire.commands import ALL_FIELDS, JointReport
from hexwire.wire.servo_packet import make_read, make_status, parse_packet, parse_status

pytestmark = pytest.mark.soak

REQUESTS = rounds(20_000, 500_000)
SAMPLE = 5_000
FAULTS = 0.01
JOINTS = 7
_ON_THE_WAY = 8


@dataclass
class Answered:
    """One line of the ledger."""

    sn: int
    seq: int
    body: bytes
    delivered: int = 0


@dataclass
class LedgerBoard:
    """Answers JOINT_STATE and servo reads, each time with another body, and remembers all of them."""

    garble: Callable[[bytes], bytes] = bytes
    ledger: dict[int, Answered] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.connection = Connection(Role.BOARD, local=8, remote=7, type=8)

    def receive(self, data: bytes, now: float) -> None:
        self.connection.receive(data, now)
        while (event := self.connection.next_event()) is not None:
            if isinstance(event, Request):
                self._answer(event, now)

    def _answer(self, request: Request, now: float) -> None:
        frame, number = request.frame, len(self.ledger)
        if frame.proto == tables.PROTO_HEXWIRE:
            body = self._report(number)
            self._note(number, frame, body)
            self.connection.reply(request, 0, body, now)
            return
        try:
            packet = parse_packet(frame.body)
        except RemoteProtocolError:
            return  # damaged, which nothing in the frame told: no servo answers it
        # A value that comes again after 65,536 answers only, so that an old one is not taken for a new one.
        body = make_status(packet.servo_id, 0, (number & 0xFFFF).to_bytes(2, "little"))
        self._note(number, frame, body)
        self.connection.reply_dialect1(body, now)

    def _note(self, number: int, frame: Frame, body: bytes) -> None:
        self.ledger[number] = Answered(frame.sn, frame.seq, body)

    def _report(self, number: int) -> bytes:
        mixed = [(number * 7919 + 31 * i) % 65521 - 32760 for i in range(JOINTS)]
        small = [value & 0x7F for value in mixed]
        return JointReport(
            number, 0, tuple(mixed), tuple(small), tuple(mixed), tuple(mixed), tuple(small), tuple(small),
            tuple(mixed), tuple(small),
        ).serialize()  # fmt: skip

    def step(self, now: float) -> None:
        due = self.connection.next_timeout()
        if due is not None and due <= now:
            self.connection.handle_timeout(now)

    def data_to_send(self) -> bytes:
        return b"".join(map(self.garble, self.connection.data_to_send()))

    def next_event_time(self) -> float | None:
        return self.connection.next_timeout()

    def reset(self, now: float) -> None:
        pass


@dataclass
class Soak:
    """The host's side: asks, and judges what it gets."""

    dialect: int
    probability: float = FAULTS
    board: LedgerBoard = field(default_factory=LedgerBoard)
    right: int = 0
    wrong: int = 0
    stale: int = 0
    unanswered: int = 0

    def __post_init__(self) -> None:
        self.clock = FakeClock(1000.0)
        inner = BoardLink(self.board, self.clock, baud=1_000_000)
        bad = Impairment.all_of(self.probability)
        self.link = ImpairedLink(inner, sending=bad, receiving=bad, seed=self.dialect)
        self.session = Session(IpcHandle.from_link(self.link), wall=lambda: 0.0)

    def run(self, requests: int) -> None:
        with self.session:
            self.session.connection.dialect = self.dialect
            for i in range(requests):
                self._ask(i)

    def _ask(self, i: int) -> None:
        connection, ledger = self.session.connection, self.board.ledger
        before, answered = connection.sn, len(ledger)
        servo = i % JOINTS
        try:
            if self.dialect == tables.PROTO_HEXWIRE:
                got = self.session.request(Command.JOINT_STATE, bytes((ALL_FIELDS,))).body
                number = JointReport.parse(got).time_us if len(got) >= 4 else -1
            else:
                got = self.session.request(Command.READ, make_read(servo, 56, 2)).body
                value = int.from_bytes(parse_status(got).params, "little")
                last = len(ledger) - 1
                number = last - (last - value) % 0x10000
        except ReplyTimeoutError:
            self.unanswered += 1
            return
        entry = ledger.get(number)
        # Any 16 bits were an answer once; what can still be on its way is one of the last few.
        if entry is None or entry.body != got or number < answered - _ON_THE_WAY:
            self.wrong += 1
        elif number < answered or not self._asked_now(entry, before):
            self.stale += 1
        else:
            self.right += 1
        if entry is not None:
            entry.delivered += 1

    def _asked_now(self, entry: Answered, before: int) -> bool:
        # In dialect 1 the request's own number may have been damaged on its way, which nothing tells.
        return self.dialect == tables.PROTO_CHAPTER or before < entry.sn <= self.session.connection.sn

    def check_nothing_was_lost_uncounted(self, requests: int) -> None:
        counters = self.session.connection.counters
        assert self.right + self.wrong + self.stale + self.unanswered == requests == counters.requests
        assert counters.replies == requests - self.unanswered
        assert counters.timeouts == self.unanswered
        assert counters.frames_sent == requests + counters.retries
        assert counters.events_dropped == 0
        # The lane was bad in every way, and each loss shows: what was not answered at once was asked again.
        for lane in (self.link.sent, self.link.received):
            done = lane.counters
            for count in (done.split, done.dropped, done.flipped, done.duplicated, done.reordered, done.frozen):
                assert count > 0.5 * self.probability * done.units
            assert done.overflowed == 0
        lost = self.link.sent.counters.dropped + self.link.received.counters.dropped
        assert counters.retries + counters.timeouts >= 0.9 * lost
        # Bytes: every one was part of a good frame, thrown away and counted, or still waits.
        for end in (self.session.connection, self.board.connection):
            decoder = end.decoder.counters
            assert decoder.bad_frames > 0
            assert decoder.bytes_dropped > 0
            assert decoder.frames > 0.8 * requests

    def figures(self) -> str:
        counters, decoder = self.session.connection.counters, self.session.connection.decoder.counters
        return (
            f"dialect {self.dialect}: {self.right} right, {self.wrong} wrong, {self.stale} late answers taken for "
            f"the present one, {self.unanswered} unanswered; {counters.retries} retries, {counters.stale} stale, "
            f"{decoder.bad_frames} bad frames here and "
            f"{self.board.connection.decoder.counters.bad_frames} there, "
            f"{self.clock.time - 1000:.0f} s of simulated time"
        )


@pytest.mark.slow
@pytest.mark.parametrize("requests", [SAMPLE, pytest.param(REQUESTS, marks=pytest.mark.slow)])
def test_dialect_2_lets_nothing_wrong_through(requests: int) -> None:
    soak = Soak(dialect=2)
    soak.run(requests)
    print(soak.figures())
    assert (soak.wrong, soak.stale) == (0, 0)
    assert max(entry.delivered for entry in soak.board.ledger.values()) == 1
    assert soak.right >= 0.98 * requests
    soak.check_nothing_was_lost_uncounted(requests)
    # Nothing hung: a request takes at most its attempts, and what a frozen line adds.
    policy = soak.session.policy
    assert soak.clock.time - 1000 < requests * policy.attempts * policy.window
    sizes = {len(entry.body) for entry in soak.board.ledger.values()}
    assert len(sizes) == 1
    decoder = soak.session.connection.decoder.counters
    frame = tables.FRAME_OVERHEAD + (size := sizes.pop()) + -size % 4
    left = decoder.bytes_received - decoder.frames * frame - decoder.bytes_dropped
    assert 0 <= left <= tables.MAX_SERIAL_FRAME


@pytest.mark.slow
def test_dialect_1_says_honestly_what_its_checksum_lets_through() -> None:
    soak = Soak(dialect=1)
    soak.run(REQUESTS)
    print(soak.figures())
    soak.check_nothing_was_lost_uncounted(REQUESTS)
    # Its frames have no check and its answers no number: one wrong answer in 256 damaged ones is what an 8-bit sum
    # is good for. It is not promised that there is none, only that they are few.
    faulty = sum(
        lane.counters.flipped + lane.counters.duplicated + lane.counters.dropped
        for lane in (soak.link.sent, soak.link.received)
    )
    assert soak.wrong <= _at_most(faulty, 1 / 256)
    assert soak.stale <= _at_most(faulty, 1 / 256)
    assert soak.right >= 0.97 * REQUESTS


def _at_most(n: int, p: float) -> float:
    """Five standard deviations over what is expected."""
    return n * p + 5 * math.sqrt(n * p * (1 - p)) + 1


class _Burst:
    """A burst that hits the data of every other answer, and its checksum."""

    def __init__(self) -> None:
        self.random = random.Random(9)
        self.hit = 0

    def __call__(self, frame: bytes) -> bytes:
        if self.random.random() < 0.5:
            return frame
        self.hit += 1
        size = int.from_bytes(frame[36:38], "little")
        end = 40 + size
        return frame[: end - 3] + self.random.randbytes(3) + frame[end:]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("dialect", "share"),
    [pytest.param(1, 1 / 256, marks=pytest.mark.slow, id="1"), pytest.param(2, 1 / 65536, id="2")],
)
def test_the_share_of_random_damage_that_gets_through(dialect: int, share: float) -> None:
    burst = _Burst()
    soak = Soak(dialect=dialect, probability=0.0, board=LedgerBoard(garble=burst))
    requests = rounds(10_000 if dialect == 1 else 3_000, 100_000)
    soak.run(requests)
    expected = burst.hit * share
    print(f"dialect {dialect}: {soak.wrong} of {burst.hit} damaged answers got through, {expected:.1f} expected")
    assert soak.wrong <= _at_most(burst.hit, share)
    if dialect == 1:
        assert soak.wrong >= expected - 5 * math.sqrt(expected)
        assert soak.wrong > 0
