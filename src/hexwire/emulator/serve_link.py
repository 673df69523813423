"""The name of an emulated device: a symbolic link to its pseudo-terminal.

Owns whose name it is: one that another program still serves, that belongs to somebody else, or that leads to
something else is never taken. Must not know what is behind the terminal.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import os
import re
import socket
import stat
from pathlib import Path

from hexwire.errors import UsageError
from hexwire.new_file import open_folder, owner_name

__all__ = ["TerminalName"]

_TERMINAL = re.compile(r"/dev/pts/[0-9]+")


class TerminalName:
    """A symbolic link to a terminal while it is served.

    While it lasts, a socket without a file is bound that stands for it: so another emulator can tell a name that is
    served from one that was left behind. The system takes it away however this program ends.

    Args:
        link: Where.
        terminal: The terminal's own path.

    Raises:
        UsageError: It cannot be made, or what is there must stay.
    """

    def __init__(self, link: Path, terminal: str) -> None:
        self._link = link
        self._terminal = terminal
        try:
            self._folder = open_folder(link.parent)
        except UsageError as error:
            raise UsageError(f"cannot make the link {link}: {error}, or another --link") from None
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
            ours = stat.S_ISLNK(found.st_mode) and found.st_uid == os.geteuid()
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
                    f"{self._link} is served by another emulator; end that one, or choose another --link"
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
            raise UsageError(f"{self._link} exists and is no symbolic link; choose another --link")
        if found.st_uid != os.geteuid():
            raise UsageError(f"{self._link} is a link of {owner_name(found.st_uid)}; choose another --link")
        target = os.readlink(self._link.name, dir_fd=self._folder)
        if not _TERMINAL.fullmatch(target):
            raise UsageError(f"{self._link} is a link to {target}, no pseudo-terminal; choose another --link")
        if target == self._terminal:
            return
        with contextlib.suppress(FileNotFoundError):
            terminal = Path(target).stat()
            # A terminal younger than the link only reuses the number.
            if terminal.st_uid == os.geteuid() and terminal.st_ctime_ns <= found.st_mtime_ns:
                raise UsageError(
                    f"{self._link} leads to {target}, which a program of yours holds; end that, or choose another "
                    "--link"
                )

    def _make(self) -> None:
        """Make it, in place of what `_look` has let pass."""
        with contextlib.suppress(FileNotFoundError):
            os.unlink(self._link.name, dir_fd=self._folder)
        # Fails if another process made it first.
        os.symlink(self._terminal, self._link.name, dir_fd=self._folder)
