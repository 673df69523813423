"""No block of any page escapes the tests: each is run, or checked by the test that is named here."""

from __future__ import annotations

import re
import time
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import click
import pytest
from tests.emulator.terminals import serving
from tests.site.pages import blocks, repository_pages
from tests.site.shell import ELSEWHERE, OTHERS, Shell, commands, parse_mentioned, split

from hexwire.control.requests.program import read_program
from hexwire.drivers.arm_file import load_arm_file
from hexwire.emulator.bus_arms import make_bus_arm
from hexwire.emulator.bus_device import BusDevice
from hexwire.emulator.serve_pty import PtyServer
from hexwire.ipc.conf import load_conf

ROOT = Path(__file__).resolve().parents[2]
PAGES = [page.as_posix() for page in repository_pages()]
ALL = {page: list(blocks((ROOT / page).read_text(encoding="utf-8"))) for page in PAGES}
OWN = {
    "docs/debugging.md": "tests/test_debugging_page.py",
    "docs/fleet.md": "tests/test_fleet_page.py",
    "docs/fleet-certificates.md": "tests/test_fleet_page.py",
    "docs/ros.md": "tests/ros1/test_ros_page.py",
    "docs/ros2.md": "tests/ros2/test_ros2_page.py",
    "docs/shell.md": "tests/cli/test_completion.py",
    "docs/so101.md": "tests/test_so101_page.py",
    "packages/zenoh-ros2/README.md": "packages/zenoh-ros2/tests/test_readme.py",
    "src/hexwire/ros2/package/templates/README.md": "tests/ros2/package/test_files.py",
}
"""Pages whose console blocks a test of their own runs, as programs."""
CONSOLE = [page for page, found in ALL.items() if page not in OWN and any(b.language == "console" for b in found)]
NOTEST = [(page, b) for page, found in ALL.items() for b in found if b.language == "python" and "notest" in b.info]
LONG = ("docs/motion.md",)
"""Their motions take many seconds; `tests/cli` has them one by one."""
ON_A_BUS = ("docs/bus.md", "docs/bus-setup.md")
"""Their ports are of servos on an adapter."""


class Inline(NamedTuple):
    """A command of hexwire within a line of a page."""

    line: int
    command: str
    table: bool


def inline_commands(page: str) -> list[Inline]:
    found, fenced = [], False
    for number, line in enumerate((ROOT / page).read_text(encoding="utf-8").splitlines(), 1):
        if line.lstrip().startswith("```"):
            fenced = not fenced
        elif not fenced:
            codes = re.findall(r"`(hexwire(?:-ros[12] [-_]| )[^`]+)`", line)
            found += [Inline(number, code, line.startswith("|")) for code in codes]
    return found


def where(page: str, line: int) -> str:
    return f"{page}:{line}"


def test_there_is_no_other_kind_of_block() -> None:
    known = {"python", "console", "sh", "toml", "yaml", "json5", "conf", "text"}
    other = [
        f"{where(page, b.line)}: {b.info!r}"
        for page, found in ALL.items()
        for b in found
        if b.language not in known
    ]
    assert not other, f"say what is in the block, with a word after its fence: {other}"


def test_pages_with_python_are_collected_by_pytest() -> None:
    """`make tests` runs the blocks of README.md, docs/ and packages/, except those marked notest."""
    (recipe,) = re.findall(r"--markdown-docs (.*)$", (ROOT / "Makefile").read_text(), re.MULTILINE)
    assert "packages README.md docs" in recipe
    outside = [page for page, found in ALL.items() for b in found if b.language == "python" if not collected(page)]
    assert not outside


def collected(page: str) -> bool:
    return page == "README.md" or page.startswith(("docs/", "packages/"))


def test_pages_that_have_a_test_of_their_own_are_named_in_it() -> None:
    for page, test in OWN.items():
        assert f'{Path(page).name}"' in (ROOT / test).read_text(encoding="utf-8")


def test_only_pages_with_a_test_of_their_own_have_blocks_that_it_reads() -> None:
    kinds = {(page, b.language) for page, found in ALL.items() for b in found} & {
        (page, kind) for page in PAGES for kind in ("sh", "yaml", "json5")
    }
    assert kinds == {("docs/ros2.md", "yaml"), ("docs/ros2.md", "json5"), ("docs/shell.md", "sh")}


@pytest.mark.parametrize("page", OWN)
def test_programs_in_pages_with_a_test_of_their_own_are_known(page: str, tmp_path: Path) -> None:
    """Whatever their own test leaves out: every command of hexwire can be parsed, every other program is known."""
    shell = Shell(tmp_path, "/dev/ttyUSB0")
    shell.only_parse = True
    for block in ALL[page]:
        if block.language == "console":
            for command, _ in commands(block.text):
                if "@" not in command:  # of a template
                    shell.run(command)


def test_what_another_test_runs_is_there() -> None:
    pages = "".join((ROOT / page).read_text(encoding="utf-8") for page in PAGES)
    for pattern, (test, word) in ELSEWHERE.items():
        assert re.search(pattern.lstrip("^"), pages), f"no page has {pattern} any more"
        assert word in (ROOT / test).read_text(encoding="utf-8"), f"{test} has no {word!r}"


