from __future__ import annotations

from pathlib import Path

import pytest

from hexwire.drivers import firmware
from hexwire.errors import DeviceError, UsageError
from hexwire.link.ports import PortInfo

MEGA = PortInfo("/dev/ttyACM0", 0x2341, 0x0042, guess="Arduino Mega 2560", likely_board=True)


@pytest.fixture
def flasher(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder that is the whole PATH, with a flasher whose words and status the test writes."""
    monkeypatch.setenv("PATH", str(tmp_path))
    return tmp_path


def pretend(folder: Path, status: int, *said: str) -> None:
    lines = "\n".join(f"echo '{line}' >&2" for line in said)
    script = folder / "avrdude"
    script.write_text(f"#!/bin/sh\n{lines}\nexit {status}\n")
    script.chmod(0o755)


def test_the_sources_of_this_checkout() -> None:
    sources = firmware.find_sources()
    assert (sources / "boards/mega2560/mega2560.ino").is_file()
    assert firmware.source_version(sources).count(".") == 2


def test_sources_elsewhere(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="not the firmware's folder"):
        firmware.find_sources(tmp_path)
    (tmp_path / "core").mkdir()
    (tmp_path / "core/generated.h").write_text("// nothing\n")
    (tmp_path / "Makefile").write_text("")
    assert firmware.find_sources(tmp_path) == tmp_path
    with pytest.raises(UsageError, match="has no version"):
        firmware.source_version(tmp_path)


def test_a_port_is_known_by_any_of_its_names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    device = tmp_path / "ttyACM0"
    device.touch()
    link = tmp_path / "by-id"
    link.symlink_to(device)
    port = PortInfo(str(device), 0x2341, 0x0042, guess="Arduino Mega 2560", likely_board=True)
    monkeypatch.setattr(firmware, "list_ports", lambda: [port])
    assert firmware.check_board(str(link)) == "Arduino Mega 2560"
    with pytest.raises(UsageError, match="not a USB serial port of this machine"):
        firmware.check_board(str(tmp_path / "other"))


@pytest.mark.parametrize(
    ("port", "device"),
    [("/dev/ttyACM0", "/dev/ttyACM0"), ("serial:///dev/ttyUSB3?baud=500000", "/dev/ttyUSB3")],
)
def test_the_device_of_a_port(port: str, device: str) -> None:
    assert firmware.device_of(port) == device


def test_the_command_compares_the_signature_and_verifies(tmp_path: Path) -> None:
    image = tmp_path / "a.hex"
    with pytest.raises(UsageError, match="build it first"):
        firmware.flash_command(MEGA.device, image)
    image.touch()
    command = firmware.flash_command(MEGA.device, image)
    assert not {"-F", "-V"} & set(command)
    assert "-V" in firmware.flash_command(MEGA.device, image, verify=False)
    assert "-D" in command  # the boot loader cannot erase the chip


@pytest.mark.parametrize(
    ("said", "text"),
    [
        (
            (
                "avrdude: Device signature = 0x1e950f (probably m328p)",
                "Expected signature for ATmega2560 is 1E 98 01",
            ),
            "its signature is 1e 95 0f, not 1e 98 01; nothing was written",
        ),
        (("avrdude: stk500v2_getsync(): timeout communicating with programmer",), "boot loader does not answer"),
        (("avrdude: verification error, first mismatch at byte 0x0010",), "flashing failed: .*first mismatch"),
        ((), "flashing failed: no output"),
    ],
)
def test_what_the_flasher_says_in_words(flasher: Path, said: tuple[str, ...], text: str) -> None:
    pretend(flasher, 1, *said)
    with pytest.raises(DeviceError, match=text):
        firmware.run_flash(["avrdude", "-n"])


def test_the_flasher_is_missing_or_content(flasher: Path) -> None:
    with pytest.raises(UsageError, match="apt-get install avrdude"):
        firmware.run_flash(["avrdude"])
    pretend(flasher, 0, "avrdude done.  Thank you.")
    firmware.run_flash(["avrdude"])
