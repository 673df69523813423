"""Chunks of bodies: order, loss, doubles, bounds, and peers that mean harm."""

from __future__ import annotations

import contextlib
import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexwire.errors import LocalProtocolError, RemoteProtocolError
from hexwire.session.fragments import ASK_AGAIN, WINDOW, FragmentReceiver, FragmentSender, Message
from hexwire.wire import tables
from hexwire.wire.commands import FragmentHead, parse_missing, serialize_missing

MIB = 1 << 20


def fragment(number: int, chunks: int, chunk: bytes, message_id: int = 1, cmd: int = 2, ext: int = 0) -> bytes:
    return FragmentHead(message_id, number, chunks, cmd, ext).serialize() + chunk


@given(st.binary(max_size=3000), st.integers(1, 200))
def test_round_trip(body: bytes, chunk_size: int) -> None:
    sender, receiver = FragmentSender(chunk_size), FragmentReceiver()
    to_send = list(sender.send(7, 0x1A, 0x80, body, 0.0))
    message, asks = None, []
    while message is None:
        assert len(to_send) <= WINDOW
        for chunk in to_send:
            message, asks = receiver.receive(chunk, 0.0)
        to_send = [chunk for ask in asks for chunk in sender.receive_missing(ask, 0.0)]
    assert message == Message(7, 0x1A, 0x80, body)
    assert asks == [serialize_missing(7, ())]
    assert sender.next_timeout() is None
    assert receiver.next_timeout() is None


@given(st.randoms(use_true_random=False), st.integers(1, 4000), st.floats(0, 0.5))
def test_a_line_that_loses_doubles_and_reorders(rng: random.Random, size: int, loss: float) -> None:
    body = rng.randbytes(size)
    sender, receiver = FragmentSender(100), FragmentReceiver()
    now, message = 0.0, None
    up = list(sender.send(1, 2, 0, body, now))
    while message is None and now < 100:
        down: list[bytes] = []
        rng.shuffle(up)
        for chunk in up:
            for _ in range(0 if rng.random() < loss else rng.choice((1, 1, 1, 2))):
                got, asks = receiver.receive(chunk, now)
                message = message or got
                down += asks
        now += 0.01
        if (due := receiver.next_timeout()) is not None and due <= now:
            down += receiver.handle_timeout(now)
        up = [c for ask in down if rng.random() >= loss for c in sender.receive_missing(ask, now)]
        if receiver.next_timeout() is None and message is None:
            up += sender.remind(1, 2, 0, body, now)
    assert message is not None
    assert message.body == body


def test_a_lost_window_is_started_again_by_a_reminder() -> None:
    body = bytes(range(250))
    sender, receiver = FragmentSender(100), FragmentReceiver()
    assert len(list(sender.send(1, 2, 0, body, 0.0))) == 3
    (first,) = sender.remind(1, 2, 0, body, 0.2)
    assert receiver.receive(first, 0.2) == (None, [])
    (ask,) = receiver.handle_timeout(0.2 + ASK_AGAIN)
    assert parse_missing(ask) == (1, (1, 2))
    done = [receiver.receive(chunk, 0.3) for chunk in sender.receive_missing(ask, 0.3)]
    assert done[-1][0] == Message(1, 2, 0, body)


def test_a_reminder_of_what_is_done_is_confirmed_again() -> None:
    sender, receiver = FragmentSender(100), FragmentReceiver()
    body = bytes(150)
    for chunk in sender.send(1, 2, 0, body, 0.0):
        message, confirm = receiver.receive(chunk, 0.0)
    assert message is not None
    assert list(sender.receive_missing(confirm[0], 0.0)) == []
    (first,) = sender.remind(1, 2, 0, body, 0.5)
    assert receiver.receive(first, 0.5) == (None, confirm)
    assert receiver.duplicates == 1
    assert receiver.is_done(1, 0.5)
    assert not receiver.is_done(1, 0.0 + tables.FRAGMENT_LIFETIME)
    receiver.forget()
    assert not receiver.is_done(1, 0.5)


