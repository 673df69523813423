from __future__ import annotations

import sys

import pytest

from hexwire.errors import UsageError
from hexwire.link.open import make_link
from hexwire.link.pyserial_link import PySerialLink
from hexwire.link.serial import SerialLink


def test_addresses() -> None:
    port = make_link("serial:///dev/ttyUSB0?baud=1000000&low_latency=0&reset=1")
    assert isinstance(port, SerialLink)
    assert (port.device, port.baud) == ("/dev/ttyUSB0", 1_000_000)
    assert port.url == "serial:///dev/ttyUSB0?baud=1000000"
    plain = make_link("/dev/ttyACM0")
    assert isinstance(plain, SerialLink)
    assert (plain.device, plain.baud) == ("/dev/ttyACM0", 115200)
    by_id = make_link("serial:///dev/serial/by-id/usb-1a86_USB%20Serial-if00?baud=9600")
    assert isinstance(by_id, SerialLink)
    assert by_id.device == "/dev/serial/by-id/usb-1a86_USB Serial-if00"


@pytest.mark.parametrize("backend", ["termios", "pyserial"])
def test_a_rate_to_which_the_line_is_raised(backend: str) -> None:
    port = make_link(f"/dev/ttyUSB0?raise=500000&backend={backend}")
    assert isinstance(port, SerialLink | PySerialLink)
    assert (port.baud, port.raise_to, port.url) == (115200, 500_000, "serial:///dev/ttyUSB0?baud=115200")


@pytest.mark.parametrize(
    ("url", "words"),
    [
        ("serial://dev/ttyUSB0", "three slashes"),
        ("serial://", "the device is missing"),
        (
            "serial:///dev/ttyUSB0?bauds=9600",
            "unknown option 'bauds'; options of serial://: backend, baud, low_latency, raise, reset",
        ),
        ("serial:///dev/ttyUSB0?baud=fast", "baud must be an integer from 50 to 12000000, not 'fast'"),
        ("/dev/ttyUSB0?baud=1", "baud must be an integer"),
        ("/dev/ttyUSB0?raise=1", "raise must be an integer from 50 to 12000000, not '1'"),
        ("serial:///dev/tty%00", "contains a zero character"),
        ("/dev/ttyUSB0?backend=poll", "backend must be termios or pyserial, not 'poll'"),
        ("/dev/ttyUSB0?reset=maybe", "reset must be 1 or 0, not 'maybe'"),
    ],
)
def test_wrong_addresses(url: str, words: str) -> None:
    with pytest.raises(UsageError) as caught:
        make_link(url)
    assert words in str(caught.value)


@pytest.mark.parametrize(
    ("url", "device"),
    [
        ("serial:///COM3?backend=pyserial", "COM3"),
        ("serial:///dev/cu.usbserial-1?backend=pyserial", "/dev/cu.usbserial-1"),
    ],
)
def test_pyserial_opens_a_port_that_is_addressed_so(url: str, device: str) -> None:
    port = make_link(url)
    assert isinstance(port, PySerialLink)
    assert (port.device, port.baud) == (device, 115200)


@pytest.mark.parametrize("system", ["darwin", "win32"])
def test_pyserial_opens_every_port_of_other_systems(system: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", system)
    assert isinstance(make_link("/dev/cu.usbserial-1"), PySerialLink)
    with pytest.raises(UsageError, match="backend=termios is for Linux"):
        make_link("serial:///dev/cu.usbserial-1?backend=termios")
