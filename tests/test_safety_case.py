"""The safety case names tests; each of them must be there."""

from __future__ import annotations

import ast
import functools
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
TEXT = (ROOT / "docs" / "safety.md").read_text(encoding="utf-8")
NAMED = sorted(set(re.findall(r"`(tests/[\w/]+\.py)::(\w+)`", TEXT)))
TABLES = re.findall(r"^\| hazard.*\n\|---.*\n((?:\|.*\n)+)", TEXT, re.MULTILINE)
ROWS = [row for table in TABLES for row in table.splitlines()]


def test_there_is_a_case() -> None:
    assert len(NAMED) > 30
    assert len(ROWS) > 25


def test_named_tests_exist() -> None:
    gone = []
    for file, name in NAMED:
        path = ROOT / file
        text = path.read_text(encoding="utf-8") if path.is_file() else ""
        if not re.search(rf"^\s*def {name}\(", text, re.MULTILINE):
            gone.append(f"{file}::{name}")
    assert not gone, f"the safety case needs another proof for: {', '.join(gone)}"


def test_every_hazard_has_a_proof() -> None:
    for row in ROWS:
        cells = [cell.strip() for cell in row.strip("|").split("|")]
        assert len(cells) == 4, row
        assert "::" in cells[3], f"no test named: {row}"
        assert cells[1] != "–" or cells[2] != "–", f"somebody must stop it: {row}"


@functools.cache
def _slow(file: str) -> frozenset[str]:
    """The tests of a file that only `make test-all` runs."""
    module = ast.parse((ROOT / file).read_text(encoding="utf-8"))
    marks = [
        node.value for node in module.body if isinstance(node, ast.Assign) and "pytestmark" in ast.unparse(node)
    ]
    tests = [node for node in module.body if isinstance(node, ast.FunctionDef) and node.name.startswith("test_")]
    everything = any("mark.slow" in ast.unparse(mark) for mark in marks)
    return frozenset(
        test.name
        for test in tests
        if everything or any("mark.slow" in ast.unparse(mark) for mark in test.decorator_list)
    )


def test_every_hazard_has_a_proof_in_make_test() -> None:
    for row in ROWS:
        proofs = re.findall(r"`(tests/[\w/]+\.py)::(\w+)`", row)
        assert any(name not in _slow(file) for file, name in proofs), f"only `make test-all` proves: {row}"
