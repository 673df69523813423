"""Conversations over datagrams: what is old, doubled, late or of another conversation is not acted on."""

from __future__ import annotations

import json
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.frames import frame_bytes
from tests.session.wires import Line, board, events, host

from hexwire.errors import LocalProtocolError
from hexwire.session.connection import Connection, Role
from hexwire.session.conversation import Conversation, Conversations, Window, is_stop
from hexwire.session.events import Reply, Request, Stale
from hexwire.wire import tables
from hexwire.wire.command_frame import Command, Frame, parse_frame, serialize_frame

VECTORS = [
    json.loads(line)
    for line in (Path(__file__).parents[2] / "vectors/conversation.jsonl").read_text(encoding="utf-8").splitlines()
]
ON, OFF = b"\x01\x7f\x00", b"\x00\x7f\x00"


def numbers(*values: int) -> Callable[[], int]:
    """A source of the given numbers, then of random ones."""
    rest, left = random.Random(repr(values)), list(values)
    return lambda: left.pop(0) if left else rest.getrandbits(31)


class Talk:
    """A host and a board over datagrams; whoever holds the line may keep, drop and repeat what goes over it."""

    def __init__(self, **changes: Any) -> None:
        self.now = 100.0
        self.host = host(numbers=numbers(1000), epoch=1e9, max_frame=8192, **changes)
        self.board = board(numbers=numbers(7777, 5000), epoch=-100.0, max_frame=8192)
        self.sent: list[bytes] = []
        self.answers: list[bytes] = []
        self.done: list[tuple[int, bytes]] = []

    def to_board(self, data: bytes) -> list[bytes]:
        """Deliver a datagram; returns what the board sends back. What it acts on is noted in `done`."""
        self.board.receive(data, self.now, end_of_message=True)
        for event in events(self.board):
            if isinstance(event, Request):
                if event.frame.cmd != Command.IDENTIFY:
                    self.done.append((event.frame.cmd, event.frame.body))
                self.board.reply(event, 0, event.frame.body, self.now)
        return self.board.data_to_send()

    def to_host(self, data: bytes) -> list[Reply]:
        self.host.receive(data, self.now, end_of_message=True)
        return [event for event in events(self.host) if isinstance(event, Reply)]

    def frames(self, cmd: int, body: bytes = b"", **how: Any) -> list[bytes]:
        """What the host would send for a request."""
        self.host.request(cmd, body, self.now, **how)
        return self.host.data_to_send()

    def ask(self, cmd: int, body: bytes = b"") -> Reply:
        """A request and its answer, at once."""
        replies = []
        for data in self.frames(cmd, body):
            self.sent.append(data)
            for answer in self.to_board(data):
                self.answers.append(answer)
                replies += self.to_host(answer)
        assert len(replies) == 1
        return replies[0]


@pytest.fixture
def talk() -> Talk:
    made = Talk()
    made.ask(Command.IDENTIFY)
    return made


def test_numbers_of_both_sides_are_in_every_frame(talk: Talk) -> None:
    talk.ask(Command.TORQUE, ON)
    question, offer = parse_frame(talk.sent[0]), parse_frame(talk.answers[0])
    assert (question.sn, question.type) == (1001, 3)
    assert (offer.sn, offer.type) == (5000, 1001)
    request, reply = parse_frame(talk.sent[1]), parse_frame(talk.answers[1])
    assert (request.sn, request.type) == (1002, 5000)
    assert (reply.sn, reply.type) == (5001, 1001)


@pytest.mark.parametrize("row", VECTORS, ids=lambda row: row["name"])
def test_vectors(row: dict[str, Any]) -> None:
    """Every step of the conversation of PROTOCOL.md section 6.6, byte for byte, and what each side makes of it."""
    end = Connection(
        Role(row["role"]),
        local=row["local"],
        remote=row["remote"],
        type=row["type"],
        numbers=numbers(*row["numbers"]),
        max_frame=tables.MAX_NETWORK_FRAME,
    )
    for step in row["steps"]:
        now, data = step["time"], bytes.fromhex(step.get("hex", ""))
        if step["what"] == "asks":
            end.request(step["cmd"], bytes.fromhex(step["body"]), now)
            assert end.data_to_send() == [data]
            continue
        end.receive(data, now, end_of_message=True)
        seen = events(end)
        taken = [event for event in seen if isinstance(event, Request | Reply)]
        assert len(taken) == (step["what"] == "takes"), step
        for event in taken:
            if isinstance(event, Request):
                end.reply(event, 0, bytes.fromhex(step["reply"]), now)
                assert end.data_to_send() == [bytes.fromhex(step["answer"])]
        if step["what"] == "refuses":
            assert any(step["why"] in str(event) for event in seen), seen


