from __future__ import annotations

import csv
import io
import math
from pathlib import Path

import pytest
from tests.recorded import make_positions

from hexwire.errors import ConfigError, UsageError
from hexwire.trace.recording import RecordingWriter, read_joint_states
from hexwire.trace.series import PlotSeries, TimedFile, read_series, write_csv, write_mcap

COLUMNS = [("J1", "position"), ("J1", "goal"), ("J2", "position"), ("J2", "goal"), ("", "rate")]
NAN = math.nan


def _written(path: Path, rows: int = 5) -> Path:
    values = [(10.0 + 0.1 * i, (0.25 * i, 0.5, -0.25 * i, NAN, 50.0)) for i in range(rows)]
    write_mcap(path, COLUMNS, values, 1000.0, robot="hex7bot")
    return path


def _series(path: Path) -> PlotSeries:
    with path.open("rb") as file:
        return read_series(file, path.name)


def test_rows_become_a_recording_and_columns_again(tmp_path: Path) -> None:
    series = _series(_written(tmp_path / "a.mcap"))
    assert series.names == ("J1", "J2")
    assert series.begin == 1010.0
    assert list(series.times) == pytest.approx([0.0, 0.1, 0.2, 0.3, 0.4])
    assert list(series.columns["J1", "position"]) == [0.0, 0.25, 0.5, 0.75, 1.0]
    assert list(series.columns["J1", "goal"]) == [0.5] * 5
    # A quantity that nobody measured has no column.
    assert set(series.columns) == {("J1", "position"), ("J1", "goal"), ("J2", "position")}
    assert series.duration == pytest.approx(0.4)
    assert series.problem == ""
    assert series.positions()[4] == (pytest.approx(0.4), (1.0, -1.0))
    # What it writes, `hexwire play` reads.
    assert [state.position[0] for state in read_joint_states(tmp_path / "a.mcap")] == [0.0, 0.25, 0.5, 0.75, 1.0]


def test_a_joint_may_be_missing_and_a_quantity_may_come_late(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "a.mcap") as out:
        out.joint_state(make_positions(("J1", "J2"), (0.0, 1.0)), 100.0)
        out.joint_state(make_positions(("J2",), (2.0,)), 100.5, goals={"J2": 3.0})
        # The clock was set back.
        out.joint_state(make_positions(("J1", "J2"), (9.0, 9.0)), 99.0)
    series = _series(tmp_path / "a.mcap")
    assert list(series.times) == [0.0, 0.5]
    assert list(series.columns["J2", "position"]) == [1.0, 2.0]
    assert math.isnan(series.columns["J1", "position"][1])
    assert math.isnan(series.columns["J2", "goal"][0])
    assert series.columns["J2", "goal"][1] == 3.0


def test_of_a_truncated_recording_the_intact_part_is_read(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with RecordingWriter(path) as out:
        for i in range(5000):
            out.joint_state(make_positions(("J1",), (math.sin(i),)), 100.0 + i / 100)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    series = _series(path)
    assert 100 < len(series.times) < 4900
    assert "truncated" in series.problem


def test_too_much_is_refused(tmp_path: Path) -> None:
    path = _written(tmp_path / "a.mcap", 50)
    with path.open("rb") as file, pytest.raises(UsageError, match=r"more than 20 numbers: too many for a plot"):
        read_series(file, "a.mcap", most=20)
    with RecordingWriter(tmp_path / "wide.mcap") as out:
        out.joint_state(make_positions([f"J{i}" for i in range(65)], [0.0] * 65), 1.0)
    with pytest.raises(UsageError, match="65 joints: too many"):
        _series(tmp_path / "wide.mcap")


def test_a_recording_without_states_and_a_file_that_is_none(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "a.mcap") as out:
        out.raw("/bytes/sent", 1.0, b"x")
    with pytest.raises(UsageError, match="no joint states"):
        _series(tmp_path / "a.mcap")
    with pytest.raises(UsageError, match="is not a recording"):
        read_series(io.BytesIO(b"<html>"), "b.mcap")


def test_numbers_that_32_bits_cannot_hold_are_unknown(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "a.mcap") as out:
        out.message(
            "/joint_states",
            "foxglove.JointStates",
            1.0,
            {"joints": [{"name": "J1", "position": 0.5, "load": 1e300}]},
        )
    assert math.isnan(_series(tmp_path / "a.mcap").columns["J1", "load"][0])


def test_reading_ends_when_its_time_is_over() -> None:
    now = [0.0]
    file = TimedFile(io.BytesIO(bytes(100)), "a.mcap", 5.0, clock=lambda: now[0])
    assert len(file.read(10)) == 10
    now[0] = 5.1
    with pytest.raises(ConfigError, match=r"a\.mcap: takes more than 5 s"):
        file.read(10)


def test_csv_has_a_column_for_each_quantity_and_nothing_for_unknown_values() -> None:
    out = io.BytesIO()
    assert write_csv(out, COLUMNS, [(1.0, (0.1, NAN, 2.0, 3.0, 50.0))], 1000.0) == 1
    assert not out.closed
    head, row = csv.reader(io.StringIO(out.getvalue().decode()))
    assert head == ["time", "J1.position", "J1.goal", "J2.position", "J2.goal", "rate"]
    assert row == ["1001.000000", "0.1", "", "2", "3", "50"]
