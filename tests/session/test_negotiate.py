"""Which dialect? Every kind of board, a booting one, a silent one, and a line full of noise."""

from __future__ import annotations

import random
import re
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.session.wires import Line, bad_line, board, events, host

from hexwire.session.connection import Connection
from hexwire.session.dialect1 import UNKNOWN_COMMAND_PACKET
from hexwire.session.events import Garbage, Request, TimedOut
from hexwire.session.negotiate import Negotiated, NegotiationFailed, Negotiator
from hexwire.wire import servo_packet as sp
from hexwire.wire import tables
from hexwire.wire.command_frame import Command, Status, parse_frame
from hexwire.wire.commands import Identity, JointRow

IDENTITY = Identity(2, (2, 0, 1), 77, 0x1FF, 253, 0, tuple(JointRow(i, 1, True) for i in range(7)))
Answer = Callable[[Connection, Request, float], None]


def dialect2_board(b: Connection, request: Request, now: float) -> None:
    frame = request.frame
    if frame.proto == 1:
        chapter_ping(b, request, now)
    elif frame.cmd == Command.IDENTIFY:
        b.reply(request, 0, IDENTITY.serialize(), now)
    else:
        b.reply(request, Status.UNKNOWN_COMMAND, b"", now)


def chapter_board(b: Connection, request: Request, now: float) -> None:
    """What the chapter's sketch answers: it knows no proto and no dst."""
    if request.frame.cmd == Command.PING:
        chapter_ping(b, request, now)
    else:
        b.reply_dialect1(UNKNOWN_COMMAND_PACKET, now)


def chapter_ping(b: Connection, request: Request, now: float) -> None:
    servo_id = request.frame.body[2]
    silent = servo_id > 6
    b.reply_dialect1(sp.make_board_error(5, servo_id) if silent else sp.make_legacy_ping_status(servo_id), now)


def shy_board(b: Connection, request: Request, now: float) -> None:
    """Knows dialect 1 and ignores what it does not know."""
    if request.frame.proto == 1:
        chapter_ping(b, request, now)


def mute(_b: Connection, _request: Request, _now: float) -> None:
    return


class Negotiation:
    """A negotiator over a line in fake time; the board may be deaf at first."""

    def __init__(
        self,
        answer: Answer,
        *,
        boots_at: float = 0.0,
        mangle: Callable[[bytes], list[bytes]] = lambda data: [data],
        boot_window: float = tables.BOOT_WINDOW,
        dialect: int | None = None,
        ping_ids: tuple[int, ...] = (0,),
        delay: float = 0.001,
    ) -> None:
        def hear(b: Connection, request: Request, now: float) -> None:
            if now >= boots_at:
                answer(b, request, now)

        self.host = host()
        self.sent: list[bytes] = []

        def note(data: bytes) -> list[bytes]:
            if parse_frame(data).src == 7:
                self.sent.append(data)
            return mangle(data)

        self.line = Line(self.host, board(), hear, mangle=note, delay=delay)
        self.negotiator = Negotiator(self.host, 0.0, boot_window=boot_window, dialect=dialect, ping_ids=ping_ids)

    def run(self, until: float = 20.0) -> Negotiated | NegotiationFailed:
        while self.negotiator.outcome is None and self.line.now < until:
            seen = len(self.line.seen)
            self.line.run(until, stop=lambda seen=seen: len(self.line.seen) > seen)
            for event in self.line.seen[seen:]:
                self.negotiator.handle(event, self.line.now)
        assert self.negotiator.outcome is not None
        # Whoever listens, no frame of a negotiation holds what an old board would cut at.
        assert all(b"\r\n" not in data[4:-2] for data in self.sent)
        return self.negotiator.outcome


def test_a_dialect_2_board_at_once() -> None:
    n = Negotiation(dialect2_board)
    assert n.run() == Negotiated(2, IDENTITY)
    assert (n.host.dialect, n.host.cautious) == (2, False)
    assert len(n.sent) == 1
    assert n.line.now < 0.01


