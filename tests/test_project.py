"""The project's own files agree with each other: pyproject.toml, uv.lock, Makefile, .ci/run, CHANGELOG.md."""

from __future__ import annotations

import importlib
import json
import re
import subprocess
import tomllib
from pathlib import Path

import pytest

from hexwire.model.arms import ArmRecord

ROOT = Path(__file__).resolve().parent.parent
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
MAKEFILE = (ROOT / "Makefile").read_text(encoding="utf-8")


def _entry_points() -> list[str]:
    project = PYPROJECT["project"]
    return sorted(
        {
            *project["scripts"].values(),
            *(target for group in project["entry-points"].values() for target in group.values()),
        }
    )


@pytest.mark.parametrize("target", _entry_points())
def test_entry_point_leads_to_a_record_or_something_callable(target: str) -> None:
    module, _, name = target.partition(":")
    found = getattr(importlib.import_module(module), name)
    assert callable(found) or isinstance(found, ArmRecord)


@pytest.mark.parametrize("where", ["in it", "from outside"])
def test_make_does_nothing_in_a_folder_with_a_space(tmp_path: Path, where: str) -> None:
    # make cuts its path in two, and would remove the folder that the first half names.
    folder = tmp_path / "my robots" / "hexwire"
    folder.mkdir(parents=True)
    for name in ("Makefile", "pyproject.toml", "uv.lock"):
        (folder / name).write_bytes((ROOT / name).read_bytes())
    words = ["make", "-n", "demo"]  # -n only prints what it would do
    if where == "from outside":
        words += ["-f", str(folder / "Makefile")]
    cwd = folder if where == "in it" else tmp_path
    done = subprocess.run(words, cwd=cwd, capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 2
    assert "a folder with a space in its path" in done.stderr
    assert "rm " not in done.stdout


def test_lock_names_public_hosts_only() -> None:
    lock = (ROOT / "uv.lock").read_text(encoding="utf-8")
    hosts = set(re.findall(r"\b\w+://([^/\"]*)", lock))
    assert hosts == {"pypi.org", "files.pythonhosted.org"}
    sources = {tuple(package["source"].items()) for package in tomllib.loads(lock)["package"]}
    own = {(("editable", path),) for path in (".", "packages/zenoh-ros2")}
    assert sources == {(("registry", "https://pypi.org/simple"),), *own}


def test_lock_needs_no_compiler() -> None:
    """Every locked package has a wheel: a bare machine has no compiler to build one."""
    packages = tomllib.loads((ROOT / "uv.lock").read_text(encoding="utf-8"))["package"]
    bare = {p["name"] for p in packages if "registry" in p["source"] and not p.get("wheels")}
    assert bare <= {"feetech-servo-sdk"}, "published as source only, but pure Python"


def test_makefile_takes_extras_that_exist() -> None:
    extras = re.search(r"^EXTRAS := (.*)$", MAKEFILE, re.MULTILINE)
    assert extras is not None
    assert set(extras[1].split()) <= set(PYPROJECT["project"]["optional-dependencies"])


def test_make_help_lists_what_the_readme_needs() -> None:
    result = subprocess.run(
        ["make", "--no-print-directory", "help"], cwd=ROOT, check=True, capture_output=True, text=True
    )
    listed = re.findall(r"^  make ([a-z-]+)", result.stdout, re.MULTILINE)
    assert {"demo", "test", "test-all", "bench", "clean", "help"} <= set(listed)


def test_ci_runs_the_three_test_commands_and_nothing_else() -> None:
    lines = (ROOT / ".ci" / "run").read_text(encoding="utf-8").splitlines()
    commands = [line for line in lines if line and not line.startswith(("#", "set ", "cd "))]
    assert commands == ["make test </dev/null", "make test-all </dev/null", "exec make test-lerobot </dev/null"]


def test_every_package_stands_in_the_import_rule() -> None:
    """A new room needs its place in the layers or contracts before it holds code."""
    named: set[str] = set()
    for contract in PYPROJECT["tool"]["importlinter"]["contracts"]:
        for text in [*contract.get("layers", []), *contract.get("source_modules", [])]:
            named.update(re.findall(r"hexwire\.(\w+)", text))
    rooms = {path.parent.name for path in (ROOT / "src" / "hexwire").glob("*/__init__.py")}
    assert rooms <= named


def test_a_public_class_has_its_name_to_itself() -> None:
    """A reader finds a class by its name; two rooms share one only where the thing has no other."""
    rooms: dict[str, set[str]] = {}
    source = ROOT / "src/hexwire"
    for path in source.rglob("*.py"):
        for name in re.findall(r"^class ([A-Za-z]\w*)", path.read_text(encoding="utf-8"), re.MULTILINE):
            rooms.setdefault(name, set()).add(path.relative_to(source).parts[0])
    shared = {name for name, found in rooms.items() if len(found) > 1}
    of_both_ros = {"ActionClient", "ActionGoals", "HardwareInterface"}
    # Read as `m.Answer` wherever they are used.
    messages = {"Answer", "Watchdog"}
    assert shared <= of_both_ros | messages


def test_changelog_has_a_place_for_the_next_change() -> None:
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert text.index("## Unreleased") < text.index("### Added")


def test_any_text_of_a_test_can_be_reported_by_a_worker(pytestconfig: pytest.Config) -> None:
    report = pytest.CollectReport("a \ud800", "failed", "why: \ud800", [], sections=[("log", "ä \udcff")])
    data = pytestconfig.hook.pytest_report_to_serializable(config=pytestconfig, report=report)
    assert json.loads(json.dumps(data, ensure_ascii=False).encode())["sections"] == [["log", "ä \\udcff"]]
