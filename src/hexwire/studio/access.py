"""Who may use the studio: tokens, sessions, and where a request may come from.

Owns the rules. Pure: time comes in as `now`, and requests as plain values. Must not know sockets, ASGI or pages.
"""

from __future__ import annotations

import hmac
import secrets
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import IntEnum

__all__ = ["COOKIE", "SHORTEST_PASSWORD", "WATCHING_ONLY", "Access", "BrowserSession", "Limits", "Right"]

COOKIE = "hexwire_session"
"""Start of the name of the cookie; the port is added, since browsers share cookies between ports."""
SHORTEST_PASSWORD = 12
"""Characters."""
WATCHING_ONLY = "this address is for watching only; open the other one that hexwire studio has printed"
"""Why something is refused that needs `Right.OPERATE`."""
_ATTEMPTS, _ATTEMPT_PERIOD = 5, 2.0
"""Passwords that may be tried at once, and seconds until another one may be."""

_FORMER = 256
"""Sessions that have ended whose pages may stop the arm."""


class Right(IntEnum):
    """What a session may do. Everybody may stop the arm."""

    WATCH = 1
    OPERATE = 2


@dataclass(frozen=True, slots=True)
class Limits:
    """Bounds for what comes from outside.

    Attributes:
        message: Bytes of one message on a socket.
        head: Bytes of the head of a request that is not complete.
        body: Bytes of the body of a request; pages that take uploads bound them themselves, below this.
        sockets: Sockets at a time, of those who may operate and again of those who may only watch; each open page
            has one.
        session_sockets: Sockets of one session at a time.
        requests: Requests of one session that are served at a time; a browser makes six. Further ones wait, but not
            those that stop something.
        waiting: Requests of one session in all; further ones are refused.
        uploads: Files that are taken at a time, of those who may operate and again of those who may only watch.
        connections: Connections at a time that have not become a socket.
        sessions: Sessions at a time.
        session_age: Seconds without a request or message after which a session ends.
        request: Seconds that a connection may take to send the head of its first request.
        patience: Seconds that a socket may take to accept a message.
    """

    message: int = 64 * 1024
    head: int = 64 * 1024
    body: int = 64 * 1024 * 1024
    sockets: int = 64
    session_sockets: int = 24
    requests: int = 8
    waiting: int = 48
    uploads: int = 4
    connections: int = 128
    sessions: int = 96
    session_age: float = 12 * 3600.0
    request: float = 10.0
    patience: float = 5.0


@dataclass(slots=True)
class BrowserSession:
    """A browser that has shown a token.

    Attributes:
        key: Value of its cookie.
        right: What it may do.
        seen: Its last request, seconds.
    """

    key: str
    right: Right
    seen: float


def _new_secret() -> str:
    return secrets.token_urlsafe(32)


