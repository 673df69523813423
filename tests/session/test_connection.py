"""Both roles of the session machine in dialect 2, and the board's half of dialect 1."""

from __future__ import annotations

import random
from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.session.wires import LOG, VECTORS, Line, bad_line, board, echo_body, events, host

from hexwire.errors import LocalProtocolError
from hexwire.session.connection import Connection
from hexwire.session.dialect1 import UNKNOWN_COMMAND_PACKET
from hexwire.session.events import BadFrame, Garbage, Reply, Report, Request, Stale, TimedOut
from hexwire.session.policy import RetryPolicy
from hexwire.wire import tables
from hexwire.wire.command_frame import Command, Frame, Status, parse_frame, serialize_frame
from hexwire.wire.commands import FragmentHead, serialize_missing

WINDOW = tables.DIALECT2_REPLY_WINDOW


def sent(connection: Connection) -> list[Frame]:
    return [parse_frame(data) for data in connection.data_to_send()]


def ask(board_end: Connection, data: bytes, now: float = 0.0) -> list[Request]:
    board_end.receive(data, now)
    return [event for event in events(board_end) if isinstance(event, Request)]


def one_reply(host_end: Connection) -> Reply:
    (reply,) = (event for event in events(host_end) if isinstance(event, Reply))
    return reply


def reply_frame(request: Frame, **changes: Any) -> bytes:
    fields: dict[str, Any] = {
        "proto": 2, "cmd": request.cmd, "body": b"", "seq": request.seq, "sn": 1, "src": 8, "dst": 7, "type": 8,
        "time_sec": 0, "time_nsec": 0, "cmd_ext": 0x80,
    }  # fmt: skip
    return serialize_frame(Frame(**fields | changes))


# --- asking and answering ----------------------------------------------------------------------------------


def test_a_request_and_its_reply() -> None:
    h, b = host(epoch=1000.0), board()
    ticket = h.request(Command.STOP, b"\0", 5.25)
    (data,) = h.data_to_send()
    frame = parse_frame(data)
    assert (frame.proto, frame.cmd, frame.cmd_ext, frame.body) == (2, Command.STOP, 0, b"\0")
    assert (frame.src, frame.dst, frame.type) == (7, 8, 3)
    assert (frame.time_sec, frame.time_nsec) == (1005, 250_000_000)
    (request,) = ask(b, data, 1.0)
    b.reply(request, Status.STOPPED, b"xyz", 1.5)
    (answer,) = b.data_to_send()
    parsed = parse_frame(answer)
    assert (parsed.src, parsed.dst, parsed.type) == (8, 7, 8)
    assert (parsed.seq, parsed.cmd, parsed.cmd_ext) == (frame.seq, frame.cmd, 0x80 | Status.STOPPED)
    h.receive(answer, 5.35)
    reply = one_reply(h)
    assert (reply.ticket, reply.cmd, reply.status, reply.body) == (ticket, Command.STOP, Status.STOPPED, b"xyz")
    assert reply.rtt == pytest.approx(0.1)
    assert reply.attempts == 1
    assert h.next_timeout() is None
    assert h.data_to_send() == []


def test_sn_grows_with_every_frame_and_seq_with_every_request() -> None:
    h = host()
    for _ in range(300):
        ticket = h.request(Command.STATS, b"", 0.0)
        h.abandon(ticket)
    frames = sent(h)
    assert all(b.sn == a.sn + 1 for a, b in pairwise(frames))
    assert all(b.seq == (a.seq + 1) % 256 for a, b in pairwise(frames))
    assert h.counters.frames_sent == 300


def test_the_sn_wraps() -> None:
    h = host()
    h.sn = 0xFFFFFFFF
    h.request(Command.STATS, b"", 0.0)
    assert sent(h)[0].sn == 0


@pytest.mark.parametrize(
    "changes",
    [{"seq": 77}, {"cmd": Command.STOP}, {"src": 3}, {"dst": 0}, {"cmd_ext": 0}],
    ids=lambda changes: next(iter(changes)),
)
def test_a_frame_that_is_not_an_answer_is_stale(changes: dict[str, int]) -> None:
    h = host()
    h.request(Command.STATS, b"", 0.0)
    (request,) = sent(h)
    h.receive(reply_frame(request, **changes), 0.1)
    (event,) = events(h)
    assert isinstance(event, Stale)
    assert h.counters.stale == 1
    # The request still waits, and says what came instead.
    h.handle_timeout(WINDOW)
    h.handle_timeout(2 * WINDOW)
    h.handle_timeout(3 * WINDOW)
    (timed_out,) = events(h)
    assert isinstance(timed_out, TimedOut)
    assert timed_out.instead
    assert timed_out.attempts == 3


