"""`--record-ros2` on a command, and `hexwire record ros2`; rosbags reads the bags."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result
from tests.recorded import make_positions

from hexwire.cli.demo import board_process
from hexwire.cli.main import cli
from hexwire.trace.recording import RecordingWriter

NOW = 1_700_000_000.0


def run(*args: str) -> Result:
    return CliRunner().invoke(cli, list(args))


def read(folder: Path) -> dict[str, list[Any]]:
    from rosbags.highlevel import AnyReader

    found: dict[str, list[Any]] = {}
    with AnyReader([folder]) as reader:
        for each, _, data in reader.messages():
            found.setdefault(each.topic, []).append(reader.deserialize(data, each.msgtype))
    return found


@pytest.fixture
def recorded(tmp_path: Path) -> Path:
    """A recording with two joint states and a message that ROS 2 does not have."""
    path = tmp_path / "a.mcap"
    names = ("J1", "J2", "J3", "J4", "J5", "J6")
    with RecordingWriter(path) as writer:
        for i in range(2):
            writer.joint_state(make_positions(names, [0.1 * i] * 6), NOW + i)
        writer.message("/clock", "hexwire.Clock", NOW, {"offset": 0.5})
    return path


@pytest.mark.system
def test_a_command_is_recorded_in_a_bag_with_the_description_of_its_arm(tmp_path: Path) -> None:
    folder = tmp_path / "bag"
    with board_process(baud=0) as port:
        result = run("state", "--record-ros2", str(folder), "--port", port)
    assert (result.exit_code, result.stderr) == (0, ""), result.output
    found = read(folder)
    (state,) = found["/joint_states"]
    assert state.name[:6] == ["J1", "J2", "J3", "J4", "J5", "J6"]
    assert len(state.position) == len(state.velocity) == len(state.name)
    assert len(found["/dynamic_joint_states"]) == 1
    (description,) = found["/robot_description"]
    assert '<robot name="hex7bot">' in description.data
    assert any("IDENTIFY request" in log.msg for log in found["/frames"])
    assert bytes(found["/bytes/sent"][0].data)[:4] == b"\x5a\xfa\xfa\x5a"


def test_a_recording_is_converted(recorded: Path, tmp_path: Path) -> None:
    folder = tmp_path / "bag"
    result = run("record", "ros2", str(recorded), str(folder), "--robot", "puma260")
    assert result.exit_code == 0
    assert result.stdout == f"5 messages written to {folder}\n"
    assert result.stderr == "left out: 1 messages of hexwire.Clock, which has no counterpart in ROS 2\n"
    found = read(folder)
    assert [state.position.tolist() for state in found["/joint_states"]] == [[0.0] * 6, [0.1] * 6]
    assert '<robot name="puma260">' in found["/robot_description"][0].data


def test_without_a_robot_there_is_no_description(recorded: Path, tmp_path: Path) -> None:
    result = run("record", "ros2", str(recorded), str(tmp_path / "bag"), "--json")
    assert json.loads(result.stdout) == {
        "count": 4,
        "folder": str(tmp_path / "bag"),
        "left_out": {"hexwire.Clock": 1},
    }
    assert "/robot_description" not in read(tmp_path / "bag")


def test_what_exists_is_overwritten_by_force_only(recorded: Path, tmp_path: Path) -> None:
    folder = str(tmp_path / "bag")
    assert run("record", "ros2", str(recorded), folder).exit_code == 0
    again = run("record", "ros2", str(recorded), folder)
    assert (again.exit_code, again.stderr) == (2, f"error: {folder} already exists; --force overwrites it\n")
    assert run("record", "ros2", str(recorded), folder, "--force").exit_code == 0


def test_a_file_that_is_no_recording_leaves_no_bag(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("x")
    result = run("record", "ros2", str(tmp_path / "a.txt"), str(tmp_path / "bag"))
    assert result.exit_code == 2
    assert "is not a recording" in result.stderr
    assert not (tmp_path / "bag").exists()


def test_a_robot_without_a_geometry_is_refused(recorded: Path, tmp_path: Path) -> None:
    result = run("record", "ros2", str(recorded), str(tmp_path / "bag"), "--robot", "sevenbot")
    assert result.exit_code == 2
    assert "no geometry is known for robot 'sevenbot'" in result.stderr


def test_a_command_makes_one_kind_of_recording(tmp_path: Path) -> None:
    result = run("--record", str(tmp_path / "a.mcap"), "--record-ros2", str(tmp_path / "bag"), "ports")
    assert result.exit_code == 2
    assert "'hexwire record ros2' converts a recording later" in result.stderr
    assert list(tmp_path.iterdir()) == []


def test_a_bag_that_cannot_be_made_ends_a_command_before_it_begins(tmp_path: Path) -> None:
    (tmp_path / "bag").mkdir()
    result = run("ports", "--record-ros2", str(tmp_path / "bag"))
    assert (result.exit_code, result.stdout) == (2, "")
    assert "already exists; --force overwrites it" in result.stderr


def test_a_command_that_reads_no_state_leaves_no_bag_behind_an_error(tmp_path: Path) -> None:
    result = run("--record-ros2", str(tmp_path / "bag"), "--force", "state", "--port", str(tmp_path / "no-port"))
    assert result.exit_code == 1
    assert not (tmp_path / "bag").exists()
