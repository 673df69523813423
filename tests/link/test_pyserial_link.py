from __future__ import annotations

import threading
from pathlib import Path

import pytest
import serial
from far_ends import PtyEnd

from hexwire.errors import LinkBusyError, LinkLostError, LinkNotFoundError, LinkPermissionError, UsageError
from hexwire.link.base import Link
from hexwire.link.open import make_link
from hexwire.link.pyserial_link import PySerialLink
from hexwire.link.serial import terminal_rate
from hexwire.testing.link import ALL_BYTES, LinkConformance, read_bytes, soon


class TestPySerial(LinkConformance):
    def make_pair(self, tmp_path: Path) -> tuple[Link, Link]:
        path = tmp_path / "ttyUSB0"
        return make_link(f"serial://{path}?backend=pyserial"), PtyEnd(path)

    def second_owner(self, near: Link) -> Link:
        assert isinstance(near, PySerialLink)
        return PySerialLink(near.device)


@pytest.fixture
def device(tmp_path: Path) -> str:
    return str(tmp_path / "ttyUSB0")


@pytest.mark.parametrize("baud", [9600, 1_000_000, 250_000, 12_345])
def test_any_baud_rate_is_set_even_on_an_open_port(device: str, baud: int) -> None:
    with PtyEnd(Path(device)) as line, PySerialLink(device) as port:
        port.set_baud(baud)
        assert terminal_rate(line.fileno()) == baud
        assert f"baud={baud}" in port.url
        port.write(ALL_BYTES, soon())
        assert read_bytes(line, 256) == ALL_BYTES


def test_what_was_written_goes_out_before_the_port_is_closed(device: str) -> None:
    data = ALL_BYTES * 8
    with PtyEnd(Path(device)) as line:
        with PySerialLink(device) as port:
            port.write(data, soon())
        assert read_bytes(line, len(data)) == data


@pytest.mark.slow
def test_closing_waits_for_a_slow_line(device: str) -> None:
    """At 9600 baud the bytes that wait need longer than the second that closing grants a port that is stuck."""
    data = ALL_BYTES * 60
    with PtyEnd(Path(device)) as line:
        port = PySerialLink(device, 9600)
        port.open()
        port.write(data, soon())
        late = threading.Timer(1.5, lambda: got.append(read_bytes(line, len(data))))
        got: list[bytes] = []
        late.start()
        port.close()
        late.join()
        assert got == [data]


def test_bytes_leave_at_the_rate_at_which_they_were_written(device: str) -> None:
    """A servo's rate is changed by a packet at the old one."""
    with PtyEnd(Path(device)) as line, PySerialLink(device, 115200) as port:
        port.write(ALL_BYTES, soon())
        port.set_baud(1_000_000)
        # The port had all of them before the rate changed.
        assert port._ahead == 0
        assert read_bytes(line, 256) == ALL_BYTES


def test_two_programs_on_one_port_whichever_link_they_use(device: str) -> None:
    links = (make_link(f"serial://{device}?backend=termios"), PySerialLink(device))
    for first, second in (links, links[::-1]):
        with PtyEnd(Path(device)), first, pytest.raises(LinkBusyError, match=r"in use by .*: close that first"):
            second.open()


def test_no_such_port_lists_those_there_are(device: str) -> None:
    with pytest.raises(LinkNotFoundError, match=r"does not exist; (ports here|no serial port)"):
        PySerialLink(device).open()


@pytest.mark.parametrize("path", ["/dev/null", "/etc/passwd", "/etc"])
def test_a_device_that_is_not_a_serial_port_is_refused(path: str) -> None:
    with pytest.raises(LinkNotFoundError, match="is not a serial port"):
        PySerialLink(path).open()


@pytest.mark.parametrize(
    ("text", "kind", "words"),
    [
        ("could not open port 'COM3': PermissionError(13, 'Access is denied.', None, 5)", LinkBusyError, "in use"),
        ("could not open port 'COM9': FileNotFoundError(2, 'Not found.', None, 2)", LinkNotFoundError, "not exist"),
    ],
)
def test_errors_of_windows_are_told_apart_by_their_text(
    text: str, kind: type[Exception], words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise serial.SerialException(text)

    monkeypatch.setattr(serial, "Serial", refuse)
    with pytest.raises(kind, match=words):
        PySerialLink("COM3").open()


def test_no_permission_names_the_remedy(device: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise serial.SerialException(13, "could not open port: Permission denied")

    monkeypatch.setattr(serial, "Serial", refuse)
    with PtyEnd(Path(device)), pytest.raises(LinkPermissionError, match=r"no permission for .*: it belongs to"):
        PySerialLink(device).open()


def test_a_rate_that_the_driver_refuses_is_an_error(device: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise ValueError("Invalid baud rate")

    with PtyEnd(Path(device)), monkeypatch.context() as patch:
        patch.setattr(serial, "Serial", refuse)
        with pytest.raises(UsageError, match="cannot do 12345 baud"):
            PySerialLink(device, 12345).open()
    with PtyEnd(Path(device)), PySerialLink(device) as port:
        monkeypatch.setattr(serial.Serial, "_reconfigure_port", refuse)
        with pytest.raises(UsageError, match="cannot do 12345 baud"):
            port.set_baud(12345)


def test_unplugged_says_what_to_do(device: str) -> None:
    line = PtyEnd(Path(device))
    with line, PySerialLink(device) as port:
        line.close()
        with pytest.raises(LinkLostError, match="went away; was it unplugged"):
            port.read(soon())
        with pytest.raises(LinkLostError, match="was it unplugged"):
            port.write(b"x", soon())


def test_reset_pulses_dtr_and_drops_what_came_before(device: str, monkeypatch: pytest.MonkeyPatch) -> None:
    levels: list[bool] = []
    monkeypatch.setattr(serial.Serial, "dtr", property(lambda _: True, lambda _, level: levels.append(level)))
    with PtyEnd(Path(device)) as line, PySerialLink(device) as port:
        line.write(b"stale", soon())
        levels.clear()
        port.reset()
        assert levels == [False, True]
        line.write(b"fresh", soon())
        assert read_bytes(port, 5) == b"fresh"


def test_low_latency_is_asked_for_and_optional(device: str, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[bool] = []

    def ask(_: object, wanted: bool) -> None:
        asked.append(wanted)
        raise ValueError("Failed to update ASYNC_LOW_LATENCY flag")

    monkeypatch.setattr(serial.Serial, "set_low_latency_mode", ask)
    with PtyEnd(Path(device)), PySerialLink(device) as port:
        assert port.is_open
    with PtyEnd(Path(device)), PySerialLink(device, low_latency=False):
        pass
    assert asked == [True]


def test_a_port_is_not_adopted_through_a_planted_link(device: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hexwire.link.serial_port.why_not", lambda _: "is the terminal that this program runs in")
    with PtyEnd(Path(device)), pytest.raises(LinkNotFoundError, match="nothing was written to it"):
        PySerialLink(device).open()


def test_a_fault_of_the_library_loses_the_link_and_no_more(device: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """pyserial raises TypeError where a port vanishes while a thread reads it."""
    with PtyEnd(Path(device)), PySerialLink(device) as port:
        monkeypatch.setattr(serial.Serial, "read", _broken)
        with pytest.raises(LinkLostError):
            port.read(soon())


def _broken(*_: object) -> bytes:
    raise TypeError("'NoneType' object cannot be interpreted as an integer")
