from __future__ import annotations

import io
from typing import Any

import pytest
from tests.frames import frame_bytes

from hexwire.errors import UsageError
from hexwire.link.tap import Direction, Passed
from hexwire.trace.capture import FRAMES, CapturedMessage, read_messages
from hexwire.trace.sources import FORMATS, read_traffic, saved_traffic
from hexwire.wire.command_frame import Command

TRAFFIC = [
    Passed(Direction.SENT, frame_bytes(Command.STATS, b"", proto=2, seq=1, src=7, dst=8), 5.25, "serial:x"),
    Passed(Direction.RECEIVED, b"noise", 5.5, "serial:x"),
]


@pytest.mark.parametrize("form", FORMATS)
def test_what_is_saved_is_read_back_with_times_of_day(form: str) -> None:
    found: list[Any] = list(read_traffic(saved_traffic(TRAFFIC, form, offset=1000.0)))
    assert found == [each._replace(time=each.time + 1000.0, url="") for each in TRAFFIC]


def test_a_recording_has_the_frames_in_words_too() -> None:
    data = saved_traffic(TRAFFIC, "mcap", offset=1000.0)
    topics = [each.topic for each in read_messages(io.BytesIO(data), "x") if isinstance(each, CapturedMessage)]
    assert FRAMES in topics


def test_nothing_and_unknown_formats_are_refused() -> None:
    with pytest.raises(UsageError, match="no traffic to save yet"):
        saved_traffic([], "mcap")
    with pytest.raises(UsageError, match="mcap or pcapng"):
        saved_traffic(TRAFFIC, "exe")
