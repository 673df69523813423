"""Endpoints: where a program of a fleet listens or connects, and what may be reached without certificates.

Owns their grammar, the check that plain TCP stays on this machine, and the folder with the sockets of this user's
arms. Must not know Zenoh's session, nor certificates.

    unixsock-stream/PATH     programs of this user on this machine
    tcp/127.0.0.1:7447       programs of this machine
    tls/HOST:7447            beyond it, with certificates on both sides
"""

from __future__ import annotations

import contextlib
import hashlib
import ipaddress
import os
import re
import socket
import sys
from collections.abc import Sequence
from pathlib import Path

from hexwire.errors import UsageError
from hexwire.folders import make_private_folder, runtime_folder
from hexwire.system import user_id

__all__ = [
    "UNIX",
    "check_endpoint",
    "endpoints_of",
    "host_and_port",
    "is_served",
    "local_name",
    "local_socket",
    "local_sockets",
    "make_socket_folder",
    "socket_folder",
]

UNIX = "unixsock-stream"
# Zenoh reads options after '?' and '#', some of which switch checks off: nothing of the kind may be in a host.
_ENDPOINT = re.compile(r"(tcp|tls)/([A-Za-z0-9_.-]+|\[[0-9A-Fa-f:.]+\]):([0-9]{1,5})", re.ASCII)
_PLAIN_PATH = re.compile(r"[^?#;\0]+")
_MOST_PATH = 100
"""Bytes of a socket's path; the system allows 107."""
_SUFFIX = ".sock"
_CONNECT = 3.0
"""Time-out for a connection, seconds."""


def host_and_port(endpoint: str) -> tuple[str, str, int]:
    """Kind, host without brackets, and port of an endpoint on TCP.

    Raises:
        UsageError: It is not one.
    """
    match = _ENDPOINT.fullmatch(endpoint)
    if match is None or not 0 < int(match[3]) < 65536:
        raise UsageError(f"{endpoint!r} is not an endpoint; write tls/HOST:PORT, or tcp/localhost:PORT")
    return match[1], match[2].strip("[]"), int(match[3])


def check_endpoint(endpoint: str, *, certificates: bool, anywhere: bool) -> str:
    """Check an endpoint.

    Args:
        endpoint: As a person wrote it.
        certificates: Whether there are certificates.
        anywhere: Allow others than this machine without TLS.

    Returns:
        The endpoint for Zenoh. A name of this machine is replaced by its address, so that no resolver decides
        whether it is this machine.

    Raises:
        UsageError: It is not one, or it reaches beyond this machine without certificates.
    """
    kind, _, path = endpoint.partition("/")
    if kind == UNIX:
        if not _PLAIN_PATH.fullmatch(path) or not _is_private(Path(path).parent):
            raise UsageError(f"{endpoint!r} is not an endpoint: its folder must be one that only you can look into")
        return endpoint
    kind, host, port = host_and_port(endpoint)
    if kind == "tls":
        if not certificates:
            raise UsageError(f"{endpoint} needs certificates: give ca, cert and key ('hexwire cert' creates them)")
        return endpoint
    if (address := _loopback(host)) is not None:
        return f"tcp/{address}:{port}"
    if not anywhere:
        raise UsageError(
            f"{endpoint} reaches beyond this machine without certificates: anybody there could move the arm. "
            "Use tls/HOST:PORT"
        )
    return endpoint


def _is_private(folder: Path) -> bool:
    if folder == socket_folder():
        return True
    try:
        status = folder.stat()
    except OSError:
        return False
    return status.st_uid == user_id() and not status.st_mode & 0o077


def _is_own(folder: Path) -> bool:
    """Whether a folder belongs to this user, and nobody else may change it."""
    try:
        status = folder.stat()
    except OSError:
        return False
    return status.st_uid == user_id() and not status.st_mode & 0o022


def _loopback(host: str) -> str | None:
    """Address of this machine in its usual form; None for whatever may be another one."""
    if host.lower() == "localhost":
        return "127.0.0.1"
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        return None
    if isinstance(address, ipaddress.IPv6Address):
        # Not the mapped addresses of IPv4: systems differ in what these reach.
        return "[::1]" if address == ipaddress.IPv6Address("::1") else None
    return str(address) if address.is_loopback else None


def socket_folder() -> Path:
    """The folder of this user's sockets."""
    return runtime_folder() / "arms"


def make_socket_folder() -> None:
    """Make the folder of this user's sockets, which nobody else can look into.

    Raises:
        UsageError: It cannot be made, or belongs to another user.
    """
    make_private_folder(socket_folder(), "set XDG_RUNTIME_DIR to a folder of yours")


def local_socket(name: str) -> Path:
    """Path of the socket of an arm that is served by this user on this machine."""
    folder, file = socket_folder(), name.replace("/", "+") + _SUFFIX
    if len(os.fsencode(folder / file)) > _MOST_PATH:
        file = hashlib.sha256(name.encode()).hexdigest()[:16] + _SUFFIX
    path = folder / file
    if len(os.fsencode(path)) > _MOST_PATH:
        raise UsageError(f"{folder} is too long for the address of a socket; set XDG_RUNTIME_DIR to a shorter one")
    return path


def local_name(path: Path) -> str:
    """The name for which a socket was made; empty if its path was too long for the name."""
    name = path.stem.replace("+", "/")
    return name if path == local_socket(name) else ""


def local_sockets() -> list[Path]:
    """Sockets of this user on which a server listens."""
    try:
        found = sorted(socket_folder().glob(f"*{_SUFFIX}"))
    except OSError:
        return []
    return [path for path in found if is_served(path)]


def is_served(path: Path) -> bool:
    """Whether a program of this user listens on that socket."""
    # With a wrong XDG_RUNTIME_DIR another user may have made the folder, and would confirm stops of no arm.
    if not _is_own(path.parent):
        return False
    if sys.platform == "win32" or not hasattr(socket, "AF_UNIX"):
        return False
    with contextlib.closing(socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)) as probe:
        probe.settimeout(_CONNECT)
        try:
            probe.connect(os.fspath(path))
        except BlockingIOError:
            # Its queue is full: a program that hangs does not take those who look whether it is there.
            return True
        except OSError:
            return False
    return True


def endpoints_of(paths: Sequence[Path]) -> tuple[str, ...]:
    """Zenoh's addresses of sockets."""
    return tuple(f"{UNIX}/{path}" for path in paths)
