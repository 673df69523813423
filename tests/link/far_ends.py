"""What stands on the other side of a link under test, where that is not a hexwire link itself."""

from __future__ import annotations

import contextlib
import itertools
import os
import random
import re
import socket
import time
import tty
from collections.abc import Callable
from pathlib import Path

from hexwire.errors import LinkLostError
from hexwire.link.base import Link, LinkKind
from hexwire.link.poll_link import PollLink


class PtyEnd(PollLink):
    """The far side of a serial line: a pseudo-terminal behind a symbolic link. Closing it is unplugging."""

    kind = LinkKind.STREAM

    def __init__(self, path: Path) -> None:
        super().__init__(f"pty:{path}")
        self._path = path
        self._master = self._slave = -1

    def _open(self) -> None:
        self._master, self._slave = os.openpty()
        # The terminal's own side stays open here, or the line would hang up whenever its user closes it.
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self._path.symlink_to(os.ttyname(self._slave))

    def _close(self) -> None:
        self._path.unlink(missing_ok=True)
        for fd in (self._master, self._slave):
            if fd >= 0:
                os.close(fd)
        self._master = self._slave = -1

    def _fileno(self) -> int:
        return self._master

    def _read_ready(self) -> bytes:
        data = os.read(self._master, 4096)
        if not data:
            raise LinkLostError("the terminal hung up")
        return data

    def _write_ready(self, data: memoryview | bytes) -> int:
        return os.write(self._master, data)


def _ports() -> range:
    """The ports of this worker: below those that the system gives to whoever asks for any."""
    first, behind, workers = 20_000, 32_768, 8
    with contextlib.suppress(OSError):
        behind = int(Path("/proc/sys/net/ipv4/ip_local_port_range").read_text(encoding="ascii").split()[0])
    each = (behind - first) // workers
    begin = first + each * (int(re.sub(r"\D", "", os.environ.get("PYTEST_XDIST_WORKER", "")) or 0) % workers)
    return range(begin, begin + each)


_next_port = itertools.count(random.randrange(10_000))


def free_port(kind: int = socket.SOCK_STREAM) -> int:
    """A port of the loopback interface that nobody uses at the moment.

    It may take a program seconds to listen there. So nobody else may get it meanwhile: no other worker, and no
    program that lets the system choose its port.
    """
    ports = _ports()
    for _ in ports:
        port = ports[next(_next_port) % len(ports)]
        with socket.socket(socket.AF_INET, kind) as probe:
            try:
                probe.bind(("127.0.0.1", port))
            except OSError:
                continue
            return port
    raise AssertionError("no port is free")


class Recorder(Link):
    """A link that writes down how it is called."""

    kind = LinkKind.STREAM
    url = "recorder://"

    def __init__(self) -> None:
        self.calls: list[object] = []
        self.answer = b""

    @property
    def is_open(self) -> bool:
        return True

    def open(self) -> None:
        self.calls.append("open")

    def close(self) -> None:
        self.calls.append("close")

    def read(self, deadline: float | None) -> bytes:
        self.calls.append(("read", deadline))
        return self.answer

    def write(self, data: bytes, deadline: float | None = None) -> None:
        self.calls.append(("write", data, deadline))

    def flush_input(self) -> int:
        self.calls.append("flush")
        return 7

    def wake(self) -> None:
        self.calls.append("wake")

    def confirm(self) -> None:
        self.calls.append("confirm")


def take_over(leave_one_behind: Callable[[], str]) -> list[int]:
    """Open terminals until one has the number of a terminal that is gone; returns their descriptors, it last.

    Other programs of this machine open terminals too and may get the number first: then leave another one behind.
    """
    for _ in range(20):
        name = leave_one_behind()
        time.sleep(0.05)  # the system's file times must differ
        opened: list[int] = []
        while len(opened) < 60:
            opened += os.openpty()
            if os.ttyname(opened[-1]) == name:
                return opened
        for fd in opened:
            os.close(fd)
    raise AssertionError("other programs keep taking the terminals' numbers")
