"""The gate before everything that the studio serves: HTTP requests and sockets.

Owns applying the rules of access, the exchange of a token for a session, and the headers of every answer.
"""

from __future__ import annotations

import asyncio
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from html import escape
from http.cookies import CookieError, SimpleCookie
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self, TypeVar
from urllib.parse import parse_qs, quote

from .access import Access, BrowserSession, Right

if TYPE_CHECKING:
    from starlette.types import ASGIApp, Message, Receive, Scope, Send

__all__ = ["PEER", "SESSION", "Guard"]

SESSION = "hexwire.session"
"""Key of the scope of a request, with its `BrowserSession`."""
PEER = "hexwire.peer"
"""Key of the state of a connection, with the `Right` of the client certificate that was verified, or None."""

_K = TypeVar("_K")
_STOPS = frozenset({"/stop", "/fleet/stop"})
"""Paths that are never refused for what else is under way."""
_BY_TOKEN = frozenset({"/foxglove"})
"""Sockets for watching only, of programs that keep no cookie: each shows its token."""
_UPLOADS = frozenset({("POST", "/wire/open"), ("POST", "/data/recording"), ("POST", "/servos/backup")})
_PAUSE = 0.01
"""Seconds between two turns at what keeps the loop of the server busy: a STOP that comes meanwhile goes first."""
_SAFE = frozenset({"GET", "HEAD", "OPTIONS"})
_POLICY = (
    b"default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; connect-src 'self'; "
    b"base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
)
"""A script in a text from elsewhere, such as the name of a servo, does not run."""
_HEADERS = (
    (b"content-security-policy", _POLICY),
    (b"referrer-policy", b"no-referrer"),
    (b"x-content-type-options", b"nosniff"),
    (b"x-frame-options", b"DENY"),
    (b"cross-origin-opener-policy", b"same-origin"),
    (b"cross-origin-resource-policy", b"same-origin"),
)
_NO_SESSION = "Open the address that hexwire studio has printed: it contains the key to this page."
_GATE = Path(__file__).parent / "gate"
_FORWARD = (_GATE / "forward.html").read_text(encoding="utf-8")
"""Not a redirection: on one that began at another page, browsers would not send the cookie, which is strict."""
_LOG_IN = (_GATE / "login.html").read_text(encoding="utf-8")
_LOG_IN_BODY = 4096


