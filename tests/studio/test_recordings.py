"""Recordings as motions."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.recorded import make_positions

from hexwire.errors import HexwireError, UsageError
from hexwire.studio.recordings import Recordings
from hexwire.trace.recording import RecordingWriter


def record(folder: Path, name: str, lag: float = 0.0, joints: tuple[str, ...] = ("J1", "J2")) -> str:
    folder.mkdir(parents=True, exist_ok=True)
    with RecordingWriter(folder / name) as out:
        for i in range(300):
            angle = 0.4 * math.sin(min(max(i / 50 - 1 - lag, 0.0), 4.0))
            out.joint_state(make_positions(joints, [angle] * len(joints)), 1e9 + i / 50)
    return name


@pytest.fixture
def recordings(tmp_path: Path) -> Iterator[Recordings]:
    made = Recordings(tmp_path)
    yield made
    made.close()


def test_a_motion_of_joints_that_the_arm_lacks_is_refused(recordings: Recordings, tmp_path: Path) -> None:
    record(tmp_path, "a.mcap")
    assert recordings.taught("a.mcap", None, ("J1", "J2", "J3")).names == ("J1", "J2")
    with pytest.raises(UsageError, match=r"a\.mcap moves J2; this arm has J1"):
        recordings.taught("a.mcap", None, ("J1",))
    with pytest.raises(HexwireError, match="there is no recording"):
        recordings.taught("b.mcap", None, ("J1",))
    assert recordings.twin_of("a.mcap") == "hex7bot"


def test_what_is_no_name_of_a_recording_plays_nothing_else(recordings: Recordings) -> None:
    assert recordings.asked({"what": "play", "recording": None}, ("J1",)) == ({"what": "play"}, None)
    for key in ("recording", "topic"):
        for value in (5, ["a.mcap"], True, {"a": 1}):
            with pytest.raises(UsageError, match=f"^{key} must be text, not "):
                recordings.asked({"what": "play", key: value}, ("J1",))
