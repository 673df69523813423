"""How a Zenoh session is set up, and why it cannot be opened, in one line.

No scouting, no multicast, no connections except those named. Owns Zenoh's settings, and the questions that Zenoh
does not answer: does anybody listen, is its certificate the expected one, does it accept ours. `node` owns what an
open session does. Must not know arms, messages or roles.

Programs of one user on one machine meet at a Unix socket in a folder that only this user can read. Beyond the
machine both ends show certificates of the lab's authority (TLS).
"""

from __future__ import annotations

import json
import os
import re
import socket
from contextlib import closing
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from hexwire.errors import (
    ConfigError,
    HexwireError,
    LinkNotFoundError,
    LinkPermissionError,
    UsageError,
)
from hexwire.inputs import LARGEST_DATA, parse_json, read_text

from .endpoints import (
    UNIX,
    check_endpoint,
    endpoints_of,
    host_and_port,
    is_served,
    local_socket,
    local_sockets,
    make_socket_folder,
)
from .node import Node, load_zenoh

if TYPE_CHECKING:
    from hexwire.link.tls import TlsFiles

__all__ = [
    "SILENT",
    "Network",
    "endpoints_of",
    "is_served",
    "local_socket",
    "local_sockets",
    "make_socket_folder",
    "open_router_file",
    "read_access",
    "tls_settings",
    "why_unreachable",
]

_PATIENCE = 2.0
"""Seconds for each step."""
# OpenSSL's names of what the other side says of our certificate.
_REFUSED = ("ALERT_UNKNOWN_CA", "CERTIFICATE", "ALERT_ACCESS_DENIED", "ALERT_DECRYPT_ERROR")
_EXPIRED = ("CERTIFICATE_EXPIRED",)
_RIGHT_NAME = "running, and the address right?"


def why_unreachable(endpoint: str, files: TlsFiles | None) -> str:
    """Why no session could be opened to an endpoint.

    Args:
        endpoint: As in ``tls/lab-pc:7447``.
        files: Own certificates, for TLS.
    """
    kind, _, rest = endpoint.partition("/")
    if kind == UNIX:
        return f"the server behind {rest} does not answer; is its program stopped?"
    try:
        kind, host, port = host_and_port(endpoint)
    except UsageError as error:
        return str(error)
    try:
        connection = socket.create_connection((host, port), _PATIENCE)
    except socket.gaierror:
        return f"{endpoint}: there is no computer {host} in this network"
    except TimeoutError:
        return f"{endpoint}: no answer; is the computer on, and does its firewall let this port through?"
    except OSError as error:
        return f"nobody answers at {endpoint} ({error.strerror}); is the server or router {_RIGHT_NAME}"
    with closing(connection):
        if kind == "tcp" or files is None:
            return f"{endpoint} answers, but not as a server or router: is it stopped, or does it want tls/?"
        return f"{endpoint}: {_handshake(connection, host, files)}"


def _handshake(connection: socket.socket, host: str, files: TlsFiles) -> str:
    # Here and below: a program without certificates needs no TLS, which takes memory and time to load.
    import ssl

    try:
        context = files.client_context()
    except UsageError as error:
        return str(error)
    try:
        with context.wrap_socket(connection, server_hostname=host) as tls:
            # In TLS 1.3 the other side refuses our certificate after the handshake.
            tls.recv(1)
    except ssl.SSLCertVerificationError as error:
        why = error.verify_message
        if "expired" in why:
            return "its certificate has expired; issue a new one for it"
        if "mismatch" in why or "not valid for" in why:
            return f"its certificate is not for the host {host}; issue one with --host {host}, or use its name"
        return f"its certificate is not of the authority {files.ca} ({why})"
    except ssl.SSLError as error:
        reason = error.reason or str(error)
        if any(word in reason for word in _EXPIRED):
            return f"it refuses the certificate {files.cert}, which has expired by its clock"
        if any(word in reason for word in _REFUSED):
            return f"it refuses the certificate {files.cert}: another authority's, or not for connecting"
        return f"no TLS ({reason}); is it a router for tcp/ only?"
    except TimeoutError:
        return "it accepts the certificate, but does not answer; is its program stopped, or not a router?"
    except OSError as error:
        return f"it ends the connection ({error.strerror})"
    return "it ends the connection; is it a server or router?"


