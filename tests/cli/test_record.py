"""`--record` on a command, and `hexwire record`."""

from __future__ import annotations

import csv
import json
import math
import subprocess
import sys
import time
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from tests.analyzers.lines import assembled
from tests.recorded import make_positions

from hexwire.cli.demo import board_process
from hexwire.cli.main import cli
from hexwire.trace.capture import BYTES, FRAMES
from hexwire.trace.recording import JOINT_STATES, RecordingWriter

NO_PORT = "no serial port on this machine; 'hexwire sim board' creates one with an emulated board\n"


def run(*args: str) -> Result:
    return CliRunner().invoke(cli, list(args))


def ok(*args: str) -> str:
    result = run(*args)
    assert (result.exit_code, result.stderr) == (0, ""), result.output
    return result.stdout


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of one `state` of an emulated arm."""
    path = tmp_path_factory.mktemp("record") / "state.mcap"
    with board_process(baud=0) as port:
        ok("state", "--record", str(path), "--port", port)
    return path


@pytest.mark.system
def test_a_command_is_recorded_in_all_layers(recorded: Path, tmp_path: Path) -> None:
    rows = {line.split()[0]: line.split()[1:] for line in ok("record", "info", str(recorded)).splitlines()}
    assert rows[JOINT_STATES] == ["foxglove.JointStates", "1"]
    assert rows[FRAMES][0] == "foxglove.Log"
    assert all(rows[topic][0] == "application/octet-stream" for topic in BYTES.values())
    target = tmp_path / "out.jsonl"
    assert ok("record", "export", str(recorded), str(target)).endswith(f"messages written to {target}\n")
    lines = [json.loads(line) for line in target.read_text().splitlines()]
    assert all(abs(line["time"] - time.time()) < 600 for line in lines)
    words = [line["message"]["message"] for line in lines if line["topic"] == FRAMES]
    assert any(text.startswith("2 IDENTIFY request seq ") for text in words)
    assert any(text.startswith("2 JOINT_STATE reply ok seq ") for text in words)
    assert bytes.fromhex(next(line["hex"] for line in lines if "hex" in line))[:4] == b"\x5a\xfa\xfa\x5a"


@pytest.mark.system
def test_joint_states_as_csv(recorded: Path, tmp_path: Path) -> None:
    target = tmp_path / "out.csv"
    assert ok("record", "export", str(recorded), str(target)) == f"1 states written to {target}\n"
    with target.open(newline="") as file:
        (row,) = csv.DictReader(file)
    assert math.degrees(float(row["J1.position"])) == pytest.approx(-4.47, abs=0.01)
    assert {name.partition(".")[0] for name in row} == {"time", *(f"J{i}" for i in range(1, 8))}


@pytest.mark.system
def test_the_traffic_opens_in_wireshark(recorded: Path, tmp_path: Path) -> None:
    target = tmp_path / "out.pcapng"
    ok("record", "export", str(recorded), str(target))
    script = assembled() / "wireshark/hexwire.lua"
    command = ["tshark", "-X", f"lua_script:{script}", "-r", str(target), "-T", "fields", "-e", "hexwire.reading"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    assert "2 IDENTIFY request seq " in done.stdout
    assert "2 JOINT_STATE reply ok seq " in done.stdout


@pytest.mark.system
def test_a_recording_is_decoded_like_any_other_traffic(recorded: Path) -> None:
    rows = [json.loads(line) for line in ok("trace", "decode", str(recorded), "--json").splitlines()]
    assert [row["kind"] for row in rows] == ["frame"] * len(rows)
    assert {row["direction"] for row in rows} == {"sent", "received"}


@pytest.mark.system
def test_a_cut_recording_is_mended(recorded: Path, tmp_path: Path) -> None:
    cut, target = tmp_path / "cut.mcap", tmp_path / "whole.mcap"
    cut.write_bytes(recorded.read_bytes()[:-200])
    assert "! the recording is truncated" in ok("record", "info", str(cut))
    result = run("record", "recover", str(cut), str(target))
    assert result.exit_code == 0
    assert f"messages saved to {target}" in result.stdout
    assert "!" not in ok("record", "info", str(target))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["cut.mcap", "whole.mcap"]


def test_a_message_of_brackets_only_is_not_exported(tmp_path: Path) -> None:
    source = tmp_path / "a.mcap"
    with RecordingWriter(source) as writer:
        writer.message(FRAMES, "foxglove.Log", 1.0, {"more": [[]] * 400_000})
    result = run("record", "export", str(source), str(tmp_path / "a.jsonl"))
    assert result.exit_code == 2
    assert result.stderr == f"error: {source}: message 1 has 1200010 bytes; no message has more than 1 MiB\n"
    assert not (tmp_path / "a.jsonl").exists()


def test_joint_states_as_a_picture(tmp_path: Path) -> None:
    source, target = tmp_path / "a.mcap", tmp_path / "a.svg"
    with RecordingWriter(source) as writer:
        for i in range(20):
            writer.joint_state(make_positions(("elbow", "wrist"), (0.1 * i, -0.05 * i)), 1.7e9 + i / 10)
    assert ok("record", "plot", str(source), str(target)) == f"20 states plotted to {target}\n"
    assert target.read_text().startswith("<?xml")
    again = run("record", "plot", str(source), str(target))
    assert (again.exit_code, again.stderr) == (2, f"error: {target} already exists; --force overwrites it\n")
    with RecordingWriter(source, force=True):
        pass
    drawn = target.read_bytes()
    result = run("record", "plot", str(source), str(target), "--force")
    assert (result.exit_code, result.stderr) == (2, f"error: {source} has no joint states\n")
    assert target.read_bytes() == drawn


def test_invalid_values_give_one_line(tmp_path: Path) -> None:
    text = tmp_path / "a.txt"
    text.write_text("hello")
    for args, words in (
        (("record", "info", str(text)), "is not a recording"),
        (("record", "export", str(text), "x.wav"), "must end in .csv, .jsonl or .pcapng"),
        (("record", "export", str(text), str(tmp_path / "no/x.csv")), "cannot be written"),
        (("record", "recover", str(text), str(text)), "another name"),
        (("record", "recover", str(text), str(tmp_path / "b.mcap")), "is not a recording"),
        (("ports", "--record", str(tmp_path / "no/x.mcap")), "cannot be written"),
    ):
        result = run(*args)
        assert result.exit_code == 2, args
        assert words in result.stderr
        assert result.stderr.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["a.txt"]


def test_the_option_may_stand_anywhere(tmp_path: Path) -> None:
    for i, args in enumerate((["--record", "{}", "ports"], ["ports", "--record={}"], ["ports", "--record", "{}"])):
        path = tmp_path / f"{i}.mcap"
        result = run(*(arg.format(path) for arg in args))
        # A machine without any port is told so, beside what was asked for.
        assert (result.exit_code, result.stderr.replace(NO_PORT, "")) == (0, ""), result.output
        assert path.read_bytes().startswith(b"\x89MCAP0\r\n")
    assert run("ports", "--record").exit_code == 2


@pytest.mark.system
def test_a_recording_answers_as_the_board_did(recorded: Path) -> None:
    program = [sys.executable, "-m", "hexwire.cli", "record", "replay", str(recorded)]
    with subprocess.Popen(program, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            port = process.stdout.readline().strip()
            state = json.loads(ok("state", "--json", "--port", port))
            refused = run("torque", "on", "--port", port)
        finally:
            process.terminate()
    assert round(state["joints"][0]["position_deg"], 5) == -4.47257
    assert refused.exit_code == 1
    assert "not supported" in refused.stderr