def test_nothing_is_asked_before_the_other_end_said_who_it_is() -> None:
    talk = Talk()
    with pytest.raises(LocalProtocolError, match="over datagrams IDENTIFY comes first: TORQUE was not sent"):
        talk.frames(Command.TORQUE, ON)
    talk.ask(Command.IDENTIFY)
    assert talk.ask(Command.TORQUE, ON).status == 0


@pytest.mark.parametrize("pause", [0.0, 0.5, 2.0, 2.5, 120.0, 86400.0])
def test_a_recorded_torque_on_is_not_executed_again(talk: Talk, pause: float) -> None:
    talk.ask(Command.TORQUE, ON)
    recorded = talk.sent[-1]
    talk.ask(Command.TORQUE, OFF)
    for number in range(5):
        talk.ask(Command.STATS, bytes([number]))
    done = list(talk.done)
    talk.now += pause
    assert talk.to_board(recorded) == []
    assert talk.done == done
    assert talk.board.counters.refused == 1


def test_a_whole_conversation_replayed_does_nothing(talk: Talk) -> None:
    for body in (ON, OFF, ON):
        talk.ask(Command.TORQUE, body)
    recorded, done = list(talk.sent), list(talk.done)
    talk.now += 120.0
    for _ in range(3):
        for data in recorded:
            talk.to_board(data)
    assert talk.done == done
    # And whoever was there goes on as if nothing had been.
    talk.ask(Command.TORQUE, OFF)
    assert talk.done == [*done, (Command.TORQUE, OFF)]
    # A board that is started later has nothing to remember, and does nothing either.
    talk.board = board(numbers=numbers(1, 2, 3, 4), epoch=-200.0, max_frame=8192)
    for data in recorded:
        talk.to_board(data)
    assert talk.done == [*done, (Command.TORQUE, OFF)]


def test_old_answers_are_not_taken_for_new_ones(talk: Talk) -> None:
    talk.ask(Command.STATS, b"old")
    old = list(talk.answers)
    later = host(numbers=numbers(1000_000), max_frame=8192)
    ticket = later.request(Command.IDENTIFY, b"", 0.0)
    for data in old:
        later.receive(data, 0.0, end_of_message=True)
    assert not [event for event in events(later) if isinstance(event, Reply)]
    assert later.counters.refused == 2
    assert not later.in_conversation
    later.abandon(ticket)
    # Nor within the same conversation.
    frames = talk.frames(Command.STATS, b"new")
    for data in old:
        assert talk.to_host(data) == []
    (answer,) = talk.to_board(frames[0])
    assert [reply.body for reply in talk.to_host(answer)] == [b"new"]


@pytest.mark.parametrize(("late", "done"), [(0.0, True), (0.9, True), (1.1, False), (3600.0, False)])
def test_a_delayed_command_is_not_executed(talk: Talk, late: float, done: bool) -> None:
    (data,) = talk.frames(Command.TORQUE, ON)
    talk.now += late
    talk.to_board(data)
    assert talk.done == ([(Command.TORQUE, ON)] if done else [])


def test_a_delayed_answer_is_taken_while_awaited_but_a_delayed_report_is_not(talk: Talk) -> None:
    (data,) = talk.frames(Command.STATS, b"x", window=30.0)
    (answer,) = talk.to_board(data)
    talk.board.report(Command.JOINT_STATE, b"old", talk.now)
    (report,) = talk.board.data_to_send()
    talk.now += 10.0
    assert [reply.body for reply in talk.to_host(answer)] == [b"x"]
    assert talk.to_host(answer) == []
    talk.to_host(report)
    assert talk.host.counters.reports == 0


@pytest.mark.parametrize(("cmd", "body"), [(Command.STOP, b"\0"), (Command.ROBOT_SIGNAL, b"\x02")])
def test_a_stop_is_obeyed_however_late_it_comes_but_once(talk: Talk, cmd: int, body: bytes) -> None:
    (data,) = talk.frames(cmd, body)
    talk.now += 30.0
    assert talk.to_board(data)
    assert talk.done == [(cmd, body)]
    talk.now += 30.0
    assert talk.to_board(data) == []
    assert talk.done == [(cmd, body)]


