"""A Zenoh session with hexwire's settings: no scouting, no multicast, and nobody reached who was not named.

Owns the settings, the folder with the sockets of this user's arms, and asking a question within a time limit. The
only module that imports Zenoh. Must not know arms, messages or roles.

Programs of one user on one machine meet at a Unix socket in a folder that only this user can read. Beyond the
machine both ends show certificates of the lab's authority (TLS).
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import socket
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hexwire.errors import (
    LinkClosedError,
    LinkError,
    LinkNotFoundError,
    LinkPermissionError,
    NotSupportedError,
    UsageError,
)
from hexwire.inputs import parse_json, read_text
from hexwire.new_file import make_folder, owner_name

__all__ = [
    "Network",
    "NoAnswerError",
    "Node",
    "endpoints_of",
    "is_served",
    "local_socket",
    "local_sockets",
    "make_socket_folder",
    "read_access",
]

_LOOPBACK = ("localhost", "127.0.0.1", "[::1]")
_MOST_PATH = 100
"""Bytes of a socket's path; the system allows 107."""
_SUFFIX = ".sock"
_CONNECT = 3.0
"""Seconds in which a connection must stand."""


def _zenoh() -> Any:
    try:
        import zenoh
    except ImportError:
        raise NotSupportedError(
            "sharing an arm needs Eclipse Zenoh, which is not installed: pip install 'hexwire[fleet]'"
        ) from None
    return zenoh


def socket_folder() -> Path:
    """The folder of this user's sockets."""
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    if runtime and Path(runtime).is_absolute():
        return Path(runtime) / "hexwire" / "arms"
    state = os.environ.get("XDG_STATE_HOME")
    home = Path(state) if state and Path(state).is_absolute() else Path.home() / ".local" / "state"
    return home / "hexwire" / "arms"


def make_socket_folder() -> None:
    """Make the folder of this user's sockets, which nobody else can look into.

    Raises:
        UsageError: It cannot be made, or belongs to another user.
    """
    folder, remedy = socket_folder(), "set XDG_RUNTIME_DIR to a folder of yours"
    try:
        make_folder(folder)
    except UsageError as error:
        raise UsageError(f"{error}: {remedy}") from None
    try:
        status = folder.stat()
        if status.st_uid != os.geteuid():
            raise UsageError(f"{folder} belongs to {owner_name(status.st_uid)}; {remedy}")
        if status.st_mode & 0o077:
            folder.chmod(0o700)
    except OSError as error:
        raise UsageError(f"{folder} cannot be used: {error.strerror}; {remedy}") from None


def local_socket(name: str) -> Path:
    """Path of the socket of an arm that is served by this user on this machine."""
    folder, file = socket_folder(), name.replace("/", "+") + _SUFFIX
    if len(os.fsencode(folder / file)) > _MOST_PATH:
        file = hashlib.sha256(name.encode()).hexdigest()[:16] + _SUFFIX
    path = folder / file
    if len(os.fsencode(path)) > _MOST_PATH:
        raise UsageError(f"{folder} is too long for the address of a socket; set XDG_RUNTIME_DIR to a shorter one")
    return path


def local_sockets() -> list[Path]:
    """Sockets of this user on which a server listens."""
    try:
        found = sorted(socket_folder().glob(f"*{_SUFFIX}"))
    except OSError:
        return []
    return [path for path in found if is_served(path)]


def is_served(path: Path) -> bool:
    """Whether a program listens on that socket."""
    with contextlib.closing(socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)) as probe:
        probe.settimeout(_CONNECT)
        try:
            probe.connect(os.fspath(path))
        except OSError:
            return False
    return True