class Guard:
    """An ASGI application around another one.

    Args:
        app: What is served to those who may see it.
        access: The rules.
        clock: Seconds.
    """

    def __init__(self, app: ASGIApp, access: Access, clock: Callable[[], float] = time.monotonic) -> None:
        self.app, self.access, self._clock = app, access, clock
        # What is under way, by session; of sockets also by right, so that watchers take none of an operator's.
        self._requests: dict[str, _Requests] = {}
        self._sockets: Counter[str | Right] = Counter()
        # The loop takes what is uploaded: of each right so many files at a time.
        self._uploads = {right: asyncio.Semaphore(access.limits.uploads) for right in Right}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request or socket."""
        if scope["type"] == "http":
            await self._http(scope, receive, send)
        elif scope["type"] == "websocket":
            await self._socket(scope, receive, send)
        else:
            await self.app(scope, receive, send)

    async def _http(self, scope: Scope, receive: Receive, send: Send) -> None:
        host, origin, cookies = _headers(scope)
        access = self.access
        if not access.allows_host(host):
            await _answer(send, 421, "This address is not one of this studio.")
            return
        if not access.allows_origin(origin, host, needed=scope["method"] not in _SAFE):
            await _answer(send, 403, "This request comes from another page.")
            return
        if _length(scope) > access.limits.body:
            await _answer(send, 413, "This is too large.")
            return
        key = cookies.get(access.cookie)
        session = access.session(key, self._clock())
        if session is None and (scope["method"], scope["path"]) == ("POST", "/stop") and access.may_stop(key):
            await self.app(scope, receive, _Secured(send).send)
            return
        if session is None or b"token=" in scope["query_string"]:
            await self._enter(scope, receive, send)
            return
        scope[SESSION] = session
        left = access.limits.body

        async def bounded() -> Message:
            nonlocal left
            message = await receive()
            left -= len(message.get("body", b""))
            # What has no length in its head is as bounded as what has.
            return {"type": "http.disconnect"} if left < 0 else message

        if scope["path"] in _STOPS:
            await self.app(scope, bounded, _Secured(send).send)
            return
        asked = self._requests.setdefault(session.key, _Requests(asyncio.Semaphore(access.limits.requests)))
        if asked.count >= access.limits.waiting:
            await _answer(send, 429, "This browser asks for too much at a time; try again.")
            return
        asked.count += 1
        try:
            upload = (scope["method"], scope["path"]) in _UPLOADS
            async with asked.turns, _Turn(self._uploads[session.right] if upload else None) as turn:
                await self.app(scope, bounded, _Secured(turn.ends_with(send)).send)
        finally:
            asked.count -= 1
            if not asked.count:
                del self._requests[session.key]

    async def _enter(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer somebody who has no session yet, or shows a token."""
        access, now = self.access, self._clock()
        token = _token(scope)
        if token and scope["method"] == "GET":
            session, refusal = access.enter(token, now), "This key is not valid. " + _NO_SESSION
        elif (right := scope.get("state", {}).get(PEER)) is not None:
            session, refusal = access.admit(right, now), "There are too many sessions."
        elif access.password and scope["path"] == "/login" and scope["method"] == "POST":
            password = parse_qs((await _body(receive, _LOG_IN_BODY)).decode("latin-1")).get("password", [""])[0]
            session = access.log_in(password, now)
            refusal = "That is not the password, or it was tried too often; wait a moment."
            if session is None:
                await _answer(send, 403, _LOG_IN.replace("{refusal}", refusal), kind=b"text/html")
                return
        elif access.password:
            await _answer(send, 401, _LOG_IN.replace("{refusal}", ""), kind=b"text/html")
            return
        else:
            await _answer(send, 401, _NO_SESSION)
            return
        if session is None:
            await _answer(send, 403, refusal)
            return
        path = "/" if scope["path"] == "/login" else escape(quote("/" + scope["path"].lstrip("/\\")))
        await _answer(send, 200, _FORWARD.replace("{path}", path), self._cookie(session), kind=b"text/html")

    async def _socket(self, scope: Scope, receive: Receive, send: Send) -> None:
        host, origin, cookies = _headers(scope)
        access = self.access
        if scope["path"] in _BY_TOKEN:
            token = _token(scope)
            if access.allows_host(host) and access.may_watch(token, origin, host):
                await self.app(scope, receive, send)
            else:
                await _refuse_socket(receive, send)
            return
        session = access.session(cookies.get(access.cookie), self._clock())
        right = access.allows_host(host) and access.allows_origin(origin, host, needed=True)
        if not right or session is None or self._has_most_sockets(session):
            await _refuse_socket(receive, send)
            return
        scope[SESSION] = session

        async def of_session() -> Message:
            message = await receive()
            if message["type"] == "websocket.receive" and access.session(session.key, self._clock()) is None:
                await send({"type": "websocket.close", "code": 1008, "reason": "the session has ended"})
                return {"type": "websocket.disconnect", "code": 1008}
            return message

        with _counted(self._sockets, session.key, session.right):
            await self.app(scope, of_session, send)

    def _has_most_sockets(self, session: BrowserSession) -> bool:
        count, limits = self._sockets, self.access.limits
        return count[session.key] >= limits.session_sockets or count[session.right] >= limits.sockets

    def _cookie(self, session: BrowserSession) -> tuple[bytes, bytes]:
        secure = "; Secure" if self.access.secure else ""
        value = f"{self.access.cookie}={session.key}; Path=/; HttpOnly; SameSite=Strict{secure}"
        return b"set-cookie", value.encode()


