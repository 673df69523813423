from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st
from tests.analyzers.lines import readings_table
from tests.frames import frame_bytes

from hexwire.link.tap import Direction, Passed
from hexwire.trace.explain import Explainer
from hexwire.trace.reading import Reader
from hexwire.trace.reading_tables import TABLES
from hexwire.wire.command_frame import Command
from hexwire.wire.servo_packet import make_legacy_ping_status, make_ping, make_read, make_status

WAYS = {"host": Direction.SENT, "board": Direction.RECEIVED}


def test_reads_as_the_table_says() -> None:
    for row in readings_table():
        explainer = Explainer(row.get("series", "board"), bus=row["line"] == "bus")
        found = []
        for i, (way, data) in enumerate(row["transfers"]):
            found += explainer.feed(Passed(WAYS[way], bytes.fromhex(data), i * 0.001, ""))
        found += explainer.finish()
        assert [explained.reading for explained in found] == row["readings"], row["name"]
        assert all(explained.as_fields()["reading"] == explained.reading for explained in found), row["name"]


def test_the_table_has_every_kind_of_line() -> None:
    table = readings_table()
    assert len({row["name"] for row in table}) == len(table) > 90
    texts = " / ".join(text for row in table for text in row["readings"])
    for words in (
        "garbage:",
        "bad frame: tail",
        "bad frame: check",
        "bad packet: checksum",
        "board error",
        "reply ok",
    ):
        assert words in texts
    for hazard in ("0D 0A inside", "current ceiling", "ICRNL", "does not fit"):
        assert f" ! {hazard}" in texts or hazard in texts


def test_a_board_s_error_is_one_only_behind_a_board() -> None:
    status = make_legacy_ping_status(3, 5)
    (alone,) = Reader(TABLES, "bus").feed(status)
    assert alone.text == "status 3 legacy error voltage, temperature"
    data = frame_bytes(Command.PING, status, proto=1, src=8, dst=7)
    (framed,) = Reader(TABLES).feed(data)
    assert framed.words == "board error ping silent, servo 3"
    assert framed.answer


def test_an_answer_with_another_series_header_is_doubted() -> None:
    explainer = Explainer(bus=True)
    list(explainer.feed(Passed(Direction.SENT, make_ping(1), 1.0, "")))
    both = make_legacy_ping_status(1) + make_status(1)
    right, wrong = explainer.feed(Passed(Direction.RECEIVED, both, 1.1, ""))
    assert "hazard" not in right.layers[0].fields
    assert wrong.layers[0].fields["hazard"] == "the header of another series"
    assert wrong.text.endswith("is this the right servo?")


def test_a_name_comes_from_the_series_that_is_given() -> None:
    request = make_read(1, 42, 2)
    texts = [Reader(TABLES, "bus", series).feed(request)[0].text for series in ("seven_bot", "sts_sms", "board")]
    assert texts == [f"read 1: {name}_position, 2 bytes" for name in ("target", "goal", "target")]
    assert Reader(TABLES, "bus").feed(make_read(99, 42, 2))[0].text == "read 99: 0x2A, 2 bytes"


part = st.one_of(
    st.binary(max_size=8), st.sampled_from([make_ping(4), make_status(4), b"\xff", b"\xff\xff", b"\xff\xf5"])
)


@given(st.lists(part, max_size=10), st.lists(st.integers(0, 80), max_size=5))
def test_no_byte_is_lost_and_pieces_make_no_difference(parts: list[bytes], cuts: list[int]) -> None:
    stream = b"".join(parts)

    def sound(pieces: list[bytes]) -> list[bytes]:
        reader, found = Reader(TABLES, "bus"), []
        for piece in pieces:
            found += reader.feed(piece)
            assert len(reader.unfinished()) < 256
        found += reader.silence()
        assert b"".join(reading.data for reading in found) == stream
        assert all(bool(reading.problem) == (reading.kind == "bad") for reading in found)
        return [reading.data for reading in found if reading.kind == "packet"]

    edges = sorted({min(cut, len(stream)) for cut in cuts})
    split = [stream[a:b] for a, b in zip([0, *edges], [*edges, len(stream)], strict=True)]
    assert sound(split) == sound([stream])


def test_requests_that_nobody_answers_are_forgotten() -> None:
    reader = Reader(TABLES)
    for src in range(2000):
        reader.feed(frame_bytes(Command.STATS, b"", proto=2, seq=1, src=src, dst=8))
    replies = [
        reader.feed(frame_bytes(Command.STATS, bytes(60), proto=2, seq=1, src=8, dst=src, cmd_ext=0x80))[0]
        for src in (0, 1999)
    ]
    assert [reply.answers is not None for reply in replies] == [False, True]
