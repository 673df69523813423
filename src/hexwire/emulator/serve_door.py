"""The door of an emulated arm: a socket that programs of this user find by a path, and that nobody else may use.

Owns how it is made, and how another program knocks. On Linux it is a Unix socket at that path, and the kernel tells
who serves it. Elsewhere it is a TCP port of this machine, and the path is a file of this user with its number and a
key, which whoever comes says first.
"""

from __future__ import annotations

import contextlib
import os
import secrets
import socket
import struct
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

from hexwire.folders import open_folder
from hexwire.system import user_id

__all__ = ["Opened", "knock", "open_door"]

_MOST = 8
"""Callers that wait at a time."""
_LARGEST = 100
"""Bytes of the file that are read."""
_HERE = "127.0.0.1"

Opened = tuple[socket.socket, bytes]
"""A socket, and the key that callers say first; empty if they need none."""


def _listen_at_port(early: Path) -> Opened:
    door, key = socket.socket(socket.AF_INET, socket.SOCK_STREAM), secrets.token_hex(16).encode()
    try:
        door.bind((_HERE, 0))
        door.listen(_MOST)
        with open_folder(early.parent) as folder:
            file = folder.make(early.name, 0o600)
        with os.fdopen(file, "wb") as out:
            out.write(b"%d %s" % (door.getsockname()[1], key))
    except BaseException:
        door.close()
        raise
    return door, key


def _knock_at_port(path: Path, patience: float) -> Opened:
    with path.open("rb") as file:
        port, _, key = file.read(_LARGEST).partition(b" ")
    if not port.isdigit() or not key:
        # Of no program that still runs.
        raise ConnectionRefusedError(f"{path} names no port")
    return socket.create_connection((_HERE, int(port)), patience), key


_listen: Callable[[Path], Opened] = _listen_at_port
_knock: Callable[[Path, float], Opened] = _knock_at_port

if sys.platform == "linux":

    @contextlib.contextmanager
    def _short(path: Path) -> Iterator[str]:
        """An address for a socket's path, which may be longer than the system allows."""
        with open_folder(path.parent) as folder:
            yield f"/proc/self/fd/{folder.descriptor}/{path.name}"

    def _listen_at_path(early: Path) -> Opened:
        door = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            with _short(early) as address:
                door.bind(address)
            door.listen(_MOST)
        except BaseException:
            door.close()
            raise
        return door, b""

    def _knock_at_path(path: Path, patience: float) -> Opened:
        talk = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            talk.settimeout(patience)
            with _short(path) as address:
                talk.connect(address)
            _, uid, _ = struct.unpack("3i", talk.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12))
            if uid != user_id():
                raise PermissionError(f"{path} belongs to another user")
        except BaseException:
            talk.close()
            raise
        return talk, b""

    _listen, _knock = _listen_at_path, _knock_at_path


def open_door(path: Path) -> Opened:
    """A listening socket that others find by a path.

    Raises:
        OSError: It cannot be made.
        UsageError: The folder cannot be opened.
    """
    # It gets its name when it listens: until then it would be taken for the leftover of a program that was killed.
    # One such may have the name; it belongs to a terminal, port or program that is now ours.
    early = path.with_name(f"{path.name}-{os.getpid()}")
    with contextlib.suppress(FileNotFoundError):
        early.unlink()
    door, key = _listen(early)
    try:
        early.replace(path)
        door.setblocking(False)
    except BaseException:
        door.close()
        raise
    return door, key


def knock(path: Path, patience: float) -> Opened:
    """A connection to the program whose door has a path, and what to say to it first.

    Args:
        path: Of the door.
        patience: Time-out of the connection, seconds.

    Raises:
        ConnectionRefusedError: Whoever made it does not listen any more.
        OSError: There is no such door, or it belongs to another user.
    """
    return _knock(path, patience)
