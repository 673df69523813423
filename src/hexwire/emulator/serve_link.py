"""The name of an emulated device: a symbolic link to its pseudo-terminal.

Owns which names may be taken: never one that another program still serves, that belongs to another user, or that
leads to anything but a pseudo-terminal. Must not know what is behind the terminal.
"""

from __future__ import annotations

import sys

if sys.platform != "linux":
    raise ImportError("names of pseudo-terminals are for Linux")

import contextlib
import errno
import hashlib
import os
import re
import socket
import stat
from pathlib import Path

from hexwire.errors import UsageError
from hexwire.folders import open_folder
from hexwire.system import user_id, user_name

__all__ = ["TerminalName"]

_TERMINAL = re.compile(r"/dev/pts/[0-9]+")


class TerminalName:
    """A symbolic link to a terminal while it is served.

    While the link exists, an abstract socket is bound that stands for it, so that another emulator can tell a name
    in use from one left behind. The system releases the socket however this program ends.

    Args:
        link: Path of the link.
        terminal: The terminal's own path.

    Raises:
        UsageError: The link cannot be made, or something that must stay has its name.
    """

    def __init__(self, link: Path, terminal: str) -> None:
        self._link = link
        self._terminal = terminal
        try:
            self._folder = open_folder(link.parent).descriptor
        except UsageError as error:
            raise UsageError(f"cannot make the link {link} (--link): {error}") from None
        self._claim: socket.socket | None = None
        try:
            self._claim = self._claimed()
            self._look()
            self._make()
        except OSError as error:
            self._release()
            raise UsageError(f"cannot make the link {link}: {error.strerror}; choose another --link") from error
        except BaseException:
            self._release()
            raise

    def remove(self) -> None:
        """Remove the link if it still leads to our terminal, which must still be open."""
        if self._folder < 0:
            return
        with contextlib.suppress(OSError):
            found = os.stat(self._link.name, dir_fd=self._folder, follow_symlinks=False)
            ours = stat.S_ISLNK(found.st_mode) and found.st_uid == user_id()
            if ours and os.readlink(self._link.name, dir_fd=self._folder) == self._terminal:
                os.unlink(self._link.name, dir_fd=self._folder)
        self._release()

    def _release(self) -> None:
        os.close(self._folder)
        self._folder = -1
        if self._claim is not None:
            self._claim.close()

    def _claimed(self) -> socket.socket | None:
        """The socket that stands for this name, by whatever path it is reached."""
        folder = os.fstat(self._folder)
        name = f"{folder.st_dev}:{folder.st_ino}:{self._link.name}"
        claim = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            claim.bind(b"\0hexwire-link:" + hashlib.sha256(os.fsencode(name)).hexdigest().encode())
        except OSError as error:
            claim.close()
            if error.errno == errno.EADDRINUSE:
                raise UsageError(
                    f"{self._link} is in use by another emulator; stop that one, or choose another --link"
                ) from None
            return None
        return claim

    def _look(self) -> None:
        """Refuse to replace what is not a link that an emulator of this user has left behind."""
        try:
            found = os.stat(self._link.name, dir_fd=self._folder, follow_symlinks=False)
        except FileNotFoundError:
            return
        if not stat.S_ISLNK(found.st_mode):
            raise UsageError(f"{self._link} exists and is not a symbolic link; choose another --link")
        if found.st_uid != user_id():
            owner = user_name(found.st_uid)
            raise UsageError(f"{self._link} is a link that belongs to {owner}; choose another --link")
        target = os.readlink(self._link.name, dir_fd=self._folder)
        if not _TERMINAL.fullmatch(target):
            raise UsageError(f"{self._link} links to {target}, not to a pseudo-terminal; choose another --link")
        if target == self._terminal:
            return
        with contextlib.suppress(FileNotFoundError):
            terminal = Path(target).stat()
            # A terminal younger than the link only reuses the number.
            if terminal.st_uid == user_id() and terminal.st_ctime_ns <= found.st_mtime_ns:
                raise UsageError(
                    f"{self._link} leads to {target}, which another program of yours has open; stop that program, "
                    "or choose another --link"
                )

    def _make(self) -> None:
        """Make the link, in place of one that `_look` has allowed to replace."""
        with contextlib.suppress(FileNotFoundError):
            os.unlink(self._link.name, dir_fd=self._folder)
        # Fails if another process made it first.
        os.symlink(self._terminal, self._link.name, dir_fd=self._folder)
