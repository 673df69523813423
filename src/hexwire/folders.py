"""Folders opened once and kept open, so that replacing a part of their path has no effect.

Owns the search for a folder: no symbolic link is followed that another user may have planted. Only Linux can open a
folder to work in it; on other systems a `Folder` is its path, and the promise is that of the system.
"""

from __future__ import annotations

import contextlib
import errno
import os
import stat
import sys
from pathlib import Path
from typing import Protocol, Self

from hexwire.errors import UsageError
from hexwire.system import BINARY, CLOSE_ON_EXEC, HAS_FOLDER_DESCRIPTORS, NO_FOLLOW, user_id, user_name

__all__ = [
    "Folder",
    "is_planted",
    "make_folder",
    "make_private_folder",
    "open_folder",
    "runtime_folder",
]

_NEW = os.O_WRONLY | os.O_CREAT | os.O_EXCL | NO_FOLLOW | CLOSE_ON_EXEC | BINARY
_MOST_LINKS = 40
"""Most symbolic links followed on the way to a folder: as many as Linux follows."""


class Folder(Protocol):
    """An open folder. Names are those of files directly in it; no method follows a symbolic link there.

    All methods but `close` raise OSError as the system's own calls.
    """

    @property
    def descriptor(self) -> int:
        """Descriptor of the folder; -1 if the system has none."""

    def status(self) -> os.stat_result:
        """Status of the folder."""

    def status_of(self, name: str) -> os.stat_result:
        """Status of a file, or of a symbolic link itself."""

    def make(self, name: str, mode: int) -> int:
        """Create a file that did not exist, and open it for writing; returns its descriptor."""

    def remove(self, name: str) -> None:
        """Remove a file."""

    def rename(self, name: str, to: str) -> None:
        """Rename a file; replaces the one that had the new name."""

    def open_lock(self) -> int:
        """Open what programs lock that change files of the folder; returns its descriptor, for `lock_file`."""

    def close(self) -> None:
        """Close the folder."""

    def __enter__(self) -> Self: ...

    def __exit__(self, *_: object) -> None: ...


class _Closing:
    def close(self) -> None:
        """Close the folder."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class _NamedFolder(_Closing):
    """A folder by its path, for systems that cannot open one."""

    descriptor = -1

    def __init__(self, path: Path) -> None:
        self._path = path

    def status(self) -> os.stat_result:
        return self._path.stat()

    def status_of(self, name: str) -> os.stat_result:
        return (self._path / name).lstat()

    def make(self, name: str, mode: int) -> int:
        return os.open(self._path / name, _NEW, mode)

    def remove(self, name: str) -> None:
        (self._path / name).unlink()

    def rename(self, name: str, to: str) -> None:
        (self._path / name).replace(self._path / to)

    def open_lock(self) -> int:
        return os.open(self._path / ".lock", os.O_RDWR | os.O_CREAT, 0o600)


def open_folder(path: Path) -> Folder:
    """Open a folder to work in it; the caller closes it.

    Symbolic links of this user and of the system are followed. One that another user has put into a world-writable
    folder is not, whatever the kernel's setting.

    Raises:
        UsageError: There is no such folder, its path leads through a planted link, or it belongs to another user
            and is world-writable.
    """
    folder = _walk(path, make=False)
    found = folder.status()
    if found.st_mode & stat.S_IWOTH and found.st_uid not in (0, user_id()):
        folder.close()
        raise UsageError(
            f"{path} belongs to {user_name(found.st_uid)}, and everybody may write to it; choose another folder"
        )
    return folder


def make_folder(path: Path) -> None:
    """Make a folder and the missing ones above it.

    Raises:
        UsageError: As `open_folder`; or this user may not make it.
    """
    _walk(path, make=True).close()


def make_private_folder(path: Path, remedy: str) -> None:
    """Make a folder that nobody else can look into, in one that nobody else can change.

    Raises:
        UsageError: One of them cannot be made, or belongs to another user; the text ends with `remedy`.
    """
    try:
        make_folder(path)
    except UsageError as error:
        raise UsageError(f"{error}: {remedy}") from None
    try:
        # Whoever may change the folder above could put another one in its place.
        for folder, forbidden in ((path.parent, 0o022), (path, 0o077)):
            status = folder.stat()
            if status.st_uid != user_id():
                raise UsageError(f"{folder} belongs to {user_name(status.st_uid)}; {remedy}")
            if status.st_mode & forbidden:
                folder.chmod(status.st_mode & 0o777 & ~forbidden)
    except OSError as error:
        raise UsageError(f"{path} cannot be used: {error.strerror}; {remedy}") from None


def runtime_folder() -> Path:
    """Folder for what programs of this user share; XDG_RUNTIME_DIR is cleared at this user's last log-out."""
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    if runtime and Path(runtime).is_absolute():
        return Path(runtime) / "hexwire"
    state = os.environ.get("XDG_STATE_HOME")
    return (Path(state) if state and Path(state).is_absolute() else Path.home() / ".local" / "state") / "hexwire"


