"""The firmware as a whole: what it is built from, how large it is, and that no input breaks it."""

from __future__ import annotations

import re
import runpy
import subprocess
from pathlib import Path

import lizard
import pytest
from tests.avr import machines
from tests.avr.client import Client
from tests.avr.machines import BUILD, FIRMWARE, CoreBoard
from tests.soak import rounds

from hexwire.wire.command_frame import Command, Status

# The first one builds. A fuzz run of `make soak` takes an hour.
pytestmark = pytest.mark.timeout(rounds(600, 7200))

CORPUS = FIRMWARE / "test/corpus"
CORE = sorted((FIRMWARE / "core").glob("*.cpp")) + sorted((FIRMWARE / "core").glob("*.h"))


def without_comments(file: Path) -> str:
    return re.sub(r"//.*", "", file.read_text())


@pytest.mark.parametrize("baud", [115200, pytest.param(500000, marks=pytest.mark.slow)])
def test_it_fits_with_room_to_spare(baud: int) -> None:
    build = "build" if baud == 115200 else f"build/{baud}"
    printed = machines.make("mega2560", BUILD=build, HOST_BAUD=baud)
    found = re.search(r"flash (\d+) of at most (\d+) bytes, RAM (\d+) of at most (\d+) bytes", printed)
    assert found, printed
    flash, flash_limit, ram, ram_limit = map(int, found.groups())
    assert flash < flash_limit == 49152
    assert ram < ram_limit == 7168


def test_a_firmware_that_is_too_large_is_an_error() -> None:
    assert "of at most 1000 bytes" in machines.make("size", fails=True, FLASH_LIMIT=1000)


def test_the_core_stays_portable() -> None:
    own = {file.name for file in CORE}
    wrong: list[str] = []
    for file in CORE:
        text = without_comments(file)
        includes = set(re.findall(r'#include [<"]([^>"]+)', text)) - own - {"stdint.h", "string.h"}
        words = ("new ", "malloc", "delete ", "float", "double", "delay", "std::", "throw", "virtual ~")
        wrong += [f"{file.name} includes {name}" for name in sorted(includes)]
        wrong += [f"{file.name} uses {word.strip()}" for word in words if word in text]
    assert not wrong, "\n".join(wrong)


def test_no_function_branches_more_than_twelve_ways() -> None:
    folders = [FIRMWARE / name for name in ("boards", "test")]
    files = [*CORE, *(f for folder in folders for f in folder.rglob("*") if f.suffix in (".cpp", ".h", ".ino"))]
    seen = [
        (function.cyclomatic_complexity, f"{file.name}: {function.name}")
        for file in files
        for function in lizard.analyze_file(str(file)).function_list
    ]
    assert len(seen) > 300
    assert not [name for ways, name in seen if ways > 12]


def test_no_loop_of_the_core_waits_for_hardware() -> None:
    # The only loops without a bound of their own empty a ring or a frame.
    loops = re.findall(r"while \((.*)\) ?[{;]", "".join(without_comments(f) for f in CORE))
    assert not [loop for loop in loops if "bus_sending" in loop or "storage_ready" in loop or "micros" in loop]


def test_the_sketch_folder_is_what_the_arduino_ide_wants() -> None:
    folder = FIRMWARE / "boards/mega2560"
    sketch = (folder / "mega2560.ino").read_text()
    assert "void setup()" in sketch
    assert "void loop()" in sketch
    # The IDE compiles the sketch's folder and src below it, and nothing else.
    assert {f.name for f in (folder / "src/core").iterdir()} >= {f.name for f in CORE}
    for include in re.findall(r'#include "([^"]+)"', sketch):
        assert (folder / include).is_file()


@pytest.mark.slow
def test_the_core_under_the_sanitizers() -> None:
    machines.make("sanitized")
    done = subprocess.run([str(BUILD / "host/test_core")], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, "0 failures\n"), done.stdout + done.stderr


@pytest.mark.slow
@pytest.mark.soak
def test_no_attack_breaks_the_core(tmp_path: Path) -> None:
    """Hostile input against servos that answer; fuzz_board.cpp says what must never happen.

    The number of attacks and the seed are fixed, so that every machine tries the same ones.
    """
    machines.make("fuzz")
    found = tmp_path / "found"
    found.mkdir()
    command = [str(BUILD / "host/fuzz_board"), str(found), str(CORPUS)]
    command += [f"-runs={rounds(400, 200_000)}", "-seed=1", "-max_len=800", "-timeout=60", "-verbosity=0"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path)
    assert done.returncode == 0, done.stderr[-3000:]


@pytest.mark.slow
def test_no_known_attack_succeeds(tmp_path: Path) -> None:
    machines.built("fuzz")
    seeds = sorted(map(str, CORPUS.iterdir()))
    done = subprocess.run(
        [str(BUILD / "host/fuzz_board"), *seeds], capture_output=True, text=True, check=False, cwd=tmp_path
    )
    # The last one that it names is the one that succeeded.
    assert done.returncode == 0, done.stderr[-3000:]
    assert all(f"Executed {seed} " in done.stderr for seed in seeds)


def test_the_seeds_are_those_of_their_script() -> None:
    written = runpy.run_path(str(CORPUS.with_name("make_corpus.py")))["SEEDS"]
    assert {seed.name: seed.read_bytes() for seed in CORPUS.iterdir()} == written


def test_outputs_start_off_and_follow_the_command() -> None:
    board = CoreBoard()
    try:
        client = Client(board)
        board.settle()
        assert board.outputs == 0
        assert client.ask(Command.IO, b"\5\7").body == b"\5\5"
        assert board.outputs == 5
        assert client.ask(Command.IO, b"\1\0").body == b"\1\4"
        assert board.outputs == 4
    finally:
        board.close()


def test_storage_that_is_broken_is_reported() -> None:
    board = CoreBoard()
    try:
        client = Client(board)
        board.settle()
        board.break_storage(True)
        reply = client.ask(Command.LIMITS, b"\7" + b"\x64\0\xb8\x0b\xe8\3" * 7, within=1.0)
        assert reply.cmd_ext & 0x3F == Status.STORAGE
        assert client.ask(Command.LIMITS).body[1:] == b"\7" + b"\0\0\xff\x0f\0\x10" * 7
        board.break_storage(False)
        assert (
            client.ask(Command.LIMITS, b"\7" + b"\x64\0\xb8\x0b\xe8\3" * 7, within=1.0).cmd_ext & 0x3F == Status.OK
        )
    finally:
        board.close()
