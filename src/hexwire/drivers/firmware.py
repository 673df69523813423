"""Building the controller board's firmware and flashing it, or the one that a wheel brings ready to flash.

Owns which tools run and how, which boards are refused, the error texts for the tools' failures, and where the files
of a wheel are and that they are whole. `make dist` puts these there; a checkout has none and builds its own. Must
not know what the firmware does, nor print.
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from hexwire.errors import DeviceError, UsageError
from hexwire.inputs import parse_json, read_bytes, read_text
from hexwire.ipc.conf import device_url
from hexwire.link.ports import list_ports

__all__ = [
    "HOST_RATES",
    "LIST",
    "BuildReport",
    "FirmwareImage",
    "build",
    "check_board",
    "device_of",
    "find_image",
    "find_sources",
    "flash_command",
    "has_sources",
    "list_images",
    "run_flash",
    "source_version",
]

FOLDER = Path(__file__).resolve().parents[1] / "share" / "firmware"
LIST = "firmware.json"
"""Name of the file in the folder that says what each other file is."""


@dataclass(frozen=True, slots=True)
class FirmwareImage:
    """A firmware file.

    Attributes:
        file: The file, Intel HEX.
        board: The board that it is for, as in ``mega2560``.
        host_baud: Host-line rate that it was built for.
        version: As in ``1.0.0``.
        sha256: Digest of the file, hexadecimal.
    """

    file: Path
    board: str
    host_baud: int
    version: str
    sha256: str


def list_images(folder: Path | None = None) -> tuple[FirmwareImage, ...]:
    """List the files that this installation brings; empty in a checkout.

    Args:
        folder: Where they are; that of this package if None.

    Raises:
        ConfigError: The list is damaged.
    """
    where = FOLDER if folder is None else folder
    path = where / LIST
    if not path.is_file():
        return ()
    listed = parse_json(read_bytes(path), str(path)).table(("version", "images"))
    images = []
    for item in listed["images"].rows(most=100):
        row = item.table(("file", "board", "host_baud", "sha256"))
        file = where / Path(row["file"].text()).name
        rate = row["host_baud"].integer(1, 10_000_000)
        images.append(
            FirmwareImage(file, row["board"].text(), rate, listed["version"].text(), row["sha256"].text())
        )
    return tuple(images)


def find_image(host_baud: int, board: str = "mega2560", folder: Path | None = None) -> FirmwareImage | None:
    """Find the file for a board and a rate; None if this installation brings none.

    Raises:
        UsageError: The file is damaged, or there are only files for other rates.
    """
    images = list_images(folder)
    if not images:
        return None
    rates = []
    for image in images:
        if image.board == board and image.host_baud == host_baud:
            if not image.file.is_file() or hashlib.sha256(read_bytes(image.file)).hexdigest() != image.sha256:
                raise UsageError(f"{image.file} is damaged; install hexwire again")
            return image
        rates.append(f"{image.board} at {image.host_baud}")
    raise UsageError(f"no firmware for {board} at {host_baud} in this installation, only for {', '.join(rates)}")


PART = "atmega2560"
HOST_RATES = (115_200, 250_000, 500_000, 1_000_000)
"""Host-line rates that the firmware can be built for."""
_SOURCES = Path(__file__).resolve().parents[3] / "firmware"
_SIGNATURE = "1e 98 01"
_BUILD_TOOLS = {"avr-g++": "gcc-avr", "avr-objcopy": "binutils-avr", "make": "make"}
_CORE = Path("/usr/share/arduino/hardware/arduino/avr/cores/arduino")
_HEX = "mega2560/hexwire.hex"
_TAIL = 3  # lines of a tool's output that go into an error text


@dataclass(frozen=True, slots=True)
class BuildReport:
    """The result of a build.

    Attributes:
        hex_file: The file to flash.
        size: The Makefile's line on flash and RAM.
        version: As in ``1.0.0``.
        host_baud: Host-line rate that it was built for.
    """

    hex_file: Path
    size: str
    version: str
    host_baud: int


def find_sources(folder: str | os.PathLike[str] | None = None) -> Path:
    """Find the folder with the firmware's Makefile.

    Args:
        folder: The folder that the user gave; the one of this checkout if None.

    Raises:
        UsageError: There are no sources.
    """
    if folder is not None:
        path = Path(folder)
        if not (path / "Makefile").is_file() or not (path / "core/generated.h").is_file():
            raise UsageError(f"{path} is not the firmware's folder, which has a Makefile and core/generated.h")
        return path
    if not has_sources():
        raise UsageError(
            "no firmware sources next to this package; clone the repository and give its folder with --source"
        )
    return _SOURCES


def has_sources() -> bool:
    """Whether this is a checkout, with the firmware's sources."""
    return (_SOURCES / "Makefile").is_file()


