"""A stranger's package, with the robots and the link of the pages on them, is checked by `hexwire.testing`."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[2] / "docs"
PAGES = "\n".join((DOCS / page).read_text(encoding="utf-8") for page in ("adding-a-robot.md", "robot-on-a-line.md"))
BLOCKS = [
    block for block in re.findall(r"```python[^\n]*\n(.*?)```", PAGES, re.DOTALL) if not block.startswith("with ")
]
CHECKS = [block for block in BLOCKS if "Conformance" in block]
# Without what the page tries in between.
CODE = [block.partition("\nlink = ")[0] for block in BLOCKS if block not in CHECKS and "as refused" not in block]


@pytest.fixture
def package(tmp_path: Path) -> Path:
    (tmp_path / "src/swing").mkdir(parents=True)
    (tmp_path / "tests").mkdir()
    (tmp_path / "src/swing/__init__.py").write_text("")
    (tmp_path / "src/swing/driver.py").write_text("\n".join(CODE))
    (tmp_path / "tests/test_swing.py").write_text("from swing.driver import *\n" + "\n".join(CHECKS))
    (tmp_path / "pyproject.toml").write_text(
        '[project]\nname = "swing"\nversion = "1.0"\n\n[tool.pytest.ini_options]\npythonpath = ["src"]\n'
    )
    return tmp_path


def run_tests(package: Path, *which: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *which]
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST")}
    environment["XDG_RUNTIME_DIR"] = str(package)
    return subprocess.run(
        command, cwd=package, env=environment, capture_output=True, text=True, timeout=100, check=False
    )


@pytest.mark.slow
def test_a_strangers_robots_and_link_pass(package: Path) -> None:
    assert len(CHECKS) == 3
    ended = run_tests(package)
    assert ended.returncode == 0, ended.stdout
    passed = re.search(r"(\d+) passed", ended.stdout)
    assert passed is not None
    # Both robots and the link.
    assert int(passed[1]) > 60
    assert "skipped" not in ended.stdout


@pytest.mark.slow
def test_a_stop_that_the_robot_forgets_fails_with_the_reason(package: Path) -> None:
    driver = package / "src/swing/driver.py"
    text = driver.read_text()
    broken = text.replace(
        "    def on_hold(self)", "    def _refuse_if_stopped(self, what: str) -> None: ...\n\n    def on_hold(self)"
    )
    assert broken != text
    driver.write_text(broken)
    ended = run_tests(package, "-k", "stop_holds")
    assert ended.returncode == 1
    assert "DID NOT RAISE" in ended.stdout
    assert "1 failed, 1 passed" in ended.stdout, "the other robot is as before"
