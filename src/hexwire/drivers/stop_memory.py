"""What this user's programs know of a device: it is stopped; its board moves nothing when it is reset.

Owns one empty file per device and fact, in a folder of this user that the system empties. Must not know robots.

`StopMemory` keeps a latched stop from one program to the next, for arms whose board does not. It does not cover a
stop by another user or from another computer, or motion without hexwire. A port without a serial number is
identified by its name; another device plugged in there later counts as the same. For `CalmBoard` it does not, since
it would be taken for safe.
"""

from __future__ import annotations

import contextlib
import hashlib
import logging
import os
import stat
from pathlib import Path
from typing import TYPE_CHECKING

from hexwire.errors import HexwireError, UsageError
from hexwire.folders import make_folder, open_folder, runtime_folder
from hexwire.link.port_identity import PTS_MAJORS
from hexwire.link.url import parse_url
from hexwire.system import device_number, device_parts, user_id

if TYPE_CHECKING:
    from hexwire.link.base import Link

__all__ = ["CalmBoard", "StopMemory"]

_log = logging.getLogger(__name__)

_NETWORK = frozenset(("tcp", "tcps", "udp"))


class _Note:
    """A fact about one device: a file that exists while it is so.

    Args:
        kind: The first part of the file's name.
        identity: What identifies the device; empty if nothing can be kept.
    """

    def __init__(self, kind: str, identity: str) -> None:
        self._name = "" if not identity else f"{kind}-{hashlib.sha256(identity.encode()).hexdigest()[:24]}"

    @property
    def _is_there(self) -> bool:
        if not self._name:
            return False
        try:
            with open_folder(runtime_folder()) as folder:
                found = folder.status_of(self._name)
        except (OSError, UsageError):
            return False
        return stat.S_ISREG(found.st_mode) and found.st_uid == user_id()

    def _make(self) -> None:
        if self._name and not self._is_there:
            make_folder(runtime_folder())
            with open_folder(runtime_folder()) as folder:
                os.close(folder.make(self._name, 0o600))

    def forget(self) -> None:
        """Remove the file: it is so no longer.

        Raises:
            OSError: The file cannot be removed.
        """
        if self._is_there:
            with contextlib.suppress(FileNotFoundError), open_folder(runtime_folder()) as folder:
                folder.remove(self._name)


class StopMemory(_Note):
    """The stop memory of one device.

    Args:
        url: URL of the link; links inside a program have no memory.
    """

    def __init__(self, url: str) -> None:
        super().__init__("stop", _identity(url))
        self._url = url
        self._failed = False

    @property
    def kept_by(self) -> str:
        """As `RobotDriver.stop_kept_by`; empty if the file could not be created."""
        return "user" if self._name and not self._failed else ""

    @property
    def stopped(self) -> bool:
        """Whether this user has stopped the device and not resumed it."""
        return self._is_there

    def remember(self) -> None:
        """Record the stop; logs a warning if it cannot be kept for other programs."""
        self._failed = False
        try:
            self._make()
        except (OSError, UsageError) as error:
            self._failed = True
            _log.warning("the stop of %s cannot be kept for other programs: %s", self._url, error)


class CalmBoard(_Note):
    """Whether the board behind a link is known to move nothing when opening the link resets it.

    Args:
        link: The link, open or not. One whose opening resets nothing is always calm.
    """

    def __init__(self, link: Link) -> None:
        self._resets = bool(getattr(link, "may_reset", False))
        super().__init__("calm", _identity(link.url, plugged=True) if self._resets else "")

    @property
    def known(self) -> bool:
        """Whether it may be opened without a warning."""
        return not self._resets or self._is_there

    def note(self, *, calm: bool) -> None:
        """Record what has been found. If it cannot be kept, the next program warns again."""
        with contextlib.suppress(OSError, UsageError):
            if calm:
                self._make()
            else:
                self.forget()


def _identity(url: str, *, plugged: bool = False) -> str:
    """Return what identifies the device; empty for a link that ends with its program.

    Args:
        url: URL of the link.
        plugged: A device is another one once it has been plugged in again, also if it has a serial number: it may
            have got other firmware elsewhere.
    """
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
    if device_parts(device_number(found))[0] in PTS_MAJORS:
        # The system reuses the names of pseudo-terminals.
        return f"{path} {found.st_ctime_ns}"
    from hexwire.link.ports import find_port

    with contextlib.suppress(HexwireError):
        port = find_port(path)
        if port.serial_number:
            usb = f"usb {port.usb_id} {port.serial_number}"
            return f"{usb} {found.st_ctime_ns}" if plugged else usb
    return f"{path} {found.st_ctime_ns}" if plugged else path
