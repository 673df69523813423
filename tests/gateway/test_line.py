"""One board below a gateway: pace, order, what a stop voids, bounds."""

from __future__ import annotations

import pytest

from hexwire.gateway.line import _MAX_VOIDED, GATEWAY_MODULE, BoardLine
from hexwire.session.connection import Connection, Role
from hexwire.wire import tables
from hexwire.wire.command_frame import Command, Frame, Status, parse_frame
from hexwire.wire.commands import FragmentHead, Identity, serialize_missing

BOARD = Connection(Role.BOARD, local=8, remote=7, type=8)
TRANSACT = Command.TRANSACT


def ask(cmd: int, body: bytes = b"", seq: int = 1) -> Frame:
    return Frame(0, 0, 1, 7, 8, 1, 2, seq, cmd, body)


def statuses(frames: list[Frame]) -> list[tuple[int, int]]:
    return [(frame.seq, frame.cmd_ext & 0x3F) for frame in frames]


def sent(line: BoardLine, now: float) -> list[Frame]:
    found = []
    while data := line.next_frame(now):
        found.append(parse_frame(data))
    return found


def answer(cmd: int, seq: int, body: bytes = b"", ext: int = 0x80, dst: int = 7) -> bytes:
    return BOARD.build(2, cmd, body, seq, 0.0, ext, dst=dst)


def knows(line: BoardLine, capabilities: int = tables.CAPABILITY_FRAGMENTS) -> Frame:
    line.request(ask(Command.IDENTIFY, seq=200), 0.0)
    sent(line, 0.0)
    identity = Identity(2, (1, 0, 0), 5, capabilities, 253, 0, ())
    (frame,) = line.receive(answer(Command.IDENTIFY, 200, identity.serialize()), 0.0)
    return frame


@pytest.fixture
def line() -> BoardLine:
    return BoardLine(9, local=8)


def test_frames_leave_at_the_pace_of_the_line_and_a_stop_first() -> None:
    line = BoardLine(9, local=8, baud=115200)
    for seq in range(3):
        line.request(ask(TRANSACT, bytes(200), seq), 0.0)
    (first,) = sent(line, 0.0)
    assert first.seq == 0
    busy = first.size * 10 / 115200
    assert line.next_timeout() == pytest.approx(busy)
    assert sent(line, busy / 2) == []
    line.request(ask(Command.STOP, b"\0", 99), busy / 2)
    assert [f.cmd for f in sent(line, busy + 1e-6)] == [Command.STOP]


def test_a_stop_that_waits_for_the_line_stays_before_what_comes_after_it() -> None:
    line = BoardLine(9, local=8, baud=115200)
    line.request(ask(TRANSACT, bytes(200), 1), 0.0)
    sent(line, 0.0)
    line.request(ask(Command.STOP, b"\0", 2), 0.001)
    line.request(ask(Command.RESUME, seq=3), 0.002)
    assert [f.cmd for f in (*sent(line, 0.1), *sent(line, 0.2))] == [Command.STOP, Command.RESUME]


def test_a_stop_voids_what_waits_and_its_repeats(line: BoardLine) -> None:
    resume, move = ask(Command.RESUME, seq=1), ask(Command.JOINT_MOVE, b"\1\2\3", seq=2)
    assert (
        line.request(resume, 0.0) + line.request(move, 0.0) + line.request(ask(Command.IDENTIFY, seq=3), 0.0) == []
    )
    void = line.request(ask(Command.STOP, b"\1", 4), 0.1)
    assert statuses(void) == [(1, Status.STOPPED), (2, Status.STOPPED), (3, Status.STOPPED)]
    assert all(frame.src == 9 and frame.dst == 7 for frame in void)
    assert [f.cmd for f in sent(line, 0.1)] == [Command.STOP]
    assert statuses(line.request(resume, 1.9)) == [(1, Status.STOPPED)]
    assert line.request(ask(Command.RESUME, seq=5), 1.9) == [], "a new one is sent"
    assert line.request(ask(Command.IDENTIFY, seq=3), 1.95) == [], "IDENTIFY is never remembered"
    assert line.request(resume, 1.96) == [], "and forgets what was void"
    assert [f.seq for f in sent(line, 1.96)] == [5, 3, 1]
    assert line.counters.voided == 3


