"""A folder of recordings: what is in it, what each holds, which are damaged; adding and repairing them.

Owns the folder, the names in it, and the bounds for files that somebody brings. Any thread may call it.
"""

from __future__ import annotations

import os
import re
import secrets
import stat
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO, BinaryIO

from hexwire.errors import ConfigError, HexwireError, UsageError
from hexwire.folders import make_folder
from hexwire.inputs import open_file, parse_message
from hexwire.new_file import OutputFile

from .capture import BYTES, recover
from .mcap_file import Readable, read_records
from .pictures import is_picture
from .recording import is_joint_state, parse_joints
from .series import PlotSeries, TimedFile, read_series

__all__ = ["LARGEST", "Library", "StoredRecording", "recordings_folder", "survey"]

LARGEST = 256 * 1024 * 1024
"""Bytes of a file that somebody brings."""
_MOST_FILES = 500
"""Files that are listed, the newest."""
_MOST_MESSAGES = 5_000_000
_MOST_CAMERAS = 8
"""Cameras of a recording that are told."""
_PATIENCE = 30.0
"""Seconds of computing for one file, however busy the machine is: an hour at 100 Hz takes half of them."""
_SHORT = 0.1
"""Seconds of computing for a survey that may be repeated whenever a file has grown."""
_REST = 20.0
"""Share of a longer survey for which a file that grows is not read again."""
_NSEC = 1_000_000_000
_NAME = re.compile(r"[^\W_][\w .()+,=@-]{0,120}\.mcap", re.ASCII)
_ENDING = ".mcap"


@dataclass(frozen=True, slots=True)
class StoredRecording:
    """What a recording holds.

    Attributes:
        name: Name of the file.
        size: Bytes.
        changed: When it was written, seconds since 1970.
        begin: Time of the first message, seconds since 1970; 0 if there is none.
        duration: Seconds to the last message.
        states: Number of joint states.
        joints: Joint names of the first state.
        topics: Channels of joint states; several in the recording of a fleet.
        cameras: Channels of pictures.
        robot: Name of the robot, if it is noted.
        traffic: Number of transfers of bytes.
        problem: Why it cannot be read, or not to its end; empty if it is whole.
        recoverable: Whether its intact part can be saved as another recording.
    """

    name: str
    size: int
    changed: float
    begin: float = 0.0
    duration: float = 0.0
    states: int = 0
    joints: tuple[str, ...] = ()
    topics: tuple[str, ...] = ()
    cameras: tuple[str, ...] = ()
    robot: str = ""
    traffic: int = 0
    problem: str = ""
    recoverable: bool = False


def recordings_folder() -> Path:
    """The folder of this user's recordings, by the rules of XDG; it may not exist yet."""
    data = os.environ.get("XDG_DATA_HOME")
    base = Path(data) if data and Path(data).is_absolute() else Path.home() / ".local" / "share"
    return base / "hexwire" / "recordings"


def survey(file: Readable, empty: StoredRecording) -> StoredRecording:
    """What a recording holds, from reading all of it.

    Args:
        file: Open for reading bytes.
        empty: Its name, size and time.
    """
    first, last = None, 0
    states = traffic = count = 0
    topics: dict[str, None] = {}
    cameras: dict[str, None] = {}
    joints: tuple[str, ...] = ()
    robot = problem = ""
    recoverable = False
    sent = set(BYTES.values())
    timed = _timed(file, empty.name)
    try:
        for record in read_records(timed, empty.name):
            if isinstance(record, str):
                problem, recoverable = record, count > 0
                break
            schema, channel, message = record
            count += 1
            if count > _MOST_MESSAGES:
                problem = f"has more than {_MOST_MESSAGES} messages, too many for a list"
                break
            first = message.log_time if first is None else min(first, message.log_time)
            last = max(last, message.log_time)
            if channel.topic in sent:
                traffic += 1
            elif is_picture(schema, channel):
                cameras.setdefault(channel.topic)
            elif is_joint_state(schema, channel):
                states += 1
                topics.setdefault(channel.topic)
                if not joints:
                    joints, robot = _first_state(message.data, empty.name)
    except HexwireError as error:
        problem = str(error).removeprefix(empty.name).removeprefix(":").strip()
    return replace(
        empty,
        begin=(first or 0) / _NSEC,
        duration=(last - first) / _NSEC if first is not None else 0.0,
        states=states,
        joints=joints,
        topics=tuple(topics),
        cameras=tuple(sorted(cameras))[:_MOST_CAMERAS],
        robot=robot,
        traffic=traffic,
        problem=problem,
        recoverable=recoverable,
    )


