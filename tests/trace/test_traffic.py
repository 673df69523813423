from __future__ import annotations

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.frames import frame_bytes

from hexwire.link.tap import Direction, Passed
from hexwire.trace.traffic import Traffic
from hexwire.wire.command_frame import Command
from hexwire.wire.commands import MoveRequest
from hexwire.wire.servo_packet import (
    BROADCAST_ID,
    make_ping,
    make_read,
    make_status,
    make_sync_read,
    make_sync_write,
)

SENT, RECEIVED = Direction.SENT, Direction.RECEIVED


def frame(cmd: int, body: bytes = b"", *, src: int = 7, seq: int = 1, ext: int = 0, proto: int = 2) -> bytes:
    return frame_bytes(cmd, body, proto=proto, seq=seq, src=src, dst=15 - src, cmd_ext=ext)


def fed(*transfers: tuple[Direction, bytes, float], most: int = 1000, size: int = 100_000) -> Traffic:
    traffic = Traffic(most=most, size=size)
    for way, data, time in transfers:
        traffic.feed(Passed(way, data, time, ""))
    return traffic


def test_an_answer_has_its_request_and_both_have_the_time_between() -> None:
    request, other = frame(Command.STATS, seq=4), frame(Command.RESUME, seq=5)
    reply = frame(Command.STATS, bytes(60), src=8, seq=4, ext=0x80)
    traffic = fed((SENT, request, 1.0), (SENT, other, 1.01), (RECEIVED, reply, 1.025))
    asked, unanswered, answered = traffic
    assert (asked.answered, answered.answers) == (3, 1)
    assert asked.took == answered.took == pytest.approx(0.025)
    assert unanswered.answered is None
    assert answered.as_row()[-2:] == [1, 25.0]
    assert asked.as_row()[-2:] == [None, None]


def test_without_times_there_is_a_pair_and_no_time() -> None:
    traffic = fed((SENT, make_ping(4), 0.0), (RECEIVED, make_status(4), 0.0))
    assert [(entry.answers, entry.took) for entry in traffic] == [(None, None), (1, None)]


def test_every_answer_to_a_sync_read_belongs_to_it() -> None:
    traffic = fed(
        (SENT, make_sync_read(0x38, 2, (4, 5)), 1.0),
        (RECEIVED, make_status(4, 0, b"ab"), 1.01),
        (RECEIVED, make_status(5, 0, b"ab"), 1.02),
    )
    asked, *answers = traffic
    assert [entry.answers for entry in answers] == [1, 1]
    assert asked.answered == 3


def test_an_entry_says_which_servos_it_names() -> None:
    move = MoveRequest(1000, ((2, 100), (6, 200))).serialize()
    read = b"\x08\x14" + make_read(4, 0x38, 2)
    traffic = fed(
        (SENT, frame(Command.JOINT_MOVE, move), 1.0),
        (SENT, frame(Command.TRANSACT, read, seq=2), 1.0),
        (SENT, frame(Command.SYNC_WRITE, make_sync_write(0x2A, {0: b"abcd", 3: b"efgh"}), proto=1), 1.0),
        (SENT, frame(Command.STATS, seq=3), 1.0),
    )
    assert [entry.servos for entry in traffic] == [(2, 6), (4,), (0, 3), ()]
    assert [entry.name for entry in traffic] == ["joint_move", "transact", "sync_write", "stats"]
    everybody = MoveRequest(1000, ((BROADCAST_ID, 100),)).serialize()
    several = fed(
        (SENT, frame(Command.TORQUE, b"\1\x29\0"), 1.0),
        (RECEIVED, frame(Command.TORQUE, b"\1\x21\0", src=8, ext=0x80), 1.0),
        (SENT, frame(Command.TRAJECTORY_BEGIN, b"\1\0\x40\0\0\0"), 1.0),
        (SENT, frame(Command.JOINT_MOVE, everybody), 1.0),
        (SENT, frame(Command.IO, b"\7\0"), 1.0),
    )
    assert [entry.servos for entry in several] == [(0, 3, 5), (0, 5), (6,), tuple(range(7)), ()]
    bus = fed((SENT, make_sync_read(0x38, 2, (4, 5)), 1.0), (RECEIVED, make_status(4, 0, b"ab"), 1.0))
    assert [entry.servos for entry in bus] == [(4, 5), (4,)]
    assert [entry.name for entry in bus] == ["sync_read", "status"]


@pytest.mark.parametrize("good", [make_status(4, 0, b"ab"), frame(Command.STATS, bytes(60), src=8, ext=0x80)])
def test_what_is_damaged_from_its_beginning_is_no_rest_of_what_came_before(good: bytes) -> None:
    tail = 1 if good[0] == 0xFF else 4
    damaged = good[:-tail] + bytes((good[-tail] ^ 1,)) + good[len(good) - tail + 1 :]
    traffic = fed((RECEIVED, damaged + good, 1.0))
    assert [entry.bad for entry in traffic] == [True, False]
    rest = Traffic(bus=tail == 1)
    rest.feed(Passed(RECEIVED, damaged[3:] + good, 1.0, ""))
    assert [entry.bad for entry in rest] == [False]


def test_bad_bytes_say_why() -> None:
    good = frame(Command.STATS)
    traffic = fed((SENT, b"xx" + good[:-1] + b"z" + good, 1.0))
    assert [(entry.bad, entry.problem) for entry in traffic] == [
        (True, "Bytes that belong to no frame and no packet."),
        (True, "tail is 0D 7A, not 0D 0A"),
        (False, ""),
    ]