@dataclass(frozen=True, slots=True)
class Network:
    """How a program takes part in a fleet.

    Attributes:
        listen: Endpoints to listen on, as in ``tls/0.0.0.0:7447``.
        connect: Endpoints to connect to; for a router, one.
        ca: Certificate of the lab's authority, a PEM file; empty for none.
        cert: Own certificate.
        key: Its key.
        router: Pass on what others send.
        reachable_without_certificates: Allow endpoints beyond this machine without TLS.
        access: Zenoh's access control, as `hexwire fleet config` writes it; None for none.
    """

    listen: tuple[str, ...] = ()
    connect: tuple[str, ...] = ()
    ca: str = ""
    cert: str = ""
    key: str = ""
    router: bool = False
    reachable_without_certificates: bool = False
    access: dict[str, Any] | None = None

    def __post_init__(self) -> None:
        for endpoint in (*self.listen, *self.connect):
            self._check(endpoint)
        given = [bool(self.ca), bool(self.cert), bool(self.key)]
        if any(given) and not all(given):
            raise UsageError("TLS needs all of ca, cert and key; 'hexwire cert' creates the files")

    def _check(self, endpoint: str) -> None:
        kind, _, rest = endpoint.partition("/")
        if kind == "unixsock-stream" and rest:
            return
        host, colon, port = rest.rpartition(":")
        if kind not in ("tcp", "tls") or not colon or not host or not port.isdigit():
            raise UsageError(f"{endpoint!r} is not an endpoint; write tls/HOST:PORT, or tcp/localhost:PORT")
        if kind == "tls":
            if not self.ca:
                raise UsageError(
                    f"{endpoint} needs certificates: give ca, cert and key ('hexwire cert' creates them)"
                )
        elif host not in _LOOPBACK and not self.reachable_without_certificates:
            raise UsageError(
                f"{endpoint} reaches beyond this machine without certificates: anybody there could move the arm. "
                "Use tls/HOST:PORT"
            )

    def open(self, *, wait: bool = True) -> Node:
        """Open a session.

        Args:
            wait: Fail if no endpoint of `connect` can be reached; otherwise keep trying in the background.

        Raises:
            LinkNotFoundError: No endpoint can be reached.
            LinkPermissionError: An endpoint cannot be listened on.
            NotSupportedError: Zenoh is not installed.
        """
        zenoh = _zenoh()
        zenoh.init_log_from_env_or("off")
        config = zenoh.Config()
        for key, value in self._settings(wait).items():
            config.insert_json5(key, json.dumps(value))
        for path in (self.ca, self.cert, self.key):
            if path and not os.access(path, os.R_OK):
                raise UsageError(f"{path} cannot be read; 'hexwire cert' creates certificates")
        for endpoint in self.listen:
            if Path(endpoint.removeprefix("unixsock-stream/")).parent == socket_folder():
                make_socket_folder()
        try:
            return Node(zenoh.open(config))
        except zenoh.ZError as error:
            raise self._failure(str(error)) from None

    def _settings(self, wait: bool) -> dict[str, Any]:
        client = bool(self.connect) and not self.listen and not self.router
        rows: dict[str, Any] = {
            "mode": "router" if self.router else "client" if client and wait else "peer",
            "listen/endpoints": list(self.listen),
            "connect/endpoints": list(self.connect),
            "scouting/multicast/enabled": False,
            "scouting/gossip/enabled": False,
            "connect/timeout_ms": round(1000 * _CONNECT) if wait else -1,
            "connect/exit_on_failure": wait,
        }
        if self.ca:
            tls = {
                "root_ca_certificate": self.ca,
                "listen_private_key": self.key,
                "listen_certificate": self.cert,
                "connect_private_key": self.key,
                "connect_certificate": self.cert,
                "enable_mtls": True,
                "verify_name_on_connect": True,
            }
            rows |= {f"transport/link/tls/{key}": value for key, value in tls.items()}
        if self.access is not None:
            rows["access_control"] = self.access
        return rows

    def _failure(self, text: str) -> LinkError:
        where = ", ".join(self.connect or self.listen)
        if self.listen and ("listener" in text.lower() or "bind" in text.lower() or "in use" in text.lower()):
            return LinkPermissionError(f"cannot listen on {', '.join(self.listen)}: {text.splitlines()[0][:200]}")
        return LinkNotFoundError(
            f"nobody answers at {where}; is the server or router running, and the address right?"
        )


class NoAnswerError(Exception):
    """No answer to a question; `absent` if nobody offers to answer it, as far as this program may know."""

    def __init__(self, *, absent: bool) -> None:
        super().__init__("nobody answers this" if absent else "no answer in time")
        self.absent = absent


