"""What differs between systems: users, devices, flags of files, sockets, signals, waiting for input and queues.

Owns these differences, so that no other module asks which system it runs on, except those that exist for one system
only. Linux is the system hexwire is made for; where another one has no such thing, the value here says so.
"""

from __future__ import annotations

import contextlib
import math
import os
import select
import signal
import struct
import sys
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, TypeVar

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence
    from queue import SimpleQueue

__all__ = [
    "BINARY",
    "CLOSE_ON_EXEC",
    "END_SIGNALS",
    "HANG_UP",
    "HAS_FOLDER_DESCRIPTORS",
    "NO_FOLLOW",
    "NO_WAIT",
    "READABLE",
    "SLEEP_ERROR",
    "WRITABLE",
    "Poll",
    "TypedLines",
    "close_at_once",
    "device_number",
    "device_parts",
    "end_by_alarm",
    "group_name",
    "lock_file",
    "make_poll",
    "next_within",
    "user_id",
    "user_name",
]

_T = TypeVar("_T")

# The same numbers on every system that has them.
READABLE, WRITABLE, _FAULT, HANG_UP = 0x001, 0x004, 0x008, 0x010
"""Events of `Poll`."""

NO_FOLLOW: int = getattr(os, "O_NOFOLLOW", 0)
"""Flag of `os.open`: fail on a symbolic link. 0 if the system has no such flag."""
CLOSE_ON_EXEC: int = getattr(os, "O_CLOEXEC", 0)
"""Flag of `os.open`: programs started later do not inherit the file. 0 where that is so anyway."""
NO_WAIT: int = getattr(os, "O_NONBLOCK", 0)
"""Flag of `os.open`: do not wait for the other end of a pipe. 0 if the system has no such flag."""
BINARY: int = getattr(os, "O_BINARY", 0)
"""Flag of `os.open`: change no byte. 0 where that is so anyway."""
HAS_FOLDER_DESCRIPTORS = sys.platform == "linux" and hasattr(os, "O_PATH")
"""A folder can be opened without reading it, and files be named relative to it, so that nobody can exchange it."""

END_SIGNALS: tuple[signal.Signals, ...] = tuple(
    getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)
)
"""Signals that end a program, besides Ctrl-C: SIGTERM, and SIGHUP if there is one."""


_LINGER = struct.Struct("=ii")
"""Of SO_LINGER: whether `close` waits, and how many seconds."""

SLEEP_ERROR = 120e-6 if sys.platform == "linux" else math.inf
"""Seconds by which a short `time.sleep` is usually late at most: 50 us are the system's tolerance, the rest goes by
until the processor is awake. Infinite where nobody has measured it; on Windows it is a millisecond or more."""


# --- users -------------------------------------------------------------------------------------------------------


def user_id() -> int:
    """Number of this user; 0 on a system that does not number its users, where every file has owner 0 too."""
    if sys.platform != "win32" and hasattr(os, "geteuid"):
        return os.geteuid()
    return 0


def user_name(number: int) -> str:
    """Name of a user, for messages."""
    if sys.platform != "win32":
        with contextlib.suppress(ImportError, KeyError):
            import pwd

            return pwd.getpwuid(number).pw_name
    return f"user {number}"


def group_name(number: int) -> str:
    """Name of a group, for messages; empty if it has none."""
    if sys.platform != "win32":
        with contextlib.suppress(ImportError, KeyError):
            import grp

            return grp.getgrgid(number).gr_name
    return ""


# --- devices -----------------------------------------------------------------------------------------------------


def device_number(status: os.stat_result) -> int:
    """Number of the device that a file stands for; 0 if it is none, or the system does not number devices."""
    return int(getattr(status, "st_rdev", 0))


def device_parts(number: int) -> tuple[int, int]:
    """Major and minor part of a device's number; zeros on a system without them."""
    if sys.platform != "win32" and hasattr(os, "major"):
        return os.major(number), os.minor(number)
    return 0, 0


# --- files -------------------------------------------------------------------------------------------------------


def lock_file(descriptor: int, *, wait: bool = False) -> bool:
    """Lock an open file for this program, until it is closed or the program ends; False if another one has it.

    Args:
        descriptor: Of the file; on Windows, open for writing.
        wait: Wait for the other one; on Windows at most 10 s.
    """
    try:
        if sys.platform == "win32":
            import msvcrt

            msvcrt.locking(descriptor, msvcrt.LK_LOCK if wait else msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except OSError:
        return False
    return True


# --- sockets -----------------------------------------------------------------------------------------------------


def close_at_once(ports: Collection[tuple[int, int]]) -> int:
    """Let `close` of TCP sockets of this program not wait until the other side has everything, whoever opened them.

    Only Linux waits there with a socket that is not to wait (SO_LINGER). What is left is delivered all the same.

    Args:
        ports: Of each, the own one and that of the other side.

    Returns:
        How many would have waited.
    """
    found = 0
    for path in Path("/proc/self/fd").iterdir() if sys.platform == "linux" and ports else ():
        # Any of them may be closed meanwhile.
        with contextlib.suppress(OSError):
            if str(path.readlink()).startswith("socket:"):
                found += _let_close(os.dup(int(path.name)), ports)
    return found


def _let_close(descriptor: int, ports: Collection[tuple[int, int]]) -> bool:
    import socket

    try:
        end = socket.socket(fileno=descriptor)
    except OSError:
        os.close(descriptor)
        raise
    with end:
        if end.type != socket.SOCK_STREAM or end.family not in (socket.AF_INET, socket.AF_INET6):
            return False
        if (end.getsockname()[1], end.getpeername()[1]) not in ports:
            return False
        size = _LINGER.size
        if not _LINGER.unpack(end.getsockopt(socket.SOL_SOCKET, socket.SO_LINGER, size))[0]:
            return False
        end.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _LINGER.pack(0, 0))
        return True


