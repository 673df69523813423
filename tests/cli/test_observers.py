"""Watching never changes what is watched: a command ends the same with and without --trace, --explain, --record."""

from __future__ import annotations

import errno
import fcntl
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from tests.bus.bus_bench import make_bus
from tests.cli.conftest import Bench
from tests.fleet.emulated import served_board

from hexwire.cli.main import cli
from hexwire.emulator.board import make_hex7bot_board
from hexwire.link import open as ipc_open
from hexwire.link.base import Link
from hexwire.trace.line_reader import LineReader
from hexwire.trace.recording import RecordingWriter

COMMANDS = (
    ("ping", "1-3"),
    ("read", "1", "present_position"),
    ("read", "2", "present_position"),
    ("scan", "--ids", "1-4"),
)


def no_space(*_: object, **__: object) -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@pytest.fixture
def bus(monkeypatch: pytest.MonkeyPatch) -> Callable[..., Result]:
    """Runs `hexwire bus` on three emulated servos, the first of which sets the reserved bit of its error byte."""

    def run(*args: str) -> Result:
        opened, device = make_bus((1, 2, 3))
        opened.close()
        device.wire.servos[0].protection.forced |= 0x80
        link: Link = opened.link
        monkeypatch.setattr(ipc_open, "build_link", lambda url: link)
        return CliRunner().invoke(cli, list(args))

    return run


def watched_and_not(bus: Callable[..., Result], command: tuple[str, ...], watching: tuple[str, ...]) -> Result:
    words = ("bus", *command, "--port", "/dev/ttyTEST")
    alone, watched = bus(*words), bus(*watching, *words)
    assert not isinstance(watched.exception, Exception) or isinstance(alone.exception, type(watched.exception))
    assert (watched.exit_code, watched.stdout) == (alone.exit_code, alone.stdout)
    assert watched.stderr.endswith(alone.stderr)
    return watched


@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
@pytest.mark.parametrize("watching", ["--trace", "--explain", "--record"])
def test_a_servo_with_reserved_error_bits(
    bus: Callable[..., Result], command: tuple[str, ...], watching: str, tmp_path: Path
) -> None:
    option = (watching, str(tmp_path / "a.mcap")) if watching == "--record" else (watching,)
    watched = watched_and_not(bus, command, option)
    assert "has gaps" not in watched.stderr


@pytest.mark.parametrize("watching", ["--trace", "--explain", "--record"])
def test_an_observer_with_a_bug(
    bus: Callable[..., Result], watching: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def feed(self: LineReader, passed: object) -> None:
        raise ZeroDivisionError("a bug")

    monkeypatch.setattr(LineReader, "feed", feed)
    option = (watching, str(tmp_path / "a.mcap")) if watching == "--record" else (watching,)
    watched = watched_and_not(bus, COMMANDS[2], option)
    warnings = [line for line in watched.stderr.splitlines() if line.startswith("warning: ")]
    assert len(warnings) == 1
    assert "has gaps, it failed" in warnings[0]
    assert "a bug" in warnings[0]


def test_a_disk_that_fills_up(bus: Callable[..., Result], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(RecordingWriter, "raw", no_space)
    watched = watched_and_not(bus, COMMANDS[2], ("--record", str(tmp_path / "a.mcap")))
    assert watched.stderr.count("No space left on device") == 1


@pytest.mark.parametrize("where", ["no/a.mcap", ".", "/dev/full", "old.mcap", "a.mcap"])
def test_a_recording_that_cannot_start_prevents_every_command_but_a_stop(
    bench: Bench, where: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "old.mcap").write_text("old")
    if where == "a.mcap":
        monkeypatch.setitem(sys.modules, "mcap.writer", None)
    refused = bench.run("torque", "on", "--record", str(tmp_path / where))
    assert (refused.exit_code, refused.stdout, refused.stderr.count("\n")) == (2, "", 1)
    assert bench.urls == []
    stopped = bench.run("stop", "--record", str(tmp_path / where))
    assert stopped.exit_code == 0
    assert stopped.stdout.startswith("stopped, limp: J1 ")
    assert stopped.stderr.count("has gaps") == stopped.stderr.count("\n") == 1
    assert bench.json("state")["stopped"]
    assert [path.read_text() for path in tmp_path.iterdir()] == ["old"]


@pytest.fixture(scope="module")
def shared_port() -> Iterator[str]:
    """The port of a board for the tests of this module, each of which resumes it."""
    with served_board(make_hex7bot_board(baud=0, start=time.monotonic())) as port:
        yield port


def at(port: str, *words: str) -> Result:
    return CliRunner().invoke(cli, [*words, "--port", port])


@pytest.mark.system
@pytest.mark.parametrize(
    ("stderr", "watching"),
    [
        pytest.param(stderr, watching, marks=[] if i == j else pytest.mark.slow)
        for i, stderr in enumerate(["closed pipe", "/dev/full", "closed"])
        for j, watching in enumerate([["--trace"], ["--explain"], ["--record", "/dev/full"]])
    ],
)
def test_a_stop_goes_through_although_nothing_can_be_recorded_or_printed(
    shared_port: str, stderr: str, watching: list[str]
) -> None:
    port = shared_port
    assert at(port, "resume").exit_code == 0
    assert '"stopped": false' in at(port, "state", "--json").stdout
    program = [sys.executable, "-m", "hexwire.cli", *watching, "stop", "--port", port]
    if stderr == "closed pipe":
        reading, writing = os.pipe()
        os.close(reading)
        done = subprocess.run(program, stdout=subprocess.PIPE, stderr=writing, timeout=60, check=False)
        os.close(writing)
    elif stderr == "/dev/full":
        with Path(stderr).open("wb") as full:
            done = subprocess.run(program, stdout=subprocess.PIPE, stderr=full, timeout=60, check=False)
    else:
        line = ["sh", "-c", 'exec "$@" 2>&-', "sh", *program]
        done = subprocess.run(line, stdout=subprocess.PIPE, timeout=60, check=False)
    assert '"stopped": true' in at(port, "state", "--json").stdout
    told = at(port, "stop")
    assert (done.returncode, done.stdout) == (0, told.stdout_bytes)


@pytest.mark.system
@pytest.mark.parametrize("watching", ["--trace", pytest.param("--explain", marks=pytest.mark.slow)])
def test_a_pager_that_is_not_scrolled_holds_nothing_up(shared_port: str, watching: str) -> None:
    """Nobody reads standard error, whose pipe is full; the command ends all the same."""
    reading, writing = os.pipe()
    os.write(writing, b"-" * fcntl.fcntl(writing, fcntl.F_GETPIPE_SZ))
    program = [sys.executable, "-m", "hexwire.cli", watching, "state", "--json", "--port", shared_port]
    done = subprocess.run(program, stdout=subprocess.PIPE, stderr=writing, timeout=60, check=False)
    os.close(writing)
    with os.fdopen(reading, "rb") as pipe:
        assert set(pipe.read()) == {ord("-")}
    assert done.returncode == 0
    assert b'"joints"' in done.stdout
