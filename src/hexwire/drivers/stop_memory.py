"""Keeps a latched stop from one program to the next, for arms whose board does not.

Owns one file per device, in a folder of this user, that exists while the stop holds. Must not know robots.

It does not cover a stop by another user or from another computer, or motion without hexwire. A port without a
serial number is identified by its name; another device plugged in there later counts as the same.
"""

from __future__ import annotations

import contextlib
import hashlib
import logging
import os
import stat
from pathlib import Path

from hexwire.errors import HexwireError, UsageError
from hexwire.folders import make_folder, open_folder, runtime_folder
from hexwire.link.url import parse_url
from hexwire.system import device_number, device_parts, user_id

__all__ = ["StopMemory"]

_log = logging.getLogger(__name__)

_PSEUDO_TERMINALS = range(136, 144)
"""Major device numbers; the system reuses the names of pseudo-terminals."""
_NETWORK = frozenset(("tcp", "udp", "tls"))


class StopMemory:
    """The stop memory of one device.

    Args:
        url: URL of the link; links inside a program have no memory.
    """

    def __init__(self, url: str) -> None:
        identity = _identity(url)
        self._name = "" if not identity else f"stop-{hashlib.sha256(identity.encode()).hexdigest()[:24]}"
        self._url = url
        self._failed = False

    @property
    def kept_by(self) -> str:
        """As `RobotDriver.stop_kept_by`; empty if the file could not be created."""
        return "user" if self._name and not self._failed else ""

    @property
    def stopped(self) -> bool:
        """Whether this user has stopped the device and not resumed it."""
        if not self._name:
            return False
        try:
            with open_folder(runtime_folder()) as folder:
                found = folder.status_of(self._name)
        except (OSError, UsageError):
            return False
        return stat.S_ISREG(found.st_mode) and found.st_uid == user_id()

    def remember(self) -> None:
        """Record the stop; logs a warning if it cannot be kept for other programs."""
        self._failed = False
        if not self._name or self.stopped:
            return
        try:
            make_folder(runtime_folder())
            with open_folder(runtime_folder()) as folder:
                os.close(folder.make(self._name, 0o600))
        except (OSError, UsageError) as error:
            self._failed = True
            _log.warning("the stop of %s cannot be kept for other programs: %s", self._url, error)

    def forget(self) -> None:
        """Remove the record: the stop has ended.

        Raises:
            OSError: The file cannot be removed.
        """
        if self.stopped:
            with contextlib.suppress(FileNotFoundError), open_folder(runtime_folder()) as folder:
                folder.remove(self._name)


def _identity(url: str) -> str:
    """Return what identifies the device; empty for a link that ends with its program."""
    try:
        parts = parse_url(url)
    except HexwireError:
        return ""
    if parts.scheme in _NETWORK:
        return url
    if parts.scheme != "serial":
        return ""
    path = os.path.realpath(parts.path)
    try:
        found = Path(path).stat()
    except OSError:
        return ""
    if not stat.S_ISCHR(found.st_mode):
        return ""
    if device_parts(device_number(found))[0] in _PSEUDO_TERMINALS:
        return f"{path} {found.st_ctime_ns}"
    from hexwire.link.ports import find_port

    with contextlib.suppress(HexwireError):
        port = find_port(path)
        if port.serial_number:
            return f"usb {port.usb_id} {port.serial_number}"
    return path