def test_before_the_clock_reads_a_second_nothing_is_done_yet() -> None:
    # A board counts from its start; a message at 0.1 s is as new as any.
    message, _ = FragmentReceiver().receive(fragment(0, 1, b"x"), 0.1)
    assert message == Message(1, 2, 0, b"x")


def test_a_peer_that_goes_away_is_given_up_in_bounded_time() -> None:
    sender, receiver = FragmentSender(100), FragmentReceiver()
    chunks = list(sender.send(1, 2, 0, bytes(5000), 0.0))
    receiver.receive(chunks[0], 0.0)
    asked = 0
    while (due := receiver.next_timeout()) is not None:
        before = due
        asked += len(receiver.handle_timeout(due))
        assert receiver.next_timeout() is None or receiver.next_timeout() > before  # type: ignore[operator]
        assert due <= tables.FRAGMENT_LIFETIME
    assert receiver.expired == 1
    assert asked <= tables.FRAGMENT_LIFETIME / ASK_AGAIN
    due = sender.next_timeout()
    assert due == tables.FRAGMENT_LIFETIME
    sender.handle_timeout(due)
    assert (sender.next_timeout(), sender.expired) == (None, 1)
    assert list(sender.receive_missing(serialize_missing(1, (3,)), 3.0)) == []


def test_a_window_that_is_asked_for_greedily_gives_no_more_than_a_window() -> None:
    sender = FragmentSender(1)
    list(sender.send(1, 2, 0, bytes(1000), 0.0))
    assert len(list(sender.receive_missing(serialize_missing(1, tuple(range(100))), 0.0))) == WINDOW
    assert list(sender.receive_missing(serialize_missing(1, (1000, 65535)), 0.0)) == []
    assert list(sender.receive_missing(serialize_missing(2, (0,)), 0.0)) == []


def test_what_a_sender_refuses() -> None:
    sender = FragmentSender(10)
    with pytest.raises(LocalProtocolError, match="too long for fragments; at most 1048576"):
        sender.send(1, 2, 0, bytes(MIB + 1), 0.0)
    with pytest.raises(LocalProtocolError, match="at most 65535"):
        sender.send(1, 2, 0, bytes(655_351), 0.0)
    for i in range(tables.FRAGMENT_MESSAGES):
        sender.send(i, 2, 0, b"x", 0.0)
    with pytest.raises(LocalProtocolError, match="4 fragmented messages are unfinished"):
        sender.send(99, 2, 0, b"x", 0.0)
    assert list(sender.remind(99, 2, 0, b"x", 0.0)) == []
    sender.forget(0)
    assert len(list(sender.send(99, 2, 0, b"x", 0.0))) == 1
    sender.send(100, 2, 0, b"x", tables.FRAGMENT_LIFETIME)


@pytest.mark.parametrize(
    "parts",
    [
        [fragment(0, 3, b"12"), fragment(1, 3, b"123")],  # unequal
        [fragment(0, 3, b"12"), fragment(2, 3, b"123")],  # the last may be shorter, never longer
        [fragment(2, 3, b"123"), fragment(0, 3, b"12")],  # nor if it came first
        [fragment(0, 3, b"")],  # an empty chunk that is not the last
        [fragment(0, 65535, bytes(17))],  # 1.1 MB by its own count
        [fragment(0, 2, bytes(MIB)), fragment(1, 2, b"x")],
        [fragment(0, 1, bytes(MIB + 1))],
        [fragment(3, 3, b"x")],
        [fragment(0, 0, b"x")],
        [b"1234567"],
        [b""],
    ],
)
def test_hostile_fragments_are_refused_and_forgotten(parts: list[bytes]) -> None:
    receiver = FragmentReceiver()
    for part in parts[:-1]:
        assert receiver.receive(part, 0.0)[0] is None
    with pytest.raises(RemoteProtocolError):
        receiver.receive(parts[-1], 0.0)
    assert receiver.next_timeout() is None
    assert receiver.receive(fragment(0, 1, b"good"), 0.0)[0] == Message(1, 2, 0, b"good")


