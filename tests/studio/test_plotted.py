"""Columns of recordings, and two of them on one time axis."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.studio.test_columns import parsed
from tests.studio.test_recordings import record

from hexwire.errors import UsageError
from hexwire.studio.plotted import Plotted
from hexwire.trace.library import Library


@pytest.fixture
def plotted(tmp_path: Path) -> Plotted:
    return Plotted(Library(tmp_path))


def test_a_recording_is_read_once(plotted: Plotted, tmp_path: Path) -> None:
    record(tmp_path, "a.mcap")
    first = plotted.series("a.mcap")
    assert plotted.series("a.mcap") is first
    for i in range(5):
        plotted.series(record(tmp_path, f"b{i}.mcap"))
    # Only a few stay in memory.
    assert plotted.series("a.mcap") is not first


def test_two_recordings_are_aligned_by_start_or_by_their_best_lag(plotted: Plotted, tmp_path: Path) -> None:
    a, b = (record(tmp_path, "a.mcap"), None), (record(tmp_path, "b.mcap", 0.5), None)
    head, times, columns = parsed(plotted.compared(a, b, "start"))
    assert head["lag"] == 0
    worst = max(abs(joint["largest"]) for joint in head["joints"])
    assert worst > 0.1
    head, times, columns = parsed(plotted.compared(a, b, "best"))
    assert head["lag"] == pytest.approx(0.5, abs=0.01)
    assert max(joint["rms"] for joint in head["joints"]) < 0.01
    assert set(columns) == {f"{j}.{c}" for j in ("J1", "J2") for c in ("first", "second", "difference")}
    assert len(columns["J1.first"]) == len(times) == head["count"]


def test_what_cannot_be_compared_says_why(plotted: Plotted, tmp_path: Path) -> None:
    a, b = record(tmp_path, "a.mcap"), record(tmp_path, "b.mcap", joints=("K1",))
    with pytest.raises(UsageError, match="no joint in common"):
        plotted.compared((a, None), (b, None), "start")
    with pytest.raises(UsageError, match="align by start, best"):
        plotted.compared((a, None), (a, None), "middle")
