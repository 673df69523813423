from __future__ import annotations

import pytest

from hexwire.errors import UsageError
from hexwire.link import serial_port
from hexwire.link.serial_port import bad_baud, busy_port, check_baud, missing_port, serial_url


@pytest.mark.parametrize("baud", [0, 49, 12_000_001, -9600])
def test_a_rate_that_no_port_has_is_refused(baud: int) -> None:
    with pytest.raises(UsageError, match=f"baud must be from 50 to 12000000, not {baud}"):
        check_baud(baud)


def test_an_address_leads_back_to_its_port() -> None:
    assert serial_url("/dev/ttyUSB0", 9600) == "serial:///dev/ttyUSB0?baud=9600"
    assert serial_url("COM3", 9600) == "serial:///COM3?baud=9600"


def test_each_error_says_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(serial_port.ports, "ports_in_words", lambda: "ports here: COM4 (URT-1)")
    monkeypatch.setattr(serial_port.owner, "device_owner", lambda device: "")
    assert str(missing_port("COM3", "does not exist", "u")) == "COM3 does not exist; ports here: COM4 (URT-1)"
    assert str(busy_port("COM3", "u")) == "COM3 is in use by another program: close that first"
    assert "use 115200 or another usual rate" in str(bad_baud("COM3", 12345, "its driver refuses it"))
