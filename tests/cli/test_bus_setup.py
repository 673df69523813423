from __future__ import annotations

from pathlib import Path

import pytest
from tests.cli.bus_cli import BusCli

from hexwire.drivers.stop_memory import StopMemory


def test_set_id_asks(monkeypatch: pytest.MonkeyPatch) -> None:
    bus = BusCli(monkeypatch)
    assert bus.run("set-id", "1", "9", answer="n\n").exit_code == 130
    assert bus.device.wire[1].servo_id == 1
    assert "servo 1 is now servo 9" in bus.ok("set-id", "1", "9", answer="y\n")
    taken = bus.run("set-id", "2", "3", "--yes")
    assert taken.exit_code == 1
    assert "nothing was changed" in taken.stderr


def test_set_baud(monkeypatch: pytest.MonkeyPatch) -> None:
    bus = BusCli(monkeypatch)
    assert "answers at 500000 baud" in bus.ok("set-baud", "2", "500000", "--yes")
    assert bus.device.wire[2].baud == 500_000


def test_center_and_recover(monkeypatch: pytest.MonkeyPatch) -> None:
    bus = BusCli(monkeypatch)
    assert "now reports 2048 at this position" in bus.ok("center", "2", "--yes")
    bus.ok("write", "2", "torque_enable", "1", "--yes")
    assert "has torque" in bus.run("center", "2", "--yes").stderr
    assert "servo 2: ok, torque off" in bus.ok("recover", "2")
    assert bus.device.wire[2].registers.get("torque_enable") == 0
    hot = BusCli(monkeypatch, faults=["hot:1"])
    result = hot.run("recover", "1")
    assert result.exit_code == 1
    assert "temperature" in result.output


def test_while_the_arm_is_stopped_only_torque_off_is_allowed(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    bus = BusCli(monkeypatch, (1,))
    file = str(tmp_path / "servos.toml")
    bus.ok("backup", "1", file)
    monkeypatch.setattr(StopMemory, "stopped", True)
    servo = bus.device.wire[1]
    before = bytes(servo.registers.read(0, 0x46))
    for words in (
        ("write", "1", "goal_position", "2500", "--yes"),
        ("write", "1", "torque_enable", "1", "--yes"),
        ("write", "1", "max_temperature", "65"),
        ("set-id", "1", "2", "--yes"),
        ("set-baud", "1", "57600", "--yes"),
        ("center", "1", "--yes"),
        ("restore", file, "--yes"),
    ):
        result = bus.run(*words)
        assert result.exit_code == 1, words
        assert "was not sent: the arm is stopped; `hexwire resume` ends that" in result.stderr
    assert servo.registers.read(0, 0x31) == before[:0x31]
    bus.ok("write", "1", "torque_enable", "0", "--yes")
    bus.ok("recover", "1")


def test_backup_diff_restore(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    bus = BusCli(monkeypatch)
    file = str(tmp_path / "b.json")
    bus.ok("backup", "1-2", file)
    assert bus.run("backup", "1-2", file).exit_code == 2
    assert "no differences" in bus.ok("diff", file)
    bus.ok("write", "1", "position_p", "50")
    result = bus.run("diff", file)
    assert result.exit_code == 1
    assert "position_p" in result.stdout
    assert "one setting differs" in result.stderr
    assert "servo 1: position_p" in bus.ok("restore", file, "--yes")
    bus.ok("diff", file)
    assert bus.run("restore", file, "--ids", "9", "--yes").exit_code == 2
    (tmp_path / "c.json").write_text("{")
    assert bus.run("diff", str(tmp_path / "c.json")).exit_code == 2
