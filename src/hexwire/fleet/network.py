"""A Zenoh session with hexwire's settings: no scouting, no multicast, and nobody reached who was not named.

Owns the settings, asking a question within a time limit, and what is published and visible. The only module that
imports Zenoh. Must not know arms, messages or roles.

Programs of one user on one machine meet at a Unix socket in a folder that only this user can read. Beyond the
machine both ends show certificates of the lab's authority (TLS).
"""

from __future__ import annotations

import contextlib
import json
import logging
import re
import threading
import weakref
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from hexwire.errors import (
    ConfigError,
    HexwireError,
    LinkClosedError,
    LinkNotFoundError,
    LinkPermissionError,
    NotSupportedError,
    UsageError,
)
from hexwire.inputs import LARGEST_DATA, parse_json, read_text
from hexwire.link.cert_facts import check_usable
from hexwire.link.tls import TlsFiles

from .endpoints import (
    UNIX,
    check_endpoint,
    endpoints_of,
    is_served,
    local_socket,
    local_sockets,
    make_socket_folder,
)
from .names import HERE
from .reach import why_unreachable

__all__ = [
    "Network",
    "NoAnswerError",
    "Node",
    "Pending",
    "Question",
    "endpoints_of",
    "is_served",
    "local_socket",
    "local_sockets",
    "make_socket_folder",
    "read_access",
]

_log = logging.getLogger(__name__)

_ACCESS = ("enabled", "default_permission", "rules", "subjects", "policies")
_OPEN = 3.0
"""Seconds in which a connection must stand."""
_SILENT = 5.0
"""Seconds of silence after which a connection counts as lost, so that a computer that was cut off shows as gone.
Where every fifth packet is lost, TCP is silent for up to 3 s."""
_SIGNS = 5
"""Signs of life in that time."""
_RETRY = {"period_init_ms": 250, "period_max_ms": 1000, "period_increase_factor": 2}
_STUCK = 0.25
"""Seconds for which an answer waits for a program that takes nothing; then its connection is closed. Behind such
answers the questions of others wait, even a stop: 5 s by Zenoh's own limit, each time."""
_MOST_SESSIONS = 10_000
"""Programs that may be connected to a router; Zenoh's own limit is 1000."""


def _zenoh() -> Any:
    try:
        import zenoh
    except ImportError:
        raise NotSupportedError(
            "sharing an arm needs Eclipse Zenoh, which is not installed: pip install 'hexwire[fleet]'"
        ) from None
    return zenoh


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
        return TlsFiles(self.ca, self.cert, self.key) if self.ca else None

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
        zenoh = _zenoh()
        zenoh.init_log_from_env_or("off")
        if self.files is not None:
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
            node = Node(zenoh.open(config), cert=self.cert)
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
            "scouting/gossip/enabled": False,
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
            "transport/link/tx/lease": round(1000 * _SILENT),
            "transport/link/tx/keep_alive": _SIGNS,
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
                # A connection that stands ends when the certificate of the other side does.
                "close_link_on_expiration": True,
            }
            rows |= {f"transport/link/tls/{key}": value for key, value in tls.items()}
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


_RECEIVING = 1.0
"""Seconds in which a sample that has arrived is handled, at most, when the session is closed."""


class NoAnswerError(Exception):
    """No answer to a question; `absent` if nobody offers to answer it, as far as this program may know."""

    def __init__(self, *, absent: bool) -> None:
        super().__init__("nobody answers this" if absent else "no answer in time")
        self.absent = absent


class Question:
    """A question that arrived.

    Args:
        key: Where it is answered. It may have been asked at a pattern, but the answer is for this key: a program
            may have no right to answer for all that the pattern names.
        query: Zenoh's.
    """

    def __init__(self, key: str, query: Any) -> None:
        self._key, self._query = key, query

    @property
    def payload(self) -> bytes:
        """What was asked."""
        payload = self._query.payload
        return bytes(payload.to_bytes()) if payload is not None else b""

    def reply(self, payload: bytes) -> None:
        """Answer it, once. Whoever asked may be gone."""
        with contextlib.suppress(Exception):
            self._query.reply(self._key, payload)
        with contextlib.suppress(Exception):
            self._query.drop()


class Pending:
    """A question on its way.

    Args:
        replies: Zenoh's channel of replies.
        closed: The exception of a channel without further replies.
    """

    def __init__(self, replies: Any, closed: type[Exception]) -> None:
        self._replies, self._closed = replies, closed

    def poll(self) -> bytes | None:
        """The answer; None while there is none. Does not wait.

        Raises:
            NoAnswerError: There will be no answer.
        """
        try:
            reply = self._replies.try_recv()
        except self._closed:
            raise NoAnswerError(absent=True) from None
        if reply is None:
            return None
        if reply.ok is None:
            raise NoAnswerError(absent=False)
        return bytes(reply.ok.payload.to_bytes())


