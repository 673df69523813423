"""A name is served once, also over a router: at the start, at the same time, and after a partition."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest
from tests.link.far_ends import free_port
from tests.waits import PATIENCE, eventually

from hexwire.errors import DeviceError, UsageError
from hexwire.fleet.names import Keys
from hexwire.fleet.network import Network
from hexwire.fleet.rights import Kind
from hexwire.fleet.service import Service
from hexwire.fleet.service_file import read_arms

from .lab import Lab


def a_service(endpoint: str) -> Service:
    return Service(read_arms({"lab/arm1": {"robot": "sim"}}), Network(connect=(endpoint,)))


def on_another_computer(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What starts from here on has other sockets and locks."""
    folder.mkdir()
    monkeypatch.setenv("XDG_RUNTIME_DIR", os.fspath(folder))


def test_a_second_server_of_a_name_is_refused(runtime: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    router = Network(listen=(endpoint,), router=True).open()
    try:
        with a_service(endpoint) as first:
            on_another_computer(runtime / "b", monkeypatch)
            with pytest.raises(DeviceError, match="the name lab/arm1 is already served"), a_service(endpoint):
                pass
            first.check()
    finally:
        router.close()


def test_the_certificate_must_be_for_the_name(tmp_path: Path, runtime: Path) -> None:
    lab = Lab(tmp_path)
    lab.issue("arm1", Kind.ARM, "lab/arm1")
    lab.issue("anna", Kind.OPERATOR, "lab/*")
    arms = read_arms({"lab/arm2": {"robot": "sim"}})
    for name, words in (("arm1", r"is for lab/arm1, not for lab/arm2"), ("anna", "is for the role operator")):
        with pytest.raises(UsageError, match=words) as raised:
            Service(arms, lab.network(name))
        assert "\n" not in str(raised.value)


def test_several_arms_do_not_listen_at_one_endpoint() -> None:
    arms = read_arms({"a": {"robot": "sim"}, "b": {"robot": "sim"}})
    with pytest.raises(UsageError, match="hexwire fleet router"):
        Service(arms, Network(listen=("tcp/localhost:7447",)))


# -- in two programs --------------------------------------------------------------------------------------


@contextmanager
def serving(folder: Path, endpoint: str, count: int = 2) -> Iterator[list[subprocess.Popen[str]]]:
    """Programs as if on several computers that serve one name."""
    words = ["serve", "--robot", "sim", "--name", "lab/arm1", "--router", endpoint]
    with ExitStack() as stack:
        programs = []
        for number in range(count):
            runtime = folder / str(number)
            runtime.mkdir()
            environ = {**os.environ, "XDG_RUNTIME_DIR": os.fspath(runtime)}
            program = subprocess.Popen(
                [sys.executable, "-m", "hexwire.cli", *words],
                env=environ,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
            )
            stack.callback(program.communicate)
            stack.callback(program.kill)
            programs.append(program)
        yield programs


def first_to_end(programs: list[subprocess.Popen[str]]) -> int:
    deadline = time.monotonic() + PATIENCE
    while time.monotonic() < deadline:
        for number, program in enumerate(programs):
            if program.poll() is not None:
                return number
        time.sleep(0.05)
    raise AssertionError("both go on")


def is_one_error(program: subprocess.Popen[str], words: str) -> None:
    _, errors = program.communicate(timeout=PATIENCE)
    said = [line for line in errors.splitlines() if line.startswith("error: ")]
    assert (program.returncode, len(said)) == (1, 1), errors
    assert words in said[0]


@pytest.mark.slow
@pytest.mark.system
def test_of_two_that_start_at_the_same_time_one_is_refused(runtime: Path) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    router = Network(listen=(endpoint,), router=True).open()
    try:
        with serving(runtime, endpoint) as programs:
            loser = first_to_end(programs)
            is_one_error(programs[loser], "lab/arm1")
            winner = programs[1 - loser]
            assert winner.stdout is not None
            assert winner.stdout.readline().startswith("lab/arm1: sim://")
            assert winner.poll() is None
            # The connection of the other one ends a moment after its program.
            eventually(lambda: len(router.visible(Keys("lab/arm1").alive, 5.0)) == 1)
    finally:
        router.close()


@pytest.mark.slow
@pytest.mark.system
def test_after_a_partition_the_one_started_later_gives_way(runtime: Path) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with serving(runtime, endpoint, 1) as (earlier,):
        assert earlier.stdout is not None
        assert earlier.stdout.readline().startswith("lab/arm1: sim://")
        (runtime / "other").mkdir()
        with serving(runtime / "other", endpoint, 1) as (later,):
            assert later.stdout is not None
            assert later.stdout.readline().startswith("lab/arm1: sim://")
            router = Network(listen=(endpoint,), router=True).open()
            try:
                is_one_error(later, "another server offers lab/arm1, and was started earlier")
                assert earlier.poll() is None
                # The connection of the other one ends a moment after its program.
                eventually(lambda: len(router.visible(Keys("lab/arm1").alive, 5.0)) == 1)
            finally:
                router.close()
