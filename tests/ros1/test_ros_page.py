"""docs/ros.md and docs/ros-interface.md say what is true: its tables, its programs, its files."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from tests.ros1.ros_world import Arm

import hexwire.ros1
from hexwire.control.motion.goal_fields import ErrorCode
from hexwire.ros1.parameters import PARAMETERS
from hexwire.ros1.path import _NEEDED

ROOT = Path(__file__).resolve().parents[2]
PAGE = "\n".join((ROOT / "docs" / page).read_text(encoding="utf-8") for page in ("ros.md", "ros-interface.md"))
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


PACKAGE_OF = {
    "roscore": "python3-roslaunch",
    "roslaunch": "python3-roslaunch",
    "rosparam": "python3-rosparam",
    "rosrun": "rosbash",
    "rosservice": "python3-rosservice",
    "rostopic": "python3-rostopic",
    "robot_state_publisher": "ros-robot-state-publisher",
    "rviz": "rviz",
}


def test_the_apt_line_has_what_the_page_uses() -> None:
    (line,) = re.findall(r"apt-get install ((?:\\\n|.)*)", _section("Install"))
    installed = set(line.replace("\\\n", " ").split())
    programs = set(re.findall(r"\b(ros(?!_|1)[a-z]+|rqt\w*|rviz|robot_state_publisher)\b", PAGE)) - {
        "rosbash",
        "rospy",
    }
    assert programs <= PACKAGE_OF.keys(), "name the Debian package of each program"
    assert {PACKAGE_OF[name] for name in programs} <= installed
    # What the node imports, and the program of the first move.
    imported = {f"python3-{name.replace('_', '-')}" for name in _NEEDED if name != "yaml"}
    assert imported <= installed


@pytest.mark.slow
def test_names_are_those_that_the_node_offers(arm: Arm) -> None:
    rows = [line for line in _section("Topics, actions, services").splitlines() if line.startswith("| `")]
    names = {name for row in rows for name in re.findall(r"`(\S+)`", row.split("|")[1])}
    topics = set(arm.world.run("rostopic", "list").out.split())
    services = set(arm.world.run("rosservice", "list").out.split())
    offered = topics | services | {topic.removesuffix("/goal") for topic in topics}
    full = {re.sub("^~", "/hardware_interface/", name).replace("POSE", "home") for name in names}
    assert {name if name.startswith("/") else f"/{name}" for name in full} <= offered
    assert len(full) == 15


@pytest.mark.slow
def test_the_program_of_the_first_move_moves_the_arm(arm: Arm, tmp_path: Path) -> None:
    (program,) = re.findall(r"```python notest\n(.*?)```", _section("First move"), re.DOTALL)
    file = tmp_path / "first_move.py"
    file.write_text(program, encoding="utf-8")
    assert arm.world.run("python", str(file)).out == "0 there\n"
