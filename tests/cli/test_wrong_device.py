"""Every command of a board on a servo bus, and those of a servo bus on a board: one line says what is there."""

from __future__ import annotations

import pytest
from click.testing import CliRunner
from tests.cli.bus_cli import BusCli
from tests.ipc.test_mistaken import board_link

from hexwire.cli.main import cli
from hexwire.link import open as ipc_open

SOON = 2.0
COMMANDS = ["state", "state --json", "probe", "ping", "move J1=10", "torque on", "torque off", "stop", "resume"]


@pytest.mark.parametrize("command", [*COMMANDS, "grip open", "pump off"])
def test_board_commands_on_a_servo_bus(monkeypatch: pytest.MonkeyPatch, command: str) -> None:
    bus = BusCli(monkeypatch, ids=(1, 2, 3, 4, 5, 6))
    bus.link.set_baud(115200)
    started = bus.link.clock()
    result = CliRunner().invoke(cli, [*command.split(), "--port", "/dev/ttyTEST"])
    assert result.exit_code == 1
    lines = result.stderr.splitlines()
    assert len(lines) == 1
    assert "is a servo bus (servos 1, 2, 3, 4, 5, 6 answer)" in lines[0]
    assert "--robot so101" in lines[0]
    assert "`hexwire bus scan`" in lines[0]
    assert bus.link.clock() - started < SOON


@pytest.mark.parametrize(
    "command", ["bus scan --ids 0-9", "bus ping 1", "bus read 1 id", "bus table 1", "state --robot so101"]
)
@pytest.mark.parametrize("dialect", [1, 2])
def test_bus_commands_on_a_board(monkeypatch: pytest.MonkeyPatch, dialect: int, command: str) -> None:
    link = board_link(dialect=dialect, rate=1_000_000)
    monkeypatch.setattr(ipc_open, "make_link", lambda url: link)
    result = CliRunner().invoke(cli, [*command.split(), "--port", "/dev/ttyTEST"])
    assert result.exit_code == 1
    assert f"is a controller board (dialect {dialect}" in result.stderr.splitlines()[-1]
    assert "not a servo bus" in result.stderr
