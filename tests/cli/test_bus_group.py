from __future__ import annotations

import pytest
from click.testing import CliRunner

from hexwire.cli.main import cli
from hexwire.cli.output import with_unit
from hexwire.link import ports


def test_ports(monkeypatch: pytest.MonkeyPatch) -> None:
    adapter = ports.PortInfo("/dev/ttyACM7", likely_adapter=True)
    for there, status, text in (([], 1, "plug it in"), ([adapter, adapter], 2, "several likely adapters")):
        monkeypatch.setattr(ports, "list_ports", lambda there=there: there)
        result = CliRunner().invoke(cli, ["bus", "ping", "1"])
        assert result.exit_code == status
        assert text in result.stderr


def test_units_for_people() -> None:
    assert with_unit(3.14159265, "rad") == "180 deg"
    assert with_unit(3.14159265, "rad/s") == "180 deg/s"
    assert with_unit(0.5, "fraction") == "50.0%"
    assert with_unit(7.4, "V") == "7.4 V"
    assert with_unit(7, "") == "7"