@dataclass(slots=True)
class _Requests:
    """Those of a session: how many are there, and the turns of those that are served."""

    turns: asyncio.Semaphore
    count: int = 0


class _Turn:
    """A turn at what takes long. It ends when the answer begins: whoever reads that slowly keeps nobody waiting.

    Args:
        turns: As many as there are; None for no limit.
    """

    def __init__(self, turns: asyncio.Semaphore | None) -> None:
        self._turns, self._held = turns, False

    async def __aenter__(self) -> Self:
        if self._turns is not None:
            await self._turns.acquire()
            self._held = True
        return self

    async def __aexit__(self, *_: object) -> None:
        self._end()

    def ends_with(self, send: Send) -> Send:
        """Send, and end the turn."""

        async def sent(message: Message) -> None:
            self._end()
            await send(message)

        return sent

    def _end(self) -> None:
        if self._held and self._turns is not None:
            self._held = False
            asyncio.get_running_loop().call_later(_PAUSE, self._turns.release)


@contextmanager
def _counted(counts: Counter[_K], *keys: _K) -> Iterator[None]:
    """Something is under way."""
    counts.update(keys)
    try:
        yield
    finally:
        for key in keys:
            counts[key] -= 1
            if not counts[key]:
                del counts[key]


class _Secured:
    """Adds the headers to an answer.

    Args:
        send: Sends to the browser.
    """

    def __init__(self, send: Send) -> None:
        self._send = send

    async def send(self, message: Message) -> None:
        """Send a message of the application."""
        if message["type"] == "http.response.start":
            kept = [row for row in message.get("headers", ()) if row[0].lower() not in dict(_HEADERS)]
            message["headers"] = [*kept, *_HEADERS]
        await self._send(message)


def _headers(scope: Scope) -> tuple[str, str | None, dict[str, str]]:
    """Host, Origin and cookies of a request; a header that is given twice counts as none that is allowed."""
    rows: dict[bytes, list[bytes]] = {}
    for name, value in scope["headers"]:
        rows.setdefault(name, []).append(value)
    hosts, origins = rows.get(b"host", []), rows.get(b"origin", [])
    host = hosts[0].decode("latin-1") if len(hosts) == 1 else ""
    origin = None if not origins else origins[0].decode("latin-1") if len(origins) == 1 else ""
    jar: SimpleCookie = SimpleCookie()
    try:
        for value in rows.get(b"cookie", []):
            jar.load(value.decode("latin-1"))
    except CookieError:
        return host, origin, {}
    return host, origin, {name: morsel.value for name, morsel in jar.items()}


def _token(scope: Scope) -> str:
    """What a request shows in its address; empty if nothing."""
    query: bytes = scope["query_string"]
    return parse_qs(query.decode("latin-1")).get("token", [""])[0]


async def _refuse_socket(receive: Receive, send: Send) -> None:
    await receive()
    await send({"type": "websocket.close", "code": 1008, "reason": "not allowed"})


def _length(scope: Scope) -> float:
    for name, value in scope["headers"]:
        if name == b"content-length":
            return int(value) if value.isdigit() else float("inf")
    return 0


async def _body(receive: Receive, most: int) -> bytes:
    """The body of a request; empty if it is longer than it may be."""
    data = b""
    while len(data) <= most:
        message = await receive()
        data += message.get("body", b"")
        if not message.get("more_body"):
            return data if len(data) <= most else b""
    return b""


async def _answer(
    send: Send, status: int, text: str, *headers: tuple[bytes, bytes], kind: bytes = b"text/plain"
) -> None:
    said = (b"content-type", kind + b"; charset=utf-8")
    rows: list[Any] = [said, (b"cache-control", b"no-store"), *_HEADERS, *headers]
    await send({"type": "http.response.start", "status": status, "headers": rows})
    await send({"type": "http.response.body", "body": text.encode()})