def test_what_was_sent_before_a_stop_is_void_after_it(talk: Talk) -> None:
    (move,) = talk.frames(Command.JOINT_MOVE, b"x")
    talk.ask(Command.STOP, b"\0")
    talk.ask(Command.RESUME)
    assert talk.to_board(move) == []
    assert talk.done == [(Command.STOP, b"\0"), (Command.RESUME, b"")]


def test_a_repeat_that_comes_after_other_requests_is_not_executed_again(talk: Talk) -> None:
    """A request is sent twice since the answer is slow; the second copy is overtaken by what is asked then."""
    (first,) = talk.frames(Command.JOINT_MOVE, b"there", window=0.1)
    talk.now += 0.15
    talk.host.handle_timeout(talk.now)
    (second,) = talk.host.data_to_send()
    for answer in talk.to_board(first):
        talk.to_host(answer)
    for number in range(6):
        talk.ask(Command.JOINT_MOVE, bytes([number]))
    done = list(talk.done)
    assert talk.to_board(second) == []
    assert talk.done == done


def test_a_first_copy_that_comes_after_its_repeat_is_not_executed_again(talk: Talk) -> None:
    (first,) = talk.frames(Command.JOINT_MOVE, b"there", window=0.1)
    talk.now += 0.15
    talk.host.handle_timeout(talk.now)
    (second,) = talk.host.data_to_send()
    for answer in talk.to_board(second):
        talk.to_host(answer)
    for number in range(6):
        talk.ask(Command.JOINT_MOVE, bytes([number]))
    done = list(talk.done)
    assert talk.to_board(first) == []
    assert talk.done == done


def test_a_repeat_is_answered_from_store_as_on_a_stream(talk: Talk) -> None:
    (first,) = talk.frames(Command.JOINT_MOVE, b"there", window=0.1)
    assert talk.to_board(first)
    talk.now += 0.15
    talk.host.handle_timeout(talk.now)
    (again,) = talk.host.data_to_send()
    (answer,) = talk.to_board(again)
    assert talk.to_host(answer)[0].body == b"there"
    assert talk.done == [(Command.JOINT_MOVE, b"there")]


def test_the_same_request_is_meant_again_when_it_is_asked_again(talk: Talk) -> None:
    for _ in range(600):
        talk.ask(Command.STATS, b"")
        talk.now += 0.001
    assert len(talk.done) == 600


def test_an_identify_that_was_recorded_disturbs_nobody(talk: Talk) -> None:
    talk.ask(Command.TORQUE, ON)
    elsewhere = Talk(local=7)
    elsewhere.host = host(numbers=numbers(99), epoch=1e9)
    (spoofed,) = elsewhere.frames(Command.IDENTIFY)
    for _ in range(50):
        talk.to_board(spoofed)
    for number in range(50):
        # Nor do many of them, as they would come from one who guesses.
        talk.to_board(spoofed[:12] + number.to_bytes(4, "little") + spoofed[16:])
    assert talk.ask(Command.TORQUE, OFF).status == 0
    assert talk.board.conversations is not None
    assert talk.board.conversations.count == 1
    assert len(talk.board.conversations._offered) <= 16


def test_a_host_that_starts_anew_is_heard_at_once(talk: Talk) -> None:
    talk.ask(Command.TORQUE, ON)
    talk.host = host(numbers=numbers(3), epoch=1e9, max_frame=8192)
    talk.ask(Command.IDENTIFY)
    assert talk.ask(Command.TORQUE, ON).status == 0
    assert talk.done == [(Command.TORQUE, ON)] * 2


def test_a_board_that_starts_anew_obeys_nothing_until_it_was_asked_who_it_is(talk: Talk) -> None:
    talk.board = board(numbers=numbers(4, 6000), epoch=-100.0, max_frame=8192)
    assert talk.to_board(talk.frames(Command.TORQUE, ON)[0]) == []
    talk.ask(Command.IDENTIFY)
    assert talk.ask(Command.TORQUE, OFF).status == 0
    assert talk.done == [(Command.TORQUE, OFF)]