def test_retries_keep_seq_and_body_and_then_give_up() -> None:
    h = host(policy=RetryPolicy(attempts=4, window=0.1))
    ticket = h.request(Command.STATS, b"body", 0.0)
    first, *rest = sent(h)
    assert rest == []
    for n in range(1, 4):
        assert h.next_timeout() == pytest.approx(n * 0.1)
        h.handle_timeout(h.next_timeout() or 0.0)
        (again,) = sent(h)
        assert (again.seq, again.cmd, again.body) == (first.seq, first.cmd, first.body)
        assert again.sn == first.sn + n
    h.handle_timeout(0.4)
    assert events(h) == [TimedOut(ticket, Command.STATS, 4, "")]
    assert h.next_timeout() is None
    assert (h.counters.retries, h.counters.timeouts) == (3, 1)
    # The answer that comes now is late, and answers nothing.
    h.receive(reply_frame(first), 0.5)
    (late,) = events(h)
    assert isinstance(late, Stale)


def test_window_and_attempts_of_one_request() -> None:
    h = host()
    h.request(Command.STATS, b"", 0.0, window=1.5, attempts=1)
    assert h.next_timeout() == 1.5
    h.handle_timeout(1.5)
    (event,) = events(h)
    assert isinstance(event, TimedOut)


def test_both_answers_to_a_repeated_request_count_once() -> None:
    h, b = host(), board()
    h.request(Command.STATS, b"", 0.0)
    h.handle_timeout(WINDOW)
    one, two = h.data_to_send()
    (request,) = ask(b, one)
    b.reply(request, 0, b"1", 0.3)
    assert ask(b, two, 0.4) == []
    answers = b.data_to_send()
    assert len(answers) == 2
    h.receive(b"".join(answers), 0.5)
    reply, stale = events(h)
    assert isinstance(reply, Reply)
    assert reply.attempts == 2
    assert isinstance(stale, Stale)
    assert b.counters.repeats == 1


def test_several_outstanding_are_matched_by_seq() -> None:
    h = host()
    tickets = {h.request(cmd, b"", 0.0): cmd for cmd in (Command.STATS, Command.STATS, Command.LIMITS)}
    for request in reversed(sent(h)):
        h.receive(reply_frame(request, body=bytes((request.seq,))), 0.1)
    found = [event for event in events(h) if isinstance(event, Reply)]
    assert {reply.ticket: reply.cmd for reply in found} == tickets
    assert [reply.body for reply in found] == [bytes((n,)) for n in (3, 2, 1)]


def test_256_outstanding_are_the_end() -> None:
    h = host()
    for _ in range(256):
        h.request(Command.STATS, b"", 0.0)
    assert len({frame.seq for frame in sent(h)}) == 256
    with pytest.raises(LocalProtocolError, match="256 requests"):
        h.request(Command.STATS, b"", 0.0)
    assert h.data_to_send() == []


def test_an_abandoned_request_is_forgotten_and_its_answer_stale() -> None:
    h = host()
    ticket = h.request(Command.STATS, b"", 0.0)
    (request,) = sent(h)
    h.abandon(ticket)
    h.abandon(ticket)
    assert h.next_timeout() is None
    h.receive(reply_frame(request), 0.1)
    (event,) = events(h)
    assert isinstance(event, Stale)


def test_urgent_goes_before_what_waits_to_be_written() -> None:
    h = host()
    h.request(Command.STATS, b"", 0.0)
    h.request(Command.STOP, b"\0", 0.0, urgent=True)
    assert [frame.cmd for frame in sent(h)] == [Command.STOP, Command.STATS]


def test_a_body_that_cannot_go_leaves_nothing_behind() -> None:
    h = host()
    with pytest.raises(LocalProtocolError, match="too long for fragments; at most 1048576"):
        h.request(Command.STATS, bytes(2 << 20), 0.0)
    assert h.next_timeout() is None
    h.handle_timeout(10.0)
    assert events(h) == []


def test_limit_frame_only_ever_shrinks_and_not_to_nonsense() -> None:
    h = host(max_frame=8192)
    h.limit_frame(253)
    h.limit_frame(8192)
    assert h.max_frame == 253
    h.limit_frame(0)
    assert h.max_frame == 128
    h.request(Command.STATS, bytes(500), 0.0)
    assert all(frame.size <= 128 for frame in sent(h))


# --- the board's half --------------------------------------------------------------------------------------


def request_frame(seq: int = 1, cmd: int = Command.JOINT_MOVE, body: bytes = b"b", **changes: int) -> bytes:
    fields = {"sn": 1, "src": 7, "dst": 8, "type": 3, "time_sec": 0, "time_nsec": 0} | changes
    return serialize_frame(Frame(proto=2, cmd=cmd, body=body, seq=seq, **fields))


def test_a_repeat_is_answered_from_store_with_a_new_number_and_time() -> None:
    b = board()
    (request,) = ask(b, request_frame())
    b.reply(request, 0, b"done", 0.0)
    (first,) = map(parse_frame, b.data_to_send())
    assert ask(b, request_frame(sn=2, time_sec=1), 1.9) == []
    (again,) = map(parse_frame, b.data_to_send())
    assert again.body == first.body == b"done"
    assert (again.seq, again.cmd, again.cmd_ext) == (first.seq, first.cmd, first.cmd_ext)
    # By its time the host knows how old what the body says is.
    assert again.sn == first.sn + 1
    assert again.time_sec + again.time_nsec * 1e-9 == pytest.approx(first.time_sec + 1.9)
    assert b.counters.repeats == 1
    assert ask(b, request_frame(sn=2, time_sec=1), 1.95) == []
    assert b.counters.repeats == 2
    assert len(ask(b, request_frame(sn=3), 2.0)) == 1


