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