@dataclass(slots=True)
class Access:
    """The rules of one studio. Not thread-safe: the loop of the server calls it.

    Args:
        hosts: Values of the Host header that name this studio, such as ``127.0.0.1:8080``.
        secure: It is reached over TLS.
        password: Whoever knows it may take control; empty for none.
        origins: Other pages that may watch by a token, such as ``https://app.foxglove.dev``.
        limits: The bounds.
        new_secret: Makes what nobody can guess.

    Attributes:
        operate_token: Token of the URL that lets its reader take control.
        watch_token: Token of the URL that only lets its reader watch.
    """

    hosts: frozenset[str]
    secure: bool = False
    password: str = field(default="", repr=False)
    origins: frozenset[str] = frozenset()
    limits: Limits = field(default_factory=Limits)
    new_secret: Callable[[], str] = _new_secret
    operate_token: str = field(default="", repr=False)
    watch_token: str = field(default="", repr=False)
    _sessions: dict[str, BrowserSession] = field(default_factory=dict, repr=False)
    _former: dict[str, None] = field(default_factory=dict, repr=False)
    """Keys of sessions that have ended, oldest first."""
    _tries: float = _ATTEMPTS
    _tried: float = 0.0

    def __post_init__(self) -> None:
        self.operate_token = self.operate_token or self.new_secret()
        self.watch_token = self.watch_token or self.new_secret()

    @property
    def scheme(self) -> str:
        """``https`` or ``http``."""
        return "https" if self.secure else "http"

    def allows_host(self, host: str) -> bool:
        """Whether a Host header names this studio; another name may lead here by DNS rebinding."""
        return host.lower() in self.hosts

    def allows_origin(self, origin: str | None, host: str, *, needed: bool) -> bool:
        """Whether a request comes from a page of this studio.

        Args:
            origin: The Origin header, or None.
            host: The Host header, which is allowed.
            needed: A request without Origin is refused, as for sockets and for whatever changes something.
        """
        if origin is None:
            return not needed
        return origin.lower() == f"{self.scheme}://{host.lower()}"

    def may_watch(self, token: str, origin: str | None, host: str) -> bool:
        """Whether a socket for watching only may begin, of a program that keeps no cookie.

        Args:
            token: What it shows.
            origin: The Origin header; None of a program that is no browser.
            host: The Host header, which is allowed.
        """
        known = self.allows_origin(origin, host, needed=False) or (origin or "").lower() in self.origins
        return known and self._right_of(token) is not None

    @property
    def cookie(self) -> str:
        """Name of the cookie: two studios on one host must not overwrite each other's."""
        port = min(self.hosts, default="").rpartition(":")[2]
        return f"{COOKIE}_{port}"

    def enter(self, token: str, now: float) -> BrowserSession | None:
        """Begin a session for a token; None if it is not valid, or if there are too many sessions."""
        right = self._right_of(token)
        return None if right is None else self.admit(right, now)

    def _right_of(self, token: str) -> Right | None:
        found = None
        for value, granted in ((self.operate_token, Right.OPERATE), (self.watch_token, Right.WATCH)):
            if hmac.compare_digest(token.encode(), value.encode()):
                found = granted
        return found

    def log_in(self, password: str, now: float) -> BrowserSession | None:
        """Begin a session for the password; None if it is wrong, or if too many were tried in a short time."""
        self._tries = min(float(_ATTEMPTS), self._tries + (now - self._tried) / _ATTEMPT_PERIOD)
        self._tried = now
        if not self.password or self._tries < 1.0:
            return None
        self._tries -= 1.0
        if not hmac.compare_digest(password.encode(), self.password.encode()):
            return None
        return self.admit(Right.OPERATE, now)

    def admit(self, right: Right, now: float) -> BrowserSession | None:
        """Begin a session; the caller has checked who asks for it.

        If there are too many, the one that was idle longest ends, but none with more rights than the new one: a
        watcher must not push out an operator. None if no session can end.
        """
        self._expire(now)
        if len(self._sessions) >= self.limits.sessions:
            others = [session for session in self._sessions.values() if session.right <= right]
            if not others:
                return None
            self.leave(min(others, key=lambda session: (session.right, session.seen)).key)
        session = BrowserSession(self.new_secret(), right, now)
        self._sessions[session.key] = session
        return session

    def session(self, key: str | None, now: float) -> BrowserSession | None:
        """The session of a cookie, which counts as a sign of life; None if there is none."""
        self._expire(now)
        found = self._sessions.get(key) if key else None
        if found is not None:
            found.seen = now
        return found

    def may_stop(self, key: str | None) -> bool:
        """Whether a cookie is that of a session that has ended: the STOP of its page must still work."""
        return key in self._former

    def leave(self, key: str) -> None:
        """End a session."""
        if self._sessions.pop(key, None) is not None:
            self._former[key] = None
            if len(self._former) > _FORMER:
                del self._former[next(iter(self._former))]

    def end_all(self) -> None:
        """End all sessions, for good."""
        self._sessions.clear()
        self._former.clear()

    def _expire(self, now: float) -> None:
        old = [s.key for s in self._sessions.values() if now - s.seen > self.limits.session_age]
        for key in old:
            self.leave(key)