def test_a_stop_takes_no_number_for_answers_that_nobody_asks_for_again() -> None:
    b = board()
    (torque,) = ask(b, request_frame(cmd=Command.TORQUE))
    b.reply(torque, 0, b"on", 0.0)
    (done,) = sent(b)
    b.take_stop(0.5)
    assert b.data_to_send() == []
    for seq in range(2, 6):
        (stop,) = ask(b, request_frame(seq=seq, cmd=Command.STOP), 0.5)
        b.reply(stop, 0, b"", 0.5)
    stopped = sent(b)[-1]
    assert stopped.sn == done.sn + 4
    # A repeat of what was done before the stop, and is no longer kept, has a number and time of its own.
    assert ask(b, request_frame(cmd=Command.TORQUE, sn=3), 0.9) == []
    (refused,) = sent(b)
    assert refused == stopped._replace(
        sn=stopped.sn + 1, time_nsec=900_000_000, seq=1, cmd=Command.TORQUE, cmd_ext=0x80 | Status.STOPPED
    )


def test_a_repeat_while_the_first_is_being_done_is_not_begun_again() -> None:
    b = board()
    (request,) = ask(b, request_frame())
    assert ask(b, request_frame(sn=2), 0.2) == []
    assert b.data_to_send() == []
    b.reply(request, 0, b"done", 0.3)
    assert len(b.data_to_send()) == 1


@pytest.mark.parametrize("rate", [129, 1000, 5000])
def test_a_host_that_wraps_seq_within_the_window_never_gets_an_old_answer(rate: int) -> None:
    h, b = host(), board()
    for i in range(600):
        now = i / rate
        ticket = h.request(Command.JOINT_STATE, b"\x3f", now)
        for data in h.data_to_send():
            for request in ask(b, data, now):
                b.reply(request, 0, i.to_bytes(4, "little"), now)
        for data in b.data_to_send():
            h.receive(data, now)
        reply = one_reply(h)
        assert (reply.ticket, reply.body) == (ticket, i.to_bytes(4, "little"))
    assert b.counters.repeats == 0


