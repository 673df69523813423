"""Every option that writes a file: nothing is overwritten and no link followed, told before anything moves."""

from __future__ import annotations

import stat
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result
from tests.cli.bus_cli import BusCli
from tests.recorded import make_positions

from hexwire.cli.main import cli
from hexwire.trace.recording import RecordingWriter

CONF = "JOY_STICK CLIENT_TX ROS1_HOST UDP 127.0.0.1 15040\n"


def run(*words: str) -> Result:
    return CliRunner().invoke(cli, list(words))


@pytest.fixture
def sources(tmp_path: Path) -> Path:
    folder = tmp_path / "sources"
    folder.mkdir()
    (folder / "a.conf").write_text(CONF)
    with RecordingWriter(folder / "a.mcap") as writer:
        for i in range(20):
            writer.joint_state(make_positions(("J1", "J2"), (0.01 * i, -0.01 * i)), 1.7e9 + i / 20)
    return folder


OFFLINE = {
    "x.csv": ("record", "export", "{}/a.mcap", "{target}"),
    "x.jsonl": ("record", "export", "{}/a.mcap", "{target}"),
    "x.pcapng": ("record", "export", "{}/a.mcap", "{target}"),
    "x.mcap": ("record", "recover", "{}/a.mcap", "{target}"),
    "x.svg": ("record", "plot", "{}/a.mcap", "{target}"),
    "y.mcap": ("play", "{}/a.mcap", "--save", "{target}"),
    "x.toml": ("conf", "convert", "{}/a.conf", "{target}"),
    "x.urdf": ("model", "urdf", "-o", "{target}"),
    "z.mcap": ("ports", "--record", "{target}"),
}
ON_AN_ARM = {
    "a.svg": ("goto", "0", "220", "200", "--plot", "{target}"),
    "b.png": ("line", "0", "0", "10", "--relative", "--speed", "10", "--plot", "{target}", "--dry-run"),
    "c.mcap": ("teach", "{target}", "--yes", "--duration", "0.2"),
    "d.mcap": ("move", "J1=5", "--record", "{target}"),
}
ON_A_BUS = {
    "a.csv": ("monitor", "1", "--seconds", "0.5", "--csv", "{target}"),
    "a.pdf": ("monitor", "1", "--seconds", "0.5", "--plot", "{target}"),
    "b.csv": ("wave", "1", "--yes", "--seconds", "0.5", "--csv", "{target}"),
    "b.json": ("backup", "1", "{target}"),
}


def check(run: Any, words: tuple[str, ...], target: Path, sources: Path, urls: list[str]) -> None:
    args = [word.replace("{target}", str(target)).replace("{}", str(sources)) for word in words]
    victim = target.parent / "victim"
    victim.write_text("precious")
    for make in (
        lambda: target.symlink_to(victim),
        lambda: target.symlink_to(target.parent / "made"),
        target.mkdir,
        lambda: target.write_text("old"),
    ):
        make()
        forced = [[], ["--force"]] if target.is_symlink() or target.is_dir() else [[]]
        for force in forced:
            result = run(*args, *force)
            assert (result.exit_code, result.stdout) == (2, ""), result.output
            assert result.stderr.startswith("error: ")
            assert result.stderr.count("\n") == 1
            assert str(target) in result.stderr
        assert not (target.parent / "made").exists()
        assert victim.read_text() == "precious"
        if target.is_symlink():
            target.unlink()
        elif target.is_dir():
            target.rmdir()
    assert urls == []
    assert target.read_text() == "old"
    result = run(*args, "--force")
    assert result.exit_code == 0, result.output
    assert target.read_bytes() != b"old"
    assert stat.S_IMODE(target.stat().st_mode) == 0o600
    target.unlink()
    result = run(*args)
    assert result.exit_code == 0, result.output
    assert stat.S_IMODE(target.stat().st_mode) == 0o600
    target.unlink()
    victim.unlink()
    assert list(target.parent.iterdir()) == []


def drawn_slow(names: Iterable[str]) -> list[Any]:
    """What is drawn takes seconds: one picture of an arm's is enough for `make test`."""
    slow = (".png", ".pdf")
    return [pytest.param(name, marks=[pytest.mark.slow] if name.endswith(slow) else []) for name in names]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    path = tmp_path / "out"
    path.mkdir()
    return path


@pytest.mark.parametrize("name", OFFLINE)
def test_files_of_commands_without_a_robot(sources: Path, folder: Path, name: str) -> None:
    check(run, OFFLINE[name], folder / name, sources, [])


@pytest.mark.parametrize("name", drawn_slow(ON_AN_ARM))
def test_files_of_commands_that_move(bench: Any, sources: Path, folder: Path, name: str) -> None:
    check(bench.run, ON_AN_ARM[name], folder / name, sources, bench.urls)


@pytest.mark.parametrize("name", drawn_slow(ON_A_BUS))
def test_files_of_commands_on_a_bus(
    monkeypatch: pytest.MonkeyPatch, sources: Path, folder: Path, name: str
) -> None:
    bus = BusCli(monkeypatch)
    check(bus.run, ON_A_BUS[name], folder / name, sources, bus.urls)


def test_force_is_for_files_only(bench: Any) -> None:
    for words in (("goto", "0", "220", "200", "--force"), ("--force", "state"), ("model", "urdf", "--force")):
        result = bench.run(*words, port=None)
        assert result.exit_code == 2
        assert "--force" in result.stderr
        assert result.stderr.count("\n") == 1
    assert bench.run("move", "J1=5", "--force").exit_code == 2
    assert bench.urls == []


def test_force_beside_record_counts_for_both_files(sources: Path, folder: Path) -> None:
    recording, table = folder / "r.mcap", folder / "t.csv"
    for path in (recording, table):
        path.write_text("old")
    words = ("record", "export", f"{sources}/a.mcap", str(table), "--record", str(recording), "--force")
    assert run(*words).exit_code == 0
    assert recording.read_bytes().startswith(b"\x89MCAP0")
    assert table.read_text().startswith("time,")


def test_a_recording_of_nothing_is_not_in_the_way_of_the_next_attempt(bench: Any, folder: Path) -> None:
    target = folder / "a.mcap"
    for words in (("move", "J9=5"), ("state", "--nonsense"), ("goto", "0", "9999", "0")):
        assert bench.run(*words, "--record", str(target)).exit_code == 2
        assert target.exists() == (words[0] == "goto")
    # The arm was asked where it is before its goal was refused.
    assert target.stat().st_size > 100


def test_without_mcap_nothing_is_asked_and_nothing_moves(
    bench: Any, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(__import__("sys").modules, "mcap.writer", None)
    for words in (("teach", f"{folder}/a.mcap", "--yes"), ("move", "J1=5", "--record", f"{folder}/a.mcap")):
        result = bench.run(*words)
        assert result.exit_code == 2
        assert "pip install 'hexwire[record]'" in result.stderr
    assert bench.urls == []
    assert list(folder.iterdir()) == []
