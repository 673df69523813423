"""Creates files safely: new, owned by this user, and in the intended folder.

Keeps three promises: nothing is overwritten unless that is asked for; no symbolic link is followed that another
user may have planted (see `hexwire.folders`); only its owner can read a new file.
"""

from __future__ import annotations

import contextlib
import os
import secrets
import stat
from pathlib import Path
from typing import BinaryIO, Self

from hexwire.errors import UsageError
from hexwire.folders import open_folder
from hexwire.system import user_id, user_name

__all__ = ["OutputFile"]


class OutputFile:
    """A file to write, created at construction, so that any obstacle is reported before other work starts.

    As a context manager it keeps the file at the end, and removes it if an error ends the block, unless `keep` was
    called before. A file that is overwritten stays unchanged until the new one is complete.

    Args:
        path: Path of the file.
        force: Overwrite an existing file.
        mode: Permissions of the file; only its owner may read it by default.
        partial: Keep what was written even if the end could not be, as for a recording on a full disk.

    Attributes:
        path: Path of the file.
        file: Open for writing bytes.

    Raises:
        UsageError: The file exists, is not a regular file, or cannot be created.
    """

    def __init__(self, path: str | Path, *, force: bool = False, mode: int = 0o600, partial: bool = False) -> None:
        self.path = Path(path)
        self._partial = partial
        if str(path).endswith("/") or self.path.name in ("", ".."):
            raise UsageError(f"{path} is a folder; name a file")
        try:
            self._folder = open_folder(self.path.parent)
        except UsageError as error:
            raise UsageError(f"{path} cannot be written: {error}") from None
        try:
            replaces = self._look(force)
            # Until it is complete, a file that replaces another has a different name.
            self._name = f".{self.path.name[:200]}.{secrets.token_hex(4)}.part" if replaces else self.path.name
            fd = self._folder.make(self._name, mode)
        except OSError as error:
            self._folder.close()
            raise UsageError(f"{path} cannot be written: {error.strerror}; choose another place") from error
        except BaseException:
            self._folder.close()
            raise
        self._made = os.fstat(fd)
        self._open = True
        self.file: BinaryIO = os.fdopen(fd, "wb")

    def keep(self) -> None:
        """Finish the file under its name. Does nothing if it is already finished.

        Raises:
            UsageError: Another program has replaced it meanwhile.
            OSError: It cannot be written completely.
        """
        if not self._open:
            return
        try:
            self.file.flush()
            # A machine beside a robot may lose its power at any time.
            os.fsync(self.file.fileno())
        except BaseException:
            if self._partial:
                self._put_in_place()
            self.discard()
            raise
        self._put_in_place()

    def discard(self) -> None:
        """Remove the file. Does nothing if it is already finished."""
        if not self._open:
            return
        with contextlib.suppress(OSError):
            if self._is_ours():
                self._folder.remove(self._name)
        self._close()

    def _put_in_place(self) -> None:
        if self._name != self.path.name:
            if not self._is_ours():
                self._close()
                raise UsageError(f"{self.path} was not written: another program has replaced {self._name}")
            # Windows renames no open file. What could not be written has been reported already.
            with contextlib.suppress(OSError):
                self.file.close()
            self._folder.rename(self._name, self.path.name)
        self._close()

    def _look(self, force: bool) -> bool:
        """Whether there is a file to overwrite.

        Raises:
            UsageError: What has this name must stay.
        """
        try:
            found = self._folder.status_of(self.path.name)
        except FileNotFoundError:
            return False
        if stat.S_ISLNK(found.st_mode):
            raise UsageError(f"{self.path} is a symbolic link, which is not followed; name the file itself")
        if stat.S_ISDIR(found.st_mode):
            raise UsageError(f"{self.path} is a folder; name a file")
        if not stat.S_ISREG(found.st_mode):
            raise UsageError(f"{self.path} is not a regular file; choose another name")
        if found.st_uid != user_id() and self._folder.status().st_mode & stat.S_IWOTH:
            raise UsageError(
                f"{self.path} belongs to {user_name(found.st_uid)}, and everybody may write to its folder; "
                "choose another name"
            )
        if not force:
            raise UsageError(f"{self.path} already exists; --force overwrites it")
        return True

    def _is_ours(self) -> bool:
        found = self._folder.status_of(self._name)
        return os.path.samestat(found, self._made)

    def _close(self) -> None:
        self._open = False
        self._folder.close()
        with contextlib.suppress(OSError):
            self.file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            self.keep()
        else:
            self.discard()
