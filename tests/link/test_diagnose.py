"""Findings from a made-up system folder; nothing real is touched."""

from __future__ import annotations

import os
import stat
from pathlib import Path

import pytest

from hexwire.errors import LinkPermissionError
from hexwire.link.diagnose import (
    RULE_PATH,
    Level,
    avr_baud_error,
    diagnose_baud,
    diagnose_port,
    diagnose_system,
    udev_rule,
    write_udev_rule,
)
from hexwire.link.ports import PortInfo


@pytest.fixture
def ch340(tmp_path: Path) -> PortInfo:
    device = tmp_path / "ttyUSB0"
    device.touch(mode=0o660)
    return PortInfo(str(device), 0x1A86, 0x7523, guess="CH340", likely_board=True)


def process(root: Path, pid: int, name: str) -> None:
    (root / "proc" / str(pid)).mkdir(parents=True)
    (root / "proc" / str(pid) / "comm").write_text(f"{name}\n")


def test_a_missing_rule_is_found_written_and_then_seen(ch340: PortInfo, tmp_path: Path) -> None:
    before = diagnose_port(ch340, tmp_path)
    assert any(f.level is Level.HINT and "no udev rule" in f.text for f in before)
    path = write_udev_rule([ch340.usb_id], tmp_path)
    assert path == tmp_path / RULE_PATH
    after = diagnose_port(ch340, tmp_path)
    assert not any("no udev rule" in f.text for f in after)
    assert any(str(path) in f.text for f in after)


def test_the_rule_gives_no_more_than_it_must() -> None:
    text = udev_rule(["1a86:7523", "0403:6001", "1a86:7523"])
    lines = [line for line in text.splitlines() if not line.startswith("#")]
    assert len(lines) == 2
    for line in lines:
        assert 'MODE="0660"' in line
        assert 'GROUP="dialout"' in line
        assert "ID_MM_DEVICE_IGNORE" in line
        assert "777" not in line


def test_a_rule_that_cannot_be_written_says_sudo(tmp_path: Path) -> None:
    (tmp_path / "etc").write_text("a file where a folder should be")
    with pytest.raises(LinkPermissionError, match="sudo"):
        write_udev_rule(["1a86:7523"], tmp_path)


def test_rivals_are_named(ch340: PortInfo, tmp_path: Path) -> None:
    assert diagnose_system([ch340], tmp_path) == []
    process(tmp_path, 7, "ModemManager")
    process(tmp_path, 8, "brltty")
    found = {f.about: f for f in diagnose_system([ch340], tmp_path)}
    assert found["ModemManager"].level is Level.BAD
    assert "brltty" in found["brltty"].advice
    write_udev_rule([ch340.usb_id], tmp_path)
    found = {f.about: f for f in diagnose_system([ch340], tmp_path)}
    assert found["ModemManager"].level is Level.OK


def test_brltty_matters_only_where_a_ch340_is(tmp_path: Path) -> None:
    process(tmp_path, 8, "brltty")
    mega = PortInfo("/dev/ttyACM0", 0x2341, 0x0042)
    assert diagnose_system([mega], tmp_path) == []


def test_rights(ch340: PortInfo, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(os, "access", lambda *_: False)
    found = [f for f in diagnose_port(ch340, tmp_path) if f.level is Level.BAD]
    assert "may not open it" in found[0].text
    monkeypatch.undo()
    Path(ch340.device).chmod(0o666)
    assert any("chmod 777" in f.advice for f in diagnose_port(ch340, tmp_path))
    Path(ch340.device).unlink()
    assert any("plugged in" in f.advice for f in diagnose_port(ch340, tmp_path))


def test_a_user_without_a_name_as_in_a_container(
    ch340: PortInfo, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(os, "access", lambda *_: False)
    monkeypatch.setattr(os, "geteuid", lambda: 4_000_000_007)
    Path(ch340.device).chmod(0o660)
    os.chown(ch340.device, -1, os.getgid() or 20)
    found = [f for f in diagnose_port(ch340, tmp_path) if f.level is Level.BAD]
    assert "user 4000000007, then log out" in found[0].advice


@pytest.mark.parametrize(
    ("baud", "error", "level"),
    [(115200, 0.0212, Level.HINT), (500000, 0.0, Level.OK), (250000, 0.0, Level.OK), (1000000, 0.0, Level.OK)],
)
def test_baud_errors_of_a_mega(baud: int, error: float, level: Level) -> None:
    assert avr_baud_error(baud) == pytest.approx(error, abs=1e-4)
    assert diagnose_baud(baud).level is level


@pytest.mark.parametrize(
    ("mode", "group", "advice"), [(0o660, 20, "usermod -aG"), (0o600, 20, "rule"), (0o660, 0, "rule")]
)
def test_what_to_do_about_permission(
    ch340: PortInfo, monkeypatch: pytest.MonkeyPatch, mode: int, group: int, advice: str
) -> None:
    """Nobody is told to join group root, or a group that may not use the port either."""
    real = os.stat_result((stat.S_IFCHR | mode, 1, 1, 1, 0, group, 0, 0, 0, 0))
    monkeypatch.setattr(Path, "stat", lambda self: real)
    monkeypatch.setattr(os, "access", lambda *_: False)
    found = next(row for row in diagnose_port(ch340) if "may not open" in row.text)
    assert found.level is Level.BAD
    assert advice in found.advice
    assert "-aG root" not in found.advice


@pytest.mark.parametrize(
    ("baud", "divisor", "level"),
    [
        (9600, 208, Level.OK),
        (57600, 35, Level.OK),
        (115200, 17, Level.HINT),
        (230400, 9, Level.HINT),
        (250000, 8, Level.OK),
        (460800, 4, Level.BAD),
        (1000000, 2, Level.OK),
        (2000000, 1, Level.OK),
        (8000000, 1, Level.BAD),
    ],
)
def test_how_far_a_board_is_off_a_rate(baud: int, divisor: int, level: Level) -> None:
    error = 16e6 / 8 / divisor / baud - 1
    assert avr_baud_error(baud) == pytest.approx(error)
    finding = diagnose_baud(baud)
    assert (finding.level, finding.about) == (level, "baud rate")
    assert f"{error:+.1%}" in finding.text
    assert bool(finding.advice) is (level is not Level.OK)