_ACCESS = ("enabled", "default_permission", "rules", "subjects", "policies")
_OPEN = 3.0
"""Time-out for a connection, seconds."""
SILENT = 5.0
"""Seconds of silence after which a connection counts as lost, so that a computer that was cut off shows as gone.
Where every fifth packet is lost, TCP is silent for up to 3 s."""
_SIGNS = 5
"""Heartbeats in that time."""
_RETRY = {"period_init_ms": 250, "period_max_ms": 1000, "period_increase_factor": 2}
_STUCK = 0.25
"""Seconds for which an answer waits for a program that takes nothing; then its connection is closed. Behind such
answers the questions of others wait, even a stop: 5 s by Zenoh's own limit, each time."""
_THREADS = "(rx: (worker_threads: 1), app: (handover: net), acc: (handover: net), tx: (handover: net))"
"""Zenoh's threads in a program that passes nothing on: one that receives, and one for all else, which goes on while
the first one waits for a slow program. By itself Zenoh has six, and a message wakes up three of them."""
_MOST_SESSIONS = 10_000
"""Programs that may be connected to a router; Zenoh's own limit is 1000."""


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
        given = [bool(self.ca), bool(self.cert), bool(self.key)]
        if any(given) and not all(given):
            raise UsageError("TLS needs all of ca, cert and key; 'hexwire cert' creates the files")
        for field in ("listen", "connect"):
            checked = (
                check_endpoint(each, certificates=bool(self.ca), anywhere=self.reachable_without_certificates)
                for each in getattr(self, field)
            )
            object.__setattr__(self, field, tuple(checked))
        if any(each.startswith("tls/") for each in self.listen) and self.access is None:
            raise UsageError(
                "whoever listens with certificates decides what each may do: give --access FILE, which "
                "'hexwire fleet config' writes"
            )

    @property
    def files(self) -> TlsFiles | None:
        """The certificates; None for none."""
        if not self.ca:
            return None
        from hexwire.link.tls import TlsFiles

        return TlsFiles(self.ca, self.cert, self.key)

    def open(self, *, wait: bool = True) -> Node:
        """Open a session.

        Args:
            wait: Fail if no endpoint of `connect` can be reached; otherwise keep trying in the background.

        Raises:
            LinkNotFoundError: No endpoint can be reached.
            LinkPermissionError: An endpoint cannot be listened on.
            NotSupportedError: Zenoh is not installed.
            UsageError: The certificates or the access control cannot be used.
        """
        zenoh = load_zenoh()
        zenoh.init_log_from_env_or("off")
        if not self.router:
            # Zenoh reads it once, when it starts its first thread.
            os.environ.setdefault("ZENOH_RUNTIME", _THREADS)
        if self.files is not None:
            from hexwire.link.certs import check_usable

            check_usable(self.files)
        config = zenoh.Config()
        for key, value in self._settings(wait).items():
            try:
                config.insert_json5(key, json.dumps(value))
            except zenoh.ZError as error:
                raise UsageError(f"{key} is not a setting of Zenoh: {_first_line(error)}") from None
        for endpoint in self.listen:
            if endpoint.startswith(f"{UNIX}/"):
                make_socket_folder()
        try:
            local = all(each.startswith(f"{UNIX}/") for each in (*self.listen, *self.connect))
            node = Node(zenoh.open(config), cert=self.cert, local=local)
        except zenoh.ZError as error:
            raise self._failure(_first_line(error)) from None
        if self.listen:
            node.answer_neighbours()
        return node

    def _settings(self, wait: bool) -> dict[str, Any]:
        client = bool(self.connect) and not self.listen and not self.router
        rows: dict[str, Any] = {
            "mode": "router" if self.router else "client" if client and wait else "peer",
            "listen/endpoints": list(self.listen),
            "connect/endpoints": list(self.connect),
            "scouting/multicast/enabled": False,
            # A router tells ROS 2 nodes of this machine of each other, as theirs does: these connect directly.
            "scouting/gossip/enabled": self.router,
            "scouting/gossip/autoconnect": {"router": [], "peer": []},
            # Zenoh would wait half a second at every start for what scouting finds.
            "scouting/delay": 0,
            # A program that waits tries once, and says why; the others try until they end.
            "connect/timeout_ms": 0 if wait else -1,
            "connect/exit_on_failure": wait,
            "connect/retry": _RETRY,
            "listen/timeout_ms": 0,
            "listen/exit_on_failure": True,
            "adminspace/enabled": False,
            "transport/shared_memory/enabled": False,
            "transport/link/protocols": sorted({UNIX, "tls", *(["tcp"] if self._has_tcp else [])}),
            "transport/unicast/open_timeout": round(1000 * _OPEN),
            "transport/link/tx/lease": round(1000 * SILENT),
            "transport/link/tx/keep_alive": _SIGNS,
        }
        if self.files is not None:
            rows |= tls_settings(self.files)
        if self.listen:
            rows["transport/link/tx/queue/congestion_control/block/wait_before_close"] = round(1e6 * _STUCK)
        if self.router:
            rows["transport/unicast/max_sessions"] = _MOST_SESSIONS
        if self.access is not None:
            rows["access_control"] = self.access
        return rows

    @property
    def _has_tcp(self) -> bool:
        return any(each.startswith("tcp/") for each in (*self.listen, *self.connect))

    def _failure(self, text: str) -> HexwireError:
        if "access control" in text.lower():
            return UsageError(f"the access control cannot be used: {text}")
        if self.listen:
            return LinkPermissionError(f"cannot listen on {', '.join(self.listen)}: {_why_not(text)}")
        return LinkNotFoundError("; ".join(why_unreachable(each, self.files) for each in self.connect))