# --- signals -----------------------------------------------------------------------------------------------------


def end_by_alarm(seconds: int) -> None:
    """Have the system end this program in so many seconds. Without effect on a system that cannot."""
    if sys.platform != "win32" and hasattr(signal, "alarm"):
        signal.alarm(seconds)


# --- waiting -----------------------------------------------------------------------------------------------------


_LINE = 4096
"""Most bytes of a typed line."""


def next_within(items: SimpleQueue[_T], seconds: float | None) -> _T:
    """The next item of a queue that no other thread reads.

    With a limit, `SimpleQueue.get` of CPython 3.11 may wait for ever: once it has the queue's lock it looks how
    much time is left, and takes less than none for no limit. A thread that a busy machine keeps from running
    meanwhile is enough. A look that does not wait takes the lock before.

    Args:
        items: The queue.
        seconds: To wait at most; None for no limit.

    Raises:
        queue.Empty: None came in time.
    """
    from queue import Empty

    try:
        return items.get_nowait()
    except Empty:
        return items.get(timeout=seconds)


class Poll(Protocol):
    """What is used of `select.poll`."""

    def register(self, fd: int, eventmask: int, /) -> None:
        """Watch a descriptor."""

    def poll(self, timeout: float | None = ..., /) -> list[tuple[int, int]]:
        """Wait at most `timeout` milliseconds, forever if None; returns descriptors with their events."""


class _SelectPoll:
    """`Poll` by `select`, for sockets only and a few hundred of them: all that Windows has."""

    def __init__(self) -> None:
        self._events: dict[int, int] = {}

    def register(self, fd: int, eventmask: int) -> None:
        self._events[fd] = eventmask

    def poll(self, timeout: float | None = None) -> list[tuple[int, int]]:
        # A negative time-out waits forever, as in the system's own poll.
        wait = None if timeout is None or timeout < 0 else timeout / 1000.0
        reads = [fd for fd, events in self._events.items() if events & READABLE]
        writes = [fd for fd, events in self._events.items() if events & WRITABLE]
        if not reads and not writes:
            # Windows refuses to wait for nothing.
            time.sleep(1e9 if wait is None else wait)
            return []
        readable, writable, failed = select.select(reads, writes, self._of_interest(reads, writes), wait)
        found = dict.fromkeys(readable, READABLE)
        # Windows reports a refused connection only here.
        for fd in (*writable, *failed):
            found[fd] = found.get(fd, 0) | WRITABLE
        return list(found.items())

    @staticmethod
    def _of_interest(reads: Sequence[int], writes: Sequence[int]) -> Sequence[int]:
        return [fd for fd in writes if fd not in reads]


def make_poll() -> Poll:
    """The system's poll, or one by `select`."""
    if sys.platform != "win32" and hasattr(select, "poll"):
        return select.poll()
    return _SelectPoll()


class TypedLines:
    """Lines that are typed, or come from a pipe, on standard input.

    Windows can wait for sockets only: a thread reads there, one line when it is asked for, until the program ends.
    """

    def __init__(self) -> None:
        self._reading: threading.Thread | None = None
        self._read = b""

    def entered(self, seconds: float) -> bool | None:
        """Whether a line comes within so many seconds; None if none ever will, since the input has ended."""
        if sys.platform == "win32":
            return self._entered_in_thread(seconds)
        else:  # noqa: RET505  # mypy knows the system by it
            if not select.select([sys.stdin], [], [], seconds)[0]:
                return False
            return True if sys.stdin.readline() else None

    def _entered_in_thread(self, seconds: float) -> bool | None:
        if self._reading is None:
            self._reading = threading.Thread(target=self._wait, args=(sys.stdin.fileno(),), daemon=True)
            self._reading.start()
        self._reading.join(seconds)
        if self._reading.is_alive():
            return False
        self._reading = None
        return True if self._read else None

    def _wait(self, descriptor: int) -> None:
        # Not through `sys.stdin`: a thread that holds its lock would abort the end of the interpreter.
        try:
            self._read = os.read(descriptor, _LINE)
        except OSError:
            self._read = b""
