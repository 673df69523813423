from __future__ import annotations

import json
import socket

import pytest
from click.testing import CliRunner
from tests.cli.bus_cli import BusCli

from hexwire.cli.main import cli
from hexwire.wire.registers import Series

ALL = (Series.STS_SMS, Series.HLS, Series.SCS)


def test_scan(monkeypatch: pytest.MonkeyPatch) -> None:
    bus = BusCli(monkeypatch, (1, 2, 3), ALL)
    rows = json.loads(bus.ok("scan", "--ids", "0-5", "--json"))
    assert [(row["id"], row["series"], row["shared"]) for row in rows] == [
        (1, "sts_sms", False),
        (2, "hls", False),
        (3, "scs", False),
    ]
    assert "sts3215" in bus.ok("scan", "--ids", "0-5")
    assert bus.urls[0] == "/dev/ttyTEST?baud=1000000"


def test_scan_of_all_rates_finds_a_lost_servo(monkeypatch: pytest.MonkeyPatch) -> None:
    bus = BusCli(monkeypatch, (1,))
    bus.ok("set-baud", "1", "57600", "--yes")
    bus.link.set_baud(1_000_000)
    missed = bus.run("scan", "--ids", "0-3")
    assert missed.exit_code == 1
    assert "--all-rates" in missed.stderr
    assert "57600" in bus.ok("scan", "--ids", "0-3", "--all-rates")


def test_scan_of_a_silent_address_names_no_rate_since_it_has_none() -> None:
    with socket.create_server(("127.0.0.1", 0)) as silent:
        port = f"tcp://127.0.0.1:{silent.getsockname()[1]}"
        result = CliRunner().invoke(cli, ["bus", "scan", "--ids", "1", "--port", port])
    assert result.stderr.splitlines()[-1] == "error: no servo answers: check power and cable"


def test_scan_names_a_shared_id(monkeypatch: pytest.MonkeyPatch) -> None:
    bus = BusCli(monkeypatch, (1, 4, 4))
    assert "several servos seem to have id 4" in bus.ok("scan", "--ids", "0-5")


def test_ping(monkeypatch: pytest.MonkeyPatch) -> None:
    bus = BusCli(monkeypatch)
    assert "1: ok sts_sms sts3215 firmware 3.10" in bus.ok("ping", "1-3")
    result = bus.run("ping", "3,4")
    assert result.exit_code == 1
    assert "no answer from 4" in result.stderr


def test_read(monkeypatch: pytest.MonkeyPatch) -> None:
    bus = BusCli(monkeypatch, (1, 2, 3), ALL)
    rows = json.loads(bus.ok("read", "1-3", "present_position", "present_voltage", "--json"))
    assert [row["raw"] for row in rows if row["register"] == "present_position"] == [
        bus.device.wire[i].registers.get("present_position") for i in (1, 2, 3)
    ]
    assert "180 deg" in bus.ok("read", "1", "present_position")
    wrong = bus.run("read", "1", "present_postion")
    assert wrong.exit_code == 2
    assert "did you mean present_position" in wrong.stderr
    assert bus.run("read", "9", "id").exit_code == 1
    assert bus.run("read", "x", "id").exit_code == 2


def test_write_stores_settings_and_asks_before_it_moves(monkeypatch: pytest.MonkeyPatch) -> None:
    bus = BusCli(monkeypatch)
    assert "65 (65 degC)" in bus.ok("write", "1", "max_temperature", "65")
    assert bus.device.wire[1].registers.stored("max_temperature") == 65
    assert bus.run("write", "1", "goal_position", "2500", answer="n\n").exit_code == 130
    assert bus.device.wire[1].registers.get("torque_enable") == 0
    assert "2500" in bus.ok("write", "1", "goal_position", "0x9C4", "--yes")
    assert "1.571" not in bus.ok("write", "1", "goal_position", "1.5708", "--si", "--yes")
    for words in (("max_temperature", "650"), ("max_temperature", "hot"), ("present_position", "1"), ("id", "9")):
        result = bus.run("write", "1", *words)
        assert result.exit_code == 2, result.output
        assert len(result.stderr.splitlines()) == 1


@pytest.mark.parametrize("series", list(Series))
def test_table_marks_what_was_changed(monkeypatch: pytest.MonkeyPatch, series: Series) -> None:
    bus = BusCli(monkeypatch, (3,), (series,))
    words = ("--series", series.value)
    rows = json.loads(bus.ok("table", "3", "--json", *words))
    assert [row["register"] for row in rows] == list(series.registers)
    if series is Series.STS_SMS:
        bus.ok("write", "3", "position_p", "99")
        line = next(line for line in bus.ok("table", "3").splitlines() if "position_p" in line)
        assert line.split()[0] == "*"
