"""The device behind a serial port's name, and whether it is still the intended one.

Owns the checks: is this a terminal in which a program runs, does a symbolic link lead to a pseudo-terminal that is
newer than the link, is this the same USB device as before. Nothing is written to a port for this.
"""

from __future__ import annotations

import errno
import os
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

from hexwire.folders import is_planted
from hexwire.system import device_number, device_parts, user_id, user_name

__all__ = [
    "PTS_MAJORS",
    "PortIdentity",
    "UsbDevice",
    "identify_port",
    "same_device",
    "why_not",
    "why_not_again",
]

_SYSFS = Path("/sys/dev/char")
_PROC = Path("/proc")
# Linux, Documentation/admin-guide/devices.txt: Unix98 pseudo-terminals, and the opening process's own terminal.
PTS_MAJORS = range(136, 144)
_OWN_TERMINAL = (5, 0)
_MOST_LINKS = 40
_SECOND = 1_000_000_000
_MOST_STAT = 4096
"""Bytes of /proc/PID/stat: about 50 numbers."""


@dataclass(frozen=True)
class UsbDevice:
    """Identity of a USB device.

    Attributes:
        vendor: Vendor id, four hexadecimal digits.
        product: Product id, four hexadecimal digits.
        serial: Its serial number; empty if it has none.
    """

    vendor: str
    product: str
    serial: str

    def __str__(self) -> str:
        return f"{self.vendor}:{self.product}" + (f" with serial number {self.serial}" if self.serial else "")


@dataclass(frozen=True)
class PortIdentity:
    """The device that a port's name leads to.

    Attributes:
        device: Number of the device.
        usb: The USB device behind it; None if there is none.
        terminal: Whether it is a pseudo-terminal.
        made: Creation time of the pseudo-terminal, nanoseconds of the system's clock; 0 for other ports.
        owner: User id of its owner.
        link: The symbolic link that leads to it; empty if there is none.
        link_made: Creation time of that link, as `made`.
        link_owner: User id of the link's owner.
        planted: A symbolic link in the path that another user has placed in a directory that everybody may write
            to; empty if there is none.
        planter: User id of that other user.
        among: Number of the file system that a pseudo-terminal is in; 0 for other ports.
    """

    device: int
    usb: UsbDevice | None
    terminal: bool
    made: int
    owner: int
    link: str = ""
    link_made: int = 0
    link_owner: int = 0
    planted: str = ""
    planter: int = 0
    among: int = 0


def same_device(one: os.stat_result, other: os.stat_result) -> bool:
    """Whether two files stand for the same device.

    Pseudo-terminals are counted in each of their file systems, and a container has its own.
    """
    number = device_number(one)
    if not number or number != device_number(other):
        return False
    return device_parts(number)[0] not in PTS_MAJORS or one.st_dev == other.st_dev


def identify_port(name: str, status: os.stat_result) -> PortIdentity:
    """Identify an open port.

    Args:
        name: The name that was opened.
        status: Status of the open descriptor.

    Raises:
        OSError: The name no longer leads to this device.
    """
    device = device_number(status)
    terminal = device_parts(device)[0] in PTS_MAJORS
    # Input and output do not affect the change time; creation, and changes of owner or mode, set it.
    made, among = (status.st_ctime_ns, status.st_dev) if terminal else (0, 0)
    usb = None if terminal else _usb_device(device)
    link, path = None, Path(name)
    planted, planter = "", 0
    for _ in range(_MOST_LINKS):
        if not path.is_symlink():
            break
        if not planted and is_planted(path.lstat(), path.parent.stat()):
            planted, planter = str(path), path.lstat().st_uid
        link, path = path, path.parent / path.readlink()
    if not same_device(path.stat(), status):
        raise OSError(errno.ENXIO, "it leads elsewhere now")
    found = PortIdentity(device, usb, terminal, made, status.st_uid, planted=planted, planter=planter, among=among)
    if link is None:
        return found
    itself = link.lstat()
    return replace(found, link=str(link), link_made=itself.st_mtime_ns, link_owner=itself.st_uid)


