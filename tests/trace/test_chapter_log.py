"""The chapter's log layout, both ways."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from hexwire.link.tap import Direction, Passed
from hexwire.trace.chapter_log import format_passed, format_positions, hex_rows, parse_log

REQUEST = bytes.fromhex(
    "5AFAFA5ADB9A7A68E04E000D2E0000000700000008000000030000003400000082012E0008000200FFFF0604023C02B514220D0A"
)
CHAPTER = """\
Read all servo positions[Encoder/counts]:
SerialPort sent - Length=52
5A FA FA 5A DB 9A 7A 68 E0 4E 00 0D 2E 00 00 00| Z Z zh N .
07 00 00 00 08 00 00 00 03 00 00 00 34 00 00 00| 4
82 01 2E 00 08 00 02 00 FF FF 06 04 02 3C 02 B5| . <
14 22 0D 0A | "
SerialPort receive - Length=32
5A FA FA 5A 0E 00 00 00 00 21 38 15 2D 00 00 00| Z Z !8 -
08 00 00 00 00 00 00 00 08 00 00 00 34 00 00 00| 4

[ INFO] [1752865499.278524557]: Hex7botRos:: HW read
"""


def test_rows_look_like_the_chapters() -> None:
    rows = list(hex_rows(REQUEST))
    assert rows[0].split("|")[0] == "5A FA FA 5A DB 9A 7A 68 E0 4E 00 0D 2E 00 00 00"
    assert rows[0].split("|")[1].split() == ["Z", "Z", "zh", "N", "."]
    assert rows[3].split("|") == ["14 22 0D 0A".ljust(47), '  "']
    assert len({row.index("|") for row in rows}) == 1


def test_headline_has_direction_and_length_and_time_if_asked() -> None:
    sent = Passed(Direction.SENT, REQUEST, 12.5, "serial:///dev/ttyUSB0")
    assert next(format_passed(sent)) == "SerialPort sent - Length=52"
    received = sent._replace(direction=Direction.RECEIVED)
    assert next(format_passed(received, start=12.0)) == "0.500000 SerialPort receive - Length=52"


def test_the_chapters_own_text_is_read() -> None:
    transfers = list(parse_log(CHAPTER.splitlines()))
    assert [(t.direction, len(t.data)) for t in transfers if isinstance(t, Passed)] == [
        (Direction.SENT, 52),
        (Direction.RECEIVED, 32),
    ]
    assert transfers[0] == Passed(Direction.SENT, REQUEST, 0.0, "")


def test_rows_of_bytes_that_belong_to_no_transfer_are_ignored() -> None:
    row = "AA BB CC DD"
    before, behind = f"{row}\n{CHAPTER}", CHAPTER.replace('14 22 0D 0A | "', f'14 22 0D 0A | "\n{row}\n{row}')
    assert behind != CHAPTER
    for text in (before, behind):
        assert list(parse_log(text.splitlines())) == list(parse_log(CHAPTER.splitlines()))


def test_missing_bytes_are_reported_and_the_rest_is_read() -> None:
    text = CHAPTER.replace("14 22 0D 0A", "14 22 0D")
    remark, transfer, *_ = parse_log(text.splitlines())
    assert remark == "the log says 52 bytes, but has 51"
    assert isinstance(transfer, Passed)
    assert transfer.data == REQUEST[:-1]


@given(st.lists(st.tuples(st.sampled_from(Direction), st.binary(min_size=1, max_size=300)), max_size=6))
def test_what_is_written_is_read_back(transfers: list[tuple[Direction, bytes]]) -> None:
    lines: list[str] = []
    for i, (direction, data) in enumerate(transfers):
        lines += format_passed(Passed(direction, data, float(i), ""), start=0.0)
    back = list(parse_log(lines))
    assert [(t.direction, t.data, t.time) for t in back if isinstance(t, Passed)] == [
        (direction, data, float(i)) for i, (direction, data) in enumerate(transfers)
    ]
    assert len(back) == len(transfers)


def test_positions_have_the_digits_of_the_chapters_log() -> None:
    counts = (6 * 0.0878917 - 5.0, 54.6484332, -8 * 0.0878917, -0.0878917)
    head, row = format_positions(("J1", "J2", "J4", "J6"), counts, name="Hex7botRos")
    assert head == "Hex7botRos:: HW read (degree):"
    assert row == "J1=-4.47265 J2=54.6484 J4=-0.703134 J6=-0.0878917"
    # Whoever reads the log passes over them.
    assert list(parse_log([head, row])) == []
