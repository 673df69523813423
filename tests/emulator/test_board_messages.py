"""Messages in fragments on the emulated board: what `tests/conformance_board/test_fragments.py` does not ask."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.emulator.boards import Bench
from tests.frames import frame_bytes

from hexwire.wire.board_trajectory import BeginRequest, PathPoint, PointsRequest
from hexwire.wire.command_frame import Command, Frame, Status
from hexwire.wire.commands import FRAGMENT_HEAD_SIZE, FragmentHead, parse_missing, serialize_missing
from hexwire.wire.servo_table import ServoTable

POINTS = Command.TRAJECTORY_POINTS
BODY = PointsRequest.of(5, 0, [PathPoint(1000 if n else 0, (2050,) * 7) for n in range(40)], last=True).serialize()
COUNT = -(-len(BODY) // 200)


@pytest.fixture
def bench() -> Bench:
    made = Bench()
    made.run(0.3)
    assert made.ask(Command.TRAJECTORY_BEGIN, BeginRequest(5, 0, 0x7F, 200).serialize()).status == Status.OK
    return made


def put(
    bench: Bench, index: int, *, src: int = 7, message_id: int = 0x0163, cmd: int = POINTS, body: bytes = BODY
) -> list[Frame]:
    """Send a chunk; what the board says at once."""
    bench.take()
    count = -(-len(body) // 200)
    head = FragmentHead(message_id, index, count, cmd, 0).serialize()
    chunk = head + body[index * 200 : index * 200 + 200]
    bench.send_raw(frame_bytes(Command.FRAGMENT, chunk, proto=2, seq=1, src=src, dst=8))
    bench.run(0.02)
    return bench.take()


def asked(frames: list[Frame]) -> list[tuple[int, ...]]:
    return [parse_missing(f.body)[1] for f in frames if f.cmd == Command.FRAGMENT_MISSING]


def statuses(frames: list[Frame]) -> list[tuple[int, int, int]]:
    return [(f.dst, f.seq, f.status) for f in frames if f.is_reply]


def test_a_message_of_another_host_is_busy_until_the_first_is_over(bench: Bench) -> None:
    assert asked(put(bench, 0)) == [(1, 2)]
    for index in (0, 1):
        assert statuses(put(bench, index, src=6)) == [(6, 0x63, Status.BUSY)]
    assert asked(put(bench, 1)) == []
    bench.run(2.2)
    assert asked(put(bench, 0, src=6)) == [(1, 2)]


def test_a_chunk_without_its_head_is_refused(bench: Bench) -> None:
    for length in (0, 1, FRAGMENT_HEAD_SIZE - 1):
        assert bench.ask(Command.FRAGMENT, bytes(length)).status == Status.BAD_LENGTH, length


def test_another_message_of_the_same_host_takes_the_place_of_the_first(bench: Bench) -> None:
    put(bench, 0)
    assert asked(put(bench, 0, message_id=0x0264)) == [(1, 2)]
    assert asked(put(bench, 1)) == [(0,)]
    assert asked(put(bench, 1, message_id=0x0264)) == []
    assert asked(put(bench, 2, message_id=0x0264)) != []


def test_identify_of_another_host_ends_nothing(bench: Bench) -> None:
    put(bench, 0)
    bench.send_raw(frame_bytes(Command.IDENTIFY, b"", proto=2, seq=9, src=6, dst=8))
    bench.run(0.02)
    assert asked(put(bench, 1)) == []
    assert asked(put(bench, 2)) == [(3,)]


def test_a_voided_message_is_refused_for_two_seconds(bench: Bench) -> None:
    put(bench, 0)
    bench.send(Command.STOP, b"\0")
    bench.run(0.5)
    bench.ask(Command.RESUME)
    assert statuses(put(bench, 0)) == [(7, 0x63, Status.STOPPED)]
    bench.run(2.0)
    assert statuses(put(bench, 0)) == [(7, 0x63, Status.BAD_RANGE)], "the stop has ended the trajectory"


def test_a_table_of_another_host_waits_until_the_first_has_all(bench: Bench) -> None:
    table = ServoTable(5, 0, 256).serialize()
    bench.send(Command.SERVO_TABLE, table)
    bench.run(0.05)
    heads = [FragmentHead.parse(f.body) for f in bench.take() if f.cmd == Command.FRAGMENT]
    assert [(h.number, h.chunks) for h in heads] == [(0, 2), (1, 2)]
    ask = frame_bytes(Command.SERVO_TABLE, table, proto=2, seq=3, src=6, dst=8)
    bench.send_raw(ask)
    bench.run(0.05)
    assert statuses(bench.take()) == [(6, 3, Status.BUSY)]
    bench.send(Command.FRAGMENT_MISSING, serialize_missing(heads[0].message_id, ()))
    bench.send_raw(frame_bytes(Command.SERVO_TABLE, table, proto=2, seq=4, src=6, dst=8))
    bench.run(0.05)
    assert [f.dst for f in bench.take() if f.cmd == Command.FRAGMENT] == [6, 6]


def test_chunks_that_do_not_exist_are_not_sent(bench: Bench) -> None:
    bench.send(Command.SERVO_TABLE, ServoTable(5, 0, 256).serialize())
    bench.run(0.05)
    head = next(FragmentHead.parse(f.body) for f in bench.take() if f.cmd == Command.FRAGMENT)
    bench.send(Command.FRAGMENT_MISSING, serialize_missing(head.message_id, (9, 1, 0xFFFF, 1)))
    bench.send(Command.FRAGMENT_MISSING, serialize_missing(head.message_id ^ 0x100, (0,)))
    bench.run(0.05)
    assert [FragmentHead.parse(f.body).number for f in bench.take() if f.cmd == Command.FRAGMENT] == [1]
    bench.run(2.1)
    bench.send(Command.FRAGMENT_MISSING, serialize_missing(head.message_id, (0,)))
    bench.run(0.05)
    assert [f for f in bench.take() if f.cmd == Command.FRAGMENT] == [], "it is forgotten"


_CHUNK = st.tuples(
    st.sampled_from([Command.FRAGMENT, Command.FRAGMENT, Command.FRAGMENT, Command.FRAGMENT_MISSING, Command.STOP]),
    st.integers(0, 3),
    st.sampled_from([0, 1, 2, 3, 0xFFFF]),
    st.sampled_from([0, 1, 3, 4, 0xFFFF]),
    st.sampled_from([POINTS, POINTS, Command.SERVO_TABLE, Command.STATS]),
    st.binary(max_size=200),
)


@settings(max_examples=40, deadline=None)
@given(st.lists(_CHUNK, max_size=12))
def test_no_chunks_break_the_board(chunks: list[tuple[int, int, int, int, int, bytes]]) -> None:
    bench = Bench()
    bench.run(0.3)
    bench.ask(Command.TRAJECTORY_BEGIN, BeginRequest(5, 0, 0x7F, 200).serialize())
    for cmd, number, index, count, inner, data in chunks:
        body = data
        if cmd == Command.FRAGMENT:
            body = FragmentHead(number, index, count, inner, 0).serialize() + (BODY[:200] if not index else data)
        elif cmd == Command.STOP:
            body = b"\0"
        bench.send(cmd, body[:208])
        bench.run(0.01)
    bench.run(2.5)
    assert bench.ask(Command.IDENTIFY).status == Status.OK
    bench.ask(Command.RESUME)
    assert bench.ask(Command.TRAJECTORY_BEGIN, BeginRequest(5, 0, 0x7F, 200).serialize()).status == Status.OK
    for index in range(COUNT):
        frames = put(bench, index)
    assert statuses(frames) == [(7, 0x63, Status.OK)]
