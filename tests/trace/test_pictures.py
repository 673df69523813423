"""Pictures of a recording: found by time, and each fault of a file has its words."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from tests.recorded import make_positions

from hexwire.errors import ConfigError, UsageError
from hexwire.trace.foxglove import compressed_image
from hexwire.trace.pictures import RecordedPictures
from hexwire.trace.recording import RecordingWriter

SECOND = 1_000_000_000


def jpeg(number: int) -> bytes:
    """Not one that can be seen, but of a length that makes parts of a file."""
    return bytes([number]) * 40_000


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "a.mcap"
    with RecordingWriter(path) as writer:
        for at in range(10):
            writer.joint_state(make_positions(["J1"], [0.0]), 100.0 + at)
            writer.picture(jpeg(at), "front", 100.5 + at)
            writer.picture(jpeg(50 + at), "side", 100.25 + at)
    return path


def test_the_picture_that_was_newest_at_a_time(path: Path) -> None:
    with path.open("rb") as file:
        pictures = RecordedPictures(file, "a")
        for at, front, side in (
            (0.0, 0, 50),
            (100.3, 0, 50),
            (100.5, 0, 50),
            (103.24, 2, 52),
            (103.5, 3, 53),
            (107.49, 6, 57),
            (4e9, 9, 59),
        ):
            ns = round(at * SECOND)
            assert pictures.at(file, "/camera/front", ns) == jpeg(front), at
            assert pictures.at(file, "/camera/side", ns) == jpeg(side), at
        for topic in ("/joint_states", "/camera/none", ""):
            with pytest.raises(UsageError, match="has no picture on"):
                pictures.at(file, topic, 0)


def test_a_damaged_file_says_so(path: Path) -> None:
    whole = path.read_bytes()
    for damaged, words in (
        (whole[: len(whole) // 2], "index of a is damaged"),
        (whole[:100], "index of a is damaged"),
        (whole[:-200] + bytes(192) + whole[-8:], "index of a is damaged"),
    ):
        path.write_bytes(damaged)
        with path.open("rb") as file, pytest.raises(UsageError, match=words):
            RecordedPictures(file, "a")
    # Where the pictures are, its index is right.
    path.write_bytes(whole[:60] + bytes(60) + whole[120:])
    with path.open("rb") as file:
        pictures = RecordedPictures(file, "a")
        with pytest.raises(UsageError, match="a is damaged at byte"):
            pictures.at(file, "/camera/front", 0)


def test_what_is_no_picture_is_a_fault_with_its_place(tmp_path: Path) -> None:
    body: dict[str, Any]
    for number, (body, words) in enumerate(
        (
            (compressed_image(b"x", "a", 1.0) | {"data": "?" * 8}, "must be base64"),
            (compressed_image(b"x", "a", 1.0) | {"data": 7}, "text"),
            ({}, "data"),
        )
    ):
        path = tmp_path / f"{number}.mcap"
        with RecordingWriter(path) as writer:
            writer.message("/camera/a", "foxglove.CompressedImage", 1.0, body)
        with path.open("rb") as file, pytest.raises(ConfigError, match=words):
            RecordedPictures(file, "a").at(file, "/camera/a", 0)
