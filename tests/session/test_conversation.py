"""Conversations over datagrams: what is old, doubled, late or of another conversation is not acted on."""

from __future__ import annotations

import json
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from tests.frames import frame_bytes
from tests.session.wires import Line, board, events, host

from hexwire.errors import LocalProtocolError
from hexwire.session.connection import Connection, Role
from hexwire.session.conversation import Window, is_stop
from hexwire.session.events import Reply, Request
from hexwire.wire import tables
from hexwire.wire.command_frame import Command, Frame, parse_frame

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
def test_a_command_held_up_on_the_way_is_not_executed(talk: Talk, late: float, done: bool) -> None:
    (data,) = talk.frames(Command.TORQUE, ON)
    talk.now += late
    talk.to_board(data)
    assert talk.done == ([(Command.TORQUE, ON)] if done else [])


def test_an_answer_held_up_on_the_way_is_taken_while_it_is_waited_for_a_report_is_not(talk: Talk) -> None:
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
    assert "already" in window.take(11)
    assert window.take(2000) == ""
    assert window.take(2000 - tables.DATAGRAM_WINDOW + 1) == ""
    assert "long past" in window.take(2000 - tables.DATAGRAM_WINDOW)
    window.void()
    assert "void" in window.take(1999)
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
