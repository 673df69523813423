from __future__ import annotations

import os
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from hexwire.cli.main import cli
from hexwire.cli.sim import shown
from hexwire.emulator import serve_view
from hexwire.errors import UsageError


@pytest.fixture(autouse=True)
def no_display(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)


@pytest.mark.parametrize("command", [("board",), ("bus", "--arm", "so101")])
def test_it_needs_physics_and_a_display(command: tuple[str, ...]) -> None:
    result = CliRunner().invoke(cli, ["sim", *command, "--view"])
    assert (result.exit_code, result.stdout) == (2, "")
    assert result.stderr == "error: --view needs --physics\n"
    result = CliRunner().invoke(cli, ["sim", *command, "--physics", "--view"])
    assert (result.exit_code, result.stdout) == (2, "")
    assert result.stderr.startswith("error: no display for --view: run it in a desktop session")
    assert result.stderr.count("\n") == 1


@pytest.fixture
def display(tmp_path: Path) -> Iterator[str]:
    """A display that keeps its picture in the file ``Xvfb_screen0``."""
    read, write = os.pipe()
    server = subprocess.Popen(
        [
            "Xvfb",
            "-displayfd",
            str(write),
            "-screen",
            "0",
            "320x240x24",
            "-fbdir",
            str(tmp_path),
            "-nolisten",
            "tcp",
        ],
        pass_fds=(write,),
        stderr=subprocess.DEVNULL,
    )
    os.close(write)
    try:
        with os.fdopen(read) as pipe:
            yield f":{pipe.readline().strip()}"
    finally:
        server.terminate()
        server.wait()


def _brightest(file: Path) -> int:
    """The brightest byte of an X window dump."""
    data = file.read_bytes()
    size, colours = struct.unpack_from(">I", data)[0], struct.unpack_from(">I", data, 76)[0]
    return max(data[size + 12 * colours :], default=0)


@pytest.mark.slow
@pytest.mark.system
def test_a_window_shows_the_arm(display: str, tmp_path: Path) -> None:
    assert _brightest(tmp_path / "Xvfb_screen0") == 0
    process = subprocess.Popen(
        [sys.executable, "-P", "-m", "hexwire", "sim", "board", "--physics", "--view", "--until-eof"],
        env={**os.environ, "DISPLAY": display},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stdout is not None
        assert process.stdout.readline().startswith("/dev/")
        deadline = time.monotonic() + 30.0
        while _brightest(tmp_path / "Xvfb_screen0") < 150 and time.monotonic() < deadline:
            time.sleep(0.05)
        assert _brightest(tmp_path / "Xvfb_screen0") > 150, "the sky"
    finally:
        _, errors = process.communicate(timeout=30)
    assert (process.returncode, errors) == (0, "")


class FakeView:
    made: list[FakeView]

    def __init__(self, twin: Any, servos: Any) -> None:
        self.twin, self.servos, self.open, self.closed = twin, servos, True, False
        FakeView.made.append(self)

    def step(self, now: float) -> bool:
        return self.open

    def close(self) -> None:
        self.closed = True


def test_the_emulator_ends_with_its_window(monkeypatch: pytest.MonkeyPatch) -> None:
    FakeView.made = []
    monkeypatch.setattr(serve_view, "TwinView", FakeView)
    ended = threading.Event()
    twin: Any = object()
    with shown(twin, ["servo"], ended.is_set, view=True) as stop:  # type: ignore[list-item]
        (view,) = FakeView.made
        assert (view.twin, view.servos) == (twin, ["servo"])
        assert not stop()
        view.open = False
        assert stop()
        view.open = True
        ended.set()
        assert stop()
    assert view.closed


def test_without_the_option_there_is_no_window() -> None:
    ended = threading.Event()
    with shown(None, [], ended.is_set, view=False) as stop:
        assert not stop()
    with pytest.raises(UsageError, match="--view needs --physics"), shown(None, [], ended.is_set, view=True):
        pass
