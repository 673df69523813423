"""The safety case names tests; each of them must be there. Its pages are safety, the hazards, and stopping."""

from __future__ import annotations

import re
from pathlib import Path

from tests.few import all_tests, slow_tests

ROOT = Path(__file__).resolve().parent.parent
PAGES = ("safety.md", "hazards.md", "hazards-sharing.md", "stopping.md")
TEXT = "\n".join((ROOT / "docs" / page).read_text(encoding="utf-8") for page in PAGES)
PROOF = r"`((?:packages/[\w-]+/)?tests/[\w/]+\.py)::(\w+)`"
NAMED = sorted(set(re.findall(PROOF, TEXT)))
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


def test_every_hazard_has_a_proof_in_make_test() -> None:
    for row in ROWS:
        proofs = re.findall(PROOF, row)
        assert any(name not in slow_tests(ROOT / file) for file, name in proofs), (
            f"only `make test-all` proves: {row}"
        )


def test_make_test_passes_through_everything() -> None:
    """Every room, the chip, a browser, clients of ROS 1 and 2, documentation: `make test` leaves none out."""
    rooms = sorted(path.parent.name for path in (ROOT / "src" / "hexwire").glob("*/__init__.py"))
    means = ["avr", "conformance_board", "property", "ros2/strict_client", "site", "studio/pages", "system"]
    for folder in [*rooms, *means]:
        files = sorted((ROOT / "tests" / folder).glob("test_*.py"))
        assert any(all_tests(file) - slow_tests(file) for file in files), f"only `make test-all` tests {folder}"
