"""The man pages say what `--help` says, and are sound roff."""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import Any

import click
import pytest
from tests.release.scripts import script

from hexwire.cli.main import COMMANDS

man: Any = script("man")


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    return {path.name: path for path in man.write(tmp_path_factory.mktemp("man"))}


def shown(page: Path) -> str:
    done = subprocess.run(["mandoc", "-T", "utf8", page], capture_output=True, text=True, check=True, timeout=60)
    text = subprocess.run(["col", "-b"], input=done.stdout, capture_output=True, text=True, check=True).stdout
    return " ".join(text.split())


@pytest.mark.parametrize("name", ["hexwire.1", "hexwire-ros1.1", "hexwire-ros2.1"])
def test_a_page_has_no_fault(pages: dict[str, Path], name: str) -> None:
    done = subprocess.run(
        ["mandoc", "-T", "lint", "-W", "warning", pages[name]], capture_output=True, text=True, timeout=60
    )
    faults = [line for line in done.stdout.splitlines() if "missing date" not in line]
    assert faults == [], "without a date the same sources give the same bytes"


def test_the_page_has_every_command_and_option(pages: dict[str, Path]) -> None:
    text = shown(pages["hexwire.1"])
    for name in COMMANDS:
        assert f"hexwire {name} " in text, name
    assert "hexwire firmware flash [OPTIONS]" in text
    assert "--dry-run Check everything and show the command, but do not write." in text
    assert "-h, --help Show this message; -V, --version: the version." in text
    assert "HEXWIRE_PORT" in text


def test_the_pages_of_the_nodes_are_their_help(pages: dict[str, Path]) -> None:
    assert "follow_joint_trajectory" in shown(pages["hexwire-ros1.1"])
    assert "-p port:=/dev/ttyUSB0" in shown(pages["hexwire-ros2.1"])


def test_text_that_roff_would_take_for_its_own(tmp_path: Path) -> None:
    @click.command()
    @click.option("--odd", help="It's \\e a ~ and a ^.")
    def odd() -> None:
        """Do it.

        .TH is no request here.

        \b
        'nor' this
          kept as it is
        """

    parts = list(man.section("odd", odd, click.Context(odd)))
    page = tmp_path / "odd.1"
    page.write_text(man.page(['.TH ODD 1 ""', ".SH COMMANDS", *parts]))
    text = shown(page)
    assert "Do it. .TH is no request here. 'nor' this kept as it is" in text
    assert "It's \\e a ~ and a ^." in text
