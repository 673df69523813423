"""A link inside one process: one end reads what the other writes.

Owns the pair of ends, for tests and for programs that hold both sides. It is a socket pair of the kernel, so it
waits, blocks and breaks like a real line. Must not know what the bytes mean.
"""

from __future__ import annotations

import contextlib
import itertools
import socket
import sys
import threading

from hexwire.errors import LinkLostError, UsageError

from .base import LinkKind
from .poll_link import PollLink

__all__ = ["MemoryLink", "memory_pair"]

_numbers = itertools.count(1)


def _socket_pair(kind: int) -> tuple[socket.socket, socket.socket]:
    if sys.platform != "win32" and hasattr(socket, "AF_UNIX"):
        return socket.socketpair(socket.AF_UNIX, kind)
    if kind != socket.SOCK_STREAM:
        raise UsageError("a datagram line in memory needs the sockets of Linux or macOS; use a stream")
    return socket.socketpair()


class _Wire:
    """Shared by the two ends: the half of the socket pair that its owner has not fetched yet."""

    def __init__(self, kind: LinkKind, capacity: int) -> None:
        self._socket_type = socket.SOCK_STREAM if kind is LinkKind.STREAM else socket.SOCK_SEQPACKET
        self._capacity = capacity
        self._lock = threading.Lock()
        self._waiting: dict[int, socket.socket] = {}

    def take(self, end: int) -> socket.socket:
        with self._lock:
            mine = self._waiting.pop(end, None)
            if mine is None:
                mine, other = _socket_pair(self._socket_type)
                for half in (mine, other):
                    half.setblocking(False)
                    half.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, self._capacity)
                self._waiting[1 - end] = other
            return mine

    def give_back(self, end: int) -> None:
        """This end closes: close a half that the other end never fetched."""
        with self._lock:
            unfetched = self._waiting.pop(1 - end, None)
        if unfetched is not None:
            unfetched.close()


class MemoryLink(PollLink):
    """One end of a line in memory; `memory_pair` creates both.

    The end that is opened first buffers its bytes for the other. When one end closes, the other is lost; both can
    be opened again and are then reconnected.
    """

    def __init__(self, url: str, kind: LinkKind, wire: _Wire, end: int, max_message: int | None) -> None:
        super().__init__(url)
        self.kind = kind
        self.max_message = max_message
        self._wire = wire
        self._end = end
        self._socket: socket.socket | None = None

    def _open(self) -> None:
        self._socket = self._wire.take(self._end)
        self._receive_some = self._socket.recv
        self._send_some = self._socket.send

    def _close(self) -> None:
        if self._socket is not None:
            self._wire.give_back(self._end)
            # The other end must see the close even if a fork has copied the descriptor.
            with contextlib.suppress(OSError):
                self._socket.shutdown(socket.SHUT_RDWR)
            self._socket.close()
            self._socket = None

    def _fileno(self) -> int:
        return -1 if self._socket is None else self._socket.fileno()

    def _read_ready(self) -> bytes:
        data = self._receive_some(65536)
        if not data:
            raise LinkLostError(f"{self.url}: the other end closed", url=self.url)
        return data

    def _write_ready(self, data: memoryview | bytes) -> int:
        return self._send_some(data)


def memory_pair(
    kind: LinkKind = LinkKind.STREAM, *, capacity: int = 65536, max_message: int = 8192
) -> tuple[MemoryLink, MemoryLink]:
    """Create the two ends of a line in memory, not open yet.

    Args:
        kind: Stream or datagram.
        capacity: Approximate number of unread bytes at which a writer has to wait: the kernel includes its own
            overhead and has a lower bound of some kilobytes.
        max_message: Longest datagram in bytes; ignored for a stream.

    Returns:
        The two ends. Each reads what the other writes.
    """
    wire = _Wire(kind, capacity)
    name = f"memory://{next(_numbers)}"
    limit = max_message if kind is LinkKind.DATAGRAM else None
    return (
        MemoryLink(f"{name}/a", kind, wire, 0, limit),
        MemoryLink(f"{name}/b", kind, wire, 1, limit),
    )
