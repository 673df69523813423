from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from hexwire.bus.servo_bus import ServoBus
from hexwire.cli.main import cli
from hexwire.emulator import serve_pty
from hexwire.emulator.servo import EmulatedServo
from hexwire.emulator.servo_motion import Motion
from hexwire.link.serial import SerialLink


@pytest.mark.parametrize(
    "words",
    [
        ("--ids", "x"),
        ("--ids", "9" * 5000),
        ("--series", "stx"),
        ("--series", "scs,hls"),
        ("--baud", "9600"),
        ("--baud", "9" * 5000),
        ("--fault", "x"),
        ("--fault", "reset:3"),
        ("--arm", "so102"),
        ("--arm", "so101", "--ids", "1-6"),
        ("--arm", "so101", "--series", "sts"),
        ("--arm", "so101", "--baud", "500000"),
        ("--leader",),
        ("--physics",),
    ],
)
def test_invalid_values_are_refused(words: tuple[str, ...]) -> None:
    result = CliRunner().invoke(cli, ["sim", "bus", *words])
    assert result.exit_code == 2
    assert len(result.stderr.splitlines()) == 1


def test_an_arm_has_its_servos_and_names(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[list[EmulatedServo], dict[str, Any]]] = []
    monkeypatch.setattr(serve_pty, "serve_bus", lambda servos, **rest: asked.append((servos, rest)))
    for words in (["--arm", "so101", "--physics"], ["--arm", "so100", "--leader", "--baud", "0"], ["--ids", "1,2"]):
        assert CliRunner().invoke(cli, ["sim", "bus", *words]).exit_code == 0
    follower, leader, plain = asked
    assert [servo.servo_id for servo in follower[0]] == [1, 2, 3, 4, 5, 6]
    assert [type(servo.motion) is Motion for servo in (follower[0][0], leader[0][0])] == [False, True]
    assert follower[1]["arm"].names[2] == "elbow_flex"
    assert (follower[1]["baud"], leader[1]["baud"]) == (1_000_000, 0)
    assert leader[0][0].motion.mechanics.max_speed > 1.5 * follower[0][0].motion.mechanics.max_speed
    assert (plain[1]["arm"], len(plain[0])) == (None, 2)


@pytest.mark.system
def test_it_serves_until_standard_input_ends(tmp_path: Path) -> None:
    link = tmp_path / "bus"
    command = [
        sys.executable,
        "-m",
        "hexwire.cli",
        "sim",
        "bus",
        "--ids",
        "1,2",
        "--series",
        "hls,scs",
        "--baud",
        "0",
    ]
    command += ["--echo", "--fault", "silent:2", "--link", str(link), "--until-eof"]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    with process:
        assert process.stdin is not None
        assert process.stdout is not None
        assert process.stdout.readline().strip() == str(link)
        with ServoBus(SerialLink(str(link)), series="hls") as bus:
            assert bus.ping(1).ok
            assert bus.ping(2).error
            assert bus.echo is True
        process.stdin.close()
        assert process.wait(30) == 0
    assert not link.exists()
