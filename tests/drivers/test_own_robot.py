"""Robots of other packages are found; those of the pages are installed for the purpose."""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Mapping
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from tests.packages import install

from hexwire.cli.main import cli
from hexwire.drivers.base import RobotDriver
from hexwire.drivers.registry import connect, load_driver, robot_names
from hexwire.errors import LinkNotFoundError, UsageError

DOCS = Path(__file__).parents[2] / "docs"
PAGE = "\n".join((DOCS / page).read_text(encoding="utf-8") for page in ("adding-a-robot.md", "robot-on-a-line.md"))


@pytest.fixture
def page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of packages; what is imported from it is forgotten afterwards."""
    monkeypatch.syspath_prepend(tmp_path)
    for name in [name for name in sys.modules if name.partition(".")[0] == "swing"]:
        monkeypatch.delitem(sys.modules, name)
    return tmp_path


def put(folder: Path, entries: Mapping[str, str], code: str) -> None:
    install(folder, "swing", {"hexwire.robots": entries}, {"swing/__init__.py": "", "swing/driver.py": code})


def drivers() -> str:
    """The blocks of the pages up to the second driver, without what is tried and tested in between."""
    blocks = re.findall(r"```python[^\n]*\n(.*?)```", PAGE, re.DOTALL)
    last = next(i for i, block in enumerate(blocks) if "class SwingDriver" in block)
    return "\n".join(
        block for block in blocks[: last + 1] if not block.startswith("with ") and "Conformance" not in block
    )


def test_the_robots_of_the_pages_are_found(page: Path) -> None:
    put(page, dict(re.findall(r'^(\w+) = "(swing\..*)"$', PAGE, re.MULTILINE)), drivers())
    assert {"hex7bot", "puma260", "pretend", "swing"} <= set(robot_names())
    driver = load_driver("swing")
    assert (driver.__name__, driver.model.names) == ("SwingDriver", ("J1", "J2"))
    assert load_driver("pretend").__name__ == "PretendDriver"
    # And by the command line, which gets as far as a port that is not there.
    result = CliRunner().invoke(cli, ["--robot", "swing", "state", "--port", "/dev/none"])
    assert (result.exit_code, "/dev/none" in result.stderr) == (1, True)
    with pytest.raises(LinkNotFoundError):
        connect("/dev/none", robot="swing")


def test_the_whole_contract_is_small_and_a_driver_of_it_short() -> None:
    members = {name for name in vars(RobotDriver) if not name.startswith("_")} | set(RobotDriver.__annotations__)
    members = {name for name in members if not name.startswith("_")}
    assert len(members) <= 30, sorted(members)
    classes = [node for node in ast.walk(ast.parse(drivers())) if isinstance(node, ast.ClassDef)]
    lines = {
        node.name: (node.end_lineno or 0) - node.lineno + 1 for node in classes if node.name.endswith("Driver")
    }
    assert lines.keys() == {"PretendDriver", "SwingDriver"}
    assert max(lines.values()) < 80, lines


@pytest.mark.slow
def test_a_robot_without_a_session_works_with_the_command_line(page: Path) -> None:
    put(page, {"pretend": "swing.driver:PretendDriver"}, drivers())
    run = CliRunner()

    def hexwire(*words: str) -> Result:
        return run.invoke(cli, ["--robot", "pretend", *words, "--port", "nowhere"])

    for words in (
        ["state"],
        ["probe"],
        ["torque", "on"],
        ["stop"],
        ["resume"],
        ["doctor"],
        ["move", "J1=10", "--wait"],
    ):
        result = hexwire(*words)
        assert (result.exit_code, result.exception) == (0, None), (words, result.output)
    assert "J1" in hexwire("state").stdout
    refused = hexwire("ping")
    assert refused.exit_code == 1
    assert "cannot be pinged one by one" in str(refused.stderr)


def test_what_is_no_driver_is_refused(page: Path) -> None:
    put(page, {"swing": "swing.driver:SwingDriver"}, "SwingDriver = dict")
    with pytest.raises(UsageError, match="of robot 'swing' is not a RobotDriver class"):
        load_driver("swing")
