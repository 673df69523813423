"""`--json`: one document, or one line a sample, on standard output; nothing else there, and errors on the other."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result
from tests.cli.bus_cli import BusCli
from tests.cli.test_options import ALL, options_of
from tests.recorded import make_positions

from hexwire.cli.main import cli
from hexwire.trace.recording import RecordingWriter

ON_AN_ARM: dict[str, tuple[str, ...]] = {
    "state": (),
    "tip": (),
    "limits": (),
    "poses": (),
    "probe": (),
    "ping": (),
    "registers": ("J6", "id"),
    "move": ("J1=5",),
    "goto": ("0", "220", "200"),
    "line": ("0", "0", "10", "--relative", "--speed", "10", "--dry-run"),
    "play": ("{}/a.mcap",),
    "teach": ("{}/b.mcap", "--yes", "--duration", "0.2"),
    "torque": ("on",),
    "stop": (),
    "resume": (),
    "grip": ("open",),
    "pump": ("state",),
    "firmware info": (),
    "doctor": (),
}
ON_A_BUS = {
    "scan": ("--ids", "1-3"),
    "ping": ("1-3",),
    "read": ("1-3", "present_position"),
    "write": ("1", "torque_limit", "500"),
    "table": ("1",),
    "set-id": ("1", "9", "--yes"),
    "set-baud": ("2", "500000", "--yes"),
    "center": ("1", "--yes"),
    "recover": ("1",),
    "backup": ("1", "{}/b.json"),
    "wave": ("1", "--yes", "--seconds", "0.5"),
    "stress": ("1-3", "-n", "5"),
    "health": ("1-3",),
}
OFFLINE = {
    "ports": (),
    "joystick list": (),
    "conf check": ("{}/a.conf",),
    "cert new": ("{}/certs",),
    "record info": ("{}/a.mcap",),
    "record export": ("{}/a.mcap", "{}/a.csv"),
    "record recover": ("{}/a.mcap", "{}/c.mcap"),
    "record ros2": ("{}/a.mcap", "{}/bag"),
    "record plot": ("{}/a.mcap", "{}/a.svg"),
    "model fk": ("90", "100", "80", "90", "45", "90"),
    "model ik": ("0", "220", "200", "--rpy", "180", "0", "0"),
    "model check": ("90", "100", "80", "90", "45", "90"),
}
ELSEWHERE = {
    # A line a sample or frame, tested below; what differs or needs hardware is tested with its command.
    *("fleet list", "fleet watch", "fleet stop", "fleet record", "fleet play", "cert issue"),
    *(
        "bus monitor",
        "trace decode",
        "bus restore",
        "bus diff",
        "bus calibrate",
        "bus setup",
        "loopback",
        "firmware build",
    ),
    *("analyzers install", "analyzers list", "analyzers remove", "ioctl", "sim hand"),
}
WITHOUT = {
    # What they print is a document or an address for other programs, or they run until they are stopped.
    *(
        "model urdf",
        "model ros2-package",
        "conf convert",
        "sim board",
        "sim bus",
        "sim puma260",
        "record replay",
        "demo",
        "teleop",
        "follow",
        "gateway",
        "studio",
    ),
    *("joystick show", "joystick send", "firmware flash", "serve", "fleet router", "fleet config"),
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "a.conf").write_text("JOY_STICK CLIENT_TX ROS1_HOST UDP 127.0.0.1 15040\n")
    with RecordingWriter(tmp_path / "a.mcap") as writer:
        for i in range(20):
            writer.joint_state(make_positions(("J1", "J2"), (0.01 * i, 0.95 + 0.005 * i)), 1.7e9 + i / 10)
    return tmp_path


def one_document(result: Result) -> Any:
    assert not isinstance(result.exception, Exception), result.exception
    assert result.exit_code in (0, 1), result.stderr
    document = json.loads(result.stdout)
    assert not re.search(r"-0\.0[,\s]|e-1\d", result.stdout)
    assert isinstance(document, dict | list)
    return document


def filled(words: tuple[str, ...], folder: Path) -> list[str]:
    return [word.replace("{}", str(folder)) for word in words]


def test_every_command_is_in_one_of_the_lists() -> None:
    listed = {*ON_AN_ARM, *(f"bus {name}" for name in ON_A_BUS), *OFFLINE, *ELSEWHERE}
    assert listed | WITHOUT == set(ALL)
    assert {name for name, command in ALL.items() if "--json" in options_of(command)} == listed


@pytest.mark.parametrize("name", ON_AN_ARM)
def test_commands_on_an_arm(bench: Any, folder: Path, name: str) -> None:
    assert one_document(bench.run(*name.split(), *filled(ON_AN_ARM[name], folder), "--json"))


@pytest.mark.parametrize("name", ON_A_BUS)
def test_commands_on_a_bus(monkeypatch: pytest.MonkeyPatch, folder: Path, name: str) -> None:
    assert one_document(BusCli(monkeypatch).run(name, *filled(ON_A_BUS[name], folder), "--json"))


@pytest.mark.parametrize("name", OFFLINE)
def test_commands_without_hardware(folder: Path, name: str) -> None:
    one_document(CliRunner().invoke(cli, [*name.split(), *filled(OFFLINE[name], folder), "--json"]))


def test_settings_put_back_and_compared(monkeypatch: pytest.MonkeyPatch, folder: Path) -> None:
    bus = BusCli(monkeypatch)
    file = str(folder / "b.json")
    bus.ok("backup", "1", file)
    assert one_document(bus.run("diff", file, "--json")) == []
    bus.ok("write", "1", "max_temperature", "60")
    different = bus.run("diff", file, "--json")
    assert different.exit_code == 1
    assert one_document(different) == [{"id": 1, "register": "max_temperature", "servo": 60, "file": 70}]
    assert one_document(bus.run("restore", file, "--yes", "--json")) == [{"id": 1, "changed": ["max_temperature"]}]


def test_a_monitor_prints_a_line_a_sample(monkeypatch: pytest.MonkeyPatch) -> None:
    result = BusCli(monkeypatch).run("monitor", "1,2", "--seconds", "0.5", "--rate", "10", "--json")
    rows = [json.loads(line) for line in result.stdout.splitlines()]
    assert len(rows) >= 8
    assert {row["id"] for row in rows} == {1.0, 2.0}
    assert all("present_position" in row and "time_s" in row for row in rows)


def test_a_motion_that_fails_has_its_document_too(bench: Any) -> None:
    bench.ok("torque", "on")
    done = bench.json("goto", "0", "220", "200")
    assert (done["arrived"], done["plot"], len(done["legs"])) == (True, None, 1)
    assert bench.json("goto", "0", "220", "210", "--dry-run")["arrived"] is None
    bench.ok("stop")
    refused = bench.run("goto", "0", "220", "190", "--json")
    assert refused.exit_code == 1
    assert json.loads(refused.stdout)["arrived"] is False
    assert refused.stderr.startswith("error: ")
    assert refused.stderr.count("\n") == 1


def test_errors_go_to_the_other_stream(bench: Any) -> None:
    for words in (("move", "J9=5"), ("goto", "0", "9999", "0"), ("grip", "500"), ("bus", "read", "x", "y")):
        result = bench.run(*words, "--json")
        assert (result.exit_code, result.stdout) == (2, "")
        assert result.stderr.startswith("error: ")
        assert result.stderr.count("\n") == 1
