"""POSIX message queues as a link between two programs on one machine.

A line has two queues: the client writes ``/name.tx`` and reads ``/name.rx``, the server does the reverse. A server
may have further lines for further clients, ``/name+2.tx`` and so on: a client takes the first that is free. Owns
their names, the system's limits, and the search for abandoned queues. Must not know what the bytes mean.

A queue outlives the programs that use it: a server removes its own when it closes, unless a client still has them
open, which would wait for the next server in vain. Messages that wait in it when an end opens it are old, perhaps
meant for another program, so they are dropped. Another user may have created it and could read and write its
traffic: a queue must belong to this user, or to a user trusted by name, and be closed to all others.
"""

from __future__ import annotations

import sys

if sys.platform != "linux":
    raise ImportError("POSIX message queues are for Linux; use tcp:// or udp://")

import contextlib
import errno
import fcntl
import os
import pwd
import re
from collections.abc import Sequence
from itertools import count
from pathlib import Path
from time import sleep
from typing import TYPE_CHECKING

from hexwire.errors import (
    LinkBusyError,
    LinkError,
    LinkPermissionError,
    UsageError,
)
from hexwire.system import user_id, user_name

from .base import LinkKind
from .owner import lock_owner
from .poll_link import PollLink
from .url import LinkUrl

if TYPE_CHECKING:
    import posix_ipc

__all__ = ["QueueLink"]

# Allowed by Linux with its default settings.
DEFAULT_DEPTH = 10
DEFAULT_SIZE = 8192
FURTHER_DEPTH = 3
_NAME = re.compile(r"/?[A-Za-z0-9_.-]{1,200}")
_INSTANT = 0.002
"""Seconds after which a queue that seemed to have an owner is looked at again."""
_REMEDY = "remove stale ones: rm /dev/mqueue/NAME.* (if it is empty: sudo mount -t mqueue none /dev/mqueue)"
_SETTINGS = Path("/proc/sys/fs/mqueue")
_SAID = {"the maximum number of files": errno.EMFILE, "nsufficient space": errno.ENOSPC}
"""Part of an error's text -> its number."""