class Node:
    """An open session. Any thread may call its methods.

    Args:
        session: As Zenoh opened it.
    """

    def __init__(self, session: Any) -> None:
        # Zenoh's stubs leave out the types of what ends a session.
        self._session = session
        self._zenoh = _zenoh()

    @property
    def is_closed(self) -> bool:
        """Whether it was closed."""
        return bool(self._session.is_closed())

    @property
    def connections(self) -> int:
        """Number of other programs that this one is connected to: peers and routers."""
        info = self._session.info
        return len(list(info.peers_zid())) + len(list(info.routers_zid()))

    @property
    def routers(self) -> int:
        """Number of routers that this one is connected to."""
        return len(list(self._session.info.routers_zid()))

    def close(self) -> None:
        """Close it; everything declared in it ends."""
        with contextlib.suppress(self._zenoh.ZError):
            self._session.close()

    def ask(self, key: str, payload: bytes, timeout: float, *, urgent: bool = False) -> bytes:
        """Ask a question and wait for the first answer.

        Args:
            key: Where.
            payload: The question.
            timeout: Seconds.
            urgent: Before everything else on the way.

        Raises:
            NoAnswerError: There is no answer.
            LinkClosedError: The session is closed.
        """
        zenoh = self._zenoh
        extra = {"priority": zenoh.Priority.REAL_TIME, "express": True} if urgent else {"express": True}
        try:
            # Receiving in this thread takes half the time of a callback in another one.
            replies = self._session.get(
                key,
                payload=payload,
                timeout=timeout,
                congestion_control=zenoh.CongestionControl.BLOCK,
                consolidation=zenoh.ConsolidationMode.NONE,
                **extra,
            )
            for reply in replies:
                if reply.ok is not None:
                    return bytes(reply.ok.payload.to_bytes())
                raise NoAnswerError(absent=False)
        except zenoh.ZError as error:
            raise LinkClosedError(f"the session is closed: {str(error)[:200]}") from None
        raise NoAnswerError(absent=True)

    def answer(self, key: str, on_question: Callable[[Any], object]) -> None:
        """Answer questions; `on_question` gets Zenoh's query in a thread of Zenoh's, and must not wait."""
        self._session.declare_queryable(key, on_question, complete=True)

    def subscribe(self, key: str, on_sample: Callable[[bytes, str], object]) -> Callable[[], None]:
        """Receive what is published; returns how to end it. A thread of Zenoh's passes payload and key."""
        subscriber = self._session.declare_subscriber(
            key, lambda sample: on_sample(sample.payload.to_bytes(), str(sample.key_expr))
        )

        def undeclare() -> None:
            with contextlib.suppress(self._zenoh.ZError):
                subscriber.undeclare()

        return undeclare

    def publisher(self, key: str) -> Callable[[bytes], None]:
        """How to publish: nobody who is slow delays the publisher, and what does not get through is dropped."""
        zenoh = self._zenoh
        publisher = self._session.declare_publisher(
            key,
            congestion_control=zenoh.CongestionControl.DROP,
            priority=zenoh.Priority.INTERACTIVE_HIGH,
            express=True,
            reliability=zenoh.Reliability.BEST_EFFORT,
        )

        def put(payload: bytes) -> None:
            with contextlib.suppress(zenoh.ZError):
                publisher.put(payload)

        return put

    def announce(self, key: str) -> None:
        """Be visible under a key as long as this session lasts."""
        self._tokens = [*getattr(self, "_tokens", []), self._session.liveliness().declare_token(key)]

    def visible(self, key: str, timeout: float) -> list[str]:
        """Keys under which programs are visible.

        Args:
            key: A key or a pattern.
            timeout: Seconds.
        """
        with contextlib.suppress(self._zenoh.ZError):
            replies = self._session.liveliness().get(key, timeout=timeout)
            return sorted(str(reply.ok.key_expr) for reply in replies if reply.ok is not None)
        return []

    def watch_visible(self, key: str, on_change: Callable[[str, bool], object]) -> None:
        """Be told in a thread of Zenoh's when programs become visible or vanish, and of those visible now."""
        put = self._zenoh.SampleKind.PUT
        self._watch = self._session.liveliness().declare_subscriber(
            key, lambda sample: on_change(str(sample.key_expr), sample.kind == put), history=True
        )


def read_access(path: str) -> dict[str, Any]:
    """Read Zenoh's access control from a file in JSON.

    Raises:
        ConfigError: It cannot be read, or is not a table.
    """
    return {key: item.value for key, item in parse_json(read_text(path), path).table().items()}


def endpoints_of(paths: Sequence[Path]) -> tuple[str, ...]:
    """Zenoh's addresses of sockets."""
    return tuple(f"unixsock-stream/{path}" for path in paths)
