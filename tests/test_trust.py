"""SECURITY.md, CITATION.cff, the workflows and the updates of dependencies: true, complete and in agreement."""

from __future__ import annotations

import re
import subprocess
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml

ROOT = Path(__file__).resolve().parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
SECURITY = (ROOT / "SECURITY.md").read_text(encoding="utf-8")
CHANGELOG = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
WORKFLOWS = sorted((ROOT / ".github/workflows").glob("*.yml"))


def load(name: str) -> Any:
    return yaml.safe_load((ROOT / name).read_text(encoding="utf-8"))


def steps(workflow: Path) -> list[dict[str, Any]]:
    jobs = yaml.safe_load(workflow.read_text(encoding="utf-8"))["jobs"]
    return [step for job in jobs.values() for step in job["steps"]]


def test_security_says_what_is_protected_what_not_and_how_to_report() -> None:
    headings = re.findall(r"^## (.*)$", SECURITY, re.MULTILINE)
    assert headings == [
        "What is protected, and from whom",
        "What is not protected",
        "What you can check",
        "Supported versions",
        "Report a fault",
    ]
    assert "*Report a\nvulnerability*" in SECURITY
    assert not re.search(r"\S+@\S+\.\w+", SECURITY), "an address that nobody reads"
    rows = re.findall(r"^\| .* \|$", SECURITY, re.MULTILINE)[1:]
    assert len(rows) >= 9
    assert all(row.count("|") == 5 for row in rows)


@pytest.mark.parametrize("page", ["SECURITY.md", "docs/versions.md", "docs/shell.md"])
def test_links_lead_to_files(page: str) -> None:
    path = ROOT / page
    targets = re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", path.read_text(encoding="utf-8"))
    assert [target for target in targets if not (path.parent / target).is_file()] == []


def test_the_citation_is_of_this_version_and_repository() -> None:
    cited = load("CITATION.cff")
    assert cited["cff-version"] == "1.2.0"
    assert {"message", "title", "authors", "license"} <= cited.keys()
    assert (cited["title"], cited["version"]) == (PROJECT["name"], PROJECT["version"])
    assert cited["repository-code"] == PROJECT["urls"]["Source"]


def test_the_ros_package_has_this_version() -> None:
    text = (ROOT / "src/hexwire/ros1/share/hexwire/package.xml").read_text(encoding="utf-8")
    assert f"<version>{PROJECT['version']}</version>" in text


def test_the_addresses_of_the_project_are_of_one_repository() -> None:
    urls = PROJECT["urls"]
    assert all(url.startswith(urls["Source"]) for url in urls.values())
    named = {
        match
        for path in [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), ROOT / "CITATION.cff"]
        for match in re.findall(r"https://github\.com/[\w-]+/hexwire\b", path.read_text(encoding="utf-8"))
    }
    assert named <= {urls["Source"]}


def test_every_action_is_pinned_to_a_commit() -> None:
    lines = [
        line for path in WORKFLOWS for line in path.read_text(encoding="utf-8").splitlines() if "uses:" in line
    ]
    assert lines
    pinned = re.compile(r"uses: [\w-]+/[\w-]+@[0-9a-f]{40} # v\d+\.\d+\.\d+$")
    assert [line for line in lines if not pinned.search(line)] == []


def test_the_workflows_run_the_commands_of_this_machine() -> None:
    runs = [step["run"] for path in WORKFLOWS for step in steps(path) if "run" in step]
    targets = {line.removeprefix("make ") for line in runs if line.startswith("make ")}
    assert {"test", "test-lerobot", "docs", "dist", "try-wheel", "resolvable"} <= targets
    known = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    assert targets <= known
    other = [line for line in runs if not line.startswith(("make ", "apt-get ", "git config "))]
    assert other == [], "what only a workflow runs cannot be tried at home"
    ci = (ROOT / ".ci/run").read_text(encoding="utf-8")
    assert set(re.findall(r"make ([a-z-]+)", ci)) <= targets


def test_a_workflow_may_only_read() -> None:
    for path in WORKFLOWS:
        workflow = yaml.safe_load(path.read_text(encoding="utf-8"))
        assert workflow["permissions"] == {"contents": "read"}, path
        for job in workflow["jobs"].values():
            assert "permissions" not in job
            assert job["timeout-minutes"] <= 60
        for step in steps(path):
            if step.get("uses", "").startswith("actions/checkout@"):
                assert step["with"]["persist-credentials"] is False


def test_updates_are_proposed_for_all_that_is_locked() -> None:
    updates = load(".github/dependabot.yml")["updates"]
    kinds = {row["package-ecosystem"]: row for row in updates}
    assert kinds.keys() == {"uv", "pip", "github-actions"}
    listed = {name.strip("/") for name in kinds["pip"]["directories"]}
    locked = {
        path.parent.relative_to(ROOT).as_posix()
        for top in ("integrations", "packages", "tests")
        for path in (ROOT / top).rglob("requirements.txt")
    }
    assert listed == locked


def test_the_changelog_has_the_headings_that_the_policy_names() -> None:
    headings = re.findall(r"^### (.*)$", CHANGELOG, re.MULTILINE)
    assert set(headings) <= {"Added", "Changed", "Deprecated", "Removed", "Fixed", "Security"}
    released = re.findall(r"^## (\S+)", CHANGELOG, re.MULTILINE)
    assert released[0] == "Unreleased"


def test_make_try_wheel_uses_the_wheel_alone() -> None:
    shown = subprocess.run(
        ["make", "-n", "try-wheel"], cwd=ROOT, capture_output=True, text=True, check=True, timeout=60
    )
    assert "release/try_wheel.py" in shown.stdout
