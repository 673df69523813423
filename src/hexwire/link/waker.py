"""A descriptor that one thread makes readable to end another thread's poll.

Owns one eventfd, or a pair of sockets if the system has none: Windows waits for nothing else. Must not know links.
"""

from __future__ import annotations

import contextlib
import os
import socket
import sys
import threading

__all__ = ["Waker"]

_ONE = (1).to_bytes(8, sys.byteorder)


class Waker:
    """Readable from `set` until `clear`. Between `close` and `open` it does nothing.

    A signal handler may call any method, even while another one runs.
    """

    def __init__(self) -> None:
        # Held while a descriptor is used: after close() another file may have its number.
        self._lock = threading.RLock()
        self._uses = 0
        self._close_pending = False
        self._receive_fd = -1
        self._send_fd = -1
        self._pair: tuple[socket.socket, ...] = ()

    def open(self) -> None:
        with self._lock:
            if self._receive_fd >= 0:
                return
            if sys.platform == "linux" and hasattr(os, "eventfd"):
                self._receive_fd = self._send_fd = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
            else:
                self._pair = socket.socketpair()
                for end in self._pair:
                    end.setblocking(False)
                self._receive_fd, self._send_fd = (end.fileno() for end in self._pair)

    def close(self) -> None:
        with self._lock:
            # If a signal handler closes it while its own thread uses it, that thread closes it afterwards.
            self._close_pending = self._uses > 0
            if not self._close_pending:
                fd, pair = self._receive_fd, self._pair
                self._receive_fd = self._send_fd = -1
                self._pair = ()
                for end in pair:
                    end.close()
                if fd >= 0 and not pair:
                    os.close(fd)

    def fileno(self) -> int:
        return self._receive_fd

    def set(self) -> None:
        with self._lock:
            self._uses += 1
            try:
                if self._send_fd >= 0:
                    # What is full is set already.
                    with contextlib.suppress(BlockingIOError):
                        self._write(_ONE)
            finally:
                # Not in a function: Ctrl-C at its start would leave the count.
                self._uses -= 1
                if self._close_pending:
                    self.close()

    def clear(self) -> None:
        with self._lock:
            self._uses += 1
            try:
                if self._receive_fd >= 0:
                    with contextlib.suppress(BlockingIOError):
                        self._read(4096)
            finally:
                self._uses -= 1
                if self._close_pending:
                    self.close()

    def _write(self, data: bytes) -> int:
        return self._pair[1].send(data) if self._pair else os.write(self._send_fd, data)

    def _read(self, size: int) -> bytes:
        return self._pair[0].recv(size) if self._pair else os.read(self._receive_fd, size)
