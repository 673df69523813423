"""The serial ports of this machine, the devices they probably belong to, and which one a cable is at.

Owns the table of USB identities, and what it means when a port goes and comes back as its cable is unplugged. Opens
no port. Must not know the protocol on a port.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace

from hexwire.errors import LinkNotFoundError, UsageError

__all__ = ["PortFinder", "PortInfo", "find_only_board", "find_port", "list_ports"]

# VID:PID -> probable device, whether likely a controller board, whether likely a servo bus adapter.
# Arduino's boards.txt for the genuine boards; converter chips by their vendors' ids.
_MEGA = ("Arduino Mega 2560", True, False)
_ADK = ("Arduino Mega ADK", True, False)
_IDENTITIES: dict[tuple[int, int], tuple[str, bool, bool]] = {
    (0x2341, 0x0010): _MEGA,
    (0x2341, 0x0042): _MEGA,
    (0x2341, 0x0210): _MEGA,
    (0x2341, 0x0242): _MEGA,
    (0x2A03, 0x0010): _MEGA,
    (0x2A03, 0x0042): _MEGA,
    (0x2341, 0x003F): _ADK,
    (0x2341, 0x0044): _ADK,
    (0x2A03, 0x003F): _ADK,
    (0x2A03, 0x0044): _ADK,
    (0x1A86, 0x7523): ("CH340: a Mega 2560 clone, or a URT-1 servo adapter", True, True),
    (0x1A86, 0x55D3): ("CH343: a newer servo adapter (URT-1, Waveshare)", False, True),
    (0x1A86, 0x55D4): ("CH9102: a newer servo adapter (Waveshare)", False, True),
    (0x0403, 0x6001): ("FTDI FT232: a board clone or a serial converter", True, True),
    (0x10C4, 0xEA60): ("CP210x: a board clone or a serial converter", True, True),
}
_QUIET = 0.5
"""Seconds after a change in which further ports of the same device come or go."""


@dataclass(frozen=True)
class PortInfo:
    """A serial port.

    Attributes:
        device: Path to open, such as ``/dev/ttyUSB0``.
        vid: USB vendor id, or None for a port that is not on USB.
        pid: USB product id, or None.
        serial_number: USB serial number; empty if it has none, like many clones.
        description: The device's own description; may be empty.
        guess: The probable device.
        likely_board: Whether it may be the arm's controller board.
        likely_adapter: Whether it may be an adapter to the servo bus.
    """

    device: str
    vid: int | None = None
    pid: int | None = None
    serial_number: str = ""
    description: str = ""
    guess: str = "unknown"
    likely_board: bool = False
    likely_adapter: bool = False

    @property
    def usb_id(self) -> str:
        """``1a86:7523``, or empty."""
        return "" if self.vid is None or self.pid is None else f"{self.vid:04x}:{self.pid:04x}"

    def __str__(self) -> str:
        return f"{self.device} ({self.guess})"


def list_ports() -> list[PortInfo]:
    """List the serial ports, USB ones first, each group by name."""
    from serial.tools import list_ports as pyserial_ports

    ports = []
    for found in pyserial_ports.comports():
        vid, pid = found.vid, found.pid
        if vid is None or pid is None:
            guess, board, adapter = "built-in serial port", False, False
        else:
            unknown = (f"unknown USB device {vid:04x}:{pid:04x}", False, False)
            guess, board, adapter = _IDENTITIES.get((vid, pid), unknown)
        description = found.description if found.description not in (None, "n/a") else ""
        ports.append(
            PortInfo(found.device, vid, pid, found.serial_number or "", description, guess, board, adapter)
        )
    return sorted(ports, key=lambda port: (port.vid is None, port.device))


def find_port(device: str) -> PortInfo:
    """Information on one port, listed or not.

    Args:
        device: Its path; may be a symbolic link, such as those in ``/dev/serial/by-id``.
    """
    real = os.path.realpath(device)
    for port in list_ports():
        if os.path.realpath(port.device) == real:
            return replace(port, device=device)
    pseudo = real.startswith("/dev/pts/")
    guess = "pseudo-terminal: an emulator, or a program that forwards bytes" if pseudo else "unknown port"
    return PortInfo(device, guess=guess)


def find_only_board() -> str:
    """Find the port if the user names none.

    Returns:
        Device path of the one port that is likely a controller board.

    Raises:
        LinkNotFoundError: There is none.
        UsageError: There are several; the text lists them.
    """
    ports = list_ports()
    boards = [port for port in ports if port.likely_board]
    if len(boards) == 1:
        return boards[0].device
    if boards:
        raise UsageError(f"several likely boards: {_in_words(boards)}; name one with --port")
    if ports:
        raise LinkNotFoundError(
            f"no likely board among the serial ports: {_in_words(ports)}; plug it in, name a port with --port or "
            "HEXWIRE_PORT, or take an emulated arm: --port sim://hex7bot"
        )
    raise LinkNotFoundError(
        "no serial port on this machine; plug the board in, name a link with --port or HEXWIRE_PORT, or take an "
        "emulated arm: --port sim://hex7bot"
    )


def ports_in_words() -> str:
    """The existing serial ports, for the end of an error text."""
    ports = list_ports()
    return f"ports here: {_in_words(ports)}" if ports else "no serial port on this machine"


def _in_words(ports: list[PortInfo]) -> str:
    names = ", ".join(str(port) for port in ports[:8])
    return f"{names} and {len(ports) - 8} more" if len(ports) > 8 else names


class PortFinder:
    """Compares lists of ports.

    A device that is unplugged takes all its ports with it, and they may have other names when it is back. A device
    that is plugged in for the first time is found too.

    Args:
        ports: The ports at the beginning.

    Attributes:
        gone: The ports that have gone, once one has.
        found: The ports of the device, at the end.
        over: They are known.
    """

    def __init__(self, ports: Sequence[PortInfo]) -> None:
        self._known = {port.device: port for port in ports}
        self._here = dict(self._known)
        self._changed_at: float | None = None
        self.gone: tuple[PortInfo, ...] = ()
        self.found: tuple[PortInfo, ...] = ()
        self.over = False

    def receive(self, ports: Sequence[PortInfo], now: float) -> None:
        """Take the ports that are here at a time, in seconds."""
        here = {port.device: port for port in ports}
        if here.keys() != self._here.keys():
            self._changed_at = now
        self._here = here
        self.gone = tuple(port for name, port in self._known.items() if name not in here) or self.gone
        free = {port.device for port in self.gone}
        came = tuple(port for name, port in here.items() if name not in self._known or name in free)
        settled = self._changed_at is not None and now - self._changed_at >= _QUIET
        if came and settled:
            self.found, self.over = came, True

    @property
    def asks(self) -> str:
        """What to do next; empty at the end."""
        if self.over:
            return ""
        if self.gone:
            names = ", ".join(port.device for port in self.gone)
            return f"{names} is gone: plug it in again"
        return "unplug the USB cable of the arm; or plug it in, if it is not yet"