def test_the_chapters_board_says_unknown_command() -> None:
    n = Negotiation(chapter_board)
    assert n.run() == Negotiated(1, None)
    assert (n.host.dialect, n.host.cautious) == (1, True)
    assert len(n.sent) == 1
    # The first request goes out at once.
    n.host.request(Command.READ, sp.make_read(0, 0x38, 2), n.line.now)
    assert len(n.host.data_to_send()) == 1


def test_a_board_that_ignores_identify_and_answers_a_ping() -> None:
    n = Negotiation(shy_board)
    assert n.run() == Negotiated(1, None)
    assert n.line.now < 1.5
    # What it had queued may still come: the line rests first.
    (before, last) = (parse_frame(data) for data in n.sent[-2:])
    assert last.time - before.time >= tables.DIALECT1_REPLY_WINDOW
    # And it may take the next frame for the rest of half a one, so that one is a ping of nobody's.
    assert (last.proto, last.cmd) == (1, Command.PING)
    n.host.request(Command.READ, sp.make_read(0, 0x38, 2), n.line.now)
    assert len(n.host.data_to_send()) == 1


def test_a_ping_to_a_silent_servo_is_answered_by_the_board_all_the_same() -> None:
    assert Negotiation(shy_board, ping_ids=(99,)).run() == Negotiated(1, None)


def test_a_silent_board() -> None:
    n = Negotiation(mute)
    outcome = n.run()
    assert isinstance(outcome, NegotiationFailed)
    assert (outcome.bytes_received, outcome.frames) == (0, 0)
    assert outcome.attempts == len(n.sent) > 10
    assert tables.BOOT_WINDOW <= n.line.now < tables.BOOT_WINDOW + 1


@pytest.mark.parametrize(("answer", "dialect"), [(dialect2_board, 2), (chapter_board, 1), (shy_board, 1)])
def test_a_board_that_is_booting_is_waited_for(answer: Answer, dialect: int) -> None:
    # Whichever question it hears first: a dialect-2 board answers a ping too, and must not be taken for less.
    for boots_at in (i / 10 for i in range(1, 45)):
        n = Negotiation(answer, boots_at=boots_at)
        outcome = n.run()
        assert isinstance(outcome, Negotiated), f"it boots at {boots_at} s"
        assert outcome.dialect == dialect, f"it boots at {boots_at} s"
        assert n.line.now < boots_at + 1.5


@pytest.mark.parametrize("dialect", [1, 2])
def test_only_one_dialect_is_asked_for_when_told_so(dialect: int) -> None:
    n = Negotiation(dialect2_board, dialect=dialect)
    outcome = n.run()
    assert isinstance(outcome, Negotiated)
    assert outcome.dialect == dialect
    assert {parse_frame(data).proto for data in n.sent} == {dialect}
    n = Negotiation(mute, dialect=dialect, boot_window=1.0)
    assert isinstance(n.run(), NegotiationFailed)
    assert {parse_frame(data).proto for data in n.sent} == {dialect}


def test_dialect_2_only_is_not_given_up_for_an_old_board() -> None:
    assert isinstance(Negotiation(chapter_board, dialect=2, boot_window=1.0).run(), NegotiationFailed)


def test_a_board_that_is_busy_is_asked_again() -> None:
    times = 0

    def busy_at_first(b: Connection, request: Request, now: float) -> None:
        nonlocal times
        times += 1
        if times < 4 and request.frame.proto == 2:
            b.reply(request, Status.BUSY, b"", now)
        else:
            dialect2_board(b, request, now)

    outcome = Negotiation(busy_at_first).run()
    assert isinstance(outcome, Negotiated)
    assert outcome.dialect == 2


