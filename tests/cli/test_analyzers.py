"""`hexwire analyzers`: what it prints, and that it refuses in one line."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from hexwire.cli import trace as command
from hexwire.cli.main import cli
from hexwire.trace.analyzers import PROGRAMS


def run(*words: str) -> Result:
    return CliRunner().invoke(cli, ["analyzers", *words])


@pytest.fixture(autouse=True)
def _home(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    monkeypatch.setenv("COLUMNS", "200")


def test_the_programs_are_those_of_the_layer_below() -> None:
    assert command._PROGRAMS == PROGRAMS
    assert set(command._NEXT) == set(PROGRAMS)


def test_install_list_remove(tmp_path: Path) -> None:
    done = run("install", "wireshark")
    assert done.exit_code == 0, done.output
    file = tmp_path / ".local/lib/wireshark/plugins/hexwire.lua"
    assert file.read_text().startswith("-- SPDX")
    assert str(file) in done.stdout
    assert "start Wireshark again" in done.stdout
    rows = {row["program"]: row["state"] for row in json.loads(run("list", "--json").stdout)}
    assert rows == {"wireshark": "current", "sigrok": "none", "saleae": "none"}
    assert "not installed" in run("list").stdout
    removed = run("remove", "wireshark")
    assert f"removed {file}" in removed.stdout
    assert json.loads(run("remove", "wireshark", "--json").stdout) == {"removed": [], "kept": []}
    assert "there is nothing to remove" in run("remove", "wireshark").stdout


def test_a_foreign_file_is_a_usage_error(tmp_path: Path) -> None:
    folder = tmp_path / "plugins"
    folder.mkdir()
    (folder / "extension.json").write_text("theirs")
    done = run("install", "saleae", "--folder", str(folder))
    assert done.exit_code == 2
    assert "is not from hexwire" in done.stderr
    assert done.stderr.count("\n") == 1
    done = run("install", "saleae", "--folder", str(folder), "--force", "--json")
    assert json.loads(done.stdout)["folder"] == str(folder)
    assert f"{folder}/extension.json" in run("install", "saleae", "--folder", str(folder)).stdout


def test_another_program_is_a_usage_error() -> None:
    assert run("install", "ghidra").exit_code == 2