def refused(line: BoardLine) -> Frame:
    """A request that found no room in the queue, which is empty again."""
    for seq in range(24):
        line.request(ask(TRANSACT, bytes(8), seq), 0.0)
    resume = ask(Command.RESUME, seq=30)
    assert statuses(line.request(resume, 0.0)) == [(30, Status.BUSY)]
    sent(line, 0.0)
    return resume


def test_a_stop_voids_repeats_of_what_found_no_room(line: BoardLine) -> None:
    resume = refused(line)
    line.request(ask(Command.STOP, b"\0", 31), 0.1)
    assert statuses(line.request(resume, 1.9)) == [(30, Status.STOPPED)]
    assert [f.cmd for f in sent(line, 1.9)] == [Command.STOP]
    # Later it is another request.
    assert line.request(resume, 2.1) == []


def test_one_that_found_no_room_may_be_tried_again(line: BoardLine) -> None:
    resume = refused(line)
    assert line.request(resume, 0.1) == []
    assert [f.cmd for f in sent(line, 0.1)] == [Command.RESUME]


def test_what_found_no_room_is_forgotten_with_its_host(line: BoardLine) -> None:
    resume = refused(line)
    line.request(ask(Command.IDENTIFY, seq=0), 0.1)
    line.request(ask(Command.STOP, b"\0", 31), 0.1)
    assert line.request(resume, 0.2) == [], "a restarted host counts anew"


def test_what_found_no_room_takes_no_more_memory_than_what_a_stop_voids(line: BoardLine) -> None:
    for n in range(24 + 2 * _MAX_VOIDED):
        line.request(ask(Command.STATS, n.to_bytes(2, "big")), 0.0)
    assert len(line._refused) == _MAX_VOIDED
    line.request(ask(Command.IDENTIFY, seq=2)._replace(src=6), 0.0)
    for n in range(2 * _MAX_VOIDED):
        line.request(ask(Command.STATS, n.to_bytes(2, "big")), 0.1)
    assert len(line._refused) == _MAX_VOIDED, "nor after a restart of another host"


def test_a_stop_of_another_voids_repeats_too(line: BoardLine) -> None:
    resume = ask(Command.RESUME, seq=1)
    line.request(resume, 0.0)
    assert statuses(line.stop_for("another", ask(Command.STOP, b"\0", 9), 0.1)) == [(1, Status.STOPPED)]
    assert statuses(line.request(resume, 1.9)) == [(1, Status.STOPPED)]
    assert line.request(resume, 2.2) == [], "later it is another request"


def test_stops_do_not_void_each_other(line: BoardLine) -> None:
    line.request(ask(Command.STOP, b"\0", 1), 0.0)
    assert line.request(ask(Command.STOP, b"\1", 2), 0.0) == []
    assert [f.body for f in sent(line, 0.0)] == [b"\0", b"\1"]


def test_a_repeat_of_what_waits_is_not_sent_twice() -> None:
    line = BoardLine(9, local=8, baud=9600)
    for _ in range(3):
        line.request(ask(Command.STATS, seq=1), 0.0)
    assert len(sent(line, 0.0) + sent(line, 1.0)) == 1


def test_a_board_that_is_asked_again_who_it_is_has_no_more_time_for_that(line: BoardLine) -> None:
    who = ask(Command.IDENTIFY, seq=1)._replace(dst=0xFF)
    for now in (0.0, 0.15):
        assert line.request(who, now) == []
    assert line.handle_timeout(0.19) == []
    assert statuses(line.handle_timeout(0.21)) == [(1, Status.UNREACHABLE)]


def test_each_question_of_the_gateways_own_has_another_number(line: BoardLine) -> None:
    """By an equal one the board would take it for a repeat of the one before."""
    for i in range(3):
        line.seek_for(f"host {i}", ask(Command.IDENTIFY, seq=7), 0.06 * i)
    assert [frame.seq for frame in sent(line, 0.2)] == [1, 2, 3]


def test_the_queue_is_bounded_and_old_requests_are_dropped(line: BoardLine) -> None:
    answers = [line.request(ask(Command.STATS, seq=n), 0.0) for n in range(26)]
    assert [statuses(frames) for frames in answers[24:]] == [[(24, Status.BUSY)], [(25, Status.BUSY)]]
    assert sent(line, 0.6) == []
    assert (line.counters.old, line.counters.refused) == (24, 2)