@pytest.mark.parametrize("status", [Status.STOPPED, Status.BUSY])
@pytest.mark.parametrize("deaf", [0, 2])
def test_an_identify_that_a_stop_voided_never_means_dialect_1(status: Status, deaf: int) -> None:
    """Also where the board missed the first questions, answered the ping, and then voids what is asked."""
    asked = 0

    def voids_at_first(b: Connection, request: Request, now: float) -> None:
        nonlocal asked
        if request.frame.proto == 1:
            chapter_ping(b, request, now)
            return
        asked += 1
        if deaf < asked <= deaf + 6:
            b.reply(request, status, b"", now)
        elif asked > deaf:
            dialect2_board(b, request, now)

    outcome = Negotiation(voids_at_first).run()
    assert isinstance(outcome, Negotiated)
    assert outcome.dialect == 2
    assert asked == deaf + 7


def test_an_identity_that_cannot_be_read_is_asked_for_again() -> None:
    bodies = [b"", IDENTITY.serialize()[:-1]]

    def garbled(b: Connection, request: Request, now: float) -> None:
        if request.frame.proto == 2:
            b.reply(request, 0, bodies.pop() if bodies else IDENTITY.serialize(), now)

    assert Negotiation(garbled).run() == Negotiated(2, IDENTITY)


def test_noise_and_nothing_else_is_counted() -> None:
    h, rng = host(), random.Random(1)
    n = Negotiator(h, 0.0, boot_window=1.0)
    now = 0.0
    while n.outcome is None:
        assert now < 5.0
        h.data_to_send()
        now += 0.01
        h.receive(rng.randbytes(100), now)
        if (due := h.next_timeout()) is not None and due <= now:
            h.handle_timeout(now)
        for event in events(h):
            n.handle(event, now)
    assert isinstance(n.outcome, NegotiationFailed)
    assert n.outcome.bytes_received > 5000
    assert n.outcome.frames == 0


@pytest.mark.parametrize(("answer", "dialect"), [(dialect2_board, 2), (chapter_board, 1), (shy_board, 1)])
@pytest.mark.parametrize("delay", [0.001, 0.06])
def test_every_byte_split(answer: Answer, dialect: int, delay: float) -> None:
    for cut in range(1, 60):
        n = Negotiation(
            answer, mangle=lambda f, cut=cut: [f[i : i + cut] for i in range(0, len(f), cut)], delay=delay
        )
        outcome = n.run()
        assert isinstance(outcome, Negotiated)
        assert outcome.dialect == dialect


@given(st.integers(0, 2**32), st.sampled_from(((dialect2_board, 2), (chapter_board, 1))))
def test_a_line_that_loses_and_doubles_still_finds_the_dialect(seed: int, which: tuple[Answer, int]) -> None:
    answer, dialect = which
    n = Negotiation(answer, mangle=bad_line(random.Random(seed), loss=0.1, double=0.1))
    outcome = n.run()
    # Four questions in a row would have to be lost to take a dialect-2 board for less.
    assert isinstance(outcome, Negotiated)
    assert outcome.dialect in (dialect, 1)
    if dialect == 1:
        assert n.host.dialect == 1


class Bare:
    """A negotiator that hears bytes as they are."""

    def __init__(self, look: bool = False) -> None:
        self.host = host()
        self.negotiator = Negotiator(self.host, 0.0, ping_ids=(3, 4), look=look)
        self.sent: list[bytes] = []
        self.now = 0.0

    def let_pass(self, questions: int) -> None:
        """Let questions go unanswered."""
        while len(self.sent) < questions and not self.negotiator.paused and self.negotiator.outcome is None:
            self.sent += self.host.data_to_send()
            if len(self.sent) == questions:
                return
            now = self.host.next_timeout()
            assert now is not None
            self.now = now
            self.host.handle_timeout(now)
            self._hand_over()

    def hear(self, data: bytes) -> None:
        self.host.receive(data, self.now)
        self._hand_over()

    def _hand_over(self) -> None:
        for event in events(self.host):
            self.negotiator.handle(event, self.now)


