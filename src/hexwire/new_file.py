"""Creates files safely: new, owned by this user, and in the intended folder.

Keeps three promises: nothing is overwritten unless that is asked for; no symbolic link is followed that another
user may have planted; only its owner can read a new file. A folder is opened once and kept open, so that replacing
a part of its path has no effect. Must not know what is written.
"""

from __future__ import annotations

import contextlib
import errno
import os
import secrets
import stat
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, Self

from hexwire.errors import UsageError

if TYPE_CHECKING:
    from types import TracebackType

__all__ = [
    "OutputFile",
    "is_planted",
    "make_folder",
    "make_private_folder",
    "open_folder",
    "owner_name",
    "runtime_folder",
]

_PATH = os.O_PATH | os.O_NOFOLLOW | os.O_CLOEXEC
_FOLDER = _PATH | os.O_DIRECTORY
_NEW = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
_MOST_LINKS = 40
"""Most symbolic links followed on the way to a folder: as many as Linux follows."""


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
        path: As given.
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
            fd = os.open(self._name, _NEW, mode, dir_fd=self._folder)
        except OSError as error:
            os.close(self._folder)
            raise UsageError(f"{path} cannot be written: {error.strerror}; choose another place") from error
        except BaseException:
            os.close(self._folder)
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
                os.unlink(self._name, dir_fd=self._folder)
        self._close()

    def _put_in_place(self) -> None:
        if self._name != self.path.name:
            if not self._is_ours():
                self._close()
                raise UsageError(f"{self.path} was not written: another program has replaced {self._name}")
            os.rename(self._name, self.path.name, src_dir_fd=self._folder, dst_dir_fd=self._folder)
        self._close()

    def _look(self, force: bool) -> bool:
        """Whether there is a file to overwrite.

        Raises:
            UsageError: What has this name must stay.
        """
        try:
            found = os.stat(self.path.name, dir_fd=self._folder, follow_symlinks=False)
        except FileNotFoundError:
            return False
        if stat.S_ISLNK(found.st_mode):
            raise UsageError(f"{self.path} is a symbolic link, which is not followed; name the file itself")
        if stat.S_ISDIR(found.st_mode):
            raise UsageError(f"{self.path} is a folder; name a file")
        if not stat.S_ISREG(found.st_mode):
            raise UsageError(f"{self.path} is not a regular file; choose another name")
        if found.st_uid != os.geteuid() and os.fstat(self._folder).st_mode & stat.S_IWOTH:
            raise UsageError(
                f"{self.path} belongs to {owner_name(found.st_uid)}, and everybody may write to its folder; "
                "choose another name"
            )
        if not force:
            raise UsageError(f"{self.path} already exists; --force overwrites it")
        return True

    def _is_ours(self) -> bool:
        found = os.stat(self._name, dir_fd=self._folder, follow_symlinks=False)
        return os.path.samestat(found, self._made)

    def _close(self) -> None:
        self._open = False
        os.close(self._folder)
        with contextlib.suppress(OSError):
            self.file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            self.keep()
        else:
            self.discard()


def open_folder(path: Path) -> int:
    """Open a folder to work in it; the caller closes the descriptor.

    Symbolic links of this user and of the system are followed. One that another user has put into a world-writable
    folder is not, whatever the kernel's setting.

    Raises:
        UsageError: There is no such folder, its path leads through a planted link, or it belongs to another user
            and is world-writable.
    """
    folder = _walk(path, make=False)
    found = os.fstat(folder)
    if found.st_mode & stat.S_IWOTH and found.st_uid not in (0, os.geteuid()):
        os.close(folder)
        raise UsageError(
            f"{path} belongs to {owner_name(found.st_uid)}, and everybody may write to it; choose another folder"
        )
    return folder


def make_folder(path: Path) -> None:
    """Make a folder and the missing ones above it.

    Raises:
        UsageError: As `open_folder`; or this user may not make it.
    """
    os.close(_walk(path, make=True))


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
            if status.st_uid != os.geteuid():
                raise UsageError(f"{folder} belongs to {owner_name(status.st_uid)}; {remedy}")
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


def owner_name(uid: int) -> str:
    """Name of a user, for messages."""
    import pwd

    try:
        return pwd.getpwuid(uid).pw_name
    except KeyError:
        return f"user {uid}"


def _walk(path: Path, *, make: bool) -> int:
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
    return bool(folder.st_mode & stat.S_IWOTH) and link.st_uid not in (0, os.geteuid(), folder.st_uid)


def _refuse_planted(path: Path, link: os.stat_result, folder: os.stat_result) -> None:
    if is_planted(link, folder):
        owner = owner_name(link.st_uid)
        raise UsageError(f"{path} leads through a symbolic link that belongs to {owner}; choose another folder")
