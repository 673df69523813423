from __future__ import annotations

import json
import random
import time
from collections.abc import Iterator
from typing import Any

import pytest
from tests.frames import frame_bytes

from hexwire.errors import UsageError
from hexwire.link.memory import memory_pair
from hexwire.link.tap import Direction, Passed
from hexwire.session.decoder import FrameDecoder
from hexwire.studio.wire_feed import WireFeed
from hexwire.wire.command_frame import Command, Frame
from hexwire.wire.servo_packet import make_ping


def frame(seq: int = 1) -> bytes:
    return frame_bytes(Command.STATS, b"", proto=2, seq=seq, src=7, dst=8)


class Line:
    """A feed whose link is one end of a pair in memory."""

    def __init__(self) -> None:
        self.now = 100.0
        self.feed = WireFeed(clock=lambda: self.now)
        tap = self.feed.begin("serial:///dev/x")
        near, self.far = memory_pair()
        self.link = tap(near)
        self.link.open()
        self.far.open()

    def all_rows(self, wanted: str = "") -> list[list[Any]]:
        rows, since, still = list[list[Any]](), 0, 0
        while still < 2:
            page = self.feed.rows(since, wanted)
            json.dumps(page, allow_nan=False)
            rows += page["rows"]
            still = still + 1 if page["next"] == since else 0
            since = page["next"]
        return rows


@pytest.fixture
def line() -> Iterator[Line]:
    made = Line()
    yield made
    made.link.close()
    made.far.close()


def test_the_traffic_of_the_open_line_is_shown(line: Line) -> None:
    for seq in range(3):
        line.link.write(frame(seq), None)
    rows = line.all_rows()
    assert [row[5] for row in rows] == [f"2 STATS request seq {seq}" for seq in range(3)]
    assert line.all_rows('"seq 1"') == [rows[1]]
    assert line.feed.rows(3, "")["rows"] == []
    line.link.write(frame(3), None)
    assert [row[0] for row in line.feed.rows(3, "")["rows"]] == [4]


def test_a_frame_comes_with_its_bytes_and_its_tree(line: Line) -> None:
    line.link.write(frame(), None)
    line.all_rows()
    found = line.feed.frame(1)
    assert bytes.fromhex(found["hex"]) == frame()
    assert [part["name"] for part in found["tree"]["parts"]] == ["session header", "command frame"]
    with pytest.raises(UsageError, match="no longer kept"):
        line.feed.frame(2)


def test_what_the_decoder_in_use_takes_is_good_and_what_it_rejects_is_bad() -> None:
    """The page and a decoder behind the same tap, for cut, delayed and damaged frames in simulated time."""
    rng = random.Random(26)
    for trial in range(60):
        line, decoder = Line(), FrameDecoder()
        now = 50.0
        line.link.link.clock = line.link.clock = lambda: now  # noqa: B023  # its value at the call
        pieces = list[bytes]()
        for _ in range(rng.randrange(1, 8)):
            data = frame(rng.randrange(256))
            if trial % 2 and rng.random() < 0.3:
                data = rng.choice([data[: rng.randrange(1, 44)], data[:40] + b"\0\0" + data[42:]])
            at = rng.randrange(len(data) + 1)
            pieces += [data[:at], data[at:]]
        whole, rejected, unread = 0, 0, False
        for piece in (*pieces, *[b""] * 4):
            if piece:
                line.far.write(piece, None)
                unread = True
            now += rng.choice([0.0, 0.01, 0.06, 2.0])
            # A reader that was busy gets the bytes late, and all that came meanwhile together.
            if rng.random() < 0.4 and piece:
                continue
            for _ in range(2):
                now += 0.0 if unread else rng.choice([0.0, 0.06])
                read, unread = line.link.read(0.0), False
                decoder.receive(read, now)
                while event := decoder.next_event() or (None if read else decoder.handle_timeout(now)):
                    whole += isinstance(event, Frame)
                    rejected += not isinstance(event, Frame)
        rows = line.all_rows()
        assert sum(not row[7] for row in rows) == whole, trial
        assert bool(rejected) >= any(row[7] for row in rows), trial
        line.link.close()
        line.far.close()


def test_what_is_kept_is_said_with_its_time_and_answers_that_the_filter_hides(line: Line) -> None:
    for seq in range(3):
        reply = frame_bytes(Command.STATS, bytes(60), proto=2, seq=seq, src=8, dst=7, cmd_ext=0x80)
        for way, data in ((Direction.SENT, frame(seq)), (Direction.RECEIVED, reply)):
            line.now += 0.25
            line.feed._ring.feed(Passed(way, data, line.now, ""))
    line.all_rows()
    page = line.feed.rows(0, "request")
    assert [row[0] for row in page["rows"]] == [1, 3, 5]
    assert page["answers"] == [(1, 2), (3, 4), (5, 6)]
    assert line.feed.rows(2, "request")["answers"] == [(3, 4), (5, 6)]
    assert line.feed.rows(0, "servo 3")["answers"] == []
    assert (page["first"], page["newest"], page["skipped"]) == (1, 6, 0)
    assert page["span"] == 1.25


