"""The commands of the pages on sharing arms: run as on the machines of a lab, which here are folders."""

from __future__ import annotations

import os
import re
import shlex
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import IO

import pytest
from click.testing import CliRunner
from tests.link.far_ends import free_port

from hexwire.cli.main import cli
from hexwire.fleet import messages as m
from hexwire.fleet.rights import Kind

ROOT = Path(__file__).resolve().parent.parent
ONE_MACHINE, LAB, MANY = (
    (ROOT / "docs" / page).read_text(encoding="utf-8")
    for page in ("fleet.md", "fleet-certificates.md", "explanation/many-arms.md")
)


def blocks(text: str, kind: str) -> list[str]:
    return re.findall(rf"^```{kind}\n(.*?)^```", text, re.MULTILINE | re.DOTALL)


BLOCKS = [re.findall(r"^\$ (.*)$", block, re.MULTILINE) for block in blocks(LAB, "console")]
(TOML,) = blocks(LAB, "toml")
STAYS = ("hexwire fleet router", "hexwire serve")


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The present folder, with a short path, since sockets are in it."""
    with tempfile.TemporaryDirectory(prefix="hw") as folder:
        monkeypatch.chdir(folder)
        yield Path(folder)


class Shell:
    """A shell on a machine of the page; what runs until it is ended is a program.

    Args:
        machine: The machine's own files and sockets. Commands run in the present folder.
    """

    def __init__(self, machine: Path) -> None:
        own = {name: str(machine) for name in ("XDG_RUNTIME_DIR", "XDG_STATE_HOME", "XDG_CONFIG_HOME")}
        self._environment: dict[str, str] = own

    def export(self, command: str) -> None:
        name, _, value = command.removeprefix("export ").partition("=")
        self._environment[name] = value

    def start(self, command: str, until: ExitStack) -> IO[str]:
        """Start a program that runs until a stack closes; returns its output."""
        program = subprocess.Popen(
            [sys.executable, "-m", "hexwire.cli", *shlex.split(command)[1:]],
            env=os.environ | self._environment,
            stdout=subprocess.PIPE,
            text=True,
        )
        until.callback(program.communicate)
        until.callback(program.terminate)
        assert program.stdout is not None
        return program.stdout

    def run(self, command: str) -> str:
        """Run a command that must succeed; returns its output."""
        done = CliRunner(env=self._environment).invoke(cli, shlex.split(command)[1:])
        assert done.exit_code == 0, f"{command}: {done.output}"
        return done.stdout


@pytest.mark.system
def test_the_lab_works_as_the_page_says(short: Path) -> None:
    port = free_port()

    def here(text: str) -> str:
        return text.replace("lab-pc", "localhost").replace("0.0.0.0", "localhost").replace("7447", str(port))

    (short / "lab").mkdir()
    (short / "lab" / "anna.toml").write_text(here(TOML))
    assert [len(block) for block in BLOCKS] == [5, 1, 1, 6]
    said = []
    with ExitStack() as stack:
        for number, block in enumerate(BLOCKS):
            machine = short / str(number)
            machine.mkdir()
            shell = Shell(machine)
            for command in map(here, block):
                if command.startswith("export "):
                    shell.export(command)
                elif command.startswith(STAYS):
                    said.append(shell.start(command, stack).readline())
                else:
                    said.append(shell.run(command))
    text = "".join(said)
    for words in ("rights of 4 certificates", "passing on at tls/localhost", "as zenoh:lab/arm1", "J1"):
        assert words in text


def wild(line: str) -> str:
    """A line of output, without what differs from run to run."""
    return " ".join(re.sub(r"\d+(\.\d+)?", "N", line.replace(socket.gethostname(), "lab-pc")).split())


@pytest.mark.slow
@pytest.mark.system
def test_arms_of_one_machine_do_what_the_page_says(short: Path) -> None:
    """The blocks in their order; a server runs until the next one is started."""
    shell = Shell(short)
    (toml,) = blocks(ONE_MACHINE, "toml")
    (short / "lab.toml").write_text(toml)
    runs = [
        run
        for block in blocks(ONE_MACHINE, "console")
        for run in re.findall(r"^\$ (.*)\n((?:(?!\$ ).*\n)*)", block, re.MULTILINE)
    ]
    assert len(runs) == 18
    with ExitStack() as stack:
        for command, shown in runs:
            if command.startswith(STAYS):
                stack.pop_all().close()
                said = shell.start(command, stack)
                for name in re.findall(r"lab/arm\d", command) or re.findall(r"lab/arm\d", toml):
                    assert f"{name}: sim://hex7bot" in said.readline()
                continue
            lines = [wild(line) for line in shell.run(command).splitlines()]
            assert [line for line in map(wild, shown.splitlines()) if line not in lines] == [], lines


def test_the_size_of_a_state_is_what_the_page_says() -> None:
    def size(holder: str) -> int:
        row = tuple(0.123456789 + i for i in range(7))
        names = tuple(f"J{i}" for i in range(1, 8))
        head = (2**40, 123456, 12345.678, 12345.679, 1.7e9 + 0.1, names)
        flags = (64,) * 7
        ends = (holder, "", "", "", 17, 0, m.Stream(2**52, 12345) if holder else None)
        state = m.State(*head, *(row,) * 6, flags, row, 12345.6, False, False, False, *ends)
        return len(m.encode(state))

    holder = "ann@lab-pc (hexwire, process 12345), operator"
    assert f"{size('')} bytes, with a holder's name {size(holder)}" in MANY


def test_each_role_is_on_the_page() -> None:
    for kind in Kind:
        assert f"| `{kind}` |" in LAB