@pytest.mark.parametrize("status", [sp.make_status(3), sp.make_status(3, 0x20), sp.make_legacy_ping_status(3)])
@pytest.mark.parametrize("cut", [6, 1, 4])
def test_a_bare_answer_to_the_ping_is_a_servos(status: bytes, cut: int) -> None:
    bare = Bare()
    bare.let_pass(3)
    for piece in (status[:cut], status[cut:]):
        bare.hear(piece)
    assert isinstance(bare.negotiator.outcome, NegotiationFailed)
    assert bare.negotiator.outcome.servo_id == 3


@pytest.mark.parametrize(
    "data", [sp.make_ping(3), sp.make_status(4), b"\xff\xff\x03\x02\x00\x00", b"." + sp.make_status(3)]
)
def test_packets_that_are_not_a_servos_answer(data: bytes) -> None:
    bare = Bare()
    bare.let_pass(3)
    bare.hear(data)
    assert bare.negotiator.outcome is None


def test_a_negotiation_pauses_once_for_a_look_elsewhere() -> None:
    bare = Bare(look=True)
    bare.let_pass(9)
    assert bare.negotiator.paused
    assert len(bare.sent) == 2
    bare.now += 0.2
    bare.negotiator.go_on(bare.now)
    bare.let_pass(9)
    assert not bare.negotiator.paused
    assert len(bare.sent) == 9


def test_our_own_frames_are_counted() -> None:
    bare = Bare()
    for questions in range(1, 4):
        bare.let_pass(questions)
        bare.hear(bare.sent[-1])
    bare.let_pass(99)
    assert isinstance(bare.negotiator.outcome, NegotiationFailed)
    assert bare.negotiator.outcome.echoes == bare.negotiator.outcome.frames == 3


@given(st.floats(0, 2e9), st.integers(0, 2**32 - 1) | st.integers(0x0A0D00, 0x0A0D40))
def test_no_clock_puts_the_marker_into_a_question(epoch: float, sn: int) -> None:
    h = host(epoch=epoch)
    h.sn = sn
    n = Negotiator(h, 0.0, boot_window=3.0)
    while n.outcome is None:
        assert all(b"\r\n" not in data[4:-2] for data in h.data_to_send())
        now = h.next_timeout()
        assert now is not None
        h.handle_timeout(now)
        for event in events(h):
            n.handle(event, now)


class Schedule:
    """Lets every question go unanswered, and notes when each was sent, in which dialect, and to which servo."""

    def __init__(self, **how: Any) -> None:
        self.host = host()
        self.asked: list[tuple[float, int, int | None]] = []
        self.negotiator = Negotiator(self.host, 10.0, **how)
        self.now = 10.0
        while self.negotiator.outcome is None and not self.negotiator.paused:
            for frame in map(parse_frame, self.host.data_to_send()):
                servo_id = frame.body[2] if frame.proto == 1 else None
                self.asked.append((round(self.now - 10.0, 6), frame.proto, servo_id))
            self.now = self.host.next_timeout() or self.now
            self.host.handle_timeout(self.now)
            for event in events(self.host):
                self.negotiator.handle(event, self.now)


def test_the_order_and_the_times_of_the_questions() -> None:
    """IDENTIFY twice with 0.25 s each, then a ping, until the time is over; the pings take their ids in turn."""
    schedule = Schedule(boot_window=2.2, ping_ids=(3, 4))
    assert [(proto, servo_id) for _, proto, servo_id in schedule.asked] == [
        (2, None), (2, None), (1, 3), (2, None), (2, None), (1, 4), (2, None), (2, None), (1, 3), (2, None),
    ]  # fmt: skip
    times = [time for time, _, _ in schedule.asked]
    for (before, (_, proto, _)), after in zip(zip(times, schedule.asked, strict=True), times[1:], strict=False):
        assert after - before == pytest.approx(0.25 if proto == 2 else tables.DIALECT1_REPLY_WINDOW)
    outcome = schedule.negotiator.outcome
    assert isinstance(outcome, NegotiationFailed)
    assert outcome == NegotiationFailed(10, 0, 0, None, 0)
    assert schedule.now == pytest.approx(12.35)


