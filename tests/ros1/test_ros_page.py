"""docs/ros.md says what is true: its tables, its programs, its files."""

from __future__ import annotations

import re
from pathlib import Path

from tests.ros1.ros_world import Arm

import hexwire.ros1
from hexwire.ros1.goals import ErrorCode
from hexwire.ros1.parameters import PARAMETERS

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "ros.md").read_text(encoding="utf-8")
PACKAGE = Path(hexwire.ros1.__file__).resolve().parent / "share" / "hexwire"


def _section(title: str) -> str:
    return PAGE.split(f"\n## {title}\n")[1].split("\n## ")[0]


def test_parameters_are_all_there_with_defaults_and_bounds() -> None:
    rows = []
    for row in PARAMETERS:
        limits = f"{row.bounds} {row.unit}".strip()
        words = f"{row.help} ({limits})" if limits else row.help
        rows.append(f"| `{row.name}` | `{row.default_text}` | {words} |")
    listed = [line for line in _section("Parameters").splitlines() if line.startswith("| `")]
    assert listed == rows


def test_error_codes_have_their_numbers() -> None:
    told = dict(re.findall(r"([A-Z_]{8,}) \((-\d)\)", PAGE))
    assert told == {code.name: str(code.value) for code in ErrorCode if code is not ErrorCode.SUCCESSFUL}


def test_launch_files_that_are_named_exist() -> None:
    named = set(re.findall(r"roslaunch hexwire (\S+\.launch)", PAGE))
    assert named == {path.name for path in (PACKAGE / "launch").glob("*.launch")}
    for path in re.findall(r"\bhexwire/launch/(\S+\.xml)", PAGE):
        assert (PACKAGE / "launch" / path).is_file()


def test_names_are_those_that_the_node_offers(arm: Arm) -> None:
    table, _, _ = _section("Topics, actions, services").partition("| trajectory, as a goal or on `command` |")
    rows = [line for line in table.splitlines() if line.startswith("| `")]
    names = {name for row in rows for name in re.findall(r"`(\S+)`", row.split("|")[1])}
    topics = set(arm.world.run("rostopic", "list").out.split())
    services = set(arm.world.run("rosservice", "list").out.split())
    offered = topics | services | {topic.removesuffix("/goal") for topic in topics}
    full = {re.sub("^~", "/hardware_interface/", name).replace("POSE", "home") for name in names}
    assert {name if name.startswith("/") else f"/{name}" for name in full} <= offered
    assert len(full) == 14


def test_the_program_of_the_first_move_moves_the_arm(arm: Arm, tmp_path: Path) -> None:
    (program,) = re.findall(r"```python notest\n(.*?)```", _section("First move"), re.DOTALL)
    file = tmp_path / "first_move.py"
    file.write_text(program, encoding="utf-8")
    assert arm.world.run("python", str(file)).out == "0 there\n"
