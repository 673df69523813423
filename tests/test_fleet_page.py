"""The commands of docs/fleet.md: run as on the machines of a lab, which here are folders."""

from __future__ import annotations

import os
import re
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
TEXT = (ROOT / "docs" / "fleet.md").read_text(encoding="utf-8")
BEFORE, _, LAB = TEXT.partition("## A lab with certificates")


def blocks(text: str, kind: str) -> list[str]:
    return re.findall(rf"^```{kind}\n(.*?)^```", text, re.MULTILINE | re.DOTALL)


BLOCKS = [re.findall(r"^\$ (.*)$", block, re.MULTILINE) for block in blocks(LAB, "console")]
(TOML,) = blocks(LAB, "toml")
STAYS = ("hexwire fleet router", "hexwire serve")

pytest.importorskip("zenoh")


@pytest.fixture
def short() -> Iterator[Path]:
    """A folder with a short path, since sockets are in it."""
    with tempfile.TemporaryDirectory(prefix="hw") as folder:
        yield Path(folder)


@pytest.mark.system
def test_the_lab_works_as_the_page_says(short: Path) -> None:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]

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
            path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
            own = {"PATH": path, "XDG_RUNTIME_DIR": str(machine), "XDG_CONFIG_HOME": str(machine)}
            environment = os.environ | own
            for command in map(here, block):
                if command.startswith("export "):
                    name, _, value = command.removeprefix("export ").partition("=")
                    environment[name] = value
                elif command.startswith(STAYS):
                    program = subprocess.Popen(
                        ["bash", "-c", f"exec {command}"],
                        cwd=short,
                        env=environment,
                        stdout=subprocess.PIPE,
                        text=True,
                    )
                    stack.callback(program.communicate)
                    stack.callback(program.terminate)
                    assert program.stdout is not None
                    said.append(program.stdout.readline())
                else:
                    done = subprocess.run(
                        ["bash", "-c", command],
                        cwd=short,
                        env=environment,
                        capture_output=True,
                        text=True,
                        timeout=60,
                        check=False,
                    )
                    assert done.returncode == 0, f"{command}: {done.stderr}"
                    said.append(done.stdout)
    text = "".join(said)
    for words in ("rights of 4 certificates", "passing on at tls/localhost", "as zenoh:lab/arm1", "J1"):
        assert words in text


def wild(line: str) -> str:
    """A line of output, without what differs from run to run."""
    return " ".join(re.sub(r"\d+(\.\d+)?", "N", line.replace(socket.gethostname(), "lab-pc")).split())


@pytest.mark.system
def test_arms_of_one_machine_do_what_the_page_says(short: Path) -> None:
    """The blocks in their order; a server runs until the next one is started."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    environment = os.environ | {"PATH": path, "XDG_RUNTIME_DIR": str(short), "XDG_CONFIG_HOME": str(short)}
    (toml,) = blocks(BEFORE, "toml")
    (short / "lab.toml").write_text(toml)
    runs = [
        run
        for block in blocks(BEFORE, "console")
        for run in re.findall(r"^\$ (.*)\n((?:(?!\$ ).*\n)*)", block, re.MULTILINE)
    ]
    assert len(runs) == 18
    with ExitStack() as stack:
        for command, shown in runs:
            if command.startswith(STAYS):
                stack.pop_all().close()
                program = subprocess.Popen(
                    ["bash", "-c", f"exec {command}"], cwd=short, env=environment, stdout=subprocess.PIPE, text=True
                )
                stack.callback(program.communicate)
                stack.callback(program.terminate)
                assert program.stdout is not None
                for name in re.findall(r"lab/arm\d", command) or re.findall(r"lab/arm\d", toml):
                    assert f"{name}: sim://hex7bot" in program.stdout.readline()
                continue
            done = subprocess.run(
                ["bash", "-c", command],
                cwd=short,
                env=environment,
                capture_output=True,
                text=True,
                timeout=90,
                check=False,
            )
            assert done.returncode == 0, f"{command}: {done.stderr}"
            said = [wild(line) for line in done.stdout.splitlines()]
            assert [line for line in map(wild, shown.splitlines()) if line not in said] == [], done.stdout


def test_the_size_of_a_state_is_what_the_page_says() -> None:
    from hexwire.fleet import messages as m

    def size(holder: str) -> int:
        row = tuple(0.123456789 + i for i in range(7))
        names = tuple(f"J{i}" for i in range(1, 8))
        head = (2**40, 123456, 12345.678, 12345.679, 1.7e9 + 0.1, names)
        flags = (64,) * 7
        state = m.State(*head, *(row,) * 6, flags, row, 12345.6, False, False, False, holder, "", "", "", 17)
        return len(m.encode(state))

    holder = "ann@lab-pc (hexwire, process 12345), operator"
    assert f"{size('')} bytes, with a holder's name {size(holder)}" in TEXT


def test_each_role_is_on_the_page() -> None:
    from hexwire.fleet.rights import Kind

    for kind in Kind:
        assert f"| `{kind}` |" in TEXT
