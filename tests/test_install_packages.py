"""The script that brings system packages, with dpkg, apt-get, id and sudo played by stand-ins."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

SCRIPT = Path(__file__).resolve().parent.parent / ".ci" / "install-packages"
Run = Callable[..., tuple[int, str, list[str]]]


@pytest.fixture
def run(tmp_path: Path) -> Run:
    """Run the script; give its exit status, its stderr and the apt-get lines it ran."""
    log = tmp_path / "apt.log"

    def stand_in(name: str, body: str) -> None:
        path = tmp_path / "bin" / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(f"#!/bin/sh\n{body}\n", encoding="utf-8")
        path.chmod(0o755)

    def run(*packages: str, root: bool, sudo: bool = False, apt: bool = True, apt_status: int = 0):
        stand_in(
            "dpkg",
            '[ "$2" = here ] && echo "Status: install ok installed" && exit 0\n'
            '[ "$2" = removed ] && echo "Status: deinstall ok config-files" && exit 0\nexit 1',
        )
        stand_in("id", f"echo {0 if root else 1000}")
        stand_in("env", 'while [ "${1#*=}" != "$1" ]; do shift; done; exec "$@"')
        stand_in("sudo", f'[ "$1" = -n ] || exit 9; shift; {"exec" if sudo else "exit 1 #"} "$@"')
        if sudo:
            stand_in("true", "exit 0")
        if apt:
            stand_in("apt-get", f'echo "$*" >> {log}\nexit {apt_status}')
        result = subprocess.run(
            ["/bin/sh", str(SCRIPT), *packages],
            env={"PATH": str(tmp_path / "bin")},
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=60,
        )
        calls = log.read_text(encoding="utf-8").splitlines() if log.exists() else []
        return result.returncode, result.stderr, calls

    return run


def test_no_package_asked_for(run: Run) -> None:
    assert run(root=False) == (0, "", [])


def test_everything_is_there_already(run: Run) -> None:
    assert run("here", root=False) == (0, "", [])


@pytest.mark.parametrize(("root", "sudo"), [(True, False), (False, True)])
def test_installs_what_is_missing_where_it_may(run: Run, root: bool, sudo: bool) -> None:
    status, _, calls = run("here", "gone", "removed", root=root, sudo=sudo)
    assert status == 0
    update, install = calls
    assert update.endswith(" -q update")
    assert install.endswith(" -q install -y --no-install-recommends gone removed")


def test_says_the_line_to_type_where_it_may_not(run: Run) -> None:
    status, text, calls = run("here", "gone", root=False)
    assert (status, calls) == (1, [])
    assert "sudo apt-get update && sudo apt-get install -y --no-install-recommends gone\n" in text


def test_no_apt_on_this_system(run: Run) -> None:
    status, text, calls = run("gone", root=True, apt=False)
    assert (status, calls) == (1, [])
    assert "system packages are missing" in text


def test_a_failure_of_apt_is_a_failure(run: Run) -> None:
    status, text, calls = run("gone", root=True, apt_status=100)
    assert status == 1
    assert len(calls) == 1
    assert "could not install gone" in text
