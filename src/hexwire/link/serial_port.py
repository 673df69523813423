"""What all links to serial ports share: rates, addresses, the reset of a board, errors."""

from __future__ import annotations

import contextlib
import errno
import stat
import sys
import time
from abc import abstractmethod
from pathlib import Path

from hexwire.errors import (
    HexwireError,
    LinkBusyError,
    LinkError,
    LinkNotFoundError,
    LinkPermissionError,
    UsageError,
)
from hexwire.system import device_number, device_parts, group_name, user_name

from . import owner, ports
from .base import LinkKind
from .poll_link import PollLink
from .port_identity import PTS_MAJORS, PortIdentity, why_not, why_not_again

__all__ = [
    "BAUD_HIGH",
    "BAUD_LOW",
    "DEFAULT_BAUD",
    "SerialPortLink",
    "bad_baud",
    "busy_port",
    "check_baud",
    "explain_opening",
    "forbidden_port",
    "may_reset",
    "missing_port",
    "serial_url",
]

DEFAULT_BAUD = 115200
"""Bits per second if an address names no rate."""
_DTR_PULSE = 0.05
"""Seconds: a Mega's reset line is pulsed through a capacitor; 50 ms is what common flashing tools use."""
BAUD_LOW, BAUD_HIGH = 50, 12_000_000
"""The rates that an address may name."""


def serial_url(device: str, baud: int) -> str:
    """Address of a port."""
    if sys.platform != "win32" and not device.startswith("/") and Path(device).exists():
        # A stop is found by the address: it must not depend on the folder in which a command is run.
        device = str(Path(device).absolute())
    return f"serial://{device if device.startswith('/') else f'/{device}'}?baud={baud}"


def check_baud(baud: int) -> None:
    """Refuse a rate that no port has; raises UsageError."""
    if not BAUD_LOW <= baud <= BAUD_HIGH:
        raise UsageError(f"baud must be from {BAUD_LOW} to {BAUD_HIGH}, not {baud}")


def may_reset(device: str) -> bool:
    """Whether opening a port may reset the board behind it, as DTR does on an Arduino.

    A pseudo-terminal has no DTR. One with the sticky bit belongs to an emulator that behaves as if it had. What is
    no device, or is not there, cannot be opened; where ports have names that are no paths, nobody can tell.
    """
    try:
        status = Path(device).stat()
    except FileNotFoundError:
        return sys.platform == "win32"
    except OSError:
        return True
    if not stat.S_ISCHR(status.st_mode):
        return False
    if device_parts(device_number(status))[0] in PTS_MAJORS:
        return bool(status.st_mode & stat.S_ISVTX)
    with contextlib.suppress(HexwireError):
        port = ports.find_port(device)
        # Only adapters to a servo bus have these chips.
        return port.likely_board or not port.likely_adapter
    return True


