"""The Zenoh session of a ROS 2 node: set up as `rmw_zenoh` does it, and what a node declares in it.

Owns Zenoh's settings and objects. The only module of this room that imports Zenoh. Must not know messages, names,
nor what a token says.
"""

from __future__ import annotations

import contextlib
import json
import logging
import math
import re
import threading
import time
import weakref
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from .errors import (
    RouterNotFoundError,
    SessionClosedError,
    SessionError,
    UsageError,
)
from .qos import History, Qos, Reliability

__all__ = ["LISTEN", "Request", "Session", "ZenohSettings", "endpoints_in", "load_zenoh", "open_router"]

_log = logging.getLogger(__name__)

_HEARTBEAT = 0.5
"""Seconds between two checks for lost samples, as in `rmw_zenoh`."""
_RETRY = {"period_init_ms": 250, "period_max_ms": 1000, "period_increase_factor": 2}
_ROUTER = "tcp/localhost:7447"
LISTEN = "tcp/localhost:0"
"""Where a node of a machine waits for others of it: any port."""
_HERE = re.compile(r"(tcp|udp)/(localhost|127(\.[0-9]{1,3}){3}|\[::1\]):[0-9]+|unixsock-stream/.*", re.ASCII)
_STUCK = 20.0
"""Seconds for which an answer waits for a client that takes nothing; then its connection is closed. One that is
silent for 10 s ends before: the other side notices that and connects again, while it never would otherwise."""
_ENDING = 5.0
"""Seconds for a thread of a session to end with it."""
_MATCHED = 0.05
"""Seconds for which it is known whether anybody subscribes."""
_LARGEST = 16 * 1024 * 1024
"""Most bytes of a message, so that no sender can fill the memory; `rmw_zenoh` takes 1 GiB."""
_AGAIN = 1.0
"""Seconds between two attempts to open a session."""
_SAID = 10
"""Attempts after which it is said again that the router is missing."""
# A value may have semicolons of its own.
_OVERRIDES = re.compile(r"""(?:[^;"']|"[^"]*"|'[^']*')+""")
_QUERY = 600_000
"""Time-out for requests, milliseconds, as in `rmw_zenoh`."""

Received = Callable[[bytes, bytes | None], object]
"""Gets payload and attachment."""
Published = tuple[Callable[[bytes, bytes], None], Callable[[], bool], Callable[[], None]]
"""What `Session.publisher` returns."""


def load_zenoh() -> Any:
    """Zenoh's module, which takes long to load."""
    import zenoh.ext

    return zenoh


