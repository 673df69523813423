from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from hexwire.cli.main import cli

# As printed in the chapter, section 9.2.
CHAPTER = Path(__file__).parents[1] / "ipc" / "ipc_msg.conf"

REST = 'destination = "ROS1_HOST"\ninterface = "QUEUE"\naddress = "/q"\n'


def run(*words: str | Path) -> Result:
    return CliRunner().invoke(cli, ["conf", *map(str, words)])


def test_the_chapters_file_as_a_table() -> None:
    result = run("check", CHAPTER)
    assert (result.exit_code, result.stderr) == (0, "")
    head, first, second, *_ = result.stdout.splitlines()
    assert head.split() == ["line", "module", "direction", "destination", "interface", "opens"]
    assert first.split()[1:] == [
        "PUMA260_HOST_IO_TRX",
        "CLIENT_TRX",
        "PUMA260_RBT_IO_SVR",
        "TCP",
        "tcp://192.168.1.175:15030",
    ]
    assert second.split()[-1] == "tcp://192.168.2.35:15030"
    assert result.stdout.endswith("ipc_msg.conf: 2 channels, no error\n")


def test_json() -> None:
    rows = json.loads(run("check", CHAPTER, "--json").stdout)
    assert rows[0] == {
        "module": "PUMA260_HOST_IO_TRX",
        "direction": "CLIENT_TRX",
        "destination": "PUMA260_RBT_IO_SVR",
        "interface": "TCP",
        "address": "192.168.1.175",
        "port": 15030,
        "peer": None,
        "line": 4,
        "url": "tcp://192.168.1.175:15030",
    }


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("JOY_STICK CLIENT_TX ROS1_HOST\n   UDPP 127.0.0.1 1\n", "2:4"),
        ("JOY_STICK CLIENT_TX ROS1_HOST UDP 127.0.0.1 99999\n", "1:45"),
        ("JOY_STICK CLIENT_TX ROS1_HOST UDP 127.0.0.1 1\nJOY_STICK CLIENT_TX ROS1_HOST UDP 127.0.0.1 2\n", "2:1"),
        ('[[channel]]\nmodule = "JOY_STICK"\ndirection = "UP"\n' + REST, "3:13"),
    ],
)
def test_an_error_has_file_line_and_column(tmp_path: Path, text: str, place: str) -> None:
    file = tmp_path / "ipc_msg.conf"
    file.write_text(text)
    for words in (("check", file), ("convert", file, tmp_path / "out.toml")):
        result = run(*words)
        assert result.exit_code == 2
        assert result.stderr.startswith(f"error: {file}:{place}: ")
        assert result.stderr.count("\n") == 1
    assert not (tmp_path / "out.toml").exists()


def test_there_and_back(tmp_path: Path) -> None:
    toml, back = tmp_path / "ipc.toml", tmp_path / "back.conf"
    assert run("convert", CHAPTER, toml).exit_code == 0
    assert toml.read_text().startswith('[[channel]]\nmodule = "PUMA260_HOST_IO_TRX"\n')
    assert run("convert", toml, back).exit_code == 0
    shown = [run("check", file, "--json").stdout for file in (CHAPTER, toml, back)]
    rows = [[row | {"line": None} for row in json.loads(text)] for text in shown]
    assert rows[0] == rows[1] == rows[2]
    assert run("convert", CHAPTER, "-").stdout == toml.read_text()
    assert run("convert", toml, "-").stdout == back.read_text()


def test_nothing_is_written_over_unasked(tmp_path: Path) -> None:
    toml = tmp_path / "ipc.toml"
    toml.write_text("# mine\n")
    result = run("convert", CHAPTER, toml)
    assert result.exit_code == 2
    assert "already exists; --force overwrites it" in result.stderr
    assert toml.read_text() == "# mine\n"
    assert run("convert", CHAPTER, toml, "--force").exit_code == 0
    assert "JNT_CMD" in toml.read_text()


def test_files_that_are_not_there(tmp_path: Path) -> None:
    result = run("check", tmp_path / "none.conf")
    assert result.exit_code == 2
    assert "cannot be read: No such file" in result.stderr
    result = run("convert", CHAPTER, tmp_path / "no" / "ipc.toml")
    assert result.exit_code == 2
    assert f"{tmp_path / 'no' / 'ipc.toml'} cannot be written: there is no such folder" in result.stderr


def test_an_empty_file(tmp_path: Path) -> None:
    file = tmp_path / "ipc_msg.conf"
    file.write_text("# nothing yet\n")
    assert run("check", file).stdout == f"{file}: 0 channels, no error\n"
