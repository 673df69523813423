"""Findings from a made-up system folder; nothing real is touched."""

from __future__ import annotations

import os
import stat
from pathlib import Path

import pytest

from hexwire.errors import LinkPermissionError
from hexwire.link import diagnose as diagnose_module
from hexwire.link.adapter import AdapterReport
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
    assert any(f.level is Level.OK and str(path) in f.text for f in after)


def test_files_of_others_may_hold_any_bytes(ch340: PortInfo, tmp_path: Path) -> None:
    path = write_udev_rule([ch340.usb_id], tmp_path)
    path.write_bytes(b"# caf\xe9\n" + path.read_bytes())
    assert any(f"udev rule in {path}" == f.text for f in diagnose_port(ch340, tmp_path))
    process(tmp_path, 6, "")
    (tmp_path / "proc/6/comm").write_bytes(b"\xff\n")
    process(tmp_path, 8, "brltty")
    assert {f.about for f in diagnose_system([ch340], tmp_path)} == {"brltty"}


def test_a_rule_that_is_there_is_replaced_and_all_may_read_it(tmp_path: Path) -> None:
    for usb_id in ("1a86:7523", "0403:6001"):
        path = write_udev_rule([usb_id], tmp_path)
        assert path.read_text() == udev_rule([usb_id])
        assert path.stat().st_mode & 0o444 == 0o444


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
    assert diagnose_system([PortInfo("/dev/ttyS0")], tmp_path) == [], "neither talks to a port that is not on USB"
    found = {f.about: f for f in diagnose_system([ch340], tmp_path)}
    assert sorted(found) == ["ModemManager", "brltty"]
    assert {f.level for f in found.values()} == {Level.BAD}
    assert "ModemManager" in found["ModemManager"].advice
    assert "brltty" in found["brltty"].advice
    write_udev_rule([ch340.usb_id], tmp_path)
    found = {f.about: f for f in diagnose_system([ch340], tmp_path)}
    assert (found["ModemManager"].level, found["ModemManager"].advice) == (Level.OK, "")
    other = PortInfo("/dev/ttyACM0", 0x2341, 0x0042)
    found = {f.about: f for f in diagnose_system([ch340, other], tmp_path)}
    assert found["ModemManager"].level is Level.BAD, "it ignores one of the ports only"


def test_a_rule_of_brltty_mistakes_the_port_even_while_it_does_not_run(ch340: PortInfo, tmp_path: Path) -> None:
    rules = tmp_path / "usr/lib/udev/rules.d"
    rules.mkdir(parents=True)
    text = 'ENV{PRODUCT}=="1a86/7523/*", ATTRS{idVendor}=="1A86", ATTRS{idProduct}=="7523"\n'
    (rules / "90-others.rules").write_text(text)
    assert diagnose_system([ch340], tmp_path) == []
    (rules / "85-brltty.rules").write_text("  # " + text)
    assert diagnose_system([ch340], tmp_path) == [], "that line is a comment"
    (rules / "85-brltty.rules").write_text("# for readers\n" + text)
    (found,) = diagnose_system([ch340], tmp_path)
    assert (found.about, found.level) == ("brltty", Level.BAD)


@pytest.mark.parametrize("folder", ["etc", "run", "usr/lib", "lib"])
def test_a_rule_counts_in_every_folder_of_udev(ch340: PortInfo, tmp_path: Path, folder: str) -> None:
    rules = tmp_path / folder / "udev/rules.d"
    rules.mkdir(parents=True)
    (rules / "10-bad.rules").mkdir()
    (rules / "20-half.rules").write_text('ATTRS{idVendor}=="1a86"\nATTRS{idProduct}=="7523"\n')
    (rules / "readme.txt").write_text("1a86 7523")
    levels = [f.level for f in diagnose_port(ch340, tmp_path)]
    assert Level.HINT in levels
    (rules / "30-mine.rules").write_text('ATTRS{idVendor}=="1A86", ATTRS{idProduct}=="7523"\n')
    found = diagnose_port(ch340, tmp_path)
    assert Level.HINT not in [f.level for f in found]
    assert found[-1].text == f"udev rule in {rules / '30-mine.rules'}"


def test_the_findings_on_a_port_are_about_it(ch340: PortInfo, tmp_path: Path) -> None:
    Path(ch340.device).chmod(0o660)
    first, second, third = diagnose_port(ch340, tmp_path)
    assert (first.level, first.about, first.text) == (Level.OK, ch340.device, "CH340, USB 1a86:7523")
    assert (second.level, second.about, second.advice) == (Level.OK, ch340.device, "")
    assert "-rw-rw----" in second.text
    assert (third.level, third.about) == (Level.HINT, ch340.device)
    plain = PortInfo(ch340.device, guess="built-in serial port")
    said, _ = diagnose_port(plain, tmp_path)  # no rule is needed
    assert said.text == "built-in serial port"


@pytest.mark.parametrize(
    ("latency", "advice", "level"), [(16, "set it", Level.BAD), (1, "", Level.OK), (None, "", None)]
)
def test_a_slow_latency_timer_of_this_machine_is_bad(
    ch340: PortInfo, latency: int | None, advice: str, level: Level | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[str] = []

    def inspect(device: str) -> AdapterReport:
        asked.append(device)
        return AdapterReport(device, "ftdi_sio", latency, 0.0, False, advice)

    monkeypatch.setattr(diagnose_module, "inspect_adapter", inspect)
    found = [f for f in diagnose_port(ch340) if "latency timer" in f.text]
    assert asked == [ch340.device]
    assert [(f.level, f.about, f.advice) for f in found] == ([(level, ch340.device, advice)] if level else [])


def test_brltty_matters_only_where_a_ch340_is(tmp_path: Path) -> None:
    process(tmp_path, 8, "brltty")
    mega = PortInfo("/dev/ttyACM0", 0x2341, 0x0042)
    assert diagnose_system([mega], tmp_path) == []


def test_rights(ch340: PortInfo, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(os, "access", lambda *_: False)
    found = [f for f in diagnose_port(ch340, tmp_path) if f.level is Level.BAD]
    assert "may not open it" in found[0].text
    assert found[0].about == ch340.device
    monkeypatch.undo()
    Path(ch340.device).chmod(0o666)
    (open_to_all,) = (f for f in diagnose_port(ch340, tmp_path) if "chmod 777" in f.advice)
    assert (open_to_all.level, open_to_all.about) == (Level.HINT, ch340.device)
    Path(ch340.device).unlink()
    (gone,) = (f for f in diagnose_port(ch340, tmp_path) if "plugged in" in f.advice)
    assert (gone.level, gone.about) == (Level.BAD, ch340.device)


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