@dataclass(frozen=True, slots=True)
class ZenohSettings:
    """How a session is set up.

    Nodes of this machine learn of each other from the router and connect directly, as with `rmw_zenoh`. Where the
    router is another machine's, all passes through it.

    A subclass may add settings of its own in `rows`, and look at more before a session is opened.

    Attributes:
        connect: Endpoints of routers.
        listen: Where other nodes of this machine may connect.
        attempts: Seconds to wait for a router, as ZENOH_ROUTER_CHECK_ATTEMPTS: 0 for no limit, less for not even
            looking for one. None: a second if the router is this machine's, which may come later; else no limit.
        config_file: Settings of Zenoh in JSON5 that replace all of these, as ZENOH_SESSION_CONFIG_URI.
        overrides: Single settings of Zenoh and their values in JSON5, as ZENOH_CONFIG_OVERRIDE.
    """

    connect: tuple[str, ...] = (_ROUTER,)
    listen: tuple[str, ...] | None = None
    attempts: int | None = None
    config_file: str = ""
    overrides: tuple[tuple[str, str], ...] = ()

    @classmethod
    def from_environment(cls, environment: Mapping[str, str], **more: Any) -> Self:
        """The settings that `rmw_zenoh` takes from environment variables.

        Args:
            environment: The variables.
            more: Other attributes.

        Raises:
            UsageError: One of them is not valid.
        """
        file = environment.get("ZENOH_SESSION_CONFIG_URI", "").removeprefix("file://")
        attempts = environment.get("ZENOH_ROUTER_CHECK_ATTEMPTS", "")
        if attempts:
            if not re.fullmatch(r"-?[0-9]{1,9}", attempts, re.ASCII):
                raise UsageError(f"ZENOH_ROUTER_CHECK_ATTEMPTS is not a whole number: {attempts[:80]!r}")
            more["attempts"] = int(attempts)
        overrides = []
        for row in _OVERRIDES.findall(environment.get("ZENOH_CONFIG_OVERRIDE", "")):
            name, _, value = (part.strip() for part in row.partition("="))
            if not (name and value):
                raise UsageError(f"ZENOH_CONFIG_OVERRIDE has the form KEY=VALUE;KEY=VALUE, not {row[:80]!r}")
            overrides.append((name.replace(".", "/"), value))
        return cls(config_file=file, overrides=tuple(overrides), **more)

    @property
    def is_local(self) -> bool:
        """Whether it connects to routers of this machine only."""
        return all(_HERE.fullmatch(each) for each in self.connect)

    def rows(self) -> dict[str, Any]:
        """Zenoh's settings: `rmw_zenoh`'s defaults with these."""
        listen = self.listen if self.listen is not None else (LISTEN,) if self.is_local else ()
        return {
            # A router relays nothing between peers.
            "mode": "peer" if self.is_local else "client",
            "connect/endpoints": list(self.connect),
            "connect/timeout_ms": {"router": -1, "peer": -1, "client": 0},
            "connect/exit_on_failure": {"router": False, "peer": False, "client": True},
            "connect/retry": _RETRY,
            "listen/endpoints": list(listen),
            "listen/timeout_ms": 0,
            "listen/exit_on_failure": True,
            "scouting/multicast/enabled": False,
            "scouting/gossip/enabled": True,
            "scouting/gossip/target": {"router": ["router", "peer"], "peer": ["router"]},
            "scouting/gossip/autoconnect": {"router": [], "peer": ["router", "peer"]},
            "scouting/gossip/autoconnect_strategy": {"peer": {"to_router": "always", "to_peer": "greater-zid"}},
            "timestamping/enabled": {"router": True, "peer": True, "client": True},
            "queries_default_timeout": _QUERY,
            "adminspace/enabled": False,
            "transport/shared_memory/enabled": False,
            "transport/link/tx/queue/congestion_control/block/wait_before_close": round(1e6 * _STUCK),
            "transport/link/rx/max_message_size": _LARGEST,
        }

    def open(self, missing: Callable[[str], object] = lambda why: None) -> Session:
        """Open a session. With a router of this machine it connects in the background; always again after a loss.

        Args:
            missing: Called now and then while it waits for the router of another machine, with the reason.

        Raises:
            UsageError: The file of settings cannot be used.
            RouterNotFoundError: There is no router in the given time.
            SessionError: It cannot listen.
            UsageError: Zenoh or `check` refuses a setting.
        """
        zenoh = load_zenoh()
        zenoh.init_log_from_env_or("off")
        self.check()
        config = self._config(zenoh)
        tries = 0
        while True:
            try:
                # Zenoh changes the settings that it opens.
                session = zenoh.open(self._config(zenoh))
                return Session(session, endpoints_in(config, "connect"), self.opened(session))
            except zenoh.ZError as error:
                if json.loads(config.get_json("mode")) != "client":
                    raise SessionError(f"cannot open a Zenoh session: {_first_line(error)}") from None
            tries += 1
            if tries == (self.attempts or 0):
                raise RouterNotFoundError(self._why_unreachable(config))
            if tries % _SAID == 1:
                missing(self._why_unreachable(config))
            time.sleep(_AGAIN)

    def check(self) -> None:
        """Check what Zenoh would not, before a session is opened; nothing here.

        Raises:
            UsageError: A setting cannot be used.
        """

    def opened(self, session: Any) -> Sequence[threading.Thread]:
        """Look at a session that was opened; nothing here.

        Args:
            session: Zenoh's.

        Returns:
            Threads that end with the session, and for which its `close` waits.
        """
        return ()

    def read_config_file(self) -> str:
        """The text of `config_file`.

        Raises:
            UsageError: It cannot be read.
        """
        try:
            return Path(self.config_file).read_text(encoding="utf-8")
        except (OSError, UnicodeError) as error:
            why = error.strerror if isinstance(error, OSError) else "not UTF-8 text"
            raise UsageError(f"{self.config_file} cannot be read: {why}") from None

    @property
    def how_to_start_a_router(self) -> str:
        """What to do without a router, for the log."""
        return "start one with `ros2 run rmw_zenoh_cpp rmw_zenohd` or `python -m zenoh_ros2`"

    def why_unreachable(self, endpoint: str) -> str:
        """Why the router at an endpoint cannot be reached, in one line."""
        return f"nobody answers at {endpoint}; is the router running, and the address right?"

    def check_replaced(self, config: Any) -> None:
        """Look at the settings that `config_file` and `overrides` have made; nothing here.

        Args:
            config: A ``zenoh.Config``.
        """

    def _why_unreachable(self, config: Any) -> str:
        return "; ".join(self.why_unreachable(each) for each in endpoints_in(config, "connect"))

    def _config(self, zenoh: Any) -> Any:
        rows = [(key, json.dumps(value)) for key, value in self.rows().items()]
        config = zenoh.Config()
        if self.config_file:
            rows = []
            try:
                config = zenoh.Config.from_json5(self.read_config_file())
            except zenoh.ZError as error:
                why = _first_line(error)
                raise UsageError(f"{self.config_file}: Invalid configuration file: {why}") from None
        for key, value in (*rows, *self.overrides):
            try:
                config.insert_json5(key, value)
            except zenoh.ZError as error:
                where = "ZENOH_CONFIG_OVERRIDE: " if (key, value) in self.overrides else ""
                why = "its value is not JSON5" if "Json5Err" in str(error) else _first_line(error)
                raise UsageError(f"{where}{key[:80]} is not a setting of Zenoh: {why}") from None
        if self.config_file or self.overrides:
            self.check_replaced(config)
        return config


