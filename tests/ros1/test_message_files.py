"""Packages of messages on disk, for programs that do not know hexwire."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
from tests.ros1.ros_world import ROS_PYTHON, Arm, PtyBoard, World
from tests.ros1.test_messages import CHECKSUMS

from hexwire.errors import UsageError
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.ros1.message_files import write_messages
from hexwire.ros1.messages import PACKAGES, SERVICES

_SUMS = """
import json, importlib, sys
found = {}
for package in ("control_msgs", "osrf_msgs"):
    for kind in ("msg", "srv"):
        try:
            module = importlib.import_module(f"{package}.{kind}")
        except ImportError:
            continue
        assert module.__file__.startswith(sys.argv[1]), module.__file__
        found |= {f"{package}/{name}": c._md5sum for name, c in vars(module).items() if hasattr(c, "_md5sum")}
print(json.dumps(found))
"""


def _write(folder: Path) -> str:
    command = [sys.executable, "-m", "hexwire.cli.ros1", "--messages", str(folder)]
    return subprocess.run(command, check=True, capture_output=True, text=True, timeout=60).stdout


def test_another_python_has_the_same_messages(tmp_path: Path) -> None:
    folder = tmp_path / "a folder"
    said = _write(folder)
    assert said.splitlines()[:2] == [str(folder / "control_msgs"), str(folder / "osrf_msgs")]
    line = said.splitlines()[2]
    for before, after in (({}, str(folder)), ({"PYTHONPATH": "/a:/b"}, f"{folder}:/a:/b")):
        shell = ["sh", "-c", f'{line}; printf %s "$PYTHONPATH"']
        assert subprocess.run(shell, check=True, capture_output=True, text=True, env=before).stdout == after
    out = subprocess.run(
        [ROS_PYTHON, "-c", _SUMS, str(folder)],
        check=True,
        capture_output=True,
        text=True,
        timeout=60,
        env={"PYTHONPATH": str(folder)},
    ).stdout
    found = json.loads(out)
    wanted = {f"{p}/{name}": checksum for p, rows in PACKAGES.items() for name, (checksum, _) in rows.items()}
    wanted |= {f"{p}/{name}": checksum for p, rows in SERVICES.items() for name, (checksum, _, _) in rows.items()}
    assert wanted.items() <= found.items()
    assert {f"control_msgs/{name}": checksum for name, checksum in CHECKSUMS.items()}.items() <= found.items()


@pytest.mark.slow
def test_rostopic_shows_what_the_node_publishes_by_them(arm: Arm, tmp_path: Path) -> None:
    _write(tmp_path / "made")
    path = str(tmp_path / "made")
    shown = arm.world.run("rostopic", "echo", "-n1", f"{arm.namespace}state/joint_names", PYTHONPATH=path)
    assert "J7" in shown.out
    asked = arm.world.run("rosservice", "call", f"{arm.namespace}query_state", "0", PYTHONPATH=path)
    assert "velocity" in asked.out


@pytest.mark.slow
def test_a_node_that_finds_them_installed_does_the_same(world: World, tmp_path: Path) -> None:
    _write(tmp_path / "made")
    board = PtyBoard(tmp_path / "board")
    try:
        node = world.node(f"_port:={board.port}", "__ns:=found", PYTHONPATH=str(tmp_path / "made"))
        assert world.client.query(service="/found/query_state", delay=0.0).get("name") == list(HEX7BOT.names)
        action = "/found/follow_joint_trajectory"
        assert world.client.send_wrong(action=action, times=1) == {"REJECTED": 1}
        assert node.end() == 0
    finally:
        board.close()


def test_what_is_there_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "osrf_msgs").mkdir()
    with pytest.raises(UsageError, match=r"osrf_msgs exists; remove it first"):
        write_messages(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["osrf_msgs"]
    (tmp_path / "dangling").mkdir()
    (tmp_path / "dangling" / "control_msgs").symlink_to("nowhere")
    with pytest.raises(UsageError, match="exists"):
        write_messages(tmp_path / "dangling")


def test_a_folder_that_cannot_be_made_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    command = [sys.executable, "-m", "hexwire.cli.ros1", "--messages", str(tmp_path / "file" / "below")]
    ended = subprocess.run(command, check=False, capture_output=True, text=True, timeout=60)
    assert ended.returncode == 1
    assert re.fullmatch(r".*cannot write \S+/file/below\S*: Not a directory\n", ended.stderr)