# --- console ---------------------------------------------------------------------------------------------------


@pytest.fixture
def bus_arm(tmp_path: Path) -> Iterator[str]:
    """An emulated SO-101 on a port."""
    with serving(PtyServer(BusDevice(make_bus_arm("so101", start=time.monotonic()).servos))) as path:
        yield path


def plain(line: str) -> str:
    """A line without what differs from run to run."""
    return " ".join(re.sub(r"-?\d+(\.\d+)?", "N", line).split())


@pytest.mark.system
@pytest.mark.parametrize(
    "page", [pytest.param(page, marks=pytest.mark.slow) if page in LONG else page for page in CONSOLE]
)
def test_commands_of_a_page(page: str, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    arm = request.getfixturevalue("bus_arm" if page in ON_A_BUS else "emulated_arm")
    shell = Shell(tmp_path, arm)
    for block in ALL[page]:
        if block.language != "console":
            continue
        for command, shown in commands(block.text):
            try:
                said = shell.run(command, whole=bool(shown))
            except KeyError as error:
                pytest.fail(f"{where(page, block.line)}: no test knows the program {error} (tests/site/shell.py)")
            if said is not None:
                lines = [plain(line) for line in said.splitlines()]
                assert [line for line in map(plain, shown) if line not in lines] == [], f"{command}: {said}"


# --- commands in sentences and tables ----------------------------------------------------------------------------

OWN_ARM = ("docs/adding-an-arm.md",)
"""Pages about an arm of another package, which `tests/test_foreign_arm.py` installs and tries."""
TABLES = [page for page in PAGES if page not in OWN_ARM and any(row.table for row in inline_commands(page))]
MADE_UP = re.compile(r"\b[A-Z]{4,}\b|\.\.\.|\|")
"""A word that stands for another one."""
NAMES = ("hexwire model ik", "hexwire fleet stop")
"""Of commands that do nothing without the words that follow, though each of those may be left out."""


@pytest.mark.parametrize("page", PAGES)
def test_commands_in_sentences_are_right(page: str) -> None:
    """Each exists and has these options; if it has arguments, it has all of them."""
    wrong = []
    for row in inline_commands(page):
        if re.search(r"\||\.\.\. ", row.command):
            continue  # several in one, or something left out in the middle
        for words in split(row.command.replace(" ...", "")):
            if words[0] != "hexwire":
                OTHERS[words[0]](words)
                continue
            try:
                complete = parse_mentioned(words)
            except click.UsageError as error:
                wrong.append(f"{where(page, row.line)}: {row.command}: {error.format_message()}")
            else:
                # What README tells to type has to be complete.
                if row.table and page == "README.md" and not complete:
                    wrong.append(f"{where(page, row.line)}: {row.command} is not complete")
    assert not wrong


@pytest.mark.system
@pytest.mark.parametrize("page", TABLES)
def test_commands_in_tables_run(page: str, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    shell = Shell(tmp_path, "")
    for row in inline_commands(page):
        words = split(row.command)[0]
        if not row.table or words[0] != "hexwire" or MADE_UP.search(row.command) or row.command in NAMES:
            continue
        if parse_mentioned(words):
            arm = request.getfixturevalue("bus_arm" if words[1] == "bus" else "emulated_arm")
            shell.arm = shell.env["HEXWIRE_PORT"] = arm
            shell.run(row.command)


# --- Python that pytest-markdown-docs does not run ---------------------------------------------------------------


@pytest.mark.parametrize(("page", "block"), NOTEST, ids=[where(page, block.line) for page, block in NOTEST])
def test_python_that_needs_a_real_port(page: str, block: object, request: pytest.FixtureRequest) -> None:
    text = block.text  # type: ignore[attr-defined]
    if page == "packages/zenoh-ros2/README.md":
        return  # its own test runs them as programs
    if page == "docs/ros.md":
        assert "find_ros()" in text, "tests/ros1/test_ros_page.py runs the program of the first move, and no other"
        return
    assert page in ON_A_BUS, "run it here, or without notest"
    exec(compile(text.replace("/dev/ttyACM0", request.getfixturevalue("bus_arm")), page, "exec"), {})


# --- files -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("page", [p for p in PAGES if p not in OWN and any(b.language == "toml" for b in ALL[p])])
def test_toml(page: str, tmp_path: Path) -> None:
    for block in ALL[page]:
        if block.language == "toml":
            table = tomllib.loads(block.text)
            if "steps" in table:
                (tmp_path / "program.toml").write_text(block.text)
                assert len(read_program(tmp_path / "program.toml").steps) > 1
            elif "name" in table:
                if "calibration" in table:
                    continue  # its second file is made by a calibration: tests/test_so101_page.py
                (tmp_path / "arm.toml").write_text(block.text)
                assert load_arm_file(tmp_path / "arm.toml").model.name == table["name"]
            else:
                assert set(table) in ({"poses"}, {"project"}), f"say what reads the file in {page}: {table}"


def test_channel_files(tmp_path: Path) -> None:
    for found in ALL.values():
        for block in found:
            if block.language == "conf":
                (tmp_path / "ipc_msg.conf").write_text(block.text)
                assert len(load_conf(tmp_path / "ipc_msg.conf")) > 0
