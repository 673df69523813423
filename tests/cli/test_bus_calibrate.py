from __future__ import annotations

import io
import json
import os
import select
import sys
import termios
from pathlib import Path
from types import SimpleNamespace

import pytest
from click.testing import CliRunner, Result
from tests.control.so_bench import NAMES, SoBench

from hexwire.cli import bus_calibrate
from hexwire.cli.main import cli
from hexwire.drivers.arm_file import load_arm_file
from hexwire.drivers.stop_memory import StopMemory
from hexwire.errors import UsageError
from hexwire.link import open as link_open
from hexwire.model.calibration import Calibration
from hexwire.setup import auto_calibration
from hexwire.setup.auto_calibration import AutoCalibration

ROW = {"id": 1, "drive_mode": 0, "homing_offset": -1470, "range_min": 758, "range_max": 3291}


class CalibrateCli:
    """Runs `hexwire bus calibrate so101` on an emulated arm in simulated time."""

    def __init__(
        self, monkeypatch: pytest.MonkeyPatch, *, pose: int | None = None, bench: SoBench | None = None
    ) -> None:
        self.parts = bench or SoBench(7, pose)
        self.turns = iter(range(10_000))
        self.enters = {150, 151}
        """Turns of the loop in which Enter is pressed."""
        self.plug_in(monkeypatch)

    def plug_in(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """Make this arm the one that every port leads to."""
        clock = self.parts.link.clock
        monkeypatch.setattr(link_open, "make_link", lambda url: self.parts.link)
        # Less time to simulate; test_calibrating has the real speeds.
        monkeypatch.setattr(auto_calibration, "_FAST", 900.0)
        monkeypatch.setattr(auto_calibration, "_SLOW", 300.0)
        monkeypatch.setattr(bus_calibrate, "time", SimpleNamespace(monotonic=clock, sleep=clock.advance))
        monkeypatch.setattr(bus_calibrate, "_entered", self.entered)

    def entered(self, seconds: float) -> bool:
        """Move every joint a little further toward both of its stops, one after the other."""
        turn = next(self.turns)
        for name, servo in zip(NAMES, self.parts.arm.servos, strict=True):
            low, high = self.parts.sensor(name) if name != "wrist_roll" else (0.0, 2000.0)
            wanted = low if turn < 60 else high
            motion = servo.motion
            motion.position += max(-100.0, min(100.0, wanted - motion.position))
        self.parts.link.clock.advance(seconds)
        return turn in self.enters

    def run(self, *words: str, answer: str | None = None) -> Result:
        return CliRunner().invoke(cli, ["bus", "calibrate", *words, "--port", "/dev/ttyTEST"], input=answer)


def test_by_hand(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    arm = CalibrateCli(monkeypatch, pose=3)
    file = tmp_path / "cal.toml"
    result = arm.run("so101", str(file), answer="\n\n")
    assert result.exit_code == 0, result.output
    assert "torque will be switched off: hold the arm" in result.stderr
    assert "put wrist_roll in its middle" in result.stderr
    assert "offsets and limits are stored in all servos" in result.stderr
    assert f"6 joints saved to {file}" in result.stdout
    found = Calibration.parse(file.read_text())
    assert found.arm == "so101"
    assert found.taken
    for row, servo in zip(found.joints, arm.parts.arm.servos, strict=True):
        assert (row.model, row.firmware) == ("sts3215", "3.10")
        assert servo.registers.stored("position_offset") == row.servo_offset
        if row.name != "wrist_roll":
            low, high = arm.parts.sensor(row.name)
            assert row.high - row.low == pytest.approx(high - low, abs=2)
    (tmp_path / "left.toml").write_text('name = "left"\nbase = "so101"\ncalibration = "cal.toml"\n')
    assert load_arm_file(tmp_path / "left.toml").calibration == found
    assert arm.run("so101", str(file)).exit_code == 2


def test_enter_too_early_says_what_is_missing(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    arm = CalibrateCli(monkeypatch)
    # Once before anything has moved, once on the way, and twice in a row.
    arm.enters = {0, 40, 41}
    result = arm.run("so101", str(tmp_path / "cal.toml"), "--yes", answer="\n")
    early, late = [line for line in result.stderr.splitlines() if line.startswith("still missing")][:2]
    assert "shoulder_pan not moved yet" in early
    assert "Enter accepts" not in early
    assert "go to both ends" in late
    assert late.endswith("(Enter accepts it as it is)")
    assert result.exit_code == 0, result.output


def test_a_time_instead_of_enter(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    arm = CalibrateCli(monkeypatch)
    result = arm.run("so101", str(tmp_path / "cal.toml"), "--yes", "--seconds", "2", answer="\n")
    assert result.exit_code == 2
    assert "shoulder_pan not moved yet" in result.stderr
    assert not (tmp_path / "cal.toml").exists()
    assert [servo.registers.stored("position_offset") for servo in arm.parts.arm.servos] == [0] * 6


def test_without_a_file_it_makes_up_a_name_and_overwrites_nothing(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    arm = CalibrateCli(monkeypatch)
    result = arm.run("so101")
    first, second = tmp_path / "so101-calibration.toml", tmp_path / "so101-calibration-2.toml"
    assert (result.exit_code, result.stdout) == (0, f"6 joints saved to {first}\n"), result.output
    before = first.read_bytes()
    result = arm.run("so101", "--from", str(first))
    assert (result.exit_code, result.stdout) == (0, f"6 joints saved to {second}\n"), result.output
    assert first.read_bytes() == before
    assert arm.run("so101", "--from", str(second), "--force").stdout == f"6 joints saved to {first}\n"
    assert sorted(each.name for each in tmp_path.iterdir()) == [second.name, first.name]


@pytest.mark.slow
def test_automatic_into_a_file_of_lerobot(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    arm = CalibrateCli(monkeypatch)
    file = tmp_path / "follower.json"
    assert "There is no terminal to answer on" in arm.run("so101", str(file), "--auto").stderr
    assert arm.run("so101", str(file), "--auto", answer="n\n").exit_code == 130
    assert not any(servo.torque_on for servo in arm.parts.arm.servos)
    result = arm.run("so101", str(file), "--auto", "--yes", "--json")
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout) == {"file": str(file), "joints": list(NAMES)}
    assert "elbow_flex: looks for its upper stop\n" in result.stderr
    theirs = json.loads(file.read_text())
    assert theirs["wrist_roll"]["range_max"] == 4095
    for servo, (name, row) in zip(arm.parts.arm.servos, theirs.items(), strict=True):
        stored = servo.registers.stored
        assert row == {
            "id": NAMES.index(name) + 1,
            "drive_mode": 0,
            "homing_offset": stored("position_offset"),
            "range_min": stored("min_position_limit"),
            "range_max": stored("max_position_limit"),
        }


def test_ctrl_c_leaves_the_arm_without_torque(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    arm = CalibrateCli(monkeypatch)
    judge = AutoCalibration.judge

    def interrupted(auto: AutoCalibration, *words: object) -> None:
        judge(auto, *words)  # type: ignore[arg-type]
        if auto.step == 1:
            raise KeyboardInterrupt

    monkeypatch.setattr(AutoCalibration, "judge", interrupted)
    result = arm.run("so101", str(tmp_path / "cal.toml"), "--auto", "--yes")
    assert result.exit_code == 130
    assert "ended: torque is off, nothing was saved" in result.stderr
    assert not any(servo.torque_on for servo in arm.parts.arm.servos)
    assert not (tmp_path / "cal.toml").exists()


@pytest.mark.parametrize("enters", [0, 1])
def test_ctrl_c_at_a_question_ends_it(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, enters: int) -> None:
    class Keyboard(io.StringIO):
        def isatty(self) -> bool:
            return True

        def readline(self, size: int | None = -1) -> str:
            if next(pressed) >= enters:
                raise KeyboardInterrupt
            return "\n"

    pressed = iter(range(10))
    arm = CalibrateCli(monkeypatch)
    for servo in arm.parts.arm.servos:
        servo.registers.write(servo.registers.rows["torque_enable"].address, b"\x01")
    monkeypatch.setattr(bus_calibrate, "sys", SimpleNamespace(stdin=Keyboard(), platform=sys.platform))
    result = arm.run("so101", str(tmp_path / "cal.toml"))
    assert result.exit_code == 130
    assert ("torque is off, nothing was saved" in result.stderr) == (enters == 1)
    # Nobody has said yet that the arm is held.
    assert {servo.torque_on for servo in arm.parts.arm.servos} == {enters == 0}


def test_a_stopped_arm_is_not_calibrated(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    arm = CalibrateCli(monkeypatch)
    monkeypatch.setattr(StopMemory, "stopped", True)
    for words in ((), ("--auto", "--yes")):
        result = arm.run("so101", str(tmp_path / "cal.toml"), *words)
        assert result.exit_code == 1
        assert "was not sent: the arm is stopped; `hexwire resume` ends that" in result.stderr


def test_a_lerobot_file_is_taken_over_and_given_back(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    arm = CalibrateCli(monkeypatch)
    theirs, mine, again = tmp_path / "follower.json", tmp_path / "cal.toml", tmp_path / "again.json"
    theirs.write_text(json.dumps({"shoulder_pan": ROW}))
    result = arm.run("so101", str(mine), "--lerobot", str(theirs))
    assert "1 joint saved" in result.stdout
    missing = "shoulder_lift, elbow_flex, wrist_flex, wrist_roll, gripper"
    assert result.stderr == f"warning: {theirs} has no {missing}: not calibrated\n"
    found = Calibration.parse(mine.read_text())
    assert (found.arm, found.joints[0].middle, found.joints[0].turn) == ("so101", 2024.5, 4095)
    assert arm.parts.arm.servos[0].registers.stored("position_offset") == 0
    result = arm.run("so101", str(again), "--from", str(mine), "--store")
    assert "offsets and limits are stored in all servos" in result.stderr
    assert json.loads(again.read_text()) == {"shoulder_pan": ROW}
    assert arm.parts.arm.servos[0].registers.stored("position_offset") == -1470
    result = arm.run("so101", str(again), "--from", str(mine), "--store", "--force")
    assert "the servos have these values already" in result.stderr
    theirs.write_text(json.dumps({"elbow": ROW}))
    assert "no joint 'elbow'" in arm.run("so101", str(tmp_path / "x.toml"), "--from", str(theirs)).stderr


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--from", "F", "--auto"), "--auto and --seconds do not apply"),
        (("--from", "F", "--seconds", "3"), "--auto and --seconds do not apply"),
        (("--auto", "--seconds", "3"), "leave out --seconds"),
        (("--store",), "--store is for --from"),
    ],
)
def test_options_that_contradict_each_other(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, words: tuple[str, ...], said: str
) -> None:
    (tmp_path / "F").write_text("")
    monkeypatch.chdir(tmp_path)
    result = CalibrateCli(monkeypatch).run("so101", "cal.toml", *words)
    assert result.exit_code == 2
    assert said in result.stderr


def test_an_arm_that_is_not_on_a_servo_bus(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    assert CalibrateCli(monkeypatch).run("hex7bot", str(tmp_path / "x.toml")).exit_code == 2


def test_the_plan_is_known_to_the_view() -> None:
    auto = AutoCalibration(SoBench().described.model)
    rows = bus_calibrate._auto_rows(auto)
    assert rows[3] == ("wrist_flex", "-", "", "looks for its lower stop")


def test_enter_on_standard_input(monkeypatch: pytest.MonkeyPatch) -> None:
    reader, writer = os.pipe()
    with os.fdopen(reader) as stdin:
        monkeypatch.setattr("sys.stdin", stdin)
        assert not bus_calibrate._entered(0.0)
        os.write(writer, b"\n")
        assert bus_calibrate._entered(5.0)
        os.close(writer)
        with pytest.raises(UsageError, match="the input has ended; give --seconds"):
            bus_calibrate._entered(5.0)


def test_enter_does_not_move_the_table(monkeypatch: pytest.MonkeyPatch) -> None:
    keyboard, terminal = os.openpty()
    with os.fdopen(terminal) as stdin:
        monkeypatch.setattr("sys.stdin", stdin)
        monkeypatch.setattr(bus_calibrate, "on_terminal", lambda: True)
        before = termios.tcgetattr(terminal)
        with bus_calibrate._screen() as show:
            show([("gripper", "0.0", "0.0", "0.0", "not moved yet")], "")
            os.write(keyboard, b"\n")
            assert bus_calibrate._entered(5.0)
        assert termios.tcgetattr(terminal) == before
        assert select.select([keyboard], [], [], 0.0)[0] == []
    os.close(keyboard)
