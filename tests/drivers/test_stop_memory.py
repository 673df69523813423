"""A stop is kept for this user from one program to the next, in a file that nobody can plant."""

from __future__ import annotations

import os
import stat
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from hexwire.drivers.hex7bot import Hex7BotDriver
from hexwire.drivers.stop_memory import StopMemory
from hexwire.emulator.board import make_hex7bot_board
from hexwire.emulator.serve_pty import PtyServer
from hexwire.errors import StoppedError
from hexwire.model.state import JointTarget

URL = "tcp://192.168.1.20:15040"


@pytest.fixture(autouse=True)
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    return tmp_path / "hexwire"


@pytest.fixture
def port() -> Iterator[str]:
    """A board of the chapter on a pseudo-terminal."""
    server = PtyServer(make_hex7bot_board(dialect=1, start=time.monotonic()))
    path, ended = server.open(), threading.Event()

    def serve() -> None:
        while not ended.is_set():
            server.run_once(0.02)

    thread = threading.Thread(target=serve)
    thread.start()
    yield path
    ended.set()
    thread.join(30)
    server.close()


def test_it_is_there_until_it_is_forgotten(place: Path) -> None:
    memory = StopMemory(URL)
    assert not memory.stopped
    memory.forget()
    for _ in range(2):
        memory.remember()
        assert StopMemory(URL).stopped
    assert not StopMemory("tcp://192.168.1.21:15040").stopped
    (file,) = place.iterdir()
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    StopMemory(URL).forget()
    assert not memory.stopped


def test_no_link_that_somebody_planted_is_followed(place: Path, tmp_path: Path) -> None:
    memory = StopMemory(URL)
    memory.remember()
    (file,) = place.iterdir()
    victim = tmp_path / "victim"
    file.unlink()
    file.symlink_to(victim)
    memory.remember()
    assert not victim.exists()
    assert not memory.stopped


@pytest.mark.parametrize("url", ["", "memory://a", "serial:///dev/not-there", "serial:///dev/null/x", "nonsense"])
def test_a_link_that_is_not_a_device_has_no_memory(place: Path, url: str) -> None:
    memory = StopMemory(url)
    memory.remember()
    assert not memory.stopped
    assert memory.kept_by == ""
    assert not place.exists()


def test_a_folder_that_cannot_be_made_is_reported_and_the_stop_continues(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "file"))
    memory = StopMemory(URL)
    assert memory.kept_by == "user"
    memory.remember()
    assert "cannot be kept for other programs" in caplog.text
    assert memory.kept_by == ""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    memory.remember()
    assert memory.kept_by == "user"


def test_a_terminal_that_another_board_gets_later_is_another_device() -> None:
    names = []
    for _ in range(2):
        main, other = os.openpty()
        memory = StopMemory(f"serial://{os.ttyname(other)}")
        names.append(memory._name)
        os.close(main)
        os.close(other)
        time.sleep(0.02)
    assert names[0] != names[1]


def test_a_stop_is_found_by_a_path_that_is_relative_to_a_folder(
    port: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "arm").symlink_to(port)
    monkeypatch.chdir(tmp_path)
    with Hex7BotDriver.from_url("arm") as robot:
        robot.stop()
    with Hex7BotDriver.from_url(port) as robot:
        assert robot.read().stopped
        robot.resume()


def test_a_stop_of_dialect_1_holds_for_the_next_program(port: str) -> None:
    with Hex7BotDriver.from_url(port) as robot:
        robot.torque(True)
        assert robot.stop_kept_by == "user"
        robot.stop()
    with Hex7BotDriver.from_url(port) as robot:
        assert robot.read().stopped
        assert robot.probe().stopped
        with pytest.raises(StoppedError, match="was not sent: the arm is stopped"):
            robot.write(JointTarget.of({"J1": 0.1}))
        with pytest.raises(StoppedError):
            robot.torque(True)
        robot.resume()
    with Hex7BotDriver.from_url(port) as robot:
        assert not robot.read().stopped
        robot.write(JointTarget.of({"J1": 0.1}))