def open_router(listen: str) -> Session:
    """Open a session that is a router for nodes, until it is closed.

    Args:
        listen: The endpoint where nodes connect.

    Raises:
        SessionError: It cannot listen there.
    """
    zenoh = load_zenoh()
    zenoh.init_log_from_env_or("off")
    config = zenoh.Config()
    rows = ZenohSettings(connect=(), listen=(listen,)).rows() | {"mode": "router"}
    # It passes on what others take.
    del rows["transport/link/rx/max_message_size"]
    try:
        for key, value in rows.items():
            config.insert_json5(key, json.dumps(value))
        return Session(zenoh.open(config))
    except zenoh.ZError as error:
        raise SessionError(f"there can be no router at {listen}: {_first_line(error)}") from None


def endpoints_in(config: Any, kind: str) -> tuple[str, ...]:
    """All endpoints in Zenoh's settings, whose form depends on who wrote them.

    Args:
        config: A ``zenoh.Config``.
        kind: ``connect`` or ``listen``.
    """

    def flat(value: Any) -> Iterator[str]:
        if isinstance(value, str):
            yield value
        elif isinstance(value, list | dict):
            for each in value.values() if isinstance(value, dict) else value:
                yield from flat(each)

    return tuple(flat(json.loads(config.get_json(f"{kind}/endpoints"))))


def _first_line(error: Exception) -> str:
    """What Zenoh says, without the places in its source."""
    return re.sub(r" at /\S*", "", str(error).partition("\n")[0])[:300].strip()


class Request:
    """A request that arrived at a service."""

    def __init__(self, key: str, query: Any) -> None:
        self._key, self._query = key, query

    @property
    def payload(self) -> bytes:
        """Its bytes."""
        return _bytes(self._query.payload) or b""

    @property
    def attachment(self) -> bytes | None:
        """What stands beside it."""
        return _bytes(self._query.attachment)

    def reply(self, payload: bytes, attachment: bytes) -> None:
        """Answer it, once. Whoever asked may have ended."""
        with contextlib.suppress(Exception):
            self._query.reply(self._key, payload, attachment=attachment)
        self.drop()

    def fail(self, reason: str) -> None:
        """Say why there is no answer."""
        with contextlib.suppress(Exception):
            self._query.reply_err(reason.encode())
        self.drop()

    def drop(self) -> None:
        """Do not answer."""
        with contextlib.suppress(Exception):
            self._query.drop()


