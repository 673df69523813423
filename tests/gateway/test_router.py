"""Frames of one host to the boards that they name, and what the loss of the host means."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.gateway.bench import EVERYBODY, Bench

from hexwire.gateway.line import GATEWAY_MODULE
from hexwire.session.events import Reply, TimedOut
from hexwire.session.fragments import FragmentSender
from hexwire.session.several import To
from hexwire.wire import tables
from hexwire.wire.addresses import Broadcast, Multicast
from hexwire.wire.board_trajectory import BeginRequest, PathFlag, PathPoint, PointsRequest, StartRequest
from hexwire.wire.command_frame import Command, Frame, Status, parse_frame, serialize_frame
from hexwire.wire.commands import FragmentHead, Identity, JointReport
from hexwire.wire.servo_table import ServoTable

ALL_ON = b"\1\x7f\0"
HERE = (2053, 2043, 2035, 2039, 2083, 2046, 2047)
ONE_SECOND = b"\xe8\3\0"


@pytest.fixture
def bench() -> Bench:
    made = Bench()
    made.run(0.3)
    made.ask_all(Command.IDENTIFY)
    # Whose boards they are from now on: who only looks for them has none.
    made.ask_all(Command.STATS)
    return made


def test_each_module_is_reached_by_its_own_id(bench: Bench) -> None:
    for module in bench.boards:
        reply = bench.ask(Command.TORQUE, ALL_ON, module)
        assert reply.frame is not None
        assert (reply.status, reply.frame.src) == (Status.OK, module)
        on = {m: all(j.torque_on for j in board.state.joints) for m, board in bench.boards.items()}
        assert on == {m: m <= module for m in bench.boards}


def test_the_same_command_to_many(bench: Bench) -> None:
    answers = bench.ask_all(Command.TORQUE, ALL_ON, Multicast((8, 10)))
    assert {m: r.status for m, r in answers.replies.items()} == {8: Status.OK, 10: Status.OK}
    answers = bench.ask_all(Command.JOINT_STATE, b"\0")
    assert list(answers.replies) == [8, 9, 10]
    assert {len(JointReport.parse(r.body).position) for r in answers.replies.values()} == {7}
    # The board, not the gateway, says what may go to several.
    answers = bench.ask_all(Command.LIMITS)
    assert {r.status for r in answers.replies.values()} == {Status.NOT_SUPPORTED}


def test_nobody_answers_for_a_module_that_is_not_there(bench: Bench) -> None:
    bench.host.remote = 11
    assert isinstance(bench.wait(bench.host.request(Command.STATS, b"", bench.now)), TimedOut)
    answers = bench.ask_all(Command.STATS, to=Multicast((9, 11)))
    assert (list(answers.replies), answers.silent) == ([9], {11})
    assert bench.gateway.counters.unknown >= 3


def test_a_lost_board_is_silence_and_the_others_go_on(bench: Bench) -> None:
    bench.gateway.lines[9].lost()
    answers = bench.ask_all(Command.STATS)
    assert (list(answers.replies), answers.silent) == ([8, 10], {9})
    bench.gateway.lines[9].back(bench.now)
    assert not bench.ask_all(Command.STATS).silent


def test_the_gateway_answers_who_is_there_in_place_of_a_board_that_it_cannot_reach(bench: Bench) -> None:
    bench.gateway.lines[9].lost()
    # Also to one who is not its host.
    stranger = bench.gateway.host_came("another")
    bench.gateway.receive_host(
        stranger, bench.host.build(2, Command.IDENTIFY, b"", 7, bench.now, dst=EVERYBODY.dst), bench.now
    )
    told = {frame.src: frame.cmd_ext & 0x3F for frame in map(parse_frame, stranger.out)}
    assert told == {8: Status.OK, 9: Status.UNREACHABLE, 10: Status.OK}
    bench.gateway.host_gone(stranger, bench.now, broken=False)
    assert bench.who() == ([8, 10], {9})
    bench.dead = {10}
    assert bench.who() == ([8], {9, 10})
    assert bench.who(Multicast((8, 10))) == ([8], {10})
    # Only that, and only to several: one that is asked alone may be back in a moment.
    assert not bench.end_of(bench.host.several.request(To(EVERYBODY), Command.STATS, b"", bench.now)).silent
    bench.host.remote = 9
    assert isinstance(bench.wait(bench.host.request(Command.IDENTIFY, b"", bench.now)), TimedOut)
    # A board that answers late is there.
    bench.dead = set()
    bench.gateway.lines[9].back(bench.now)
    late: list[bytes] = []
    line = bench.gateway.lines[10]
    plain = line.receive
    line.receive = lambda data, now: (late.append(data), [])[1]  # type: ignore[method-assign]
    ticket = bench.host.several.request(To(EVERYBODY), Command.IDENTIFY, b"", bench.now, window=1.0, attempts=1)
    bench.run(0.5)
    line.receive = plain  # type: ignore[method-assign]
    bench.gateway.receive_board(10, b"".join(late), bench.now)
    end = bench.end_of(ticket)
    assert (list(end.replies), end.silent) == ([8, 9, 10], set())


def test_a_stop_that_a_lost_board_missed_reaches_it_first_when_it_is_back(bench: Bench) -> None:
    bench.ask_all(Command.TORQUE, ALL_ON)
    bench.gateway.lines[9].lost()
    assert bench.ask_all(Command.STOP, b"\1").silent == {9}
    bench.gateway.lines[9].back(bench.now)
    bench.run(0.5)
    assert bench.stopped() == dict.fromkeys((8, 9, 10), True)
    assert not any(joint.torque_on for joint in bench.boards[9].state.joints)
    assert [f.cmd for f in bench.to_boards[9] if f.src == GATEWAY_MODULE and f.cmd != Command.IDENTIFY] == [
        Command.STOP
    ]


# -- the host goes ----------------------------------------------------------------------------------------------


def test_a_host_that_leaves_in_order_stops_nothing(bench: Bench) -> None:
    bench.ask(Command.TORQUE, ALL_ON)
    bench.ask(Command.WATCHDOG, ONE_SECOND)
    bench.ask(Command.WATCHDOG, b"\0\0\0")
    assert bench.gateway.host_gone(bench.side, bench.now, broken=False) == []
    bench.run(0.5)
    assert not any(bench.stopped().values())


def test_a_broken_link_stops_every_board(bench: Bench) -> None:
    assert bench.gateway.host_gone(bench.side, bench.now, broken=True) == [8, 9, 10]
    bench.run(0.5)
    assert all(bench.stopped().values())
    assert not any(line.stopping for line in bench.gateway.lines.values())


@pytest.mark.parametrize("mode", [0, 1])
def test_a_host_that_ends_with_a_watchdog_armed_stops_every_board(bench: Bench, mode: int) -> None:
    bench.ask_all(Command.TORQUE, ALL_ON)
    bench.ask(Command.WATCHDOG, b"\xe8\3" + bytes((mode,)), 9)
    assert bench.gateway.host_gone(bench.side, bench.now, broken=False) == [8, 9, 10]
    bench.run(0.6)
    assert all(bench.stopped().values())
    torque = {m: any(j.torque_on for j in board.state.joints) for m, board in bench.boards.items()}
    assert torque == {8: True, 9: not mode, 10: True}


def test_a_host_that_ends_before_the_answer_stops_every_board(bench: Bench) -> None:
    bench.host.request(Command.TORQUE, ALL_ON, bench.now)
    for data in bench.host.data_to_send():
        bench.gateway.receive_host(bench.side, data, bench.now)
    assert bench.gateway.host_gone(bench.side, bench.now, broken=False) == [8, 9, 10]


def test_the_stop_is_repeated_until_the_board_has_it(bench: Bench) -> None:
    bench.dead = {9}
    bench.gateway.host_gone(bench.side, bench.now, broken=True)
    bench.run(0.5)
    assert bench.stopped() == {8: True, 9: False, 10: True}
    bench.dead = set()
    bench.run(0.5)
    assert all(bench.stopped().values())
    bench.connect()
    bench.ask_all(Command.STATS)
    bench.dead = {9}
    sent = len(bench.to_boards[9])
    bench.gateway.host_gone(bench.side, bench.now, broken=True)
    bench.run(4.0)
    assert len(bench.to_boards[9]) - sent == 20, "not for ever"


def test_nothing_of_a_lost_host_is_sent_afterwards() -> None:
    bench = Bench(baud=9600)
    bench.run(0.3)
    for _ in range(5):
        bench.host.request(Command.RESUME, b"", bench.now)
    for data in bench.host.data_to_send():
        bench.gateway.receive_host(bench.side, data, bench.now)
    bench.gateway.host_gone(bench.side, bench.now, broken=True)
    bench.host.void()
    bench.run(1.0)
    assert {f.cmd for f in bench.to_boards[8]} == {Command.STOP}
    bench.connect()
    bench.run(1.0)
    assert bench.stopped()[8]


def follow(bench: Bench, *, outlives: bool) -> None:
    """Let board 8 follow a path of two seconds."""
    bench.ask(Command.TORQUE, ALL_ON)
    bench.ask(Command.WATCHDOG, ONE_SECOND)
    flags = PathFlag.OUTLIVES_HOST if outlives else 0
    bench.ask(Command.TRAJECTORY_BEGIN, BeginRequest(5, flags, 0x7F, 200).serialize())
    points = [PathPoint(0, HERE), PathPoint(20000, tuple(place + 100 for place in HERE))]
    bench.ask(Command.TRAJECTORY_POINTS, PointsRequest.of(5, 0, points, last=True).serialize())
    assert bench.ask(Command.TRAJECTORY_START, StartRequest(5, 1, 0).serialize()).status == Status.OK
    bench.run(0.2)


def test_a_path_that_may_finish_alone_does_so(bench: Bench) -> None:
    follow(bench, outlives=True)
    assert bench.gateway.host_gone(bench.side, bench.now, broken=True) == [9, 10]
    bench.run(2.2)
    assert bench.boards[8].state.joints[0].position == pytest.approx(HERE[0] + 100, abs=6)


def test_another_path_is_stopped_with_its_host(bench: Bench) -> None:
    follow(bench, outlives=False)
    assert bench.gateway.host_gone(bench.side, bench.now, broken=False) == [8, 9, 10]
    bench.run(2.2)
    assert bench.boards[8].state.joints[0].position < HERE[0] + 50


# -- bounds and bad bytes ---------------------------------------------------------------------------------------


def test_only_a_stop_is_obeyed_of_what_waited_while_it_was_suspended(bench: Bench) -> None:
    before = len(bench.to_boards[8])
    bench.host.request(Command.JOINT_MOVE, b"\x64\0\1\xfe\0\x08", bench.now)
    bench.host.request(Command.RESUME, b"", bench.now)
    bench.host.request(Command.STOP, b"\0", bench.now)
    for data in bench.host.data_to_send():
        bench.gateway.receive_host(bench.side, data, bench.now, stale=True)
    bench.run(0.1)
    assert [f.cmd for f in bench.to_boards[8][before:]] == [Command.STOP]
    assert bench.gateway.counters.stale == 2


def test_the_host_learns_that_longer_frames_are_split_here(bench: Bench) -> None:
    reply = bench.ask(Command.IDENTIFY)
    assert Identity.parse(reply.body).max_frame == tables.MAX_NETWORK_FRAME


def test_dialect_1_is_not_for_a_gateway(bench: Bench) -> None:
    sent = len(bench.to_boards[8])
    bench.host.dialect = 1
    bench.host.request(Command.PING, b"\xff\xff\0\2\1\xfc", bench.now)
    bench.run(0.1)
    assert len(bench.to_boards[8]) == sent


@settings(max_examples=40, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 4), st.binary(max_size=300)), max_size=12), st.integers(0, 2**32))
def test_no_bytes_from_any_side_break_it(pieces: list[tuple[int, bytes]], seed: int) -> None:
    bench = Bench()
    for number, (side, data) in enumerate(pieces):
        if side in (0, 1):
            cmd = (seed >> number) % 64
            to = (8, -1, Multicast((8, 9)).dst, 5, -7)[number % 5]
            data = data[:208]
            frame = bench.host.build(2, cmd, data, number, bench.now, dst=to) if side else data
            bench.gateway.receive_host(bench.side, frame, bench.now)
        elif side == 2:
            bench.gateway.receive_board(8, data, bench.now)
        elif side == 3:
            board = bench.boards[9].connection
            ext = (0, 0x80, 0x40, 0x85)[number % 4]
            cmd = (Command.FRAGMENT, Command.FRAGMENT_MISSING, Command.IDENTIFY, Command.STOP)[seed >> number & 3]
            frame = board.build(2, cmd, data[:200], number, bench.now, ext, dst=(7, GATEWAY_MODULE)[number & 1])
            bench.gateway.receive_board(9, frame, bench.now)
        else:
            bench.gateway.lines[10].lost() if number & 1 else bench.gateway.lines[10].back(bench.now)
        bench.run(0.003)
    bench.run(0.1)
    bench.gateway.lines[10].back(bench.now)
    bench.run(0.1)
    bench.connect()
    assert not bench.ask_all(Command.STOP, b"\0", within=4.0).silent
    assert all(bench.stopped().values())


def test_broadcast_reaches_only_boards_behind_it(bench: Bench) -> None:
    assert list(bench.ask_all(Command.STATS, to=Broadcast()).replies) == [8, 9, 10]


# -- large data -------------------------------------------------------------------------------------------------


def long_path(bench: Bench, module: int = 8) -> bytes:
    """The body of a request with 40 points, of a path that has begun."""
    begin = BeginRequest(5, PathFlag.HERMITE, 0x7F, 200).serialize()
    assert bench.ask(Command.TRAJECTORY_BEGIN, begin, module).status == Status.OK
    points = [PathPoint(100 if n else 0, HERE, (0,) * 7) for n in range(40)]
    return PointsRequest.of(5, 0, points, last=True).serialize()


def test_a_long_request_is_split_and_a_long_reply_joined(bench: Bench) -> None:
    body = long_path(bench, 9)
    reply = bench.ask(Command.TRAJECTORY_POINTS, body, 9)
    assert (reply.status, len(reply.body)) == (Status.OK, 14)
    assert {f.cmd for f in bench.to_boards[9][-7:]} == {Command.FRAGMENT}
    table = bench.ask(Command.SERVO_TABLE, ServoTable(5, 0, 256).serialize(), 9)
    assert table.frame is not None
    assert (table.status, table.frame.src, table.frame.cmd_ext) == (Status.OK, 9, 0x80)
    assert ServoTable.parse(table.body).data[:40] == bench.boards[9].wire[5].registers.read(0, 40)
    assert (bench.gateway.lines[9].counters.split, bench.gateway.lines[9].counters.joined) == (1, 1)


def test_a_chunk_that_is_lost_on_a_boards_line_is_sent_again(bench: Bench) -> None:
    body = long_path(bench)
    lost = [2, 4]

    def drop(module: int, frame: Frame) -> bool:
        if frame.cmd == Command.FRAGMENT and FragmentHead.parse(frame.body).number in lost:
            lost.remove(FragmentHead.parse(frame.body).number)
            return True
        return False

    bench.drop = drop
    ticket = bench.host.request(Command.TRAJECTORY_POINTS, body, bench.now, window=1.0)
    reply = bench.wait(ticket)
    assert isinstance(reply, Reply)
    assert (reply.status, lost) == (Status.OK, [])


def test_a_stop_overtakes_a_long_request_on_a_slow_line() -> None:
    bench = Bench(baud=115200)
    bench.run(0.4)
    bench.ask_all(Command.IDENTIFY)
    body = long_path(bench)
    long = bench.host.request(Command.TRAJECTORY_POINTS, body, bench.now, window=1.0)
    bench.run(0.05)
    stop = bench.host.request(Command.STOP, b"\0", bench.now, urgent=True)
    at = bench.now
    bench.run(1.0, until=lambda: bench.stopped()[8])
    # At most the chunk that was on the line, and the stop.
    assert bench.now - at < (252 + 48) * 10 / 115200 + 0.01
    ends = [bench.wait(long), bench.wait(stop)]
    assert [end.status for end in ends if isinstance(end, Reply)] == [Status.STOPPED, Status.OK]
    assert bench.boards[8].trajectory.path is not None
    assert bench.boards[8].trajectory.path.next == 0


def test_a_request_that_its_host_has_split_reaches_the_board_whole(bench: Bench) -> None:
    body = long_path(bench, 9)
    frame = Frame(0, 0, 1, 7, 9, 1, tables.PROTO_HEXWIRE, 77, Command.FRAGMENT, b"")
    sender = FragmentSender(100)
    bodies = list(sender.send(0x0100 | 77, Command.TRAJECTORY_POINTS, 0, body, bench.now))
    while bodies:
        for chunk in bodies:
            bench.gateway.receive_host(bench.side, serialize_frame(frame._replace(body=chunk)), bench.now)
        answers = [parse_frame(data) for data in bench.gateway.host_frames(bench.side)]
        asks = [answer.body for answer in answers if answer.cmd == Command.FRAGMENT_MISSING]
        assert all((answer.src, answer.dst) == (9, 7) for answer in answers)
        bodies = [chunk for asked in asks for chunk in sender.receive_missing(asked, bench.now)]
    bench.run(1.0)
    chunks = [frame.body for frame in bench.to_boards[9] if frame.cmd == Command.FRAGMENT]
    parts = {FragmentHead.parse(chunk).number: chunk[8:] for chunk in chunks}
    assert b"".join(parts[number] for number in sorted(parts)) == body
    assert {FragmentHead.parse(chunk).message_id & 0xFF for chunk in chunks} == {77}, "the number of the request"
    assert bench.gateway.lines[9].counters.split == 1
    assert bench.gateway.counters.unknown == 0


def chunk_of(message_id: int, number: int, chunks: int, cmd: int = Command.TRAJECTORY_POINTS) -> bytes:
    return FragmentHead(message_id, number, chunks, cmd, 0).serialize() + bytes(50)


def give(bench: Bench, cmd: int, body: bytes, module: int = 9) -> None:
    frame = Frame(0, 0, 1, 7, module, 1, tables.PROTO_HEXWIRE, 5, cmd, body)
    bench.gateway.receive_host(bench.side, serialize_frame(frame), bench.now)


def test_a_chunk_of_the_host_that_is_missing_is_asked_for(bench: Bench) -> None:
    give(bench, Command.FRAGMENT, chunk_of(0x0105, 1, 2))
    bench.gateway.host_frames(bench.side)
    due = bench.gateway.next_timeout()
    assert due is not None
    bench.gateway.handle_timeout(due)
    (asked,) = [parse_frame(data) for data in bench.gateway.host_frames(bench.side)]
    assert (asked.cmd, asked.src, asked.dst) == (Command.FRAGMENT_MISSING, 9, 7)


def test_the_next_time_out_is_that_of_whatever_is_due_first(bench: Bench) -> None:
    line = bench.gateway.lines[9]
    assert bench.gateway.next_timeout() is None
    give(bench, Command.FRAGMENT, chunk_of(0x0105, 1, 2))
    chunk = bench.gateway.next_timeout()
    assert chunk is not None
    line.request(Frame(0, 0, 1, 7, 8, 1, tables.PROTO_HEXWIRE, 5, Command.STATS, b""), bench.now)
    assert bench.gateway.next_timeout() == line.next_timeout() < chunk


def test_every_frame_of_a_host_is_counted(bench: Bench) -> None:
    before = bench.gateway.counters.received
    for count in range(1, 4):
        give(bench, Command.STATS, b"")
        assert bench.gateway.counters.received == before + count


def test_chunks_that_mean_nothing_are_counted(bench: Bench) -> None:
    before = bench.gateway.counters.unknown
    give(bench, Command.FRAGMENT, chunk_of(0x0105, 0, 2), module=99)
    give(bench, Command.FRAGMENT, b"?")
    give(bench, Command.FRAGMENT_MISSING, chunk_of(0x0105, 0, 2))
    assert bench.gateway.counters.unknown == before + 3
    assert bench.gateway.host_frames(bench.side) == []


@pytest.mark.parametrize("changes", [{"proto": tables.PROTO_CHAPTER}, {"cmd_ext": 1}, {"dst": -1 << 31}])
def test_frames_in_a_form_that_no_board_takes_are_counted(bench: Bench, changes: dict[str, int]) -> None:
    before = bench.gateway.counters.unknown
    frame = Frame(0, 0, 1, 7, 9, 1, tables.PROTO_HEXWIRE, 5, Command.STATS, b"")
    bench.gateway.receive_host(bench.side, serialize_frame(frame._replace(**changes)), bench.now)  # type: ignore[arg-type]
    assert bench.gateway.counters.unknown == before + 1
    assert bench.gateway.host_frames(bench.side) == []


def test_chunks_in_chunks_are_no_request() -> None:
    bench = Bench()
    for cmd in (Command.FRAGMENT, Command.FRAGMENT_MISSING):
        give(bench, Command.FRAGMENT, chunk_of(0x0100 + cmd, 0, 1, cmd))
    bench.run(0.1)
    assert bench.to_boards[9] == []
    assert bench.gateway.held(bench.side) == []
