"""The safety case names tests; each of them must be there."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
TEXT = (ROOT / "docs" / "safety.md").read_text(encoding="utf-8")
NAMED = sorted(set(re.findall(r"`(tests/[\w/]+\.py)::(\w+)`", TEXT)))
ROWS = [line for line in TEXT.splitlines() if line.startswith("| ") and not line.startswith(("| hazard", "|---"))]


def test_there_is_a_case() -> None:
    assert len(NAMED) > 30
    assert len(ROWS) > 25


@pytest.mark.parametrize(("file", "name"), NAMED, ids=lambda part: part.removeprefix("tests/"))
def test_named_test_exists(file: str, name: str) -> None:
    path = ROOT / file
    assert path.is_file(), f"{file} is gone; the safety case needs another proof"
    assert re.search(rf"^\s*def {name}\(", path.read_text(encoding="utf-8"), re.MULTILINE), f"no {name} in {file}"


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.split("|")[1].strip())
def test_every_hazard_has_a_proof(row: str) -> None:
    cells = [cell.strip() for cell in row.strip("|").split("|")]
    assert len(cells) == 4
    assert "::" in cells[3]
    assert cells[1] != "–" or cells[2] != "–", "somebody must stop it"
