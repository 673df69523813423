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
BLOCKS = [
    re.findall(r"^\$ (.*)$", block, re.MULTILINE)
    for block in re.findall(r"^```console\n(.*?)^```", TEXT, re.MULTILINE | re.DOTALL)
]
(TOML,) = re.findall(r"^```toml\n(.*?)^```", TEXT, re.MULTILINE | re.DOTALL)
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
    assert [len(block) for block in BLOCKS] == [5, 1, 1, 4]
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


def test_each_role_is_on_the_page() -> None:
    from hexwire.fleet.rights import Kind

    for kind in Kind:
        assert f"| `{kind}` |" in TEXT
