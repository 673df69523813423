from __future__ import annotations

import os
from pathlib import Path
from types import SimpleNamespace

import pytest
from serial.tools import list_ports as pyserial_ports

from hexwire.errors import LinkNotFoundError, UsageError
from hexwire.link.ports import PortInfo, find_only_board, find_port, list_ports, ports_in_words


def usb(device: str, vid: int, pid: int, description: str = "USB Serial", number: str | None = "A1") -> object:
    return SimpleNamespace(device=device, vid=vid, pid=pid, description=description, serial_number=number)


BUILT_IN = SimpleNamespace(device="/dev/ttyS0", vid=None, pid=None, description="n/a", serial_number=None)
MEGA = usb("/dev/ttyACM0", 0x2341, 0x0042, "Mega 2560")
CLONE = usb("/dev/ttyUSB0", 0x1A86, 0x7523, number=None)
ADAPTER = usb("/dev/ttyACM1", 0x1A86, 0x55D3)
PHONE = usb("/dev/ttyACM2", 0x04E8, 0x6860)


@pytest.fixture
def plug(monkeypatch: pytest.MonkeyPatch) -> object:
    def plug_in(*ports: object) -> None:
        monkeypatch.setattr(pyserial_ports, "comports", lambda: list(ports))

    return plug_in


def test_ports_are_listed_with_what_they_probably_are(plug) -> None:  # type: ignore[no-untyped-def]  # a fixture
    plug(BUILT_IN, CLONE, PHONE, MEGA)
    mega, phone, clone, built_in = list_ports()
    assert mega == PortInfo("/dev/ttyACM0", 0x2341, 0x42, "A1", "Mega 2560", "Arduino Mega 2560", likely_board=True)
    assert mega.usb_id == "2341:0042"
    assert phone.guess == "unknown USB device 04e8:6860"
    assert not phone.likely_board
    assert not phone.likely_adapter
    assert (clone.serial_number, clone.likely_board, clone.likely_adapter) == ("", True, True)
    assert "CH340" in clone.guess
    assert (built_in.usb_id, built_in.description, built_in.guess) == ("", "", "built-in serial port")


@pytest.mark.parametrize(
    ("vid", "pid", "board", "adapter"),
    [
        *((0x2341, pid, True, False) for pid in (0x0010, 0x0042, 0x0210, 0x0242, 0x003F, 0x0044)),
        *((0x2A03, pid, True, False) for pid in (0x0010, 0x0042, 0x003F, 0x0044)),
        (0x1A86, 0x7523, True, True),
        (0x0403, 0x6001, True, True),
        (0x10C4, 0xEA60, True, True),
        (0x1A86, 0x55D3, False, True),
        (0x1A86, 0x55D4, False, True),
    ],
)
def test_known_identities(plug, vid: int, pid: int, board: bool, adapter: bool) -> None:  # type: ignore[no-untyped-def]  # a fixture
    plug(usb("/dev/ttyX", vid, pid))
    (port,) = list_ports()
    assert (port.likely_board, port.likely_adapter) == (board, adapter)


def test_the_only_board_is_found(plug) -> None:  # type: ignore[no-untyped-def]  # a fixture
    plug(BUILT_IN, PHONE, ADAPTER, CLONE)
    assert find_only_board() == "/dev/ttyUSB0"


def test_two_boards_are_a_question_to_the_user(plug) -> None:  # type: ignore[no-untyped-def]  # a fixture
    plug(MEGA, CLONE)
    with pytest.raises(UsageError) as caught:
        find_only_board()
    text = str(caught.value)
    assert "/dev/ttyACM0 (Arduino Mega 2560), /dev/ttyUSB0 (CH340" in text
    assert text.endswith("name one with --port")


def test_no_board_says_what_there_is(plug) -> None:  # type: ignore[no-untyped-def]  # a fixture
    plug(BUILT_IN, PHONE)
    with pytest.raises(LinkNotFoundError, match=r"no likely board .*/dev/ttyACM2 .*/dev/ttyS0 \(built-in"):
        find_only_board()
    plug()
    with pytest.raises(LinkNotFoundError, match="no serial port on this machine"):
        find_only_board()
    assert ports_in_words() == "no serial port on this machine"


def test_a_long_list_is_cut(plug) -> None:  # type: ignore[no-untyped-def]  # a fixture
    plug(*(usb(f"/dev/ttyUSB{n}", 1, 2) for n in range(10)))
    assert ports_in_words().endswith("and 2 more")
    assert ports_in_words().count("/dev/") == 8


def test_a_port_is_known_by_any_of_its_names(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    device = tmp_path / "ttyUSB0"
    device.touch()
    link = tmp_path / "arm"
    link.symlink_to(device)
    monkeypatch.setattr(pyserial_ports, "comports", lambda: [usb(str(device), 0x1A86, 0x55D3)])
    found = find_port(str(link))
    assert (found.device, found.usb_id, found.likely_adapter) == (str(link), "1a86:55d3", True)
    assert find_port(str(tmp_path / "other")) == PortInfo(str(tmp_path / "other"), guess="unknown port")


def test_a_pseudo_terminal_is_called_one() -> None:
    master, slave = os.openpty()
    try:
        assert "pseudo-terminal" in find_port(os.ttyname(slave)).guess
    finally:
        os.close(master)
        os.close(slave)