def test_identify_may_be_lost_either_way(talk: Talk) -> None:
    for lost in ("question", "answer"):
        talk.host.request(Command.IDENTIFY, b"", talk.now, window=0.1)
        (question,) = talk.host.data_to_send()
        if lost == "answer":
            assert talk.to_board(question)
        talk.now += 0.2
        talk.host.handle_timeout(talk.now)
        (again,) = talk.host.data_to_send()
        (answer,) = talk.to_board(again)
        assert talk.to_host(answer)
        assert talk.ask(Command.STATS).status == 0


def test_dialect_1_is_not_obeyed_over_datagrams(talk: Talk) -> None:
    data = frame_bytes(Command.SYNC_WRITE, b"x", proto=1)
    assert talk.to_board(data) == []
    assert talk.done == []


def test_identify_in_fragments_opens_nothing(talk: Talk) -> None:
    head = bytes((1, 1, 0, 0, 1, 0, Command.IDENTIFY, 0))
    talk.to_board(talk.frames(Command.FRAGMENT, head)[0])
    assert talk.board.conversations is not None
    assert talk.board.conversations._offered == {}
    assert talk.done == []


def test_clocks_that_part_slowly_are_followed(talk: Talk) -> None:
    for _ in range(4000):  # ten hours; the host's clock loses 0.5 s in an hour
        talk.now += 9.0
        talk.host.epoch -= 9.0 * 0.5 / 3600
        talk.ask(Command.STATS)


def test_a_clock_that_was_set_right_does_not_make_frames_late() -> None:
    talk = Talk()
    talk.host.epoch += 250.0  # as IDENTIFY may be stamped, to keep 0D 0A out of it
    talk.ask(Command.IDENTIFY)
    talk.host.epoch -= 250.0
    assert talk.to_board(talk.frames(Command.TORQUE, ON)[0]) == [], "by its stamp it is 250 s late"
    talk = Talk()
    talk.host.epoch -= 250.0
    talk.ask(Command.IDENTIFY)
    talk.host.epoch += 250.0
    assert talk.ask(Command.TORQUE, ON).status == 0


def test_window() -> None:
    window = Window(10)
    assert window.take(10) != ""
    assert window.take(9) != ""
    assert [window.take(sn) for sn in (12, 11, 13)] == ["", "", ""]
    assert "arrived before" in window.take(11)
    assert window.take(2000) == ""
    assert window.take(2000 - tables.DATAGRAM_WINDOW + 1) == ""
    assert "too old" in window.take(2000 - tables.DATAGRAM_WINDOW)
    window.void()
    assert "cancelled" in window.take(1999)
    assert window.take(2001) == ""
    wrapping = Window(0xFFFFFFFE)
    assert [wrapping.take(sn) for sn in (0xFFFFFFFF, 1, 0)] == ["", "", ""]


def test_what_is_a_stop() -> None:
    def frame(cmd: int, body: bytes, ext: int = 0) -> Frame:
        return Frame(0, 0, 1, 7, 8, 3, 2, 1, cmd, body, ext)

    assert is_stop(frame(Command.STOP, b"\0"))
    assert is_stop(frame(Command.ROBOT_SIGNAL, b"\x01"))
    assert not is_stop(frame(Command.ROBOT_SIGNAL, b"\x03"))
    assert not is_stop(frame(Command.STOP, b"\0\x7f\0", tables.EXT_REPLY)), "an answer to a stop is none"


def test_loss_doubles_and_disorder_do_what_they_do_on_a_stream() -> None:
    """Any of 300 requests is done once, whatever the line does to datagrams within its limits."""
    chance = random.Random(4)
    done: list[bytes] = []

    def answer(end: Connection, request: Request, now: float) -> None:
        if request.frame.cmd != Command.IDENTIFY:
            done.append(request.frame.body)
        end.reply(request, 0, request.frame.body, now)

    def mangle(data: bytes) -> list[bytes]:
        return [data] * chance.choice((0, 1, 1, 1, 1, 1, 2, 3))

    line = Line(
        host(numbers=numbers(5), max_frame=8192), board(numbers=numbers(6), max_frame=8192), answer, mangle=mangle
    )
    line.host.request(Command.IDENTIFY, b"", line.now, attempts=50)
    line.run(60.0, lambda: line.host.in_conversation)
    assert line.host.in_conversation
    for number in range(300):
        ticket = line.host.request(Command.STATS, number.to_bytes(2, "little"), line.now, attempts=20)
        line.run(
            line.now + 10.0,
            lambda ticket=ticket: any(isinstance(e, Reply) and e.ticket == ticket for e in line.seen),
        )
    assert done == [number.to_bytes(2, "little") for number in range(300)]