@pytest.mark.parametrize("rate", [129, 300, 1000])
def test_what_is_asked_after_a_stop_is_done_however_fast_seq_wraps(rate: int) -> None:
    """The board refuses repeats of what it did before a stop, and seq comes round within the time of that."""
    h, b = host(), board()
    cases = [
        (Command.RESUME, b""),
        (Command.TORQUE, b"\1\x7f"),
        (Command.TORQUE, b"\0\x7f"),
        (Command.MAINTENANCE, b"\1"),
        (Command.WATCHDOG, b"\0\0\0"),
    ]

    def asked(cmd: int, body: bytes, now: float) -> int:
        h.request(cmd, body, now)
        for data in h.data_to_send():
            for request in ask(b, data, now):
                if cmd == Command.STOP:
                    b.take_stop(now)
                b.reply(request, 0, b"", now)
        for data in b.data_to_send():
            h.receive(data, now)
        return one_reply(h).status

    # Every request comes again at a distance of 256 numbers.
    for i in range(0, 12 * 256, 32):
        cmd, body = cases[i // 32 % 8 % len(cases)]
        for part in range(29):
            assert asked(Command.JOINT_STATE, b"\x3f", (i + part) / rate) == 0
        assert asked(Command.STOP, b"\0", (i + 29) / rate) == 0
        assert asked(cmd, body, (i + 30) / rate) == 0, (i, cmd)
        assert asked(Command.RESUME, b"", (i + 31) / rate) == 0, i
    assert len(h._used) <= 3 * rate


def test_a_host_that_starts_anew_is_not_taken_for_its_own_repeat() -> None:
    b = board()
    done = 0
    for _ in range(3):
        # The same program run three times within two seconds: same numbers, same bodies, each meant.
        h = host()
        for cmd, body in ((Command.IDENTIFY, b""), (Command.TORQUE, b"\1\x7f\0")):
            h.request(cmd, body, 0.0)
            (data,) = h.data_to_send()
            for request in ask(b, data, 0.5):
                done += 1
                b.reply(request, 0, b"", 0.5)
    assert done == 6


@pytest.mark.parametrize(
    "changes", [{"dst": 7}, {"dst": -2}, {"dst": 0x40000080}, {"cmd_ext": 0x80}, {"cmd_ext": 0x40}, {"cmd_ext": 1}]
)
def test_what_is_not_for_this_board_is_ignored(changes: dict[str, int]) -> None:
    for cmd in (Command.STOP, Command.FRAGMENT, Command.FRAGMENT_MISSING):
        b = board()
        body = FragmentHead(1, 0, 2, 2, 0).serialize() + b"x"
        b.receive(request_frame(cmd=cmd, body=body, **changes), 0.0)
        assert [type(event) for event in events(b)] == [Stale]
        b.handle_timeout(1.0)
        assert b.data_to_send() == []


@pytest.mark.parametrize("row", [r for r in VECTORS if r["kind"] == "bad"], ids=lambda r: r["name"])
def test_a_bad_frame_is_neither_acted_on_nor_answered(row: dict[str, Any]) -> None:
    for end in (host(), board()):
        end.receive(bytes.fromhex(row["hex"]), 0.0)
        while (due := end.next_timeout()) is not None:
            end.handle_timeout(due)
        found = events(end)
        good = row["name"] == "one byte too many" and end.role.value == "board"
        kinds = (BadFrame, Garbage, Stale) + ((Request,) if good else ())
        assert all(isinstance(event, kinds) for event in found)
        assert end.data_to_send() == []


def test_reports_are_unsolicited_and_bounded() -> None:
    h, b = host(), board()
    for i in range(100):
        b.report(Command.JOINT_STATE, bytes((i,)), 0.0)
    frames = b.data_to_send()
    assert all(parse_frame(data).cmd_ext == 0x40 for data in frames)
    h.receive(b"".join(frames), 0.0)
    found = [event.frame.body[0] for event in events(h) if isinstance(event, Report)]
    assert found == list(range(36, 100))
    assert (h.counters.reports, h.counters.reports_dropped) == (100, 36)


def test_a_reply_survives_any_amount_of_noise_after_it() -> None:
    h = host()
    ticket = h.request(Command.STATS, b"", 0.0)
    (request,) = sent(h)
    noise = tables.SYNC_BYTES * 4000 + request_frame() * 2000
    for _ in range(5):
        h.receive(reply_frame(request) + noise, 0.1)
    replies = [event for event in events(h) if isinstance(event, Reply)]
    assert [reply.ticket for reply in replies] == [ticket]
    assert h.counters.events_dropped > 0


def test_a_board_answers_a_host_of_another_name_under_that_name() -> None:
    b = board()
    (request,) = ask(b, request_frame(src=0))
    b.reply(request, 0, bytes(500), 0.0)
    assert {frame.dst for frame in sent(b)} == {0}


# --- dialect 1, the board's half: the chapter's log --------------------------------------------------------


@pytest.mark.parametrize(("request_row", "reply_row"), [LOG[:2], LOG[2:]], ids=["load", "position"])
def test_the_chapters_log_byte_for_byte(request_row: dict[str, Any], reply_row: dict[str, Any]) -> None:
    b = board()
    (request,) = ask(b, bytes.fromhex(request_row["hex"]))
    frame = request.frame
    assert frame.body == bytes.fromhex(request_row["body"])
    b.sn = reply_row["sn"] - 1
    now = reply_row["time_sec"] + reply_row["time_nsec"] / 1e9
    b.reply_dialect1(bytes.fromhex(reply_row["body"]), now)
    # The chapter's clock counts milliseconds; given the same one, the stamps are the same too.
    assert b.data_to_send() == [bytes.fromhex(reply_row["hex"])]
    # And a host that asked this takes it for the answer.
    h = host(dialect=1)
    ticket = h.request(frame.cmd, frame.body, 0.0)
    (ours,) = h.data_to_send()
    assert ours[32:34] == bytes.fromhex(request_row["hex"])[32:34]
    assert ours[35:48] == bytes.fromhex(request_row["hex"])[35:48]
    h.receive(bytes.fromhex(reply_row["hex"]), 0.05)
    reply = one_reply(h)
    assert (reply.ticket, reply.body) == (ticket, bytes.fromhex(reply_row["body"]))


def test_dialect_1_is_taken_whatever_its_dst_and_type() -> None:
    for dst in (8, 0, -1, 99):
        data = serialize_frame(
            Frame(proto=1, cmd=2, body=b"", seq=1, sn=1, src=7, dst=dst, type=dst, time_sec=0, time_nsec=0)
        )
        assert len(ask(board(), data)) == 1


@given(st.integers(0, 10**9))
def test_milliseconds_are_not_cut_short(ms: int) -> None:
    b = board()
    b.reply_dialect1(b"\xff\xff\x00\x02\x00\xfd", ms / 1000)
    (frame,) = sent(b)
    assert frame.time_sec * 1000 + frame.time_nsec / 10**6 == ms


# --- time --------------------------------------------------------------------------------------------------


def test_an_unfinished_frame_is_noted_and_what_it_held_comes_out() -> None:
    h = host()
    h.request(Command.STATS, b"", 0.0)
    (request,) = sent(h)
    false_head = reply_frame(request, body=bytes(200))[:40]
    h.receive(false_head + reply_frame(request), 0.01)
    assert events(h) == []
    h.handle_timeout(0.0601)
    found = events(h)
    assert isinstance(found[0], BadFrame)
    assert any(isinstance(event, Reply) for event in found)


CHUNKS = st.lists(
    st.binary(max_size=60)
    | st.builds(
        lambda cmd, ext, body, seq, src: serialize_frame(Frame(
            proto=2, cmd=cmd, body=body, seq=seq, sn=1, src=src, dst=15 - src, type=3, time_sec=0, time_nsec=0,
            cmd_ext=ext,
        )),
        st.sampled_from(list(Command)) | st.integers(0, 255),
        st.sampled_from((0, 0x80, 0x40, 0x85, 0xFF)),
        st.binary(max_size=20)
        | st.builds(
            lambda *head, chunk=b"x": FragmentHead(*head).serialize() + chunk,
            st.integers(0, 5), st.integers(0, 3), st.integers(0, 4), st.integers(0, 40), st.just(0),
        )
        | st.builds(serialize_missing, st.integers(0, 600), st.lists(st.integers(0, 300), max_size=8).map(tuple)),
        st.integers(0, 4),
        st.sampled_from((7, 8)),
    ),
    max_size=12,
)  # fmt: skip
ACTIONS = st.lists(st.sampled_from(("ask", "ask big", "ask 1", "abandon", "wait", "listen")), max_size=12)


@given(CHUNKS, ACTIONS, st.lists(st.floats(0, 0.3), min_size=12, max_size=12), st.sampled_from((1, 2)))
def test_any_bytes_and_any_order_of_calls(
    chunks: list[bytes], actions: list[str], steps: list[float], dialect: int
) -> None:
    """No call raises but for what it says, no timeout stands still, and every request has one outcome."""
    ends = host(dialect=dialect), board()
    now, open_tickets, line = 0.0, set(), list(chunks)
    for action, step in zip(actions, steps, strict=False):
        now += step
        h = ends[0]
        if action == "listen" and line:
            data = line.pop()
            for end in ends:
                end.receive(data, now)
        elif action == "abandon" and open_tickets:
            h.abandon(open_tickets.pop())
        elif action.startswith("ask"):
            if dialect == 1:
                open_tickets.add(h.request(Command.READ, b"\xff\xff\x00\x04\x02\x38\x02\xbf", now))
            elif action == "ask big":
                try:
                    open_tickets.add(h.request(Command.STATS, bytes(900), now))
                except LocalProtocolError:
                    assert len(open_tickets) >= tables.FRAGMENT_MESSAGES
            else:
                open_tickets.add(h.request(Command.STATS, b"", now))
        for end in ends:
            if (due := end.next_timeout()) is not None and due <= now:
                end.handle_timeout(now)
                after = end.next_timeout()
                assert after is None or after > now
            assert all(len(data) <= 253 for data in end.data_to_send())
            for event in events(end):
                assert "\n" not in str(event)
                if isinstance(event, Reply | TimedOut):
                    open_tickets.remove(event.ticket)
                elif isinstance(event, Request) and event.frame.proto == 2:
                    end.reply(event, 0, event.frame.body * 20, now)
    # Left alone, every request comes to its end in bounded time.
    h = ends[0]
    rounds = 0
    while (due := h.next_timeout()) is not None:
        rounds += 1
        assert rounds < 500
        now = max(now, due)
        h.handle_timeout(now)
        h.data_to_send()
        for event in events(h):
            if isinstance(event, Reply | TimedOut):
                open_tickets.remove(event.ticket)
    assert not open_tickets


# --- fragments over two connections ------------------------------------------------------------------------


def test_a_megabyte_there_and_back_over_a_bad_line() -> None:
    rng = random.Random(3)
    body = rng.randbytes(1 << 20)
    line = Line(
        host(max_frame=8192), board(max_frame=8192), mangle=bad_line(rng, loss=0.02, double=0.05), delay=0.002
    )
    ticket = line.host.request(Command.TRANSACT, body, 0.0, attempts=10)
    line.run(60.0, stop=lambda: any(isinstance(event, Reply) for event in line.seen))
    (reply,) = (event for event in line.seen if isinstance(event, Reply))
    assert reply.ticket == ticket
    assert reply.body == body
    requests = [event for event in line.board_seen if isinstance(event, Request)]
    assert len(requests) == 1
    assert requests[0].frame.body == body


@pytest.mark.parametrize("loss", [0.0, 0.1, 0.3])
@pytest.mark.parametrize("size", [209, 1000, 20_000])
def test_bodies_over_a_serial_line_that_loses_frames(size: int, loss: float) -> None:
    for seed in range(5):
        rng = random.Random(seed)
        body = rng.randbytes(size)
        line = Line(host(), board(), mangle=bad_line(rng, loss=loss, double=loss / 2))
        line.host.request(Command.TRANSACT, body, 0.0, attempts=50)
        line.run(120.0, stop=lambda line=line: any(isinstance(event, Reply) for event in line.seen))
        (reply,) = (event for event in line.seen if isinstance(event, Reply))
        assert reply.body == body
        assert sum(isinstance(event, Request) for event in line.board_seen) == 1


def test_the_answer_to_a_request_in_fragments_is_asked_for_again_when_lost() -> None:
    drop = True

    def mangle(data: bytes) -> list[bytes]:
        nonlocal drop
        frame = parse_frame(data)
        if drop and frame.is_reply:
            drop = False
            return []
        return [data]

    def short_answer(b: Connection, request: Request, now: float) -> None:
        b.reply(request, 0, b"short", now)

    line = Line(host(), board(), short_answer, mangle=mangle)
    line.host.request(Command.TRANSACT, bytes(1000), 0.0)
    line.run(5.0)
    (reply,) = (event for event in line.seen if isinstance(event, Reply))
    assert (reply.body, reply.attempts) == (b"short", 2)
    assert sum(isinstance(event, Request) for event in line.board_seen) == 1


def test_a_long_answer_may_take_longer_than_the_window() -> None:
    def long_answer(b: Connection, request: Request, now: float) -> None:
        b.reply(request, 0, bytes(20_000), now)

    line = Line(host(), board(), long_answer, delay=0.05)
    line.host.request(Command.STATS, b"", 0.0, attempts=1)
    line.run(5.0)
    (reply,) = (event for event in line.seen if isinstance(event, Reply))
    assert reply.body == bytes(20_000)
    assert reply.rtt > 2 * WINDOW


def test_a_peer_that_goes_away_in_the_middle_is_given_up() -> None:
    line = Line(host(max_frame=8192), board(max_frame=8192), delay=0.01)
    ticket = line.host.request(Command.TRANSACT, bytes(1 << 20), 0.0)
    line.run(0.05)
    line.up = False
    line.run(10.0)
    assert [event for event in line.seen if isinstance(event, TimedOut)] == [
        TimedOut(ticket, Command.TRANSACT, 3, "")
    ]
    for end in (line.host, line.board):
        assert end.next_timeout() is None
        assert not end._fragments_out._out
        assert not end._fragments_in._in


def test_a_fragment_in_a_fragment_is_not_opened() -> None:
    b = board()
    inner = FragmentHead(9, 0, 1, Command.STOP, 0).serialize() + b"\0"
    body = FragmentHead(5, 0, 1, Command.FRAGMENT, 0).serialize() + inner
    assert ask(b, request_frame(cmd=Command.FRAGMENT, body=body)) == []
    assert b.counters.stale == 1


def test_hostile_fragments_are_events_and_never_errors() -> None:
    b = board()
    for body in (b"", b"1234567", FragmentHead(1, 0, 65535, 2, 0).serialize() + bytes(100)):
        b.receive(request_frame(cmd=Command.FRAGMENT, body=body), 0.0)
        b.receive(request_frame(cmd=Command.FRAGMENT_MISSING, body=body), 0.0)
    for message_id in range(3000):
        body = FragmentHead(message_id, 0, 2, 2, 0).serialize() + b"x"
        b.receive(request_frame(cmd=Command.FRAGMENT, body=body), 0.0)
    assert all(isinstance(event, BadFrame) for event in events(b))
    assert len(b._fragments_in._in) <= tables.FRAGMENT_MESSAGES


@given(st.integers(0, 500), st.data())
def test_every_byte_split_of_a_conversation(size: int, data: st.DataObject) -> None:
    cut = data.draw(st.integers(1, 40))

    def mangle(frame: bytes) -> list[bytes]:
        return [frame[i : i + cut] for i in range(0, len(frame), cut)]

    line = Line(host(), board(), echo_body, mangle=mangle)
    body = bytes(range(256)) * 2
    line.host.request(Command.TRANSACT, body[:size], 0.0)
    line.run(3.0)
    (reply,) = (event for event in line.seen if isinstance(event, Reply))
    assert reply.body == body[:size]


# --- a stop, and what is given up ----------------------------------------------------------------------------


def test_a_stop_voids_every_request_but_other_stops() -> None:
    h = host()
    taken = h.request(Command.JOINT_MOVE, b"a", 0.0)
    h.data_to_send()
    waiting = h.request(Command.JOINT_MOVE, b"b", 0.0)
    long = h.request(Command.TRANSACT, bytes(1000), 0.0)
    stop = h.request(Command.STOP, b"\0", 0.0, urgent=True)
    h.void()
    assert [frame.cmd for frame in sent(h)] == [Command.STOP]
    assert [h.holds(ticket) for ticket in (taken, waiting, long, stop)] == [False, False, False, True]
    assert not h._fragments_out._out
    h.handle_timeout(WINDOW)
    assert [frame.cmd for frame in sent(h)] == [Command.STOP], "nothing else is asked again"
    h.void()
    assert h.data_to_send() == []
    h.handle_timeout(2 * WINDOW)
    h.handle_timeout(3 * WINDOW)
    assert [(e.ticket, e.attempts) for e in events(h) if isinstance(e, TimedOut)] == [(stop, 3)]


def test_what_is_held() -> None:
    h = host()
    first, second = (h.request(Command.STATS, b"", 0.0) for _ in range(2))
    request, _ = sent(h)
    assert (h.holds(first), h.holds(second), h.holds(99)) == (True, True, False)
    h.receive(reply_frame(request), 0.1)
    assert (h.holds(first), h.holds(second)) == (False, True)


def test_giving_up_says_whether_some_of_it_may_have_gone() -> None:
    h = host()
    assert h.abandon(99), "not known here"
    ticket = h.request(Command.STATS, b"", 0.0)
    other = h.request(Command.LIMITS, b"", 0.0)
    assert not h.abandon(ticket)
    assert [frame.cmd for frame in sent(h)] == [Command.LIMITS]
    assert h.abandon(other)
    twice = h.request(Command.STATS, b"", 0.0)
    h.data_to_send()
    h.handle_timeout(WINDOW)
    assert h.abandon(twice), "its first sending went"
    assert h.data_to_send() == []
    long = h.request(Command.TRANSACT, bytes(1000), 1.0)
    assert not h.abandon(long)
    assert h.data_to_send() == []
    long = h.request(Command.TRANSACT, bytes(1000), 1.0)
    h._out = h._out[1:]
    assert h.abandon(long), "its first frame went"
    assert h.data_to_send() == []


def test_after_256_requests_a_number_that_is_still_waited_for_is_passed_over() -> None:
    h = host()
    kept = h.request(Command.STATS, b"", 0.0, window=100.0)
    for _ in range(255):
        h.abandon(h.request(Command.STATS, b"", 0.0))
    h.data_to_send()
    h.request(Command.STATS, b"", 0.0)
    assert [frame.seq for frame in sent(h)] == [2]
    assert h.holds(kept)


def test_an_answer_that_comes_late_or_twice_counts_once() -> None:
    h = host()
    ticket = h.request(Command.STATS, b"", 0.0)
    (request,) = sent(h)
    h.handle_timeout(WINDOW - 1e-9)
    assert h.data_to_send() == [], "its window is not over"
    h.handle_timeout(WINDOW)
    assert len(h.data_to_send()) == 1
    h.receive(reply_frame(request) * 2, WINDOW + 0.05)
    reply, stale = events(h)
    assert isinstance(reply, Reply)
    assert (reply.ticket, reply.attempts, reply.cmd) == (ticket, 2, Command.STATS)
    assert reply.rtt == pytest.approx(0.05), "from the last sending"
    assert reply.frame is not None
    assert isinstance(stale, Stale)
    assert stale == Stale(reply.frame, "answers no outstanding request")
    c = h.counters
    assert (c.requests, c.retries, c.replies, c.stale, c.timeouts, c.frames_sent) == (1, 1, 1, 1, 0, 2)


def test_the_next_deadline_is_the_first_of_all() -> None:
    h = host()
    assert h.next_timeout() is None
    h.request(Command.STATS, b"", 1.0, window=5.0)
    h.request(Command.STATS, b"", 1.0, window=3.0)
    h.request(Command.STATS, b"", 1.0, window=4.0)
    assert h.next_timeout() == 4.0
    h.receive(tables.SYNC_BYTES, 1.5)
    assert h.next_timeout() == 1.5 + tables.INTERBYTE_TIMEOUT
    h.handle_timeout(1.5 + tables.INTERBYTE_TIMEOUT)
    assert h.next_timeout() == 4.0


def test_bytes_received_instead_are_reported_for_every_waiting_request() -> None:
    h = host(policy=RetryPolicy(attempts=1))
    for _ in range(2):
        h.request(Command.STATS, b"", 0.0)
    h.receive(b"xyz", 0.1)
    h.handle_timeout(WINDOW)
    assert [e.instead for e in events(h) if isinstance(e, TimedOut)] == ["3 bytes of garbage: 78 79 7A"] * 2
    h.request(Command.STATS, b"", 1.0)
    (request,) = sent(h)[-1:]
    other = reply_frame(request, seq=99)
    h.receive(other, 1.1)
    h.handle_timeout(1.0 + WINDOW)
    assert [e.instead for e in events(h) if isinstance(e, TimedOut)] == [str(parse_frame(other))]


def test_a_message_with_an_end_leaves_nothing_unfinished() -> None:
    h = host()
    h.receive(reply_frame(request_of(b""))[:-1], 0.0, end_of_message=True)
    found = events(h)
    assert isinstance(found[0], BadFrame)
    assert found[0].reason == "cut short"
    assert h.next_timeout() is None


def request_of(body: bytes, cmd: int = Command.STATS) -> Frame:
    h = host()
    h.request(cmd, body, 0.0)
    return sent(h)[0]


@pytest.mark.parametrize("cmd", [Command.FRAGMENT, Command.FRAGMENT_MISSING, Command.IDENTIFY])
def test_what_may_not_come_in_fragments(cmd: int) -> None:
    b = board()
    data = request_frame(cmd=Command.FRAGMENT, body=FragmentHead(5, 0, 1, cmd, 0).serialize() + b"x")
    b.receive(data, 0.0)
    assert events(b) == [Stale(parse_frame(data), "a command that must not be fragmented")]
    assert b.counters.stale == 1


def test_requests_to_a_host_and_replies_to_a_board_are_ignored() -> None:
    h, b = host(), board()
    request = request_frame(src=8, dst=7)
    h.receive(request, 0.0)
    assert events(h) == [Stale(parse_frame(request), "a request to a host")]
    other = request_frame(cmd=Command.FRAGMENT, body=FragmentHead(1, 0, 2, 2, 0).serialize() + b"x", src=3, dst=7)
    h.receive(other, 0.0)
    assert events(h) == [Stale(parse_frame(other), "from another module")]
    assert h.next_timeout() is None
    elsewhere = request_frame(dst=3)
    b.receive(elsewhere, 0.0)
    assert events(b) == [Stale(parse_frame(elsewhere), "not for this module")]


def test_the_chapters_unknown_command_answers_an_identify_and_nothing_else() -> None:
    h, b = host(), board()
    b.reply_dialect1(UNKNOWN_COMMAND_PACKET, 0.0)
    b.reply_dialect1(b"\xff\xf5\xff\x06\x04\xf6", 0.0)
    unknown, short = b.data_to_send()
    h.request(Command.STATS, b"", 1.0)
    h.receive(unknown, 1.1)
    assert [type(e) for e in events(h)] == [Stale]
    ticket = h.request(Command.IDENTIFY, b"", 1.0)
    h.receive(short, 1.1)
    assert [e.reason for e in events(h) if isinstance(e, Stale)] == ["dialect 1, answers no outstanding request"]
    h.receive(unknown, 1.125)
    (reply,) = events(h)
    assert reply == Reply(ticket, Command.IDENTIFY, Status.UNKNOWN_COMMAND, b"", parse_frame(unknown), 0.125, 1)
    assert not h.holds(ticket)


def test_a_stop_drops_what_has_begun_to_arrive() -> None:
    b = board()
    for number in range(2):
        body = FragmentHead(1, number, 2, Command.TRANSACT, 0).serialize() + b"x"
        assert ask(b, request_frame(cmd=Command.FRAGMENT, body=body)) == []
        if number == 0:
            b.take_stop(0.1)
    assert b._fragments_in._in


def test_an_identify_begins_anew_with_fragments_too() -> None:
    b = board()
    body = FragmentHead(1, 0, 2, Command.TRANSACT, 0).serialize() + b"x"
    ask(b, request_frame(cmd=Command.FRAGMENT, body=body))
    assert b._fragments_in._in
    (request,) = ask(b, request_frame(cmd=Command.IDENTIFY, body=b""))
    assert not b._fragments_in._in
    b.reply(request, 0, b"", 0.0)
    assert len(ask(b, request_frame(cmd=Command.IDENTIFY, body=b""))) == 1, "an IDENTIFY is never a repeat"


def test_the_answer_to_a_message_is_given_again_once_for_each_reminder() -> None:
    h, b = host(), board()
    h.request(Command.TRANSACT, bytes(500), 0.0)
    chunks = h.data_to_send()
    requests = [request for data in chunks for request in ask(b, data, 0.1)]
    (request,) = requests
    b.reply(request, 0, b"done", 0.1)
    b.data_to_send()
    assert ask(b, chunks[1], 0.2) == []
    confirmed = sent(b)
    assert [frame.cmd for frame in confirmed] == [Command.FRAGMENT_MISSING]
    assert b.counters.repeats == 0
    assert ask(b, chunks[0], 0.3) == []
    confirm, again = sent(b)
    assert (confirm.cmd, confirm.dst, confirm.body) == (Command.FRAGMENT_MISSING, 7, confirmed[0].body)
    assert (again.cmd, again.body, again.seq) == (Command.TRANSACT, b"done", request.frame.seq)
    assert again.time == pytest.approx(0.3)
    assert b.counters.repeats == 1


def test_while_a_message_is_on_its_way_its_answer_is_waited_for() -> None:
    h = host()
    h.request(Command.TRANSACT, bytes(5000), 0.0)
    message_id = FragmentHead.parse(sent(h)[0].body).message_id
    missing = request_frame(cmd=Command.FRAGMENT_MISSING, body=serialize_missing(message_id, (16,)), src=8, dst=7)
    h.receive(missing, 0.15)
    assert [FragmentHead.parse(frame.body).number for frame in sent(h)] == [16]
    assert h.next_timeout() == 0.15 + WINDOW
    other = request_frame(
        cmd=Command.FRAGMENT_MISSING, body=serialize_missing(message_id ^ 0x100, (16,)), src=8, dst=7
    )
    h.receive(other, 0.3)
    assert h.next_timeout() == 0.15 + WINDOW


def test_while_an_answer_comes_in_fragments_it_is_waited_for() -> None:
    h = host()
    h.request(Command.STATS, b"", 0.0)
    (request,) = sent(h)
    for changes, deadline in (
        ({"cmd": Command.LIMITS}, WINDOW),
        ({"cmd_ext": 0}, WINDOW),
        ({"message_id": request.seq + 1}, WINDOW),
        ({}, 0.19 + WINDOW),
    ):
        head = FragmentHead(0x100 | request.seq, 0, 2, Command.STATS, 0x80)._replace(**changes)
        data = request_frame(cmd=Command.FRAGMENT, body=head.serialize() + b"x", src=8, dst=7)
        h.receive(data, 0.19)
        assert [p.deadline for p in h._pending.values()] == [pytest.approx(deadline)]
        h._fragments_in.forget()


def test_over_a_link_of_datagrams_dialect_1_needs_no_conversation() -> None:
    for dialect, numbers, may in ((1, None, True), (2, None, True), (1, int, True), (2, int, False)):
        assert host(dialect=dialect, numbers=numbers).in_conversation is may


def test_reports_are_counted_and_kept_in_order() -> None:
    h, b = host(), board()
    for i in range(3):
        b.report(Command.JOINT_STATE, bytes((i,)), 0.0)
    h.receive(b"".join(b.data_to_send()), 0.0)
    assert [e.frame.body for e in events(h) if isinstance(e, Report)] == [b"\0", b"\1", b"\2"]
    assert (h.counters.reports, h.counters.reports_dropped) == (3, 0)