class Session:
    """An open session. Any thread may call it; what it calls runs in Zenoh's threads and must not wait.

    Attributes:
        endpoints: Where routers are expected.
    """

    def __init__(
        self, session: Any, endpoints: tuple[str, ...] = (), threads: Sequence[threading.Thread] = ()
    ) -> None:
        self._session = session
        self.endpoints = endpoints
        self._zenoh = load_zenoh()
        self._closing = weakref.finalize(self, _close, session, self._zenoh.ZError, threads)

    @property
    def zid(self) -> str:
        """Its id."""
        return str(self._session.zid())

    @property
    def routers(self) -> int:
        """Number of routers that it is connected to."""
        with contextlib.suppress(self._zenoh.ZError):
            return len(list(self._session.info.routers_zid()))
        return 0

    @property
    def is_closed(self) -> bool:
        """Whether it was closed."""
        return bool(self._session.is_closed())

    def close(self) -> None:
        """Close it; everything declared in it ends."""
        self._closing()

    def publisher(self, key: str, qos: Qos) -> Published:
        """Declare a publisher.

        Returns:
            A function that publishes payload and attachment, one that says whether anybody subscribes, and one
            that undeclares the publisher. Publishing waits for a slow receiver only with `RELIABLE` and `KEEP_ALL`.
        """
        zenoh, options = self._zenoh, {}
        reliable = qos.reliability is not Reliability.BEST_EFFORT
        keeps_all = reliable and qos.history is History.KEEP_ALL
        if qos.latched:
            options["cache"] = zenoh.ext.CacheConfig(max_samples=max(1, qos.depth))
            options["publisher_detection"] = True
            if reliable:
                options["sample_miss_detection"] = zenoh.ext.MissDetectionConfig(
                    heartbeat=None, sporadic_heartbeat=_HEARTBEAT
                )
        options["congestion_control"] = zenoh.CongestionControl.BLOCK if keeps_all else zenoh.CongestionControl.DROP
        options["reliability"] = zenoh.Reliability.RELIABLE if reliable else zenoh.Reliability.BEST_EFFORT
        with self._lost():
            if qos.latched:
                publisher = zenoh.ext.declare_advanced_publisher(self._session, key, **options)
            else:
                publisher = self._session.declare_publisher(key, **options)

        def put(payload: bytes, attachment: bytes) -> None:
            try:
                publisher.put(payload, attachment=attachment)
            except zenoh.ZError:
                _log.debug("the session is closed; nothing is published at %s", key)

        asked, reached = -math.inf, False

        def matched() -> bool:
            # Asking takes half as long as publishing, and a node may ask a thousand times a second.
            nonlocal asked, reached
            if (now := time.monotonic()) - asked >= _MATCHED:
                try:
                    asked, reached = now, bool(publisher.matching_status.matching)
                except zenoh.ZError:
                    reached = False
            return reached

        # A latched message is kept for those who come later.
        return put, (lambda: True) if qos.latched else matched, self._ending(publisher)

    def subscribe(self, key: str, qos: Qos, received: Received) -> Callable[[], None]:
        """Declare a subscription; returns a function that ends it."""
        zenoh, options = self._zenoh, {}
        if qos.latched:
            options["history"] = zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=max(1, qos.depth))
            options["subscriber_detection"] = True
            if qos.reliability is not Reliability.BEST_EFFORT:
                options["recovery"] = zenoh.ext.RecoveryConfig(periodic_queries=None, heartbeat=True)

        def arrived(sample: Any) -> None:
            received(_bytes(sample.payload) or b"", _bytes(sample.attachment))

        with self._lost():
            return self._ending(
                zenoh.ext.declare_advanced_subscriber(self._session, key, self._direct(arrived), **options)
            )

    def answer(self, key: str, asked: Callable[[Request], object]) -> Callable[[], None]:
        """Declare a service; returns a function that ends it."""
        with self._lost():
            return self._ending(
                self._session.declare_queryable(
                    key, self._direct(lambda query: asked(Request(key, query))), complete=True
                )
            )

    def ask(
        self, key: str, payload: bytes, attachment: bytes, timeout: float
    ) -> Iterator[tuple[bytes, bytes | None]]:
        """Ask a service; gives payload and attachment of each answer until none is left or the time is over."""
        zenoh = self._zenoh
        with self._lost():
            replies = self._session.get(
                key,
                payload=payload,
                attachment=attachment,
                timeout=timeout,
                target=zenoh.QueryTarget.ALL_COMPLETE,
                consolidation=zenoh.ConsolidationMode.NONE,
                congestion_control=zenoh.CongestionControl.BLOCK,
            )
        for reply in replies:
            if reply.ok is not None:
                yield _bytes(reply.ok.payload) or b"", _bytes(reply.ok.attachment)

    def declare_token(self, key: str) -> Callable[[], None]:
        """Show a liveliness token; returns a function that takes it back."""
        with self._lost():
            return self._ending(self._session.liveliness().declare_token(key))

    def watch_tokens(self, pattern: str, changed: Callable[[str, bool], object]) -> Callable[[], None]:
        """Call a function with each token that is there, appears (True) or vanishes (False); returns its end."""
        put = self._zenoh.SampleKind.PUT

        def arrived(sample: Any) -> None:
            changed(str(sample.key_expr), sample.kind == put)

        with self._lost():
            return self._ending(
                self._session.liveliness().declare_subscriber(pattern, self._direct(arrived), history=True)
            )

    def _direct(self, function: Callable[[Any], object]) -> Any:
        # Zenoh's own threads for callbacks would keep a program alive that ends without closing the session.
        def guarded(item: Any) -> None:
            try:
                function(item)
            except Exception:  # noqa: BLE001  # logged; the next one may be right
                _log.exception("a message failed")

        return self._zenoh.handlers.Callback(guarded, indirect=False)

    def _ending(self, declared: Any) -> Callable[[], None]:
        lock, lost = threading.Lock(), self._zenoh.ZError

        def end() -> None:
            with lock, contextlib.suppress(lost):
                declared.undeclare()

        return end

    @contextlib.contextmanager
    def _lost(self) -> Iterator[None]:
        try:
            yield
        except self._zenoh.ZError as error:
            raise SessionClosedError(f"the Zenoh session is closed: {_first_line(error)}") from None


def _bytes(data: Any) -> bytes | None:
    return None if data is None else bytes(data.to_bytes())


def _close(session: Any, error: type[Exception], threads: Sequence[threading.Thread]) -> None:
    with contextlib.suppress(error):
        session.close()
    # A thread that comes back from Zenoh into an interpreter that has ended would abort the program.
    for thread in threads:
        if thread is not threading.current_thread():
            thread.join(_ENDING)