@given(
    st.sampled_from((0, 5000, 2**32 - 40)),
    st.lists(
        st.sampled_from((1, 2, 3, 7, 1023, 1024, 1025, -1, -2, -5, -1022, -1023, -1024, -1025, "void")), max_size=30
    ),
)
def test_window_as_a_set_of_numbers(start: int, steps: list[int | str]) -> None:
    """Offsets are from the newest number so far; the model counts on where the wire comes round."""
    window, newest, seen, void_below = Window(start), start, {start}, start
    for step in steps:
        if isinstance(step, str):
            window.void()
            void_below = newest
            continue
        number = newest + step
        refused = window.take(number & 0xFFFFFFFF)
        long_past = number <= newest - tables.DATAGRAM_WINDOW
        assert bool(refused) == (long_past or number in seen or number < void_below)
        assert ("too old" in refused) == long_past
        if not refused:
            seen.add(number)
            newest = max(newest, number)


def of(
    sn: int, *, cmd: int = Command.STATS, body: bytes = b"", seq: int = 1, ext: int = 0, time: float = 0.0
) -> Frame:
    return Frame(int(time), round(time % 1 * 1e9), sn, 7, 8, 3, 2, seq, cmd, body, ext)


def test_half_of_all_numbers_is_ahead_and_half_behind() -> None:
    assert Window(5).take(5 + 2**31 - 1) == ""
    assert Window(5).take(5 + 2**31) == "its number is too old"


def test_what_is_a_repeat_of_a_request() -> None:
    """The same within 128 numbers, or an older one; another request of the same seq is none."""
    for start in (1000, 2**32 - 10):
        for step, body, repeat in (
            (1, b"a", True),
            (127, b"a", True),
            (128, b"a", False),
            (1, b"b", False),
            (-1, b"a", True),
            (-1, b"b", True),
            (-(2**31), b"b", True),
            (2**31 - 1, b"a", False),
        ):
            talk = Conversation(1, 2, 0.0, 0.0)
            assert not talk.is_repeat(of(start, body=b"a"))
            assert talk.is_repeat(of(start + step & 0xFFFFFFFF, body=body)) is repeat, (step, body)
            assert not talk.is_repeat(of(start + 300 & 0xFFFFFFFF, body=b"a", seq=2)), "of another seq"
        # What counts is the last one that was none.
        talk = Conversation(1, 2, 0.0, 0.0)
        talk.is_repeat(of(start, body=b"a"))
        assert not talk.is_repeat(of(start + 5 & 0xFFFFFFFF, body=b"b"))
        assert not talk.is_repeat(of(start + 9 & 0xFFFFFFFF, body=b"a"))
        assert not talk.is_repeat(of(start + 12 & 0xFFFFFFFF, body=b"a", cmd=Command.LIMITS))


@pytest.mark.parametrize("offset", [0.0, -50.0, 1e6])
@pytest.mark.parametrize("quiet", [1.0, 100.0])
def test_a_frame_is_late_by_the_quickest_before_it(offset: float, quiet: float) -> None:
    """A second at most, and 1 ms for each second since the last frame, by which clocks may part."""
    for held_up, late in ((0.999 + 0.001 * quiet, False), (1.002 + 0.001 * quiet, True)):
        talk = Conversation(10, 20, 3.0 + offset, 200.0)
        # Sent when their clock read 197, it took no longer than the first did.
        assert talk.take(of(11, time=200.0 - 3.0 + 1000.0), 1200.0 + offset) == ""
        sent_at = 1197.0 + quiet - held_up
        problem = talk.take(of(12, time=sent_at), 1200.0 + quiet + offset)
        assert (problem != "") is late
        assert problem in ("", "it is 1.0 s late", "it is 1.1 s late")
        # An answer is good however late it comes, and so is a stop.
        assert talk.take(of(13, time=sent_at, ext=0x80), 1200.0 + quiet + offset) == ""
        assert talk.take(of(14, time=sent_at, cmd=Command.STOP, body=b"\0"), 1200.0 + quiet + offset) == ""


def test_a_quicker_frame_sets_the_measure() -> None:
    talk = Conversation(10, 20, 5.0, 5.0)
    assert talk.take(of(11, time=2.0), 6.0) == "", "a second quicker than the first"
    assert talk.take(of(12, time=2.0), 6.99) == ""
    assert talk.take(of(13, time=2.0), 7.1) == "it is 1.1 s late"