def test_however_short_the_time_one_question_is_asked() -> None:
    assert len(Schedule(boot_window=0.0).asked) == 1
    assert len(Schedule(boot_window=0.25).asked) == 1
    assert len(Schedule(boot_window=0.26).asked) == 2
    assert len(Schedule(boot_window=0.0, look=True).asked) == 1


def test_one_dialect_only() -> None:
    assert [proto for _, proto, _ in Schedule(boot_window=1.1, dialect=2).asked] == [2] * 5
    assert [(p, i) for _, p, i in Schedule(boot_window=0.7, dialect=1, ping_ids=(5, 6)).asked][:3] == [
        (1, 5), (1, 6), (1, 5),
    ]  # fmt: skip
    assert {i for _, p, i in Schedule(boot_window=1.0, ping_ids=()).asked if p == 1} == {0}


def test_bytes_received_before_do_not_count() -> None:
    h, b = host(), board()
    b.report(Command.JOINT_STATE, b"x", 0.0)
    (report,) = b.data_to_send()
    h.receive(report + b"noise", 0.0)
    negotiator = Negotiator(h, 0.0, boot_window=0.1)
    h.receive(report + report + b"abc", 0.1)
    h.handle_timeout(0.25)
    for event in events(h):
        negotiator.handle(event, 0.25)
    assert negotiator.outcome == NegotiationFailed(1, 2 * len(report) + 3, 2, None, 0)


@pytest.mark.parametrize(
    ("failed", "words"),
    [
        (NegotiationFailed(5, 0, 0), "check the port, the rate, and the board's power"),
        (NegotiationFailed(5, 7, 0), "7 bytes that are not a frame.*baud rate may be wrong"),
        (NegotiationFailed(5, 70, 3, None, 2), "2 of our own frames.*only echoes"),
        (NegotiationFailed(5, 70, 3), "3 frames that answer no request.*another program"),
    ],
)
def test_a_failure_says_what_came_instead_and_what_to_do(failed: NegotiationFailed, words: str) -> None:
    error = failed.as_error("serial:///dev/x")
    assert "IDENTIFY on serial:///dev/x" in str(error)
    assert re.search(words, str(error), re.DOTALL)
    assert error.attempts == 5


def test_after_the_outcome_nothing_more_is_asked() -> None:
    n = Negotiation(dialect2_board)
    n.run()
    n.negotiator.handle(TimedOut(n.negotiator._ticket, Command.IDENTIFY, 1, ""), 5.0)
    assert n.negotiator.outcome == Negotiated(2, IDENTITY)
    assert n.host.data_to_send() == []
    n.negotiator._pinged = 3
    n.negotiator.handle(Garbage(6, sp.make_status(3)), 5.0)
    assert n.negotiator.outcome == Negotiated(2, IDENTITY)


def test_the_events_of_other_requests_are_left_alone() -> None:
    bare = Bare()
    bare.let_pass(1)
    bare.negotiator.handle(TimedOut(99, Command.IDENTIFY, 1, ""), 0.0)
    assert bare.host.data_to_send() == []
    assert bare.negotiator.outcome is None


def test_noise_is_remembered_up_to_64_bytes_and_only_since_the_last_question() -> None:
    bare = Bare()
    bare.let_pass(3)
    status = sp.make_status(3)
    bare.negotiator.handle(Garbage(3, status[:3]), bare.now)
    bare.let_pass(4)
    bare.negotiator.handle(Garbage(3, status[3:]), bare.now)
    assert bare.negotiator.outcome is None
    assert bare.negotiator._noise == status[3:]
    bare.negotiator.handle(Garbage(100, bytes(range(100))), bare.now)
    assert bare.negotiator._noise == bytes(range(36, 100))


def test_a_dialect_1_answer_to_identify_is_no_verdict_where_dialect_2_is_asked_for() -> None:
    n = Negotiation(chapter_board, dialect=2, boot_window=0.6)
    assert n.run() == NegotiationFailed(len(n.sent), n.host.decoder.counters.bytes_received, len(n.sent))
