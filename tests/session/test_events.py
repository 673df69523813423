"""Events have a log line that cannot fail, and are values."""

from __future__ import annotations

import dataclasses
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.frames import frame_bytes

from hexwire.session import events as e
from hexwire.wire.command_frame import parse_frame

FRAME = parse_frame(frame_bytes(0x15, b"\0", seq=9, sn=1, cmd_ext=0x85))


@pytest.mark.parametrize(
    ("event", "line"),
    [
        (e.Garbage(3, b"\0\1\2"), "3 bytes of garbage: 00 01 02"),
        (e.BadFrame("tail is 0A 0A, not 0D 0A", b"\x5a"), "bad frame, tail is 0A 0A, not 0D 0A: 5A"),
        (e.TimedOut(1, 0x11, 3, ""), "no answer to JOINT_STATE after 3"),
        (e.Reply(1, 0x15, 5, b"", None, 0.0, 1), "reply to STOP: stopped, 0 bytes"),
        (e.Request(FRAME), f"request {FRAME}"),
        (e.Report(FRAME), f"report {FRAME}"),
        (e.Stale(FRAME, "late"), f"stale frame, late: {FRAME}"),
    ],
)
def test_line(event: e.Event, line: str) -> None:
    assert str(event) == line


@given(st.integers(0, 2**40), st.binary(max_size=64), st.text(max_size=10))
def test_any_bytes_have_a_short_line(count: int, data: bytes, reason: str) -> None:
    assert len(str(e.Garbage(count, data))) < 120
    assert len(str(e.BadFrame(reason, data))) < 120


@pytest.mark.parametrize("event", [e.Garbage(1, b""), e.BadFrame("", b""), e.TimedOut(1, 2, 3, "")])
def test_frozen(event: Any) -> None:
    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(event, dataclasses.fields(event)[0].name, 5)


def test_counters_start_at_nothing() -> None:
    assert not any(dataclasses.astuple(e.ConnectionCounters()))


def test_a_line_shows_sixteen_bytes() -> None:
    shown = " ".join(["AB"] * 16)
    assert str(e.Garbage(20, b"\xab" * 20)) == f"20 bytes of garbage: {shown}"
    assert str(e.BadFrame("unfinished", b"\xab" * 20)) == f"bad frame, unfinished: {shown}"