def source_version(sources: Path) -> str:
    """Read the version that these sources build, as in ``1.0.0``.

    Raises:
        UsageError: They have no version.
    """
    text = read_text(sources / "core/generated.h")
    parts = [re.search(rf"VERSION_{part} = (\d+)", text) for part in ("MAJOR", "MINOR", "PATCH")]
    if not all(parts):
        raise UsageError(f"{sources / 'core/generated.h'} has no version")
    return ".".join(part.group(1) for part in parts if part)


def build(sources: Path, *, host_baud: int = 115200) -> BuildReport:
    """Build the firmware for the Mega 2560.

    Args:
        sources: See `find_sources`.
        host_baud: Rate of the host line.

    Raises:
        UsageError: A tool is missing; the text names its Debian package.
        DeviceError: The build failed, or the firmware is too large.
    """
    missing = [package for tool, package in _BUILD_TOOLS.items() if shutil.which(tool) is None]
    missing += [] if _CORE.is_dir() else ["arduino-core-avr"]
    if missing:
        raise UsageError(f"build tools are missing: sudo apt-get install {' '.join(missing)} avr-libc")
    # A folder for each rate: one rate cannot use the files of another.
    folder = "build" if host_baud == 115200 else f"build/{host_baud}"
    command = ["make", "-C", str(sources), "mega2560", f"HOST_BAUD={host_baud}", f"BUILD={folder}"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=_clean_environment())
    if done.returncode != 0:
        raise DeviceError(f"the build failed: {_tail(done.stderr or done.stdout)}")
    size = next((line for line in done.stdout.splitlines() if line.startswith("flash ")), "")
    return BuildReport(sources / folder / _HEX, size, source_version(sources), host_baud)


def device_of(port: str) -> str:
    """Return the device of a port given as a path, a serial URL or a channel of a configuration file.

    Raises:
        UsageError: The port is not a serial port, which flashing needs.
    """
    url = device_url(port)
    if url.scheme != "serial":
        raise UsageError(f"{port}: a board is flashed through its serial port, such as /dev/ttyUSB0")
    return url.path


def check_board(device: str) -> str:
    """Refuse a port that certainly does not lead to a Mega 2560.

    A converter chip can belong to a clone or to a servo adapter: such a port passes, and the flasher checks the
    chip's signature.

    Returns:
    The probable device, for display.

    Raises:
    UsageError: The device is a known other device, or is unknown.
    """
    real = os.path.realpath(device)
    for port in list_ports():
        if os.path.realpath(port.device) != real:
            continue
        if not port.likely_board:
            raise UsageError(f"{device} is not a Mega 2560 but {port.guess}; use --any-port if you know better")
        return port.guess
    raise UsageError(f"{device} is not a USB serial port of this machine; use --any-port if you know better")


def flash_command(device: str, hex_file: Path, *, verify: bool = True) -> list[str]:
    """Make the flasher's command line: STK500v2 over the boot loader, no chip erase.

    Raises:
        UsageError: There is no such file.
    """
    if not hex_file.is_file():
        raise UsageError(f"no firmware at {hex_file}; build it first: hexwire firmware build")
    command = ["avrdude", "-q", "-p", PART, "-c", "wiring", "-P", device, "-b", "115200", "-D"]
    return [*command, *([] if verify else ["-V"]), "-U", f"flash:w:{hex_file}:i"]


def run_flash(command: Sequence[str]) -> None:
    """Run the flasher, which checks the chip's signature before it writes.

    Raises:
        UsageError: The flasher is not installed.
        DeviceError: The chip is another one, the boot loader does not answer, or verification failed.
    """
    if shutil.which(command[0]) is None:
        raise UsageError(f"{command[0]} is not installed: sudo apt-get install {command[0]}")
    done = subprocess.run(list(command), capture_output=True, text=True, check=False)
    if done.returncode == 0:
        return
    said = done.stdout + done.stderr
    if "expected signature" in said.lower():
        found = re.search(
            r"[Dd]evice signature = (?:0x)?([0-9A-Fa-f]{2}) ?([0-9A-Fa-f]{2}) ?([0-9A-Fa-f]{2})", said
        )
        chip = " ".join(found.groups()) if found else "another one"
        raise DeviceError(
            f"the chip is not an {PART}: its signature is {chip}, not {_SIGNATURE}; nothing was written"
        )
    if any(sign in said for sign in ("timeout", "stk500v2_getsync", "not responding", "programmer is not")):
        raise DeviceError(
            "the boot loader does not answer: is it a Mega 2560, is the port free, is there a capacitor at RESET? "
            "nothing was written"
        )
    raise DeviceError(f"flashing failed: {_tail(said)}")


def _tail(text: str) -> str:
    return " / ".join([line.strip() for line in text.splitlines() if line.strip()][-_TAIL:]) or "no output"


def _clean_environment() -> dict[str, str]:
    """Return the environment without the variables that an outer make passes to an inner one."""
    return {name: value for name, value in os.environ.items() if name not in ("MAKEFLAGS", "MAKELEVEL", "MFLAGS")}
