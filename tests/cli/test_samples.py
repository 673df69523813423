from __future__ import annotations

import csv
import dataclasses
import stat
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from tests.cli.bus_cli import BusCli

from hexwire.bus.servo_bus import ServoBus
from hexwire.cli.bus_live import SampleFiles, saving
from hexwire.drivers.bus_arm import BusArm
from hexwire.errors import LinkLostError, UsageError
from hexwire.model.state import JointFlag, JointState


def rows_of(path: Path) -> list[dict[str, str]]:
    return list(csv.DictReader(path.read_text().splitlines()))


def fails_at(count: int, error: BaseException, real: Callable[..., object]) -> Callable[..., object]:
    calls = iter(range(1_000_000))

    def call(*args: object, **options: object) -> object:
        if next(calls) >= count:
            raise error
        return real(*args, **options)

    return call


@pytest.mark.parametrize(
    ("error", "status"), [(KeyboardInterrupt(), 0), (LinkLostError("/dev/ttyTEST went away"), 1)]
)
def test_a_wave_that_ends_early_keeps_its_samples(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, error: BaseException, status: int
) -> None:
    bus = BusCli(monkeypatch)
    table, plot = tmp_path / "w.csv", tmp_path / "w.svg"
    monkeypatch.setattr(BusArm, "read", fails_at(32, error, BusArm.read))
    result = bus.run("wave", "1", "--yes", "--csv", str(table), "--plot", str(plot))
    assert result.exit_code == status
    assert "30 samples saved" in result.stderr
    assert "Traceback" not in result.output
    assert len(rows_of(table)) == 30
    assert plot.read_text().startswith("<?xml")
    assert [stat.S_IMODE(path.stat().st_mode) for path in (table, plot)] == [0o600, 0o600]
    assert bus.device.wire[1].registers.get("torque_enable") == 0


@pytest.mark.parametrize(
    ("error", "status"), [(KeyboardInterrupt(), 0), (LinkLostError("/dev/ttyTEST went away"), 1)]
)
def test_a_monitor_that_ends_early_keeps_its_samples(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, error: BaseException, status: int
) -> None:
    bus = BusCli(monkeypatch)
    table = tmp_path / "m.csv"
    monkeypatch.setattr(ServoBus, "sync_read_blocks", fails_at(7, error, ServoBus.sync_read_blocks))
    result = bus.run("monitor", "1,2", "--csv", str(table))
    assert result.exit_code == status
    assert len(rows_of(table)) == 14


def deaf(monkeypatch: pytest.MonkeyPatch, silent: Callable[[int], bool]) -> None:
    """From the third on, reads of which `silent` says so bring no answer."""
    real, calls = BusArm.read, iter(range(1_000_000))

    def read(arm: BusArm) -> JointState:
        state = real(arm)
        if not silent(next(calls)):
            return state
        return dataclasses.replace(state, flags=tuple(flags | JointFlag.SILENT for flags in state.flags))

    monkeypatch.setattr(BusArm, "read", read)


def test_silent_samples_now_and_then_do_not_end_a_wave(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    bus = BusCli(monkeypatch)
    deaf(monkeypatch, lambda call: call == 0 or call % 50 in (10, 11, 12))
    table = tmp_path / "w.csv"
    result = bus.run("wave", "1", "--yes", "--seconds", "4", "--csv", str(table))
    assert result.exit_code == 0, result.stderr
    assert "warning: 12 samples missing: the servo did not answer" in result.stderr
    rows = rows_of(table)
    assert len(rows) > 150
    positions = [float(row["position"]) for row in rows]
    assert 0.28 < max(positions) - min(positions) < 0.40


def test_a_servo_that_stays_silent_ends_a_wave(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    bus = BusCli(monkeypatch)
    deaf(monkeypatch, lambda call: call >= 52)
    result = bus.run("wave", "1", "--yes", "--csv", str(tmp_path / "w.csv"))
    assert result.exit_code == 1
    assert "servo 1 fell silent: 25 samples in a row are missing" in result.stderr
    assert len(rows_of(tmp_path / "w.csv")) == 50


def test_a_servo_that_never_answers_is_not_waved(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    bus = BusCli(monkeypatch)
    deaf(monkeypatch, lambda _: True)
    result = bus.run("wave", "1", "--yes", "--csv", str(tmp_path / "w.csv"))
    assert result.exit_code == 1
    assert bus.device.wire[1].registers.get("torque_enable") == 0
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("words", [("wave", "1", "--yes"), ("monitor", "1", "--seconds", "1")])
def test_nothing_is_sampled_if_it_cannot_be_saved(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, words: tuple[str, ...]
) -> None:
    bus = BusCli(monkeypatch)
    (tmp_path / "there.csv").write_text("old")
    (tmp_path / "there.svg").write_text("old")
    for option, name, says in (
        ("--csv", "there.csv", "already exists; --force overwrites it"),
        ("--plot", "there.svg", "already exists; --force overwrites it"),
        ("--csv", "no/a.csv", "there is no such folder"),
        ("--plot", "a.txt", "must end in .png, .svg, .pdf"),
    ):
        result = bus.run(*words, option, str(tmp_path / name))
        assert (result.exit_code, result.stdout) == (2, "")
        assert says in result.stderr
        assert result.stderr.count("\n") == 1
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    result = bus.run(*words, "--plot", str(tmp_path / "a.svg"), "--csv", str(tmp_path / "a.csv"))
    assert result.exit_code == 2
    assert "pip install 'hexwire[plots]'" in result.stderr
    assert bus.urls == []
    assert bus.run(*words, "--force").exit_code == 2
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {"there.csv": "old", "there.svg": "old"}


def test_with_force_the_old_samples_stay_until_there_are_new_ones(tmp_path: Path) -> None:
    table = tmp_path / "a.csv"
    table.write_text("old")
    files = SampleFiles(str(table), None, True)
    with pytest.raises(UsageError), saving(files, ("time_s", "id", "position"), "position"):
        raise UsageError("before the first")
    assert table.read_text() == "old"
    with saving(files, ("time_s", "id", "position"), "position") as samples:
        samples.append((0.0, 1.0, 0.5))
        assert table.read_text() == "old"
    assert rows_of(table) == [{"time_s": "0.0", "id": "1.0", "position": "0.5"}]