@pytest.mark.parametrize("words", ["unanswered", "problem", "not slow 5000", "not unanswered"])
def test_what_depends_on_an_answer_is_shown_when_that_is_overdue(line: Line, words: str) -> None:
    def passed(way: Direction, data: bytes, time: float) -> None:
        line.feed._ring.feed(Passed(way, data, time, ""))

    reply = frame_bytes(Command.STATS, bytes(60), proto=2, seq=1, src=8, dst=7, cmd_ext=0x80)
    passed(Direction.SENT, frame(1), 1.0)
    passed(Direction.SENT, frame(2), 1.1)
    page = line.feed.rows(0, words)
    assert (page["rows"], page["next"], page["more"]) == ([], 0, False)
    passed(Direction.RECEIVED, reply, 1.2)
    assert [row[0] for row in line.feed.rows(0, words)["rows"] if row[0] < 3] == ([1] if "not" in words else [])
    passed(Direction.SENT, frame(3), 2.15)
    rows = {row[0]: row[6] for row in line.feed.rows(0, words)["rows"] if row[0] != 3}
    lost = {2: "no answer came"}
    assert rows == {"not slow 5000": {1: "", **lost}, "not unanswered": {1: ""}}.get(words, lost)


def test_the_oldest_frame_that_is_shown_can_be_opened_after_some_more_have_come(line: Line) -> None:
    line.feed._ring.feed(Passed(Direction.SENT, frame() * 11_000, 1.0, ""))
    first = line.feed.rows(10_500)["first"]
    assert first == 1001
    line.feed._ring.feed(Passed(Direction.SENT, frame() * 400, 1.1, ""))
    assert line.feed.rows(11_000)["first"] == 1401
    assert line.feed.frame(first)["number"] == first


def test_many_frames_come_in_pages(line: Line) -> None:
    line.feed._ring.feed(Passed(Direction.SENT, frame() * 2500, 1.0, ""))
    first = line.feed.rows(0)
    assert (len(first["rows"]), first["more"], first["next"]) == (1000, True, 1000)
    assert len(line.all_rows()) == 2500
    assert line.all_rows("bad") == []


def test_only_the_end_of_what_came_before_is_read(line: Line) -> None:
    for i in range(5000):
        line.feed._ring.feed(Passed(Direction.SENT, frame(i % 256), 1.0 + i / 1000, ""))
    assert len(line.all_rows()) == 2000


def test_what_came_while_nobody_looked_is_left_out(line: Line) -> None:
    line.link.write(frame() + frame()[:10], None)
    assert len(line.all_rows()) == 1
    for i in range(3000):
        line.feed._ring.feed(Passed(Direction.SENT, frame(i % 256), 1e6 + i / 1000, ""))
    rows = line.all_rows()
    assert len(rows) == 2001
    assert not [row for row in rows if row[7]]
    assert line.feed.rows(0)["skipped"] == 1000


def test_another_line_starts_anew(line: Line) -> None:
    line.link.write(frame(), None)
    assert line.all_rows()
    line.feed.begin("serial:///dev/y")
    assert line.feed.rows(0)["rows"] == []
    # A tab that asks from a number of the last line gets the right one to continue from.
    assert line.feed.rows(99)["next"] == 0


def test_a_link_that_goes_on_is_observed_once(line: Line) -> None:
    old = line.feed._ring
    again: Any = line.feed.begin("serial:///dev/x")(line.link)
    again.write(frame(), None)
    assert len(line.all_rows()) == 1
    assert old.newest == 0
    assert again.link is line.link.link  # type: ignore[attr-defined]  # a tap has one


def test_the_page_says_why_nothing_is_seen() -> None:
    feed = WireFeed()
    assert "Nothing is open" in feed.rows(0)["note"]
    feed.begin("zenoh:lab/arm1")
    assert "shared by another program" in feed.rows(0)["note"]


def test_the_series_of_the_line_is_that_of_the_arm() -> None:
    feed = WireFeed()
    feed.begin("serial:///dev/x")
    for series, shown in ((["hls"] * 6, "hls"), (["seven_bot", "hls"], "board"), ([], "board"), (["x"], "board")):
        feed.expect(series)
        assert feed.rows(0)["series"] == shown


def test_the_line_is_read_as_that_of_a_series() -> None:
    feed = WireFeed()
    feed.set_series("scs")
    assert feed.rows(0)["series"] == "scs"
    with pytest.raises(UsageError, match="no servo series"):
        feed.set_series("other")


def test_what_is_kept_of_the_line_can_be_saved(line: Line) -> None:
    assert line.feed.kept()[0] == []
    line.link.write(make_ping(4), None)
    kept, offset = line.feed.kept()
    assert [passed.data for passed in kept] == [make_ping(4)]
    assert abs(time.time() - offset - line.now) < 60.0
