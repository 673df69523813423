from __future__ import annotations

import json
from types import SimpleNamespace

import pytest
from tests.cli.bus_cli import BusCli

from hexwire.cli import bus as bus_health
from hexwire.drivers.stop_memory import StopMemory


def test_healthy_servos(monkeypatch: pytest.MonkeyPatch) -> None:
    bus = BusCli(monkeypatch, (1, 2, 3))
    output = bus.ok("health", "1-3")
    assert output.splitlines() == [
        "ok    faults       no servo reports a fault",
        "ok    supply       7.4 V",
        "ok    temperature  28 deg C",
        "ok    current      0 mA at rest without torque",
        "ok    cabling      0 of 600 answers lost",
    ]
    document = json.loads(bus.ok("health", "1-3", "--json"))
    assert document["healthy"] is True
    assert document["findings"][0] == {
        "level": "ok",
        "ids": [1, 2, 3],
        "topic": "faults",
        "text": "no servo reports a fault",
        "advice": "",
    }


def test_trouble_is_said_and_gives_a_status(monkeypatch: pytest.MonkeyPatch) -> None:
    bus = BusCli(monkeypatch, (1, 2, 3), faults=("supply:2:12.5", "silent:3"))
    result = bus.run("health", "1-3")
    assert result.exit_code == 1
    assert "BAD   cabling      servo 3: no answer" not in result.stdout
    assert "BAD   cabling      no answer from servo 3, the end of the chain" in result.stdout
    assert "      -> check the cable between servos 2 and 3, and both its plugs" in result.stdout
    assert "BAD   supply       servo 2: supply 12.5 V is above its limit of 8.0 V" in result.stdout
    assert "2 problems found, marked BAD above" in result.stderr
    document = json.loads(bus.run("health", "1-3", "--json").stdout)
    assert document["healthy"] is False


def test_a_hint_alone_is_no_trouble(monkeypatch: pytest.MonkeyPatch) -> None:
    bus = BusCli(monkeypatch, (1, 2))
    bus.device.wire[1].registers.put("max_voltage", 140)
    assert "hint  supply       servo 1: made for 12 V" in bus.ok("health", "1-2")


def test_nothing_moves_unless_it_is_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    bus = BusCli(monkeypatch, (1, 2))
    clock = bus.link.clock
    monkeypatch.setattr(bus_health, "time", SimpleNamespace(monotonic=clock, sleep=clock.advance))
    bus.ok("health", "1-2")
    assert not any(servo.torque_on for servo in bus.device.wire.servos)
    assert bus.run("health", "1-2", "--backlash", answer="n\n").exit_code == 130
    assert [servo.registers.get("goal_position") for servo in bus.device.wire.servos] == [0, 0]
    bus.device.wire[2].motion.position = 10.0
    result = bus.run("health", "1-2", "--backlash", "--yes")
    assert result.exit_code == 0, result.output
    assert "ok    backlash     0.0 deg" in result.stdout
    assert "servo 1 moves" in result.stderr
    assert "its backlash is unknown: servo 2 is at 10" in result.stderr
    monkeypatch.setattr(StopMemory, "stopped", True)
    assert "the arm is stopped" in bus.run("health", "1-2", "--backlash", "--yes").stderr
    assert bus.run("health", "1-2").exit_code == 0


def test_the_series_is_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    assert BusCli(monkeypatch).run("health", "1", "--series", "sts").exit_code == 2