def open_router_file(path: str) -> tuple[Node, tuple[str, ...]]:
    """Open a router whose settings are those of a file, as ZENOH_ROUTER_CONFIG_URI names it for ROS 2.

    Args:
        path: Zenoh's settings in JSON5. Nothing of them is checked: it is for those who know Zenoh.

    Returns:
        The session, and where it listens.

    Raises:
        ConfigError: The file cannot be read, or its settings are not those of a router.
        LinkPermissionError: It cannot be opened with them.
        NotSupportedError: Zenoh is not installed.
    """
    zenoh = load_zenoh()
    zenoh.init_log_from_env_or("off")
    text = read_text(path)
    try:
        config = zenoh.Config.from_json5(text)
    except zenoh.ZError as error:
        raise ConfigError(f"Invalid configuration file: {_first_line(error)}", file=path) from None
    if json.loads(config.get_json("mode")) != "router":
        raise ConfigError("has no mode 'router'", file=path)
    listens = json.loads(config.get_json("listen/endpoints"))
    listens = listens.get("router", []) if isinstance(listens, dict) else listens
    try:
        return Node(zenoh.open(config)), tuple(str(each) for each in listens or ())
    except zenoh.ZError as error:
        raise LinkPermissionError(f"cannot open a router with {path}: {_why_not(_first_line(error))}") from None


def tls_settings(files: TlsFiles) -> dict[str, Any]:
    """Zenoh's settings for certificates on both sides."""
    tls = {
        "root_ca_certificate": files.ca,
        "listen_private_key": files.key,
        "listen_certificate": files.cert,
        "connect_private_key": files.key,
        "connect_certificate": files.cert,
        "enable_mtls": True,
        "verify_name_on_connect": True,
        # An open connection ends when the certificate of the other side expires.
        "close_link_on_expiration": True,
    }
    return {f"transport/link/tls/{key}": value for key, value in tls.items()}


def _first_line(error: Exception) -> str:
    """What Zenoh says, without the places in its source."""
    return re.sub(r" at /\S*", "", str(error).partition("\n")[0])[:300].strip()


def _why_not(text: str) -> str:
    for words, plain in (
        ("in use", "another program listens there"),
        ("Permission denied", "this user may not listen there; ports below 1024 need more rights"),
        ("Cannot assign requested address", "this computer does not have that address"),
        ("failed to lookup", "there is no such host"),
    ):
        if words in text:
            return plain
    return text


def read_access(path: str) -> dict[str, Any]:
    """Read Zenoh's access control from a file in JSON.

    Raises:
        ConfigError: It cannot be read, or is not a table.
    """
    text = read_text(path, largest=LARGEST_DATA)
    rows = {key: item.value for key, item in parse_json(text, path).table(_ACCESS, ()).items()}
    if rows["enabled"] is not True or rows["default_permission"] != "deny":
        raise ConfigError(f"{path}: access control that is switched off, or allows what no rule names")
    return rows
