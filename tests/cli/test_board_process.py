from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from hexwire.cli import demo as module
from hexwire.cli.demo import board_process
from hexwire.errors import DeviceError, UsageError

pytestmark = pytest.mark.system


@pytest.fixture
def processes(monkeypatch: pytest.MonkeyPatch) -> list[subprocess.Popen[bytes]]:
    """Every process that is started."""
    started: list[subprocess.Popen[bytes]] = []
    popen = subprocess.Popen

    def start(*args: Any, **options: Any) -> subprocess.Popen[bytes]:
        process = popen(*args, **options)
        started.append(process)
        return process

    monkeypatch.setattr(module.subprocess, "Popen", start)
    return started


def replaced_by(monkeypatch: pytest.MonkeyPatch, code: str) -> None:
    """Another program in the board's place."""
    popen = subprocess.Popen
    monkeypatch.setattr(
        module.subprocess, "Popen", lambda command, **options: popen([sys.executable, "-c", code], **options)
    )


def test_it_yields_a_terminal_and_ends_the_process(processes: list[subprocess.Popen[bytes]]) -> None:
    with board_process(baud=0) as path:
        assert Path(path).is_char_device()
        (process,) = processes
        assert process.poll() is None
        assert os.getsid(process.pid) == process.pid, "Ctrl-C is not for the board"
    assert process.returncode == 0


@pytest.mark.slow
def test_physics_are_those_of_the_emulated_board(processes: list[subprocess.Popen[bytes]]) -> None:
    with board_process(baud=0, physics=True) as path:
        assert Path(path).is_char_device()
        assert "--physics" in processes[0].args  # type: ignore[operator]  # a list


def test_the_process_ends_after_an_error_too(processes: list[subprocess.Popen[bytes]]) -> None:
    with pytest.raises(RuntimeError, match="ours"), board_process():
        raise RuntimeError("ours")
    assert processes[0].returncode == 0


def test_a_file_in_the_present_folder_does_not_stand_in_for_a_module(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "click.py").write_text("raise SystemExit('the wrong click')")
    monkeypatch.chdir(tmp_path)
    with board_process() as path:
        assert path.startswith("/dev/")


def test_a_fault_that_does_not_exist() -> None:
    said = r"the emulated board did not start: .*silly"
    with pytest.raises(UsageError, match=said), board_process(faults=["silly:1"]):
        pytest.fail("it started")


def test_an_emulator_that_dies_is_reported_with_its_last_words(monkeypatch: pytest.MonkeyPatch) -> None:
    replaced_by(monkeypatch, "import sys; sys.exit('first\\nlast words')")
    with pytest.raises(DeviceError, match="did not start: last words"), board_process():
        pytest.fail("it started")


def test_an_emulator_that_dies_without_a_word(monkeypatch: pytest.MonkeyPatch) -> None:
    replaced_by(monkeypatch, "import sys; sys.exit(7)")
    with pytest.raises(DeviceError, match="did not start: exit status 7"), board_process():
        pytest.fail("it started")


def test_an_emulator_that_hangs_is_ended(
    monkeypatch: pytest.MonkeyPatch, processes: list[subprocess.Popen[bytes]]
) -> None:
    replaced_by(monkeypatch, "import signal, time; signal.signal(15, signal.SIG_IGN); time.sleep(600)")
    monkeypatch.setattr(module, "_START_TIMEOUT", 1.0)
    monkeypatch.setattr(module, "_END_TIMEOUT", 0.3)
    with pytest.raises(DeviceError, match="did not start within 1 s"), board_process():
        pytest.fail("it started")
