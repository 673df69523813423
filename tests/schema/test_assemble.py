"""`make analyzers`: folders that can be copied as they are, from one decoder and one set of tables."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
WANTED = {
    "wireshark": {"hexwire.lua", "hexwire_tables.lua"},
    "sigrok/hexwire_host": {"__init__.py", "line.py", "pd.py", "reading.py", "tables.py"},
    "sigrok/hexwire_servo": {"__init__.py", "line.py", "pd.py", "reading.py", "tables.py"},
    "saleae": {"HighLevelAnalyzer.py", "extension.json", "reading.py", "tables.py"},
}


def assemble(into: Path, script: Path = ROOT / "schema/assemble.py") -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-E", "-S", str(script), str(into)]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)


def test_each_folder_holds_all_that_its_program_wants(tmp_path: Path) -> None:
    done = assemble(tmp_path / "out")
    assert (done.returncode, done.stdout, done.stderr) == (0, f"{tmp_path}/out\n", "")
    for folder, names in WANTED.items():
        present = {path.name for path in (tmp_path / "out" / folder).iterdir() if path.is_file()}
        assert present - {"README.md"} == names
    assert (tmp_path / "out/LICENSE").read_text() == (ROOT / "analyzers/LICENSE").read_text()


def test_every_program_in_them_says_its_licence(tmp_path: Path) -> None:
    assemble(tmp_path)
    for path in [*tmp_path.rglob("*.py"), *tmp_path.rglob("*.lua")]:
        first, text = path.read_text().partition("\n")[0], path.read_text()
        assert "SPDX-License-Identifier: " in first, path
        assert "GPL-2.0-or-later" in first, path
        if path.suffix == ".py":
            ast.parse(text, feature_version=(3, 8))  # the Python inside Logic 2


def test_nothing_that_is_assembled_is_among_the_sources() -> None:
    names = {path.name for path in (ROOT / "analyzers").rglob("*")}
    assert "hexwire.lua" in names
    assert not {"reading.py", "tables.py", "hexwire_tables.lua"} & names


@pytest.mark.slow
def test_make_writes_the_same_folders(tmp_path: Path) -> None:
    subprocess.run(["make", "--silent", "analyzers"], cwd=ROOT, check=True, capture_output=True, timeout=60)
    assemble(tmp_path)
    made = ROOT / "build/analyzers"
    for path in tmp_path.rglob("*"):
        if path.is_file():
            assert (made / path.relative_to(tmp_path)).read_bytes() == path.read_bytes()


def test_a_folder_that_cannot_be_made_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    done = assemble(tmp_path / "file/out")
    assert done.returncode == 1
    assert str(tmp_path / "file/out") in done.stderr
    assert done.stderr.count("\n") == 1