def test_only_a_reader_that_waited_in_vain_ends_an_incomplete_frame() -> None:
    good = frame(Command.STATS)
    reading = (RECEIVED, good[:20], 1.0)
    (entry,) = fed((RECEIVED, good, 0.9), reading, (RECEIVED, b"", 1.06)).since(1)
    assert entry.problem.startswith("cut short, 20 of")
    assert entry.reading.time == 1.0
    # A frame is whole, however far apart its parts came, and whatever came the other way meanwhile.
    for pause in (0.0, 0.06, 5.0):
        traffic = fed(reading, (SENT, good, 1.0 + pause), (RECEIVED, good[20:], 1.0 + pause))
        assert [(entry.sent, entry.bad) for entry in traffic] == [(True, False), (False, False)], pause
    # What is cut short is found nevertheless, by what follows it.
    traffic = fed((RECEIVED, good, 0.9), reading, (RECEIVED, good + good, 1.3))
    assert [entry.bad for entry in traffic] == [False, True, False, False]


@pytest.mark.parametrize("way", list(Direction))
def test_traffic_that_begins_in_the_middle_of_a_frame_is_not_damaged(way: Direction) -> None:
    begins = frame(Command.STATS, bytes(60), src=8, seq=4, ext=0x80)
    packet = make_status(4, 0, b"abcdefgh")
    for kind, whole in (("frame", begins), ("packet", packet)):
        for cut in range(1, len(whole)):
            traffic = fed((way, whole[cut:], 1.0), (way, whole + whole, 1.1))
            found = [(entry.bad, entry.reading.data) for entry in traffic]
            assert found == [(False, whole)] * 2, (kind, cut)
            # The same after transfers were left out.
            traffic.skip()
            traffic.feed(Passed(way, whole[cut:], 9.0, ""))
            traffic.feed(Passed(way, whole, 9.1, ""))
            assert not any(entry.bad for entry in traffic), (kind, cut)
    # Noise is no rest of a frame: it is shown as soon as that is clear.
    noise = b"\x00\xf0" * 20
    assert [entry.bad for entry in fed((way, noise, 1.0), (way, begins, 1.1))] == [True, False]
    assert [entry.bad for entry in fed((way, noise, 1.0), (way, b"", 1.1))] == [True]
    assert sum(len(entry.reading.data) for entry in fed(*[(way, noise, 1.0)] * 200)) == 200 * len(noise)
    ended = fed((way, noise, 1.0))
    ended.finish()
    assert [entry.bad for entry in ended] == [True]


def test_after_a_gap_nothing_is_joined_or_paired() -> None:
    request, reply = frame(Command.STATS, seq=4), frame(Command.STATS, bytes(60), src=8, seq=4, ext=0x80)
    traffic = fed((SENT, request + request[:20], 1.0), (RECEIVED, reply[:50], 1.0), most=3)
    traffic.skip()
    traffic.feed(Passed(RECEIVED, reply, 5.0, ""))
    traffic.feed(Passed(SENT, request, 5.0, ""))
    assert [(entry.number, entry.bad, entry.answers) for entry in traffic] == [
        (1, False, None),
        (2, False, None),
        (3, False, None),
    ]
    # The offsets of bytes begin anew: dropping an entry from before must not take the pair of one from after.
    traffic.feed(Passed(RECEIVED, frame(Command.RESUME, b"\0", src=8, seq=9, ext=0x80), 5.1, ""))
    traffic.feed(Passed(RECEIVED, reply, 5.2, ""))
    assert [entry.answers for entry in traffic] == [None, None, 3]


def test_the_end_of_a_file_ends_what_is_incomplete() -> None:
    traffic = fed((SENT, frame(Command.STATS)[:20], 0.0))
    traffic.finish()
    assert [entry.bad for entry in traffic] == [True]


def test_the_oldest_entries_are_dropped_and_numbers_stay() -> None:
    traffic = fed(*[(SENT, frame(Command.STATS, seq=i), 1.0) for i in range(10)], most=4)
    assert [entry.number for entry in traffic] == [7, 8, 9, 10]
    assert traffic.lost == 6
    assert traffic.newest == 10
    assert traffic.get(6) is None
    assert traffic.get(11) is None
    assert [traffic.get(number) for number in (7, 10)] == [next(iter(traffic)), list(traffic)[-1]]
    assert [entry.number for entry in traffic.since(8)] == [9, 10]
    assert [entry.number for entry in traffic.since(0, most=2)] == [9, 10]
    # An answer to a request that was dropped has none.
    traffic.feed(Passed(RECEIVED, frame(Command.STATS, bytes(60), src=8, seq=1, ext=0x80), 1.0, ""))
    assert traffic.since(10)[0].answers is None
    assert len(fed(*[(SENT, frame(Command.STATS, seq=i), 1.0) for i in range(10)], size=100)) == 2


@given(st.lists(st.tuples(st.sampled_from(Direction), st.binary(max_size=80), st.floats(0, 3)), max_size=12))
def test_any_bytes_make_rows(transfers: list[tuple[Direction, bytes, float]]) -> None:
    traffic = fed(*transfers, most=5)
    traffic.finish()
    assert len(traffic) <= 5
    json.dumps([entry.as_row() for entry in traffic], allow_nan=False)
