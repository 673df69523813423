from __future__ import annotations

from tests.frames import frame_bytes

from hexwire.link.tap import Direction, Passed
from hexwire.trace.line_reader import LineReader
from hexwire.wire.command_frame import Command
from hexwire.wire.servo_packet import make_ping, make_status

SENT, RECEIVED = Direction.SENT, Direction.RECEIVED
FRAME = frame_bytes(Command.STATS, b"", proto=2, seq=1, src=7, dst=8)


def lines(reader: LineReader, way: Direction, data: bytes) -> list[str]:
    return [reading.line for reading in reader.feed(Passed(way, data, 0.0, ""))]


def test_a_line_that_begins_with_a_servo_packet_is_a_bus_until_a_frame_is_found() -> None:
    reader = LineReader()
    assert lines(reader, SENT, make_ping(1)) == ["bus"]
    assert lines(reader, SENT, FRAME) == ["host"]
    assert lines(reader, SENT, make_ping(1) + FRAME) == ["host", "host"]
    # The other direction decides for itself.
    assert lines(reader, RECEIVED, make_status(1)) == ["bus"]


def test_what_the_caller_says_about_the_line_wins() -> None:
    assert lines(LineReader(bus=True), SENT, FRAME)[0] == "bus"
    assert lines(LineReader(bus=False), SENT, make_ping(1) + FRAME)[0] == "host"


def test_a_pause_gives_up_an_incomplete_frame_of_its_direction_only() -> None:
    reader = LineReader()
    for way in Direction:
        assert lines(reader, way, FRAME[:-1]) == []
        assert reader.waits(way)
    (given_up,) = reader.silence(SENT, 2.5)
    assert (given_up.kind, given_up.time) == ("bad", 2.5)
    assert given_up.problem == f"cut short, {len(FRAME) - 1} of {len(FRAME)} bytes"
    assert not reader.waits(SENT)
    assert reader.waits(RECEIVED)
    assert [reading.way for reading in reader.finish()] == [RECEIVED]


def test_a_caller_that_stops_early_loses_nothing() -> None:
    reader = LineReader()
    next(reader.feed(Passed(SENT, FRAME * 3, 0.0, "")))
    assert len(list(reader.feed(Passed(SENT, FRAME, 0.0, "")))) == 3