def test_a_stop_that_is_refused_makes_nothing_void() -> None:
    talk = Conversation(10, 20, 0.0, 0.0)
    assert talk.take(of(20, cmd=Command.STOP, body=b"\0"), 0.0) == ""
    assert talk.take(of(30), 0.0) == ""
    assert talk.take(of(20, cmd=Command.STOP, body=b"\0"), 0.0) != ""
    assert talk.take(of(29), 0.0) == ""
    assert talk.take(of(35, cmd=Command.STOP, body=b"\0"), 0.0) == ""
    assert talk.take(of(34), 0.0) == "it arrived before, or is cancelled"


def test_numbers_with_the_highest_bit_set_travel_in_a_signed_field() -> None:
    talk = Talk()
    talk.host = host(numbers=numbers(0x7FFFFFFF), epoch=1e9, max_frame=8192)
    talk.ask(Command.IDENTIFY)
    assert parse_frame(talk.sent[0]).sn == 0x80000000
    assert parse_frame(talk.answers[0]).type == -(2**31)
    talk.board.conversations.current = None  # type: ignore[union-attr]
    talk.host.conversations.current = Conversation(0xFFFFFFFE, 5, 0.0, 0.0)  # type: ignore[union-attr]
    assert parse_frame(talk.frames(Command.STATS)[0]).type == -2


def test_the_number_of_a_host_comes_round() -> None:
    talk = Talk()
    talk.ask(Command.IDENTIFY)
    talk.ask(Command.STATS)
    talk.host.conversations._sn = 0xFFFFFFFE  # type: ignore[union-attr]
    talk.board.conversations.current._window = Window(0xFFFFFFF0)  # type: ignore[union-attr]
    for _ in range(3):
        talk.ask(Command.STATS)
    assert [parse_frame(data).sn for data in talk.sent[-3:]] == [0xFFFFFFFF, 0, 1]


def test_the_number_of_a_board_comes_round() -> None:
    conversation = Conversation(1, 0xFFFFFFFE, 0.0, 0.0)
    assert [conversation.next_number() for _ in range(4)] == [0xFFFFFFFE, 0xFFFFFFFF, 0, 1]


def test_only_the_last_sixteen_questions_may_be_answered() -> None:
    talk = Talk()
    asked = []
    for _ in range(17):
        ticket = talk.host.request(Command.IDENTIFY, b"", talk.now)
        asked += talk.host.data_to_send()
        talk.host.abandon(ticket)
    answers = [answer for data in asked for answer in talk.to_board(data)]
    ticket = talk.host.request(Command.IDENTIFY, b"", talk.now)
    seq = parse_frame(talk.host.data_to_send()[0]).seq
    # With the question just now there are 18: the first two are forgotten.
    for i, answer in enumerate(answers):
        frame = parse_frame(answer)
        fits = talk.host.conversations.is_answer(frame)  # type: ignore[union-attr]
        assert fits is (i >= 2)
    last = serialize_frame(parse_frame(answers[-1])._replace(seq=seq))
    assert [reply.ticket for reply in talk.to_host(last)] == [ticket]
    # Whatever was asked before the one that was answered is past.
    assert [talk.host.conversations.is_answer(parse_frame(a)) for a in answers] == [False] * 17  # type: ignore[union-attr]


def test_what_was_asked_after_the_answered_question_may_still_be_answered() -> None:
    conversations = Conversations(numbers(100), host=True)
    for sn in (101, 102, 103):
        conversations.sent(Command.IDENTIFY, sn)
    conversations.begin(of(500, cmd=Command.IDENTIFY, ext=0x80)._replace(type=102), 0.0)
    assert [conversations.is_answer(of(1)._replace(type=sn)) for sn in (101, 102, 103)] == [False, False, True]
    assert conversations.current is not None
    assert (conversations.current.theirs, conversations.current.ours) == (500, 102)
    assert (conversations.count, conversations.has_news(), conversations.has_news()) == (1, True, False)