def test_answers_of_the_gateway_carry_number_and_time_of_the_board(line: BoardLine) -> None:
    knows(line)
    data = answer(Command.STATS, 5)
    line.receive(data, 0.0)
    board = parse_frame(data)
    line.request(ask(Command.RESUME, seq=6), 0.0)
    (void,) = line.request(ask(Command.STOP, b"\0", 7), 0.0)
    assert (void.sn, void.time_sec, void.time_nsec, void.type) == (
        board.sn,
        board.time_sec,
        board.time_nsec,
        board.type,
    )


def test_the_rate_of_its_line_is_not_for_the_host(line: BoardLine) -> None:
    identity = Identity.parse(knows(line, tables.CAPABILITY_HOST_BAUD | tables.CAPABILITY_REPORT).body)
    assert identity.capabilities == tables.CAPABILITY_REPORT
    refused = line.request(ask(Command.HOST_BAUD, (500_000).to_bytes(4, "little"), seq=1), 0.0)
    assert statuses(refused) == [(1, Status.NOT_SUPPORTED)]
    assert sent(line, 0.0) == []


def test_a_lost_board_forgets_what_waits_but_not_a_stop(line: BoardLine) -> None:
    line.request(ask(Command.RESUME, seq=1), 0.0)
    line.request(ask(Command.STOP, b"\1", 2), 0.0)
    line.request(ask(Command.RESUME, seq=3), 0.0)
    line.lost()
    assert line.request(ask(Command.RESUME, seq=4), 0.1) == []
    assert sent(line, 0.1) == []
    line.back(1.0)
    (stop,) = sent(line, 1.0)
    assert (stop.cmd, stop.body, stop.src, stop.dst) == (Command.STOP, b"\1", GATEWAY_MODULE, 8)
    assert line.receive(answer(Command.STOP, stop.seq, dst=GATEWAY_MODULE), 1.01) == []
    assert not line.stopping
    line.lost()
    line.back(2.0)
    assert sent(line, 2.0) == [], "the stop has arrived"


def test_a_stop_is_no_repeat_of_one_before_it_also_of_a_gateway_that_was_restarted() -> None:
    numbers = []
    for now in (1000.0, 1000.1, 1001.0, 1001.99):
        line = BoardLine(9, local=8)
        for _ in range(3):
            line.stop(0, now)
            (stop,) = sent(line, now)
            numbers.append(stop.seq)
            line.receive(answer(Command.STOP, stop.seq, dst=GATEWAY_MODULE), now)
    assert len(set(numbers)) == len(numbers)


def test_only_frames_of_the_board_go_up(line: BoardLine) -> None:
    other = Connection(Role.BOARD, local=5, remote=7, type=8)
    assert line.receive(other.build(2, Command.STATS, b"", 1, 0.0, 0x80), 0.0) == []
    assert line.receive(BOARD.build(2, Command.STATS, b"", 1, 0.0, 0), 0.0) == []
    assert line.receive(BOARD.build_dialect1(b"\xff\xf5\xff\6\4\xf6", 0.0, 0), 0.0) == []
    assert line.counters.strange == 3
    (report,) = line.receive(BOARD.build(2, Command.JOINT_STATE, b"x", 1, 0.0, 0x40), 0.0)
    assert (report.src, report.body) == (9, b"x")


# -- long requests and replies ----------------------------------------------------------------------------------

LONG = bytes(range(250)) * 2


def chunks(frames: list[Frame]) -> list[FragmentHead]:
    assert {frame.cmd for frame in frames} <= {Command.FRAGMENT}
    return [FragmentHead.parse(frame.body) for frame in frames]