def why_not(port: PortIdentity) -> str:
    """Why nothing may be written to a port; empty if writing is allowed.

    The text continues a sentence that starts with the port's name.
    """
    if device_parts(port.device) == _OWN_TERMINAL:
        return "is the terminal that this program runs in"
    if port.planted:
        return (
            f"is reached by the link {port.planted}, which {user_name(port.planter)} has placed in a folder that "
            "everybody may write to; use the port's own name"
        )
    program = _at_work(port.device, port.among, itself=port.terminal)
    if program:
        return f"is the terminal that {program} runs in, not a robot"
    if not port.terminal:
        return ""
    if not port.link:
        if user_id() not in (0, port.owner):
            return f"is a terminal of {user_name(port.owner)}"
        return ""
    # Allow two seconds on a file system that stores whole seconds.
    slack = 0 if port.link_made % _SECOND else 2 * _SECOND
    if port.made > port.link_made + slack:
        return (
            f"is stale: the terminal it leads to was created after the link {port.link}, so it is a different one; "
            "start the emulator again, or recreate the link"
        )
    if port.owner != port.link_owner:
        return (
            f"leads to a terminal of {user_name(port.owner)}, but {user_name(port.link_owner)} created the link "
            f"{port.link}; recreate the link"
        )
    return ""


def why_not_again(before: PortIdentity, now: PortIdentity) -> str:
    """Why a port is not the one that was open before; empty if it is or may be the same."""
    if before.usb is not None and now.usb is not None:
        return "" if before.usb == now.usb else f"is another device now: {now.usb} instead of {before.usb}"
    if before.terminal and now.terminal:
        # A link that the emulator creates again is checked by its age; a terminal without a link is gone for good.
        if before.link and now.link:
            return "" if before.owner == now.owner else f"belongs to {user_name(now.owner)} now"
        same = (before.device, before.made) == (now.device, now.made)
        return "" if same else "is another terminal now: the one that was open is gone; use the emulator's new name"
    same = (before.usb, before.device) == (now.usb, now.device)
    return "" if same else "is another device now"


def _usb_device(number: int) -> UsbDevice | None:
    try:
        folder = (_SYSFS / "{}:{}".format(*device_parts(number)) / "device").resolve(strict=True)
    except OSError:
        return None
    for parent in (folder, *folder.parents):
        if (parent / "idVendor").is_file():
            return UsbDevice(*(_word(parent / name) for name in ("idVendor", "idProduct", "serial")))
    return None


def _word(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return ""


def _at_work(number: int, among: int, *, itself: bool) -> str:
    """A program whose controlling terminal is the device, this one only if `itself`; empty if there is none."""
    major, minor = device_parts(number)
    wanted = (minor & 0xFF) | major << 8 | (minor & ~0xFF) << 12  # linux, new_encode_dev
    if not _PROC.is_dir():
        return ""
    # Hundreds of files, each time that a port is opened: plain calls take a third of the time that `Path` takes.
    for process in filter(str.isdecimal, os.listdir(_PROC)):  # noqa: PTH208
        try:
            with open(f"{_PROC}/{process}/stat", "rb", buffering=0) as file:  # noqa: PTH123
                head, _, tail = file.read(_MOST_STAT).rpartition(b")")
            terminal = int(tail.split(None, 5)[4]) & 0xFFFFFFFF
        except (OSError, ValueError, IndexError):
            continue  # it has ended
        if (
            terminal == wanted
            and (itself or process != str(os.getpid()))
            and not _is_elsewhere(process, number, among)
        ):
            return f"{head.partition(b'(')[2].decode('utf-8', 'replace')} (pid {process})"
    return ""


def _is_elsewhere(process: str, number: int, among: int) -> bool:
    """Whether a program's terminal is one of another file system that has the same number.

    What it has open tells; if it has no terminal open, where its terminals are.
    """
    found = set()
    with suppress(OSError):
        for fd in os.scandir(f"{_PROC}/{process}/fd"):
            with suppress(OSError):
                status = fd.stat()
                if device_number(status) == number:
                    found.add(status.st_dev)
    if not found:
        with suppress(OSError):
            found.add(os.stat(f"{_PROC}/{process}/root/dev/pts/ptmx").st_dev)  # noqa: PTH116  # as above
    return bool(found) and among not in found
