"""vectors/session.jsonl both ways: the bytes mean what the line says, and the meaning builds the bytes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from hexwire.errors import RemoteProtocolError
from hexwire.session.decoder import FrameDecoder
from hexwire.session.events import BadFrame
from hexwire.wire.command_frame import Frame, parse_frame, serialize_frame

FILE = Path(__file__).parents[2] / "vectors/session.jsonl"
ROWS: list[dict[str, Any]] = [json.loads(line) for line in FILE.read_text().splitlines()]
NUMBERS = ("time_sec", "time_nsec", "sn", "src", "dst", "type", "proto", "seq", "cmd", "cmd_ext")


def of_kind(kind: str) -> pytest.MarkDecorator:
    return pytest.mark.parametrize("row", [row for row in ROWS if row["kind"] == kind], ids=lambda row: row["name"])


def test_every_line_names_its_source() -> None:
    assert all(row["source"] for row in ROWS)
    assert len({row["hex"] for row in ROWS}) == len(ROWS)
    assert sum(row["source"].startswith("the chapter's log,") for row in ROWS) == 6


@of_kind("frame")
def test_frame_is_parsed_and_built(row: dict[str, Any]) -> None:
    data = bytes.fromhex(row["hex"])
    frame = parse_frame(data)
    body = bytes.fromhex(row["body"])
    assert frame == Frame(body=body, **{name: row[name] for name in NUMBERS})
    assert frame.size == row["size"]
    built = serialize_frame(frame)
    at = 40 + len(body)
    assert int.from_bytes(data[at : at + 2], "little") == row["check"]
    if "note" in row:
        # The chapter's host sends a check that nobody can compute; everything else is the same.
        built = built[:at] + data[at : at + 2] + built[at + 2 :]
    assert built == data


@of_kind("frame")
def test_frame_comes_out_of_a_stream(row: dict[str, Any]) -> None:
    data = bytes.fromhex(row["hex"])
    decoder = FrameDecoder()
    decoder.receive(data, 0.0)
    assert decoder.next_event() == parse_frame(data)
    assert decoder.next_event() is None


@of_kind("bad")
def test_bad_frame_is_refused_for_its_reason(row: dict[str, Any]) -> None:
    data = bytes.fromhex(row["hex"])
    with pytest.raises(RemoteProtocolError) as caught:
        parse_frame(data)
    assert str(caught.value).startswith(row["reason"])


@pytest.mark.parametrize("row", [row for row in ROWS if row["source"].endswith("log, unchanged")])
def test_tail_0a_0a_of_the_log_is_refused_live_and_readable_once_put_right(row: dict[str, Any]) -> None:
    data = bytes.fromhex(row["hex"])
    decoder = FrameDecoder()
    decoder.receive(data, 0.0)
    event = decoder.next_event()
    assert isinstance(event, BadFrame)
    assert event.reason.startswith("tail is 0A 0A")
    assert not isinstance(decoder.next_event(), Frame)
    # The same line of the log with its tail put right is one of the good frames here.
    assert any(bytes.fromhex(r["hex"]) == data[:-2] + b"\r\n" for r in ROWS if r.get("log_tail") == "0A 0A")