def _timed(file: Readable, name: str) -> TimedFile:
    # Not by the wall clock: beside a robot, other threads take their share.
    return TimedFile(file, name, _PATIENCE, time.thread_time)


def _first_state(data: bytes, name: str) -> tuple[tuple[str, ...], str]:
    _, rows = parse_joints(data, name, 1)
    said = parse_message(data, name, "joint state 1").table().get("robot")
    return tuple(row["name"].text() for row in rows), said.text(100) if said is not None else ""


def _remark(odd: int, many: int) -> str:
    """Which files are not listed."""
    told = []
    if odd:
        told.append(
            f"{odd} {'file is' if odd == 1 else 'files are'} not listed: give recordings names of letters A to Z, "
            "digits, blanks and .()+,=@_- that begin with a letter or digit, and use no links"
        )
    if many > 0:
        told.append(f"only the newest {_MOST_FILES} recordings are listed")
    return "; ".join(told)


class Library:
    """Recordings of one folder. It is made when something is written.

    Args:
        folder: The folder.
        largest: Most bytes of a file that is added.

    Attributes:
        folder: The folder.
        largest: Most bytes of a file that is added.
        remark: Which files were not listed last time, and why; empty if all were.
    """

    def __init__(self, folder: str | Path, *, largest: int = LARGEST) -> None:
        self.folder = Path(folder)
        self.largest = largest
        self.remark = ""
        self._known: dict[str, StoredRecording] = {}
        self._rests: dict[str, float] = {}
        self._lock = threading.Lock()
        self._reading = threading.Lock()

    def entries(self, without: str = "") -> list[StoredRecording]:
        """The recordings, newest first. Reads those that are new or have changed.

        A file that grows, and whose reading takes long, is as it was some seconds ago.

        Args:
            without: Name of a recording that is left out and not read, since it is being written.

        Raises:
            UsageError: The folder cannot be read, or the package ``mcap`` is not installed.
        """
        found: list[tuple[float, str, int]] = []
        odd = 0
        try:
            with suppress(FileNotFoundError), os.scandir(self.folder) as entries:
                for entry in entries:
                    with suppress(OSError):
                        status = entry.stat(follow_symlinks=False)
                        if stat.S_ISREG(status.st_mode) and _NAME.fullmatch(entry.name):
                            found.append((status.st_mtime, entry.name, status.st_size))
                        elif entry.name.endswith(_ENDING) and not stat.S_ISDIR(status.st_mode):
                            odd += 1
        except OSError as error:
            raise UsageError(f"the folder of recordings {self.folder} cannot be read: {error.strerror}") from None
        found.sort(reverse=True)
        self.remark = _remark(odd, len(found) - _MOST_FILES)
        listed = [self._entry(*one) for one in found[:_MOST_FILES] if one[1] != without]
        with self._lock:
            for gone in set(self._known) - {name for _, name, _ in found}:
                del self._known[gone]
        return listed

    def names(self, ending: str = _ENDING) -> list[str]:
        """Names of its files with an ending, at most 500 in their order; none is read."""
        found: list[str] = []
        with suppress(OSError), os.scandir(self.folder) as entries:
            files = [entry.name for entry in entries if entry.is_file(follow_symlinks=False)]
            found = [name for name in files if name.endswith(ending) and _NAME.fullmatch(Path(name).stem + _ENDING)]
        return sorted(found)[:_MOST_FILES]

    def _entry(self, changed: float, name: str, size: int) -> StoredRecording:
        """What a file holds; it is read if that is not known."""
        # One at a time: a page asks again while the first answer is being made.
        with self._reading:
            with self._lock:
                known, rest = self._known.get(name), self._rests.get(name, 0.0)
            if known is not None:
                if (known.changed, known.size) == (changed, size):
                    return known
                if size > known.size and time.monotonic() < rest:
                    return known
            began = time.thread_time()
            known = self._look(StoredRecording(name, size, changed))
            took = time.thread_time() - began
            with self._lock:
                self._known[name] = known
                self._rests[name] = time.monotonic() + (_REST * took if took > _SHORT else 0.0)
            return known

    def _look(self, empty: StoredRecording) -> StoredRecording:
        if not empty.size:
            return replace(empty, problem="is empty: nothing was written, or it is being written")
        try:
            with self.open(empty.name) as file:
                return survey(file, empty)
        except OSError as error:
            return replace(empty, problem=f"cannot be read: {error.strerror}")
        except ConfigError as error:
            return replace(empty, problem=str(error).removeprefix(f"{error.file}: "))

    def find(self, name: str) -> StoredRecording:
        """One recording.

        Raises:
            UsageError: There is none of this name.
        """
        status = self.present(name).stat(follow_symlinks=False)
        return self._entry(status.st_mtime, name, status.st_size)

    def present(self, name: str) -> Path:
        """Path of a recording that is there; it is not read.

        Raises:
            UsageError: There is none of this name.
        """
        if _NAME.fullmatch(name):
            path = self.folder / name
            with suppress(OSError):
                if stat.S_ISREG(path.stat(follow_symlinks=False).st_mode):
                    return path
        raise UsageError(f"there is no recording {name!r}; it may have been removed")

    @contextmanager
    def open(self, name: str) -> Iterator[BinaryIO]:
        """Open a recording for reading.

        Raises:
            UsageError: The name is not that of a recording in the folder, or that of a link to a file elsewhere or
                of a pipe that never ends.
        """
        path = self.path(name)
        if not os.path.lexists(path):
            raise UsageError(f"there is no recording {name!r}; it may have been removed")
        with open_file(path, links=False) as file:
            yield file

    def path(self, name: str) -> Path:
        """Path of a recording in the folder.

        Raises:
            UsageError: The name could lead elsewhere, or does not end in .mcap.
        """
        if not _NAME.fullmatch(name):
            raise UsageError(
                f"{name[:80]!r} cannot be the name of a recording: use letters, digits and ., end with {_ENDING}"
            )
        return self.folder / name

    def series(self, name: str, topic: str | None = None) -> PlotSeries:
        """Its joint states as columns; raises as `read_series`."""
        try:
            with self.open(name) as file:
                return read_series(_timed(file, name), name, topic=topic)
        except OSError as error:
            raise ConfigError(f"cannot be read: {error.strerror}", file=name) from None

    def new_name(self, words: str, now: float | None = None) -> str:
        """A name for a new recording that no file in the folder has: the time, then some words."""
        stamp = time.strftime("%Y-%m-%d %H-%M-%S", time.localtime(now))
        clean = re.sub(r"[^A-Za-z0-9+-]+", "-", words).strip("-")[:60]
        base = f"{stamp} {clean}".strip()
        for number in range(1, 1000):
            name = f"{base}{f' ({number})' if number > 1 else ''}{_ENDING}"
            if not (self.folder / name).exists():
                return name
        raise UsageError(f"the folder has too many recordings named {base}")

    def make_folder(self) -> None:
        """Make the folder; raises as `hexwire.new_file.make_folder`."""
        make_folder(self.folder)

    def add(self, name: str, content: IO[bytes]) -> StoredRecording:
        """Add a file that somebody brings. A truncated recording is kept; what is no recording is not.

        Args:
            name: Its name there; characters that cannot stay are replaced.
            content: Open for reading bytes.

        Raises:
            UsageError: It is too large, is no recording, or has nothing that could be read; nothing was kept.
        """
        base = re.sub(r"[^A-Za-z0-9 .()+,=@_-]+", "-", Path(name).name.removesuffix(_ENDING)).strip(" .-_")[:100]
        name = f"{base or 'recording'}{_ENDING}"
        self.make_folder()
        if (self.folder / name).exists():
            name = f"{base or 'recording'} {secrets.token_hex(2)}{_ENDING}"
        with OutputFile(self.path(name)) as out:
            left = self.largest + 1
            while left > 0 and (part := content.read(min(left, 1 << 20))):
                out.file.write(part)
                left -= len(part)
            if left <= 0:
                raise UsageError(f"{name} is larger than {self.largest >> 20} MiB; nothing was kept")
            out.file.flush()
            with Path(out.path).open("rb") as file:
                status = os.fstat(file.fileno())
                found = survey(file, StoredRecording(name, status.st_size, status.st_mtime))
            if found.problem and not found.recoverable:
                raise UsageError(f"{found.problem}; nothing was kept")
        return self.find(name)

    def recover(self, name: str) -> StoredRecording:
        """Save the intact part of a damaged recording as a new one, as `hexwire record recover` does.

        Raises:
            UsageError: It is not a recording.
        """
        new = f"{name.removesuffix(_ENDING)[:100]} recovered{_ENDING}"
        with self.open(name) as file, OutputFile(self.path(new)) as out:
            recover(_timed(file, name), name, out.file)
        return self.find(new)

    def remove(self, name: str) -> None:
        """Delete a recording.

        Raises:
            UsageError: There is none of this name, or it cannot be deleted.
        """
        try:
            self.path(name).unlink()
        except FileNotFoundError:
            raise UsageError(f"there is no recording {name!r}") from None
        except OSError as error:
            raise UsageError(f"{name} cannot be deleted: {error.strerror}") from None
