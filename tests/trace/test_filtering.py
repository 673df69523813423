from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.frames import frame_bytes

from hexwire.errors import UsageError
from hexwire.link.tap import Direction, Passed
from hexwire.trace.filtering import parse_filter
from hexwire.trace.traffic import Traffic
from hexwire.wire.command_frame import Command, Status
from hexwire.wire.commands import MoveRequest
from hexwire.wire.servo_packet import (
    BROADCAST_ID,
    make_ping,
    make_read,
    make_status,
    make_sync_read,
    make_sync_write,
    make_write,
)

SENT, RECEIVED = Direction.SENT, Direction.RECEIVED


def frame(cmd: int, body: bytes = b"", *, src: int = 7, seq: int = 1, ext: int = 0, proto: int = 2) -> bytes:
    return frame_bytes(cmd, body, proto=proto, seq=seq, src=src, dst=15 - src, cmd_ext=ext)


def make_traffic() -> Traffic:
    traffic = Traffic()
    for way, data, time in (
        (SENT, frame(Command.JOINT_MOVE, MoveRequest(1000, ((3, 100),)).serialize()), 1.0),
        (RECEIVED, frame(Command.JOINT_MOVE, b"\xe8\x03\x00", src=8, ext=0x80), 1.03),
        (SENT, frame(Command.READ, make_read(4, 0x38, 2), proto=1), 2.0),
        (SENT, b"noise" + frame(Command.STATS, seq=9), 3.0),
    ):
        traffic.feed(Passed(way, data, time, ""))
    return traffic


def test_what_goes_to_all_servos_is_not_unanswered_and_errors_are_doubtful() -> None:
    traffic = Traffic("sts_sms")
    for way, data in (
        (SENT, make_sync_write(0x2A, {3: b"ab", 4: b"ab"})),
        (SENT, make_write(BROADCAST_ID, 0x28, b"\0")),
        (SENT, make_ping(4)),
        (RECEIVED, make_status(4, 0x20)),
        (SENT, make_ping(3)),
        (RECEIVED, make_status(3)),
        (SENT, make_ping(BROADCAST_ID)),
        (SENT, make_sync_read(0x38, 2, (5, 6))),
    ):
        traffic.feed(Passed(way, data, 0.0, ""))

    def passing(text: str) -> list[int]:
        return [entry.number for entry in filter(parse_filter(text), traffic)]

    assert passing("unanswered") == [7, 8]
    assert passing("doubt") == [4]
    assert passing("problem") == [4, 7, 8]
    assert [parse_filter(words).of_answers for words in ("not unanswered", "SLOW 2", "bad", '"problem"')] == [
        True,
        True,
        False,
        False,
    ]
    assert traffic.get(4).problem == "the servo reports an error"  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("cmd", "body", "ext", "proto"),
    [
        (Command.TORQUE, b"", 0x80 | Status.STOPPED, 2),
        (Command.TRANSACT, make_status(4, 0x20), 0x80, 2),
        (Command.READ, make_status(4, 0x20, b"ab"), 0, 1),
    ],
)
def test_an_answer_that_reports_an_error_is_doubtful(cmd: int, body: bytes, ext: int, proto: int) -> None:
    for fine in (False, True):
        asked = frame(cmd, b"" if proto == 2 else make_read(4, 0x38, 2), proto=proto)
        without = make_status(4, 0, b"ab") if body else b""
        answer = frame(cmd, without if fine else body, src=8, ext=0x80 if fine and proto == 2 else ext, proto=proto)
        traffic = Traffic()
        for way, data in ((SENT, asked), (RECEIVED, answer)):
            traffic.feed(Passed(way, data, 0.0, ""))
        assert [entry.number for entry in filter(parse_filter("doubt"), traffic)] == ([] if fine else [2])


@pytest.mark.parametrize(
    ("text", "numbers"),
    [
        ("", [1, 2, 3, 4, 5]),
        ("servo 3", [1]),
        ("servo 3,4", [1, 3]),
        ("joint_move", [1, 2]),
        ("JOINT_MOVE answer", [2]),
        ("bad", [4]),
        ("not bad", [1, 2, 3, 5]),
        ("-bad -joint_move", [3, 5]),
        ("not not bad", [4]),
        ("doubt", [4]),
        ("sent frame", [1, 3, 5]),
        ("received", [2]),
        ("request unanswered", [3, 5]),
        ("dialect 1", [3]),
        ("slow 20", [1, 2]),
        ("slow 40", []),
        ("present_position", [3]),
        ("PRESENT_pos", [3]),
        ('"seq 9"', [5]),
        ('"reply ok', [2]),
        ('"bad"', []),
        ("bytes FFFF04", [3]),
        ("packet", []),
    ],
)
def test_a_filter_finds(text: str, numbers: list[int]) -> None:
    passes = parse_filter(text)
    assert [entry.number for entry in make_traffic() if passes(entry)] == numbers


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("servo", "servo needs a number up to 254: servo 3, or servo 3,4"),
        ("servo x", "servo needs a number"),
        ("servo 255", "up to 254"),
        ("slow soon", "in milliseconds"),
        ("dialect", "dialect needs a number"),
        ("bytes 0D0", "pairs of hex digits"),
        ("bad not", "what follows 'not'?"),
        ("x" * 201, "at most 200"),
    ],
)
def test_a_wrong_filter_says_what_is_right(text: str, words: str) -> None:
    with pytest.raises(UsageError, match=words.replace("?", r"\?")):
        parse_filter(text)


@given(st.text(max_size=40))
def test_any_text_is_a_filter_or_a_usage_error(text: str) -> None:
    try:
        passes = parse_filter(text)
    except UsageError:
        return
    assert [passes(entry) for entry in make_traffic()]


def test_what_a_board_reports_by_itself_is_no_request() -> None:
    traffic = Traffic()
    traffic.feed(Passed(SENT, frame(Command.JOINT_STATE), 1.0, ""))
    traffic.feed(Passed(RECEIVED, frame(Command.JOINT_STATE, src=8, ext=0x40), 1.1, ""))
    traffic.feed(Passed(RECEIVED, frame(Command.JOINT_STATE, src=8, ext=0x80), 1.2, ""))
    for text, numbers in (
        ("request", [1]),
        ("answer", [3]),
        ("unanswered", []),
        ("not request", [2, 3]),
        ("report", [2]),
    ):
        passes = parse_filter(text)
        assert [entry.number for entry in traffic.since(0) if passes(entry)] == numbers, text