class SerialPortLink(PollLink):
    """A serial port, 8N1, raw, for one program at a time.

    Args:
        device: Name of the port.
        baud: Bits per second; any rate that the port's driver supports.
        low_latency: Ask the driver to deliver bytes at once, where it has such a setting.
        reset_board: Pulse DTR after opening, to reset a board even if opening does not.
        raise_to: Rate to which a session shall raise the line once it knows the board; 0 leaves it.

    Attributes:
        device: Name of the port.
        baud: The present rate.
        raise_to: Rate to which a session shall raise the line; 0 leaves it.
    """

    kind = LinkKind.STREAM
    _lost_advice = "; was it unplugged?"

    def __init__(
        self,
        device: str,
        baud: int = DEFAULT_BAUD,
        *,
        low_latency: bool = True,
        reset_board: bool = False,
        raise_to: int = 0,
    ) -> None:
        check_baud(baud)
        super().__init__(serial_url(device, baud))
        self.device, self.baud, self.raise_to = device, baud, raise_to
        self._low_latency, self._reset_board = low_latency, reset_board
        # Of the port that was open last.
        self._identity: PortIdentity | None = None

    @property
    def may_reset(self) -> bool:
        """Whether opening it may reset the board."""
        return may_reset(self.device)

    def open(self) -> None:
        super().open()
        if self._reset_board:
            self.reset()

    def reset(self) -> None:
        """Pulse DTR, which resets an Arduino, and discard what arrived before. Takes 50 ms.

        Does nothing on a port without that line, such as a pseudo-terminal.
        """
        self.fileno()
        with contextlib.suppress(OSError):
            self._set_dtr(False)
            time.sleep(_DTR_PULSE)
            self._set_dtr(True)
        self.flush_input()

    def set_baud(self, baud: int) -> None:
        """Change the rate, even of an open port; nothing else changes and no board is reset.

        Raises:
            UsageError: The port's driver does not support that rate.
            LinkLostError: The port was lost.
        """
        check_baud(baud)
        self.url = serial_url(self.device, baud)
        self.set_rate(baud)

    @abstractmethod
    def set_rate(self, baud: int) -> None:
        """As `set_baud`, but the address stays that of the usual rate: the board changes its rate as well."""

    @abstractmethod
    def _set_dtr(self, on: bool) -> None:
        """Set the line DTR; raises OSError."""

    def _check_intended(self, found: PortIdentity) -> None:
        """Refuse a port that is not the intended one, before anything is written to it.

        Args:
            found: The port behind the name.

        Raises:
            LinkNotFoundError: It is another one.
        """
        problem = why_not(found)
        if not problem and self._identity is not None:
            problem = why_not_again(self._identity, found)
        if problem:
            raise LinkNotFoundError(f"{self.device} {problem}; nothing was written to it", url=self.url)

    def _no_port(self, what: str) -> LinkNotFoundError:
        return missing_port(self.device, what, self.url)

    def _bad_baud(self, why: str) -> UsageError:
        return bad_baud(self.device, self.baud, why)


# --- errors ------------------------------------------------------------------------------------------------------


def missing_port(device: str, what: str, url: str) -> LinkNotFoundError:
    """There is no such port; `what` says why, after the port's name."""
    return LinkNotFoundError(f"{device} {what}; {ports.ports_in_words()}", url=url)


def busy_port(device: str, url: str) -> LinkBusyError:
    """Another program has the port."""
    who = owner.device_owner(device) or "another program"
    return LinkBusyError(f"{device} is in use by {who}: close that first", url=url)


def forbidden_port(device: str, url: str) -> LinkPermissionError:
    """This user may not open the port."""
    return LinkPermissionError(f"no permission for {device}: {_permission_advice(device)}", url=url)


def explain_opening(error: OSError, device: str, url: str) -> LinkError:
    """Why the system did not open a port, with what to do."""
    if error.errno in (errno.EACCES, errno.EPERM):
        return forbidden_port(device, url)
    if error.errno == errno.EBUSY:
        return busy_port(device, url)
    if error.errno in (errno.ENOENT, errno.ENOTDIR, errno.ENXIO, errno.ENODEV, errno.ELOOP):
        what = "does not exist" if error.errno == errno.ENOENT else "has no device behind it"
        return missing_port(device, what, url)
    if error.errno in (errno.EISDIR, errno.EROFS, errno.ETXTBSY):
        return missing_port(device, "is not a serial port", url)
    return LinkError(f"{device} cannot be opened: {error.strerror or error}", url=url)


def bad_baud(device: str, baud: int, why: str) -> UsageError:
    """The port cannot have that rate."""
    return UsageError(f"{device} cannot do {baud} baud ({why}): use 115200 or another usual rate")


def _permission_advice(device: str) -> str:
    try:
        status = Path(device).stat()
    except OSError:
        return "ask the owner of this machine for access to it"
    group = group_name(status.st_gid)
    if not group:
        return "ask the owner of this machine for access to it"
    if group == "root" or not status.st_mode & stat.S_IRGRP:
        user = user_name(status.st_uid)
        return f"it belongs to {user} alone; add a udev rule that gives it to group dialout"
    return f"it belongs to group {group}; run 'sudo usermod -aG {group} $USER', then log out and in again"
