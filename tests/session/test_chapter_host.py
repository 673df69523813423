"""The host's half of dialect 1: one outstanding, matched by servo id, quiet where an old board needs it."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.session.wires import board, events, host

from hexwire.errors import LocalProtocolError
from hexwire.session.connection import Connection
from hexwire.session.dialect1 import SHORT_FRAME_PACKET, UNKNOWN_COMMAND_PACKET
from hexwire.session.events import Reply, Stale, TimedOut
from hexwire.session.policy import RetryPolicy
from hexwire.wire import servo_packet as sp
from hexwire.wire import tables
from hexwire.wire.command_frame import Command, Frame, parse_frame

WINDOW = tables.DIALECT1_REPLY_WINDOW
HOLDOFF = RetryPolicy().dialect1_holdoff


def read(servo_id: int) -> bytes:
    return sp.make_read(servo_id, 0x38, 2)


def answer(servo_id: int, value: int = 2053) -> bytes:
    return sp.make_status(servo_id, 0, value.to_bytes(2, "little"), legacy=True)


def one() -> Connection:
    return host(dialect=1)


def sent(connection: Connection) -> list[Frame]:
    return [parse_frame(data) for data in connection.data_to_send()]


def asked(connection: Connection) -> list[bytes]:
    return [frame.body for frame in sent(connection)]


def receive(connection: Connection, packets: Iterable[bytes], now: float) -> None:
    b = board()
    for packet in packets:
        b.reply_dialect1(packet, now)
    connection.receive(b"".join(b.data_to_send()), now)


def test_one_is_outstanding_and_the_rest_wait_in_order() -> None:
    h = one()
    tickets = [h.request(Command.READ, read(i), 0.0) for i in range(3)]
    for i in range(3):
        (frame,) = sent(h)
        assert (frame.proto, frame.cmd, frame.body) == (1, Command.READ, read(i))
        h.handle_timeout(0.01 * i)
        assert h.data_to_send() == []
        receive(h, [answer(i)], 0.01 * i)
        (reply,) = events(h)
        assert isinstance(reply, Reply)
        assert (reply.ticket, reply.body, reply.status) == (tickets[i], answer(i), 0)
    assert h.next_timeout() is None


def test_the_answer_of_another_servo_is_stale() -> None:
    h = one()
    ticket = h.request(Command.READ, read(3), 0.0)
    receive(h, [answer(2), sp.make_status(3, 0, b"", legacy=True)], 0.05)
    assert [type(event) for event in events(h)] == [Stale, Stale]
    receive(h, [answer(3)], 0.1)
    (reply,) = events(h)
    assert isinstance(reply, Reply)
    assert reply.ticket == ticket
    assert reply.rtt == pytest.approx(0.1)


def test_sn_and_seq_of_an_answer_mean_nothing() -> None:
    h, b = one(), board()
    for i in range(5):
        h.request(Command.READ, read(i), 0.0)
        h.data_to_send()
        b.sn = 0xABCDEF00 + 100 * i
        b.reply_dialect1(answer(i), 0.0)
        h.receive(b.data_to_send()[0], 0.0)
        assert isinstance(events(h)[0], Reply)


def test_unanswered_it_is_asked_again_and_then_the_line_rests() -> None:
    h = one()
    first = h.request(Command.READ, read(3), 0.0)
    h.request(Command.READ, read(2), 0.0)
    for n in range(3):
        assert asked(h) == [read(3)]
        assert h.next_timeout() == pytest.approx((n + 1) * WINDOW)
        h.handle_timeout((n + 1) * WINDOW + 1e-9)
    assert [type(event) for event in events(h)] == [TimedOut]
    assert (h.counters.retries, h.counters.timeouts) == (2, 1)
    assert first == 1
    # Nothing goes out before a late answer has had its time; one that comes then is stale.
    assert h.data_to_send() == []
    receive(h, [answer(3)], 0.7)
    assert [type(event) for event in events(h)] == [Stale]
    due = h.next_timeout()
    assert due == pytest.approx(4 * WINDOW)
    h.handle_timeout(due or 0.0)
    assert asked(h) == [read(2)]


def test_after_a_retry_that_was_answered_the_second_answer_cannot_pass_for_another() -> None:
    h = one()
    h.request(Command.READ, read(3), 0.0)
    h.handle_timeout(WINDOW)
    receive(h, [answer(3, 1)], 0.21)
    (reply,) = events(h)
    assert isinstance(reply, Reply)
    assert reply.attempts == 2
    # The same servo is asked again; the answer to the second sending is still on its way.
    h.data_to_send()
    h.request(Command.READ, read(3), 0.22)
    assert h.data_to_send() == []
    receive(h, [answer(3, 2)], 0.3)
    assert [type(event) for event in events(h)] == [Stale]
    h.handle_timeout(0.21 + WINDOW)
    assert asked(h) == [read(3)]
    receive(h, [answer(3, 3)], 0.5)
    (reply,) = events(h)
    assert isinstance(reply, Reply)
    assert reply.body == answer(3, 3)


def test_a_timeout_forgets_the_half_frame_that_is_held() -> None:
    h, b = one(), board()
    h.request(Command.READ, read(3), 0.0)
    b.reply_dialect1(answer(3), 0.0)
    (data,) = b.data_to_send()
    h.receive(data[:30], WINDOW - 0.001)
    h.handle_timeout(WINDOW)
    assert h.decoder.next_timeout() is None
    receive(h, [answer(3)], WINDOW + 0.01)
    assert any(isinstance(event, Reply) for event in events(h))


def test_a_sync_write_is_done_when_sent_and_holds_the_line() -> None:
    h = one()
    packet = sp.make_sync_write(0x2A, {0: bytes(4), 1: bytes(4)})
    ticket = h.request(Command.SYNC_WRITE, packet, 1.0)
    h.request(Command.READ, read(0), 1.0)
    (frame,) = sent(h)
    assert (frame.cmd, frame.body) == (Command.SYNC_WRITE, packet)
    (reply,) = events(h)
    assert isinstance(reply, Reply)
    assert (reply.ticket, reply.status, reply.body, reply.frame) == (ticket, 0, b"", None)
    h.handle_timeout(1.0 + HOLDOFF - 0.001)
    assert h.data_to_send() == []
    assert h.next_timeout() == 1.0 + HOLDOFF
    h.handle_timeout(1.0 + HOLDOFF)
    assert asked(h) == [read(0)]


def test_sync_writes_in_a_row_keep_their_distance() -> None:
    h = one()
    times = []
    for i in range(4):
        h.request(Command.SYNC_WRITE, sp.make_sync_write(0x2A, {i: bytes(4)}), 0.0)
    now: float | None = 0.0
    while now is not None:
        times += [now] * len(h.data_to_send())
        now = h.next_timeout()
        if now is not None:
            h.handle_timeout(now)
    assert len(times) == 4
    assert all(b - a >= HOLDOFF * 0.999 for a, b in pairwise(times))


def test_an_echoing_adapter_makes_no_difference() -> None:
    h = one()
    h.request(Command.READ, read(0), 0.0)
    (data,) = h.data_to_send()
    # The whole frame comes back: a frame of ours, whose packet reads like a status packet of the same servo.
    h.receive(data, 0.001)
    assert [type(event) for event in events(h)] == [Stale]
    # And the board passes on the echo of its own bus, with bytes 5 and 6 of it all exchanged.
    receive(h, [bytes.fromhex("FF FF 00 04 02 02 38 BF FF F5 00 04 00 08 05 EE")], 0.05)
    (reply,) = events(h)
    assert isinstance(reply, Reply)
    assert reply.body == answer(0)


@pytest.mark.parametrize("packet", [SHORT_FRAME_PACKET, UNKNOWN_COMMAND_PACKET, sp.make_board_error(1, 3)])
def test_errors_of_the_board_are_answers(packet: bytes) -> None:
    h = one()
    h.request(Command.READ, read(3), 0.0)
    receive(h, [packet], 0.1)
    (reply,) = events(h)
    assert isinstance(reply, Reply)
    assert reply.body == packet


def test_an_unanswered_ping_is_an_answer() -> None:
    h = one()
    h.request(Command.PING, sp.make_ping(3), 0.0)
    receive(h, [sp.make_board_error(5, 2), sp.make_board_error(5, 3)], 0.1)
    stale, reply = events(h)
    assert isinstance(stale, Stale)
    assert isinstance(reply, Reply)
    assert reply.body == bytes.fromhex("FFF5030605F1")


def test_urgent_goes_next_but_never_beside_what_is_outstanding() -> None:
    h = one()
    for i in (1, 2):
        h.request(Command.READ, read(i), 0.0)
    h.request(Command.READ, read(6), 0.0, urgent=True)
    assert asked(h) == [read(1)]
    receive(h, [answer(1)], 0.05)
    assert asked(h) == [read(6)]
    receive(h, [answer(6)], 0.1)
    assert asked(h) == [read(2)]


def test_an_abandoned_request_leaves_its_window_of_silence() -> None:
    h = one()
    ticket = h.request(Command.READ, read(1), 0.0)
    queued = h.request(Command.READ, read(2), 0.0)
    h.request(Command.READ, read(3), 0.0)
    h.data_to_send()
    h.abandon(queued)
    h.abandon(ticket)
    h.handle_timeout(0.1)
    assert h.data_to_send() == []
    receive(h, [answer(1)], 0.15)
    assert [type(event) for event in events(h)] == [Stale]
    assert h.next_timeout() == WINDOW
    h.handle_timeout(WINDOW)
    assert asked(h) == [read(3)]


def test_stay_quiet_holds_everything_back() -> None:
    h = one()
    h.stay_quiet(1.0)
    h.stay_quiet(0.5)
    h.request(Command.READ, read(1), 0.0)
    assert h.data_to_send() == []
    assert h.next_timeout() == 1.0
    h.handle_timeout(1.0)
    assert asked(h) == [read(1)]


def test_a_refused_packet_does_not_disturb_the_queue() -> None:
    h = one()
    h.request(Command.READ, read(1), 0.0)
    with pytest.raises(LocalProtocolError):
        h.request(Command.READ, sp.make_read(1, 0x38, 8), 0.0)
    with pytest.raises(LocalProtocolError):
        h.request(Command.IDENTIFY, b"", 0.0)
    assert asked(h) == [read(1)]
    receive(h, [answer(1)], 0.1)
    assert isinstance(events(h)[0], Reply)
    assert h.next_timeout() is None


@given(
    st.floats(0, 2e9, allow_nan=False),
    st.integers(0, 2**32 - 1) | st.integers(0x0A0D00 - 3, 0x0A0D00 + 300) | st.integers(0x0A0D, 0x0A0E),
    st.lists(st.floats(0, 1), min_size=1, max_size=5),
)
def test_a_host_never_sends_the_marker(epoch: float, sn: int, steps: list[float]) -> None:
    h = host(dialect=1, epoch=epoch)
    h.sn = sn
    now = 0.0
    for i, step in enumerate(steps):
        now += step
        h.request(Command.READ, read(i), now)
        (data,) = h.data_to_send()
        assert b"\r\n" not in data[4:-2]
        receive(h, [answer(i)], now)
        assert isinstance(events(h)[0], Reply)


def test_hours_of_polling_never_stop_at_a_number() -> None:
    # sn 0x0A0D00 comes after six and a half hours at the chapter's rate, and used up its whole range of 256.
    h = one()
    h.sn = 0x0A0CF0
    numbers = []
    for i in range(400):
        h.request(Command.READ, read(0), i * 0.036)
        numbers += [frame.sn for frame in sent(h)]
        receive(h, [answer(0)], i * 0.036)
        assert isinstance(events(h)[0], Reply)
    assert all(b > a for a, b in pairwise(numbers))
    assert not any(b"\r\n" in n.to_bytes(4, "little") for n in numbers)


def test_on_a_network_link_the_serial_limit_holds_too() -> None:
    h = host(dialect=1, max_frame=8192)
    with pytest.raises(LocalProtocolError, match="208 is the most"):
        h.request(Command.SYNC_WRITE, sp.make_sync_write(0x2A, {i: bytes(4) for i in range(48)}), 0.0)


def test_the_echo_of_an_earlier_request_is_no_answer() -> None:
    h = one()
    for address in (0x2A, 0x38):
        h.request(Command.READ, sp.make_read(4, address, 2), 0.0)
        h.data_to_send()
        if address == 0x2A:
            receive(h, [sp.make_status(4, 0, b"\x05\x08")], 0.01)
            events(h)
    # By its form it is servo 4's answer, with error 2.
    receive(h, [sp.make_read(4, 0x2A, 2)], 0.02)
    assert [type(event) for event in events(h)] == [Stale]
    receive(h, [sp.make_read(4, 0x2A, 2) + sp.make_status(4, 0, b"\x06\x08")], 0.03)
    (reply,) = events(h)
    assert isinstance(reply, Reply)
    assert reply.body == sp.make_status(4, 0, b"\x06\x08")


def test_what_was_sent_is_remembered_within_bounds() -> None:
    h = one()
    for k in range(300):
        h.request(Command.READ, sp.make_read(k % 200, k % 80, 2), 0.0)
        h.data_to_send()
        receive(h, [answer(k % 200)], 0.0)
        events(h)
    assert len(h._chapter._sent) == 64


SYNC = sp.make_sync_write(0x2A, {0: bytes(4)})


def test_a_stop_voids_what_waits_and_what_was_not_sent_yet() -> None:
    h = one()
    first, second = (h.request(Command.READ, read(i), 0.0) for i in (1, 2))
    stop = h.request(Command.READ, read(6), 0.0, urgent=True)
    h.void()
    assert h.data_to_send() == []
    assert [h.holds(ticket) for ticket in (first, second, stop)] == [False, False, True]
    # Nothing went, so nothing has to be waited for.
    assert h.next_timeout() == 0.0
    h.handle_timeout(0.0)
    assert asked(h) == [read(6)]
    h.void()
    assert h.holds(stop), "it is urgent itself"
    receive(h, [answer(6)], 0.1)
    assert [e.ticket for e in events(h) if isinstance(e, Reply)] == [stop]
    assert h.next_timeout() is None


def test_a_stop_that_is_voided_beside_others_stays_to_be_sent() -> None:
    h = one()
    h.request(Command.READ, read(6), 0.0, urgent=True)
    h.request(Command.READ, read(1), 0.0)
    h.void()
    assert asked(h) == [read(6)]
    receive(h, [answer(6)], 0.1)
    assert asked(h) == []


def test_after_a_stop_the_answer_to_what_was_sent_has_its_window() -> None:
    h = one()
    first = h.request(Command.READ, read(1), 0.05)
    h.data_to_send()
    stop = h.request(Command.READ, read(6), 0.1, urgent=True)
    h.void()
    assert (h.holds(first), h.holds(stop)) == (False, True)
    assert h.next_timeout() == pytest.approx(0.05 + WINDOW)
    h.handle_timeout(0.05 + WINDOW - 0.001)
    assert h.data_to_send() == []
    h.handle_timeout(0.05 + WINDOW)
    assert asked(h) == [read(6)]


def test_what_is_held() -> None:
    h = one()
    outstanding, queued = (h.request(Command.READ, read(i), 0.0) for i in (1, 2))
    assert (h.holds(outstanding), h.holds(queued), h.holds(99)) == (True, True, False)
    receive(h, [answer(1)], 0.1)
    assert (h.holds(outstanding), h.holds(queued)) == (False, True)
    receive(h, [answer(2)], 0.1)
    assert not h.holds(queued)


def test_giving_up_says_whether_it_may_have_gone() -> None:
    h = one()
    assert h.abandon(99), "not known here"
    taken, queued = (h.request(Command.READ, read(i), 0.0) for i in (1, 2))
    h.data_to_send()
    assert not h.abandon(queued)
    assert h.abandon(99)
    assert h.abandon(taken)
    assert h._chapter._quiet_until == WINDOW
    h.handle_timeout(WINDOW)
    held_back = h.request(Command.READ, read(3), 1.0)
    assert not h.abandon(held_back)
    assert h.data_to_send() == []
    assert h._chapter._quiet_until == WINDOW, "what was not sent needs no silence"
    twice = h.request(Command.READ, read(4), 2.0)
    h.data_to_send()
    h.handle_timeout(2.0 + WINDOW)
    assert h.abandon(twice), "its first sending went"
    assert h.data_to_send() == []


@pytest.mark.parametrize("taken", [False, True])
def test_a_sync_write_can_be_taken_back_until_it_is_sent(taken: bool) -> None:
    h = one()
    ticket = h.request(Command.SYNC_WRITE, SYNC, 0.0)
    if taken:
        h.data_to_send()
    assert h.abandon(ticket + 1), "another"
    assert h.abandon(ticket) is taken
    assert h.data_to_send() == []


def test_an_answer_in_time_leaves_no_silence_behind() -> None:
    h = one()
    h.request(Command.READ, read(1), 0.0)
    h.request(Command.READ, read(2), 0.0)
    h.data_to_send()
    receive(h, [answer(1)], 0.01)
    assert asked(h) == [read(2)]
    c = h.counters
    assert (c.requests, c.replies, c.retries, c.timeouts, c.frames_sent) == (2, 1, 0, 0, 2)
    (reply,) = events(h)
    assert isinstance(reply, Reply)
    assert (reply.attempts, reply.cmd, reply.status) == (1, Command.READ, 0)
    assert reply.frame is not None
    assert reply.frame.body == answer(1)


def test_a_window_of_its_own_and_what_came_instead() -> None:
    h = one()
    h.request(Command.READ, read(1), 1.0, window=0.5, attempts=1)
    receive(h, [answer(2)], 1.1)
    assert h.next_timeout() == 1.5
    h.handle_timeout(1.499)
    assert [type(event) for event in events(h)] == [Stale]
    h.handle_timeout(1.5)
    (timed_out,) = events(h)
    assert isinstance(timed_out, TimedOut)
    assert (timed_out.cmd, timed_out.attempts) == (Command.READ, 1)
    assert "dialect 1" in timed_out.instead
    h.request(Command.READ, read(1), 1.6)
    assert h.next_timeout() == 2.0, "and as long again for an answer that comes late"


def test_a_packet_sent_again_is_the_last_to_be_forgotten() -> None:
    h = one()
    for k in [0, *range(1, 64), 0, 64]:
        h.request(Command.READ, sp.make_read(1, k, 2), 0.0)
        h.data_to_send()
        receive(h, [answer(1)], 0.0)
    assert [packet[5] for packet in h._chapter._sent] == [*range(2, 64), 0, 64]