def test_a_board_keeps_its_last_sixteen_offers_and_takes_up_any_of_them() -> None:
    conversations = Conversations(iter(range(1000, 2000)).__next__, host=False)
    for sn in range(17):
        assert conversations.offer(of(sn, cmd=Command.IDENTIFY), 0.0)
        assert not conversations.offer(of(sn, cmd=Command.IDENTIFY), 0.0), "it arrived before"
    assert not conversations.has_news()
    # Numbers 1001 to 1017 were offered; the first made room for the last.
    assert conversations.take(of(100)._replace(type=1001), 0.0) == "it is of another conversation"
    assert (conversations.current, conversations.count) == (None, 0)
    assert conversations.take(of(100)._replace(type=1005), 0.0) == ""
    assert (conversations.count, conversations.has_news(), conversations.has_news()) == (1, True, False)
    assert conversations.is_current(of(1)._replace(type=1005))
    assert not conversations.is_current(of(1)._replace(type=1006))
    # What was offered before it is past, what was offered since is not.
    assert conversations.take(of(101)._replace(type=1004), 0.0) == "it is of another conversation"
    assert not conversations.has_news()
    assert conversations.take(of(101)._replace(type=1006), 0.0) == ""
    assert conversations.count == 2
    # And the one that was left cannot be gone back to.
    assert conversations.take(of(102)._replace(type=1005), 0.0) == "it is of another conversation"


def test_only_accepted_frames_count_as_news() -> None:
    conversations = Conversations(iter(range(1000, 2000)).__next__, host=False)
    conversations.offer(of(5, cmd=Command.IDENTIFY), 0.0)
    assert conversations.take(of(6)._replace(type=1001), 0.0) == ""
    assert conversations.has_news()
    assert conversations.take(of(6)._replace(type=1001), 0.0) != ""
    assert not conversations.has_news()
    assert conversations.take(of(7)._replace(type=1001), 0.0) == ""
    assert conversations.take(of(7)._replace(type=1001), 0.0) != ""
    assert conversations.has_news()
    assert not conversations.offer(of(5, cmd=Command.IDENTIFY), 0.0), "it began the one that is"


def test_a_board_in_no_conversation_sends_under_a_random_number() -> None:
    conversations = Conversations(numbers(1, 77, 88), host=False)
    assert conversations.stamp(Command.JOINT_STATE, 8, None) == (77, 8)
    offer = Conversation(9, 3000, 0.0, 0.0)
    assert conversations.stamp(Command.IDENTIFY, 8, offer) == (3000, 9)
    conversations.current = Conversation(11, 4000, 0.0, 0.0)
    assert conversations.stamp(Command.STATS, 8, None) == (4000, 11)
    assert conversations.stamp(Command.IDENTIFY, 8, offer) == (3001, 9)
    assert not conversations.is_repeat(of(1))
    assert conversations.is_repeat(of(2))


def test_dialect_1_is_refused_by_a_board_and_left_to_a_host(talk: Talk) -> None:
    data = serialize_frame(Frame(0, 0, 1, 8, 7, 3, 1, 1, Command.READ, b"x"))
    talk.board.receive(data, talk.now, end_of_message=True)
    assert [event.reason for event in events(talk.board) if isinstance(event, Stale)] == [
        "dialect 1 has no number that identifies an old datagram"
    ]
    assert talk.board.counters.refused == talk.board.counters.stale == 1
    talk.host.receive(data, talk.now, end_of_message=True)
    assert talk.host.counters.refused == 0


def test_why_a_datagram_is_refused(talk: Talk) -> None:
    talk.ask(Command.TORQUE, ON)
    for data in talk.sent:
        talk.board.receive(data, talk.now, end_of_message=True)
    for answer in talk.answers:
        talk.host.receive(answer, talk.now, end_of_message=True)
    assert [event.reason for event in events(talk.board) if isinstance(event, Stale)] == [
        "it arrived before",
        "it arrived before, or is cancelled",
    ]
    assert [event.reason for event in events(talk.host) if isinstance(event, Stale)] == [
        "it does not answer our IDENTIFY",
        "it arrived before, or is cancelled",
    ]
    assert (talk.board.counters.refused, talk.host.counters.refused) == (2, 2)


def test_an_answer_to_a_conversation_that_is_over_is_not_sent(talk: Talk) -> None:
    (data,) = talk.frames(Command.STATS, b"x")
    talk.board.receive(data, talk.now, end_of_message=True)
    (request,) = [event for event in events(talk.board) if isinstance(event, Request)]
    talk.host = host(numbers=numbers(3), epoch=1e9, max_frame=8192)
    talk.ask(Command.IDENTIFY)
    talk.ask(Command.STATS, b"y")
    talk.board.reply(request, 0, b"x", talk.now)
    assert talk.board.data_to_send() == []
