"""The console blocks of docs/debugging.md: each command is run, and its output is what the page shows."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from tests.analyzers.lines import assembled

ROOT = Path(__file__).resolve().parent.parent
TEXT = (ROOT / "docs" / "debugging.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```console\n(.*?)^```", TEXT, re.MULTILINE | re.DOTALL)
RUNS = [run for block in BLOCKS for run in re.findall(r"^\$ (.*)\n((?:(?!\$ ).*\n)*)", block, re.MULTILINE)]


def test_there_are_three_faults() -> None:
    assert len(BLOCKS) == 3
    assert len(RUNS) == 4


@pytest.mark.parametrize(("command", "shown"), RUNS, ids=[run[0][:40] for run in RUNS])
def test_the_output_is_what_the_page_shows(command: str, shown: str, tmp_path: Path) -> None:
    (tmp_path / "build").mkdir()
    (tmp_path / "build/analyzers").symlink_to(assembled())
    (tmp_path / "vectors").symlink_to(ROOT / "vectors")
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    environment = os.environ | {"PATH": path, "XDG_CONFIG_HOME": str(tmp_path), "COLUMNS": "200"}
    done = subprocess.run(
        ["bash", "-c", command],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    assert [line.rstrip() for line in done.stdout.splitlines()] == shown.splitlines()


def test_the_captures_are_all_used() -> None:
    for capture in (ROOT / "vectors" / "captures").iterdir():
        assert f"vectors/captures/{capture.name}" in TEXT


def test_the_pictures_show_what_the_page_says() -> None:
    done = subprocess.run(
        [sys.executable, ROOT / "docs" / "make_pictures.py", "--check"], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")
    for name in re.findall(r"\(pictures/([\w-]+\.svg)\)", TEXT):
        svg = (ROOT / "docs" / "pictures" / name).read_text(encoding="utf-8")
        assert svg.startswith("<svg")
        assert "@font-face" not in svg