class QueueLink(PollLink):
    """One end of a line over two message queues, which are created if they do not exist.

    Only this user may open queues created here. The other end need not be open; messages sent before it opens do
    not reach it.

    Args:
        name: Letters, digits, ``. _ -``; with or without a leading slash.
        server: Be the server's end.
        depth: Number of unread messages at which a writer has to wait; an existing queue keeps its own depth.
        size: Longest message in bytes; likewise.
        unlink: Remove both queues when this end is closed; False keeps them. If None, a server removes those of
            this user, unless a client has them open.
        trust: Users, besides this one, whose queues are accepted; such a queue may be open to a group.

    Attributes:
        dropped: Old messages dropped at the last opening.
        further: A server's end of a further line; see `make_further`.
    """

    kind = LinkKind.DATAGRAM
    further = False

    def __init__(
        self,
        name: str,
        *,
        server: bool = False,
        depth: int = DEFAULT_DEPTH,
        size: int = DEFAULT_SIZE,
        unlink: bool | None = None,
        trust: Sequence[str] = (),
    ) -> None:
        if not _NAME.fullmatch(name):
            raise UsageError(f"{name!r} is not a queue name: use letters, digits, '.', '_' and '-'")
        self.name = "/" + name.removeprefix("/")
        super().__init__(f"mq://{self.name}" + ("?role=server" if server else ""))
        self.max_message = size
        self._server = server
        self._depth = depth
        self._size = size
        self._unlink = unlink
        self._trust = tuple(trust)
        self.dropped = 0
        self._inbox: posix_ipc.MessageQueue | None = None
        self._outbox: posix_ipc.MessageQueue | None = None
        self._full_or_empty: type[Exception] = BlockingIOError

    @classmethod
    def from_url(cls, url: LinkUrl) -> QueueLink:
        """Build from ``mq:///name?role=server&depth=10&size=8192&unlink=1&trust=user,user``."""
        url.check_keys(("role", "depth", "size", "unlink", "trust"))
        if url.netloc:
            raise UsageError(f"{url.text}: a queue's address has three slashes, as in mq:///{url.netloc}")
        return cls(
            url.path,
            server=url.choice("role", "client", ("client", "server")) == "server",
            depth=url.integer("depth", DEFAULT_DEPTH, 1, 65536),
            size=url.integer("size", DEFAULT_SIZE, 1, 1 << 24),
            unlink=url.yes_no("unlink", False) if "unlink" in url.query else None,
            trust=[user for user in url.query.get("trust", "").split(",") if user],
        )

    def make_further(self, number: int) -> QueueLink:
        """A server's end for one more client of the same name, with a few messages: memory for queues is scarce.

        Args:
            number: Of the line, from 2 on without a gap.
        """
        depth = min(self._depth, FURTHER_DEPTH)
        link = QueueLink(self.name, server=True, depth=depth, size=self._size, unlink=True, trust=self._trust)
        link.name, link.further = _further_name(self.name, number), True
        return link

    def _open(self) -> None:
        self._full_or_empty = _posix_ipc().BusyError
        try:
            self._open_line(self.name)
        except LinkBusyError:
            if self._server or not self._open_further():
                raise

    def _open_further(self) -> bool:
        """Whether a server has a further line that is free, which is open then."""
        for number in count(2):
            name = _further_name(self.name, number)
            try:
                queue = _posix_ipc().MessageQueue(name + ".tx", 0, read=False)
            except (_posix_ipc().Error, OSError):
                return False
            # One that is abandoned is nobody's.
            served = _holder(queue.mqd)
            queue.close()
            if served:
                with contextlib.suppress(LinkBusyError):
                    self._open_line(name)
                    return True
        return False

    def _open_line(self, name: str) -> None:
        self._open_both(name)
        while any(queue is not None and not os.fstat(queue.mqd).st_nlink for queue in (self._inbox, self._outbox)):
            # A server has removed them meanwhile.
            self._drop_both()
            self._open_both(name)
        assert self._inbox is not None
        self.dropped = 0
        # At most one full queue: a peer that never stops writing must not block this end.
        with contextlib.suppress(self._full_or_empty):
            while self.dropped < self._inbox.max_messages:
                self._inbox.receive()
                self.dropped += 1

    def _open_both(self, name: str) -> None:
        self._inbox = self._queue(name + (".tx" if self._server else ".rx"), reads=True)
        try:
            # The reader is the owner of a queue; its lock ends with the process, whatever happens to the queue.
            self._lock(self._inbox.mqd)
        except BlockingIOError as error:
            who = lock_owner(os.fstat(self._inbox.mqd)) or "another program"
            self._inbox.close()
            self._inbox = None
            role = "server" if self._server else "client"
            raise LinkBusyError(
                f"{self.url} already has a {role}: {who}; close that first", url=self.url
            ) from error
        self._outbox = self._queue(name + (".rx" if self._server else ".tx"), reads=False)
        self.max_message = self._outbox.max_message_size

    @staticmethod
    def _lock(descriptor: int) -> None:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            # For an instant the other end may have it, see `other_end`.
            sleep(_INSTANT)
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)

    def other_end(self) -> str:
        """Who has the other end open, such as ``hexwire (pid 4711)``; empty if nobody.

        A program that is killed says no farewell, but its lock ends with it.
        """
        if self._outbox is None:
            raise self._refusal()
        return _holder(int(self._outbox.mqd))

    def _queue(self, name: str, *, reads: bool) -> posix_ipc.MessageQueue:
        ipc = _posix_ipc()
        try:
            queue = self._make_or_find(name, reads)
        except (ValueError, OSError, ipc.Error) as error:
            raise self._explain(error) from error
        try:
            self._check_owner(name, os.fstat(queue.mqd))
        except BaseException:
            queue.close()
            raise
        queue.block = False
        return queue

    def _make_or_find(self, name: str, reads: bool) -> posix_ipc.MessageQueue:
        ipc = _posix_ipc()
        while True:
            # Never mistake another user's queue for ours: it is either new, or checked like an existing one.
            try:
                return ipc.MessageQueue(
                    name,
                    ipc.O_CREX,
                    mode=0o600,
                    max_messages=self._depth,
                    max_message_size=self._size,
                    read=reads,
                    write=not reads,
                )
            except ipc.ExistentialError:
                pass
            try:
                return ipc.MessageQueue(name, 0, read=reads, write=not reads)
            except ipc.ExistentialError:
                continue  # removed in between

    def _check_owner(self, name: str, status: os.stat_result) -> None:
        """Refuse a queue that another user has created or may use."""
        trusted = {self._user_id(user) for user in self._trust}
        if status.st_uid not in (user_id(), *trusted):
            owner = user_name(status.st_uid)
            raise LinkPermissionError(
                f"{self.url}: queue {name} belongs to {owner}, who could read and write its messages; choose "
                f"another name, or add trust={owner} to the address",
                url=self.url,
            )
        open_to = "all users" if status.st_mode & 0o007 else "a group" if status.st_mode & 0o070 else ""
        if open_to == "all users" or (open_to and not trusted):
            who = f"{open_to} (mode {status.st_mode & 0o777:03o})"
            raise LinkPermissionError(
                f"{self.url}: queue {name} is open to {who}; have it removed, or choose another name", url=self.url
            )

    def _user_id(self, user: str) -> int:
        try:
            return pwd.getpwnam(user).pw_uid
        except KeyError as error:
            raise UsageError(f"{self.url}: trust={user}, but there is no such user") from error

    def _close(self) -> None:
        if self._unlink or (self._unlink is None and self._is_over()):
            for queue in (self._outbox, self._inbox):
                if queue is not None:
                    with contextlib.suppress(_posix_ipc().ExistentialError):
                        queue.unlink()
        self._drop_both()

    def _is_over(self) -> bool:
        """Whether a server's queues are of no use any more; the client's is then locked until it is closed."""
        if not self._server or self._inbox is None or self._outbox is None:
            return False
        if any(os.fstat(queue.mqd).st_uid != user_id() for queue in (self._inbox, self._outbox)):
            return False
        try:
            fcntl.flock(self._outbox.mqd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        return True

    def _drop_both(self) -> None:
        for queue in (self._inbox, self._outbox):
            if queue is not None:
                queue.close()
        self._inbox = self._outbox = None

    def _fileno(self) -> int:
        return -1 if self._inbox is None else int(self._inbox.mqd)

    def _write_fileno(self) -> int:
        return -1 if self._outbox is None else int(self._outbox.mqd)

    def _read_ready(self) -> bytes:
        assert self._inbox is not None
        try:
            return bytes(self._inbox.receive()[0])
        except self._full_or_empty:
            return b""

    def _write_ready(self, data: memoryview | bytes) -> int:
        assert self._outbox is not None
        try:
            self._outbox.send(bytes(data))
        except self._full_or_empty:
            return 0
        return len(data)

    def _explain(self, error: Exception) -> LinkError | UsageError:
        # posix_ipc gives some of them as text only.
        number = next((number for text, number in _SAID.items() if text in str(error)), None)
        number = number or (error.errno if isinstance(error, OSError) else 0)
        if isinstance(error, ValueError):
            depth, size = _setting("msg_max"), _setting("msgsize_max")
            return UsageError(
                f"{self.url}: {self._depth} messages of {self._size} bytes are refused; this system allows queues "
                f"of at most {depth} messages of {size} bytes (sysctl fs.mqueue.msg_max, fs.mqueue.msgsize_max)"
            )
        if isinstance(error, _posix_ipc().PermissionsError):
            return LinkPermissionError(
                f"{self.url} belongs to another user and is closed to others; choose another name", url=self.url
            )
        if number == errno.ENOSPC:
            return LinkError(
                f"{self.url}: the system's {_setting('queues_max')} queues are all in use; raise "
                f"fs.mqueue.queues_max by sysctl, or {_REMEDY}",
                url=self.url,
            )
        if number == errno.EMFILE:
            return LinkError(
                f"{self.url}: this user's memory for queues is used up (ulimit -q); {_REMEDY}",
                url=self.url,
            )
        return LinkError(f"{self.url} cannot be opened: {error}", url=self.url)


def _further_name(name: str, number: int) -> str:
    # No name of an address has a plus sign.
    return f"{name}+{number}"


def _holder(descriptor: int) -> str:
    """Who reads from a queue; empty if nobody."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return lock_owner(os.fstat(descriptor)) or "another program"
    fcntl.flock(descriptor, fcntl.LOCK_UN)
    return ""


def _posix_ipc() -> posix_ipc:
    try:
        import posix_ipc
    except ImportError as error:
        raise UsageError("mq:// needs the package posix_ipc: pip install 'hexwire[mq]'") from error
    return posix_ipc


def _setting(name: str) -> str:
    return _text(_SETTINGS / name).strip() or "a few"


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="ascii", errors="replace")
    except OSError:
        return ""