def test_a_long_request_goes_down_as_the_board_asks_for_it(line: BoardLine) -> None:
    frame = knows(line)
    assert Identity.parse(frame.body).max_frame == tables.MAX_NETWORK_FRAME
    line.request(ask(Command.TRAJECTORY_POINTS, LONG, 17), 0.0)
    first = sent(line, 0.0)
    (head,) = chunks(first)
    assert (head.number, head.chunks, head.cmd, head.message_id & 0xFF) == (0, 3, Command.TRAJECTORY_POINTS, 17)
    line.receive(BOARD.build(2, Command.FRAGMENT_MISSING, serialize_missing(head.message_id, (1, 2)), 0, 0.0), 0.1)
    rest = sent(line, 0.1)
    assert [h.number for h in chunks(rest)] == [1, 2]
    assert b"".join(f.body[8:] for f in first + rest) == LONG
    # A repeat of the host reminds the board, no more.
    line.request(ask(Command.TRAJECTORY_POINTS, LONG, 17), 0.2)
    assert [h.number for h in chunks(sent(line, 0.2))] == [0]
    line.receive(BOARD.build(2, Command.FRAGMENT_MISSING, serialize_missing(head.message_id, ()), 0, 0.0), 0.3)
    (reply,) = line.receive(answer(Command.TRAJECTORY_POINTS, 17, b"done"), 0.3)
    assert (reply.src, reply.body) == (9, b"done")
    line.request(ask(Command.TRAJECTORY_POINTS, LONG, 18), 0.4)
    (again,) = chunks(sent(line, 0.4))
    assert again.message_id != head.message_id
    assert line.counters.split == 2


def test_one_message_at_a_time(line: BoardLine) -> None:
    knows(line)
    line.request(ask(Command.SERVO_TABLE, LONG, 1), 0.0)
    assert statuses(line.request(ask(Command.SERVO_TABLE, LONG, 2), 0.1)) == [(2, Status.BUSY)]
    # One that nobody asks for any more makes room.
    assert line.request(ask(Command.SERVO_TABLE, LONG, 3), 2.1) == []


def test_a_board_without_fragments_gets_none(line: BoardLine) -> None:
    frame = knows(line, 0)
    assert Identity.parse(frame.body).max_frame == 253
    assert statuses(line.request(ask(Command.SERVO_TABLE, LONG, 1), 0.0)) == [(1, Status.NOT_SUPPORTED)]
    assert sent(line, 0.0) == []


def test_a_stop_voids_a_message_under_way(line: BoardLine) -> None:
    knows(line)
    line.request(ask(Command.SERVO_TABLE, LONG, 1), 0.0)
    (head,) = chunks(sent(line, 0.0))
    line.receive(BOARD.build(2, Command.FRAGMENT_MISSING, serialize_missing(head.message_id, (1, 2)), 0, 0.0), 0.1)
    void = line.request(ask(Command.STOP, b"\0", 2), 0.1)
    assert statuses(void) == [(1, Status.STOPPED)]
    assert [f.cmd for f in sent(line, 0.1)] == [Command.STOP]
    line.receive(BOARD.build(2, Command.FRAGMENT_MISSING, serialize_missing(head.message_id, (1, 2)), 0, 0.0), 0.2)
    assert sent(line, 0.2) == []
    assert statuses(line.request(ask(Command.SERVO_TABLE, LONG, 1), 0.2)) == [(1, Status.STOPPED)]


def test_a_reply_in_fragments_goes_up_as_one(line: BoardLine) -> None:
    knows(line)
    line.request(ask(Command.SERVO_TABLE, b"\3\0\xc8\0", 5), 0.0)
    sent(line, 0.0)
    parts = [LONG[:132], LONG[132:204]]

    def chunk(number: int) -> bytes:
        head = FragmentHead(0x0105, number, 2, Command.SERVO_TABLE, 0x80).serialize()
        return BOARD.build(2, Command.FRAGMENT, head + parts[number], 0, 0.0)

    assert line.receive(chunk(1), 0.1) == []
    asked = sent(line, 0.1)
    (whole,) = line.receive(chunk(0), 0.15)
    asked += sent(line, 0.15)
    assert (whole.cmd, whole.seq, whole.cmd_ext, whole.src, whole.body) == (
        Command.SERVO_TABLE,
        5,
        0x80,
        9,
        LONG[:204],
    )
    assert [f.body for f in asked if f.cmd == Command.FRAGMENT_MISSING][-1] == serialize_missing(0x0105, ())
    assert {(f.src, f.dst, f.cmd_ext) for f in asked} == {(7, 8, 0)}
    assert line.counters.joined == 1