def test_thousands_of_message_ids_are_bounded() -> None:
    receiver = FragmentReceiver()
    refused = 0
    for message_id in range(5000):
        try:
            receiver.receive(fragment(0, 2, bytes(100), message_id), 0.0)
        except RemoteProtocolError as error:
            refused += 1
            text = str(error)
    assert refused == receiver.refused == 5000 - tables.FRAGMENT_MESSAGES
    assert "more than 4 fragmented messages at the same time" in text
    assert len(receiver.handle_timeout(ASK_AGAIN)) == tables.FRAGMENT_MESSAGES
    assert receiver.handle_timeout(tables.FRAGMENT_LIFETIME) == []
    assert receiver.expired == tables.FRAGMENT_MESSAGES


def test_thousands_of_whole_messages_are_forgotten_in_time() -> None:
    receiver = FragmentReceiver()
    for i in range(20_000):
        now = i * 0.001
        message, _ = receiver.receive(fragment(0, 1, b"x", i), now)
        assert message is not None
        assert len(receiver._done) <= tables.FRAGMENT_LIFETIME / 0.001 + 2
    receiver.handle_timeout(30.0)
    assert not receiver._done


def test_a_message_of_other_shape_under_the_same_id_starts_anew() -> None:
    receiver = FragmentReceiver()
    receiver.receive(fragment(0, 3, b"old"), 0.0)
    receiver.receive(fragment(0, 2, b"new"), 0.0)
    message, _ = receiver.receive(fragment(1, 2, b"er"), 0.0)
    assert message == Message(1, 2, 0, b"newer")


def test_doubles_do_not_keep_a_message_alive() -> None:
    receiver = FragmentReceiver()
    receiver.receive(fragment(0, 2, b"x"), 0.0)
    for i in range(1, 20):
        assert receiver.receive(fragment(0, 2, b"x"), i * 0.1) == (None, [])
    assert receiver.duplicates == 19
    receiver.handle_timeout(tables.FRAGMENT_LIFETIME)
    assert receiver.expired == 1


def test_asking_early_asks_once() -> None:
    receiver = FragmentReceiver()
    receiver.receive(fragment(0, 3, b"x"), 0.0)
    assert receiver.handle_timeout(ASK_AGAIN / 2) == []
    assert len(receiver.handle_timeout(ASK_AGAIN)) == 1
    # Called for another deadline meanwhile, it waits for the answer first.
    assert receiver.handle_timeout(ASK_AGAIN * 1.5) == []
    assert len(receiver.handle_timeout(ASK_AGAIN * 2)) == 1


def test_the_largest_message_of_the_smallest_chunks_asks_in_linear_time() -> None:
    # 65535 chunks of a byte: every ask starts where the last gap was.
    sender, receiver = FragmentSender(1), FragmentReceiver()
    to_send = list(sender.send(1, 2, 0, bytes(65535), 0.0))
    message: Message | None = None
    while message is None:
        for chunk in to_send:
            message, asks = receiver.receive(chunk, 0.0)
        to_send = [chunk for ask in asks for chunk in sender.receive_missing(ask, 0.0)]
    assert len(message.body) == 65535


@given(st.lists(st.binary(max_size=40), max_size=30), st.lists(st.floats(0, 5), max_size=30))
def test_any_bodies_are_taken_or_refused(bodies: list[bytes], times: list[float]) -> None:
    sender, receiver = FragmentSender(5), FragmentReceiver()
    sender.send(1, 2, 0, b"something long", 0.0)
    now = 0.0
    for body, step in zip(bodies, times, strict=False):
        now += step
        for take in (receiver.receive, sender.receive_missing):
            with contextlib.suppress(RemoteProtocolError):
                take(body, now)
        assert len(receiver._in) <= tables.FRAGMENT_MESSAGES
        due = receiver.next_timeout()
        if due is not None and due <= now:
            receiver.handle_timeout(now)
            after = receiver.next_timeout()
            assert after is None or after > now