class Node:
    """An open session. Any thread may call its methods.

    Args:
        session: As Zenoh opened it.
        cert: Certificate by which others know this program; empty for none.
    """

    def __init__(self, session: Any, *, cert: str = "") -> None:
        self.cert = cert
        # Zenoh's stubs leave out the types of what ends a session.
        self._session = session
        self._zenoh = _zenoh()
        self._receivers: list[threading.Thread] = []
        # Also at the end of a program that forgets it.
        self._closing = weakref.finalize(self, _close, session, self._zenoh.ZError, self._receivers)

    @property
    def is_closed(self) -> bool:
        """Whether it was closed."""
        return bool(self._session.is_closed())

    @property
    def connections(self) -> int:
        """Number of other programs that this one is connected to: peers and routers."""
        info = self._session.info
        return len(list(info.peers_zid())) + len(list(info.routers_zid()))

    def ask_neighbours(self, timeout: float) -> None:
        """Ask the routers and servers that this program is connected to whether they know it.

        Args:
            timeout: Seconds.

        Raises:
            NoAnswerError: None answers; `absent` if none is silent, but their access control does not know this
                program.
        """
        info = self._session.info
        silent = NoAnswerError(absent=False)
        for neighbour in (*info.routers_zid(), *info.peers_zid()):
            try:
                self.ask(HERE.replace("*", str(neighbour)), b"", timeout)
            except NoAnswerError as none:
                silent = none
            else:
                return
        raise silent

    def answer_neighbours(self) -> None:
        """Answer `ask_neighbours` of those who connect to this program."""
        key = HERE.replace("*", str(self._session.info.zid()))

        self.answer(key, lambda question: question.reply(b""))

    @property
    def routers(self) -> int:
        """Number of routers that this one is connected to."""
        return len(list(self._session.info.routers_zid()))

    def close(self) -> None:
        """Close it; everything declared in it ends."""
        self._closing()

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
        # Receiving in this thread takes half the time of a callback in another one.
        for reply in self._get(key, payload, timeout, urgent):
            if reply.ok is not None:
                return bytes(reply.ok.payload.to_bytes())
            raise NoAnswerError(absent=False)
        raise NoAnswerError(absent=True)

    def question(self, key: str, payload: bytes, timeout: float, *, urgent: bool = False) -> Pending:
        """Ask a question without waiting for its answer; otherwise as `ask`.

        Raises:
            LinkClosedError: The session is closed.
        """
        return Pending(self._get(key, payload, timeout, urgent), self._zenoh.ZError)

    def _get(self, key: str, payload: bytes, timeout: float, urgent: bool) -> Any:
        zenoh = self._zenoh
        extra = {"priority": zenoh.Priority.REAL_TIME, "express": True} if urgent else {"express": True}
        try:
            return self._session.get(
                key,
                payload=payload,
                timeout=timeout,
                congestion_control=zenoh.CongestionControl.BLOCK,
                consolidation=zenoh.ConsolidationMode.NONE,
                **extra,
            )
        except zenoh.ZError as error:
            raise LinkClosedError(f"the session is closed: {str(error)[:200]}") from None

    def answer(self, key: str, on_question: Callable[[Question], object]) -> None:
        """Answer questions; `on_question` gets each in a thread of Zenoh's, and must not wait."""
        self._session.declare_queryable(key, lambda query: on_question(Question(key, query)), complete=True)

    def subscribe(self, key: str, on_sample: Callable[[bytes, str], object]) -> Callable[[], None]:
        """Receive what is published; returns how to end it. A thread of its own passes payload and key."""
        subscriber, lost = self._session.declare_subscriber(key), self._zenoh.ZError

        def receive() -> None:
            # It raises when it is undeclared, or when the session is closed.
            with contextlib.suppress(lost):
                for sample in subscriber:
                    try:
                        on_sample(sample.payload.to_bytes(), str(sample.key_expr))
                    except Exception:  # noqa: BLE001  # logged; the next sample may be right
                        _log.exception("a sample of %s failed", sample.key_expr)

        # Zenoh's own thread for callbacks would keep a program alive that ends without closing the session.
        thread = threading.Thread(target=receive, name=f"receive {key}", daemon=True)
        self._receivers[:] = [*(other for other in self._receivers if other.is_alive()), thread]
        thread.start()

        def undeclare() -> None:
            with contextlib.suppress(lost):
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
        watch = self._session.liveliness().declare_subscriber(
            key, lambda sample: on_change(str(sample.key_expr), sample.kind == put), history=True
        )
        self._watches = [*getattr(self, "_watches", []), watch]


def _close(session: Any, error: type[Exception], receivers: list[threading.Thread]) -> None:
    with contextlib.suppress(error):
        session.close()
    # A thread that comes back from Zenoh into an interpreter that has ended would abort the program.
    for thread in receivers:
        if thread is not threading.current_thread():
            thread.join(_RECEIVING)


def read_access(path: str) -> dict[str, Any]:
    """Read Zenoh's access control from a file in JSON.

    Raises:
        ConfigError: It cannot be read, or is not a table.
    """
    text = read_text(path, largest=LARGEST_DATA)
    rows = {key: item.value for key, item in parse_json(text, path).table(_ACCESS, _ACCESS).items()}
    if rows["enabled"] is not True or rows["default_permission"] != "deny":
        raise ConfigError(f"{path}: access control that is switched off, or allows what no rule names")
    return rows