def _walk(path: Path, *, make: bool) -> Folder:
    if sys.platform == "linux" and HAS_FOLDER_DESCRIPTORS:
        return _OpenFolder(_descend(path, make=make))
    try:
        if make:
            path.mkdir(mode=0o755, parents=True, exist_ok=True)
        if not path.is_dir():
            raise OSError(errno.ENOENT, "there is no such folder")
    except OSError as error:
        raise UsageError(f"{error.strerror} ({path}); choose another place") from error
    return _NamedFolder(path)


if sys.platform == "linux" and HAS_FOLDER_DESCRIPTORS:
    _PATH = os.O_PATH | NO_FOLLOW | CLOSE_ON_EXEC
    _FOLDER = _PATH | os.O_DIRECTORY

    class _OpenFolder(_Closing):
        """A folder by its descriptor."""

        def __init__(self, descriptor: int) -> None:
            self.descriptor = descriptor

        def status(self) -> os.stat_result:
            return os.fstat(self.descriptor)

        def status_of(self, name: str) -> os.stat_result:
            return os.stat(name, dir_fd=self.descriptor, follow_symlinks=False)

        def make(self, name: str, mode: int) -> int:
            return os.open(name, _NEW, mode, dir_fd=self.descriptor)

        def remove(self, name: str) -> None:
            os.unlink(name, dir_fd=self.descriptor)

        def rename(self, name: str, to: str) -> None:
            os.rename(name, to, src_dir_fd=self.descriptor, dst_dir_fd=self.descriptor)

        def open_lock(self) -> int:
            return os.open(".", os.O_RDONLY | os.O_DIRECTORY | CLOSE_ON_EXEC, dir_fd=self.descriptor)

        def close(self) -> None:
            os.close(self.descriptor)

    def _descend(path: Path, *, make: bool) -> int:
        left = list(reversed(path.parts))
        links = 0
        here = os.open(".", _FOLDER)
        try:
            while left:
                part = left.pop()
                # A link is itself opened, then examined: nobody can replace it in between.
                try:
                    there = os.open(part, _PATH, dir_fd=here)
                except FileNotFoundError:
                    if not make:
                        raise
                    # Another program may make it at the same moment.
                    with contextlib.suppress(FileExistsError):
                        os.mkdir(part, 0o755, dir_fd=here)
                    there = os.open(part, _PATH, dir_fd=here)
                found = os.fstat(there)
                if stat.S_ISLNK(found.st_mode):
                    target = os.readlink("", dir_fd=there)
                    os.close(there)
                    links += 1
                    _refuse_planted(path, found, os.fstat(here))
                    if links > _MOST_LINKS:
                        raise OSError(errno.ELOOP, os.strerror(errno.ELOOP))
                    left += reversed(Path(target).parts)
                    continue
                os.close(here)
                here = there
                if not stat.S_ISDIR(found.st_mode):
                    raise OSError(errno.ENOTDIR, os.strerror(errno.ENOTDIR))
        except OSError as error:
            os.close(here)
            what = "there is no such folder" if error.errno == errno.ENOENT else error.strerror
            raise UsageError(f"{what} ({path}); choose another place") from error
        except BaseException:
            os.close(here)
            raise
        return here


def is_planted(link: os.stat_result, folder: os.stat_result) -> bool:
    """Whether another user has put a symbolic link into a world-writable folder.

    This is the rule of Linux's protected_symlinks, which may be off, applied to folders without the sticky bit too.
    Links of root and of the folder's owner are trusted.
    """
    return bool(folder.st_mode & stat.S_IWOTH) and link.st_uid not in (0, user_id(), folder.st_uid)


def _refuse_planted(path: Path, link: os.stat_result, folder: os.stat_result) -> None:
    if is_planted(link, folder):
        owner = user_name(link.st_uid)
        raise UsageError(f"{path} leads through a symbolic link that belongs to {owner}; choose another folder")