def test_the_largest_message_goes_and_one_byte_more_does_not() -> None:
    sender, receiver = FragmentSender(MIB // 4), FragmentReceiver()
    (*_, done) = [receiver.receive(chunk, 0.0) for chunk in sender.send(1, 2, 0, bytes(MIB), 0.0)]
    assert done[0] == Message(1, 2, 0, bytes(MIB))
    with pytest.raises(LocalProtocolError):
        sender.send(1, 2, 0, bytes(MIB + 1), 0.0)
    assert FragmentReceiver().receive(fragment(0, 1, bytes(MIB)), 0.0)[0] is not None
    receiver = FragmentReceiver()
    assert receiver.receive(fragment(0, 17, bytes(65536)), 0.0)[0] is None, (
        "16 of them are a megabyte, the last is empty"
    )
    with pytest.raises(RemoteProtocolError, match="fragment 0 of 18 with 65536 bytes"):
        receiver.receive(fragment(0, 18, bytes(65536), 2), 0.0)
    assert receiver.refused == 1


def test_a_message_is_kept_as_long_as_the_peer_asks_for_it() -> None:
    sender = FragmentSender(1, lifetime=3.0)
    sender.send(1, 2, 0, bytes(40), 10.0)
    sender.send(2, 2, 0, bytes(40), 11.0)
    assert sender.next_timeout() == 13.0
    assert len(list(sender.receive_missing(serialize_missing(1, (5, 39, 40)), 12.5))) == 2
    assert sender.next_timeout() == 14.0
    sender.handle_timeout(13.9)
    assert sender.expired == 0
    sender.handle_timeout(14.0)
    assert (sender.expired, sender.next_timeout()) == (1, 15.5)


def test_what_a_sender_sends() -> None:
    sender, body = FragmentSender(10), bytes(range(165))
    sent = list(sender.send(0x1234, 0x1A, 0x85, body, 0.0))
    assert [FragmentHead.parse(data) for data in sent] == [
        FragmentHead(0x1234, i, 17, 0x1A, 0x85) for i in range(16)
    ]
    assert b"".join(data[8:] for data in sent) == body[:160]
    (last,) = sender.receive_missing(serialize_missing(0x1234, (16,)), 0.0)
    assert (FragmentHead.parse(last).number, last[8:]) == (16, body[160:])
    assert list(FragmentSender(10).send(1, 2, 3, b"", 0.0)) == [fragment(0, 1, b"", 1, 2, 3)]
    assert len(list(FragmentSender(10).send(1, 2, 3, bytes(20), 0.0))) == 2


def test_a_reminder_of_a_message_that_was_forgotten_starts_it_again() -> None:
    sender = FragmentSender(10)
    sender.send(1, 2, 3, bytes(40), 0.0)
    sender.forget(1)
    sender.forget(1)
    assert list(sender.receive_missing(serialize_missing(1, (1,)), 0.0)) == []
    assert list(sender.remind(1, 2, 3, bytes(40), 1.0)) == [fragment(0, 4, bytes(10), 1, 2, 3)]
    assert len(list(sender.receive_missing(serialize_missing(1, (1, 3)), 1.0))) == 2
    assert sender.next_timeout() == 1.0 + tables.FRAGMENT_LIFETIME
    assert list(sender.remind(1, 2, 3, bytes(40), 1.5)) == [fragment(0, 4, bytes(10), 1, 2, 3)]
    assert sender.next_timeout() == 1.0 + tables.FRAGMENT_LIFETIME, "only its peer keeps a message"


def test_a_message_that_is_sent_anew_needs_no_room() -> None:
    sender = FragmentSender(10)
    for i in range(tables.FRAGMENT_MESSAGES):
        sender.send(i, 2, 0, b"x", 0.0)
    assert len(list(sender.send(0, 2, 0, bytes(20), 0.0))) == 2


def test_when_a_receiver_asks_and_for_what() -> None:
    receiver = FragmentReceiver(lifetime=1.0)
    for number in range(15):
        assert receiver.receive(fragment(number, 40, b"x"), 10.0 + number / 100) == (None, [])
    assert receiver.next_timeout() == pytest.approx(10.14 + ASK_AGAIN)
    assert receiver.receive(fragment(15, 40, b"x"), 10.2) == (None, [serialize_missing(1, tuple(range(16, 32)))])
    for number in (17, 30):
        assert receiver.receive(fragment(number, 40, b"x"), 10.25) == (None, [])
    assert receiver.next_timeout() == pytest.approx(10.25 + ASK_AGAIN)
    assert receiver.handle_timeout(10.25 + ASK_AGAIN - 0.001) == []
    missing = tuple(i for i in range(16, 34) if i not in (17, 30))
    assert receiver.handle_timeout(10.25 + ASK_AGAIN) == [serialize_missing(1, missing)]
    # Asked, it waits as long again; after a lifetime of silence it gives up.
    assert receiver.next_timeout() == pytest.approx(10.25 + 2 * ASK_AGAIN)
    assert len(receiver.handle_timeout(11.2)) == 1
    assert receiver.next_timeout() == pytest.approx(11.25)
    assert len(receiver.handle_timeout(11.2499)) == 0
    assert receiver.handle_timeout(11.25) == []
    assert (receiver.expired, receiver.next_timeout()) == (1, None)


def test_a_window_that_is_whole_is_asked_on_for_by_its_last_chunk() -> None:
    receiver = FragmentReceiver()
    asked = [bool(receiver.receive(fragment(number, 40, b"x"), 0.0)[1]) for number in range(39)]
    assert [number for number, ask in enumerate(asked) if ask] == [15, 31]


def test_counters_of_a_receiver() -> None:
    receiver = FragmentReceiver()
    receiver.receive(fragment(0, 2, b"12"), 0.0)
    receiver.receive(fragment(0, 2, b"12"), 0.0)
    assert (receiver.duplicates, receiver.refused, receiver.expired) == (1, 0, 0)
    assert receiver.receive(fragment(1, 2, b"34"), 0.5)[0] is not None
    assert receiver.receive(fragment(1, 2, b"34"), 0.6) == (None, [serialize_missing(1, ())])
    assert receiver.duplicates == 2
    with pytest.raises(RemoteProtocolError):
        receiver.receive(fragment(0, 2, b"", 9), 0.6)
    assert (receiver.duplicates, receiver.refused, receiver.expired) == (2, 1, 0)
    # What was done is known for its lifetime, and its number is free after that.
    assert receiver.is_done(1, 0.5 + tables.FRAGMENT_LIFETIME - 0.001)
    assert not receiver.is_done(1, 0.5 + tables.FRAGMENT_LIFETIME)
    for number in range(2):
        message, _ = receiver.receive(fragment(number, 2, b"56"), 3.0)
    assert message == Message(1, 2, 0, b"5656")


@pytest.mark.parametrize("changes", [{"cmd": 3}, {"ext": 0x80}, {"chunks": 3}])
def test_a_chunk_of_another_command_begins_another_message(changes: dict[str, int]) -> None:
    receiver = FragmentReceiver()
    receiver.receive(fragment(0, 2, b"old"), 0.0)
    other = {"number": 1, "chunks": 2, "chunk": b"new", **changes}
    assert receiver.receive(fragment(**other), 0.0)[0] is None  # type: ignore[arg-type]
    assert [dict(message.chunks) for message in receiver._in.values()] == [{1: b"new"}]


def test_a_message_of_other_shape_is_taken_where_no_other_has_room() -> None:
    receiver = FragmentReceiver()
    for i in range(tables.FRAGMENT_MESSAGES):
        receiver.receive(fragment(0, 2, b"x", i), 0.0)
    receiver.receive(fragment(0, 3, b"x", 0), 0.0)
    assert receiver.refused == 0
