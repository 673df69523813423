from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.studio.test_columns import parsed

from hexwire.errors import UsageError
from hexwire.studio.shelf import Shelf
from hexwire.trace.recording import RecordingWriter, make_positions


def record(folder: Path, name: str, lag: float = 0.0, joints: tuple[str, ...] = ("J1", "J2")) -> str:
    folder.mkdir(parents=True, exist_ok=True)
    with RecordingWriter(folder / name) as out:
        for i in range(300):
            angle = 0.4 * math.sin(min(max(i / 50 - 1 - lag, 0.0), 4.0))
            out.joint_state(make_positions(joints, [angle] * len(joints)), 1e9 + i / 50)
    return name


@pytest.fixture
def shelf(tmp_path: Path) -> Iterator[Shelf]:
    made = Shelf(tmp_path)
    yield made
    made.close()


def test_a_recording_is_read_once(shelf: Shelf, tmp_path: Path) -> None:
    record(tmp_path, "a.mcap")
    first = shelf.series("a.mcap")
    assert shelf.series("a.mcap") is first
    for i in range(5):
        shelf.series(record(tmp_path, f"b{i}.mcap"))
    # Only a few stay in memory.
    assert shelf.series("a.mcap") is not first


def test_two_recordings_are_aligned_by_start_or_by_their_best_lag(shelf: Shelf, tmp_path: Path) -> None:
    a, b = (record(tmp_path, "a.mcap"), None), (record(tmp_path, "b.mcap", 0.5), None)
    head, times, columns = parsed(b"".join(shelf.compared(a, b, "start")))
    assert head["lag"] == 0
    worst = max(abs(joint["largest"]) for joint in head["joints"])
    assert worst > 0.1
    head, times, columns = parsed(b"".join(shelf.compared(a, b, "best")))
    assert head["lag"] == pytest.approx(0.5, abs=0.01)
    assert max(joint["rms"] for joint in head["joints"]) < 0.01
    assert set(columns) == {f"{j}.{c}" for j in ("J1", "J2") for c in ("first", "second", "difference")}
    assert len(columns["J1.first"]) == len(times) == head["count"]


def test_what_cannot_be_compared_says_why(shelf: Shelf, tmp_path: Path) -> None:
    a, b = record(tmp_path, "a.mcap"), record(tmp_path, "b.mcap", joints=("K1",))
    with pytest.raises(UsageError, match="no joint in common"):
        shelf.compared((a, None), (b, None), "start")
    with pytest.raises(UsageError, match="align by start, best"):
        shelf.compared((a, None), (a, None), "middle")


def test_a_motion_of_joints_that_the_arm_lacks_is_refused(shelf: Shelf, tmp_path: Path) -> None:
    record(tmp_path, "a.mcap")
    assert shelf.taught("a.mcap", None, ("J1", "J2", "J3")).names == ("J1", "J2")
    with pytest.raises(UsageError, match=r"a\.mcap moves J2; this arm has J1"):
        shelf.taught("a.mcap", None, ("J1",))