def test_a_missing_chunk_of_a_reply_is_asked_for(line: BoardLine) -> None:
    knows(line)
    head = FragmentHead(0x0105, 1, 2, Command.SERVO_TABLE, 0x80).serialize()
    line.receive(BOARD.build(2, Command.FRAGMENT, head + b"x", 0, 0.0), 0.0)
    sent(line, 0.0)
    due = line.next_timeout()
    assert due is not None
    line.handle_timeout(due)
    assert [f.body for f in sent(line, due)] == [serialize_missing(0x0105, (0,))]


def test_what_is_asked_of_the_board_in_the_hosts_name_has_the_time_of_its_sending(line: BoardLine) -> None:
    knows(line)
    head = FragmentHead(0x0105, 1, 2, Command.SERVO_TABLE, 0x80).serialize()
    line.receive(BOARD.build(2, Command.FRAGMENT, head + b"x", 0, 0.0), 12.5)
    (asked,) = sent(line, 12.5)
    assert (asked.time_sec, asked.time_nsec) == (12, 500_000_000)


def test_a_board_that_has_not_said_that_it_takes_fragments_gets_none(line: BoardLine) -> None:
    assert statuses(line.request(ask(Command.SERVO_TABLE, LONG, 1), 0.0)) == [(1, Status.NOT_SUPPORTED)]
    knows(line)
    assert line.request(ask(Command.SERVO_TABLE, LONG, 2), 0.0) == []
    # Another board may be there when it is back.
    line.lost()
    line.back(1.0)
    assert statuses(line.request(ask(Command.SERVO_TABLE, LONG, 3), 1.0)) == [(3, Status.NOT_SUPPORTED)]


def test_messages_that_were_stopped_take_no_room(line: BoardLine) -> None:
    knows(line)
    for seq in range(100):
        assert line.request(ask(Command.SERVO_TABLE, LONG, seq), 0.01 * seq) == [], seq
        line.request(ask(Command.STOP, b"\0", 100 + seq), 0.01 * seq)
        sent(line, 0.01 * seq)
    assert line.counters.split == 100


def test_frames_that_mean_nothing_are_counted(line: BoardLine) -> None:
    for number in range(1, 4):
        line.receive(BOARD.build(2, Command.FRAGMENT, b"?", number, 0.0), 0.0)
        assert line.counters.strange == number


def test_only_the_answer_to_who_it_is_says_who_it_is(line: BoardLine) -> None:
    knows(line)
    known, body = line.identity, Identity(2, (9, 9, 9), 6, 0, 100, 0, ()).serialize()
    (other,) = line.receive(answer(Command.STATS, 3, body), 0.0)
    (refusal,) = line.receive(answer(Command.IDENTIFY, 4, body, 0x80 | Status.BUSY), 0.0)
    assert other.body == refusal.body == body
    assert line.identity == known


def test_frames_down_and_up_and_those_of_a_lost_board_are_counted(line: BoardLine) -> None:
    for seq in range(3):
        line.request(ask(Command.STATS, seq=seq), 0.0)
        sent(line, 0.0)
        line.receive(answer(Command.STATS, seq), 0.0)
    assert (line.counters.down, line.counters.up, line.counters.lost) == (3, 3, 0)
    line.lost()
    line.request(ask(Command.STATS, seq=4), 0.0)
    line.request(ask(Command.STOP, b"\0", 5), 0.0)
    line.stop_for("another", ask(Command.STOP, b"\0", 6), 0.0)
    assert (line.counters.down, line.counters.lost) == (3, 3)


@pytest.mark.parametrize(
    ("cmd", "body", "mode"),
    [
        (Command.STOP, b"\0", 0),
        (Command.STOP, b"\1", 1),
        (Command.STOP, b"", 0),
        (Command.ROBOT_SIGNAL, b"\1", 0),
    ],
)
def test_who_is_not_the_host_stops_in_the_way_that_it_asks_for(
    line: BoardLine, cmd: int, body: bytes, mode: int
) -> None:
    line.stop_for("somebody", ask(cmd, body, 9), 0.0)
    (stop,) = sent(line, 0.0)
    assert (stop.cmd, stop.body) == (Command.STOP, bytes((mode,)))
