from __future__ import annotations

import fcntl
import os
import subprocess
import sys
import tty
from collections.abc import Iterator
from pathlib import Path

import pytest

from hexwire.link import owner as owner_module
from hexwire.link.owner import device_owner, lock_owner
from hexwire.link.port_identity import same_device


@pytest.fixture
def terminal() -> Iterator[tuple[int, str]]:
    master, slave = os.openpty()
    tty.setraw(slave)
    yield slave, os.ttyname(slave)
    os.close(master)
    os.close(slave)


def test_the_device_owner_a_port_is_named(terminal: tuple[int, str]) -> None:
    slave, device = terminal
    assert device_owner(device) == "this program", "it is held open here"
    fcntl.flock(slave, fcntl.LOCK_EX)
    assert device_owner(device) == "this program", "and locked here"


def test_a_terminal_of_the_same_number_in_a_container_is_another_one(terminal: tuple[int, str]) -> None:
    here = os.fstat(terminal[0])
    there = os.stat_result([*here[:2], here.st_dev + 1, *here[3:]], {"st_rdev": here.st_rdev})
    assert same_device(here, here)
    assert not same_device(here, there)
    null = Path("/dev/null").stat()
    assert same_device(null, os.stat_result([*null[:2], null.st_dev + 1, *null[3:]], {"st_rdev": null.st_rdev}))
    assert not same_device(Path(__file__).stat(), Path(__file__).stat()), "no device"


def test_the_device_owner_nothing() -> None:
    assert device_owner("/dev/does-not-exist") == ""


def test_the_holder_of_a_lock_is_named(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.touch()
    assert lock_owner(path.stat()) == ""
    code = "import fcntl, sys; f = open(sys.argv[1]); fcntl.flock(f, 2); print(flush=True); sys.stdin.read()"
    command = [sys.executable, "-c", code, str(path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout is not None
        other.stdout.readline()
        assert lock_owner(path.stat()).endswith(f"(pid {other.pid})")
        assert device_owner(str(path)).endswith(f"(pid {other.pid})")
        other.communicate()
    assert device_owner(str(path)) == "", "a plain file has no owner but by its lock"


def test_without_proc_no_cause_is_given(monkeypatch: pytest.MonkeyPatch) -> None:
    real = Path.read_text

    def refuse(path: Path, *args: object, **more: object) -> str:
        if str(path).startswith("/proc"):
            raise PermissionError
        return real(path)

    monkeypatch.setattr(owner_module.Path, "read_text", refuse)
    assert lock_owner(Path("/dev/null").stat()) == ""
    assert owner_module._program("1") == ""
