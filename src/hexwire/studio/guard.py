"""The gate before everything that the studio serves: HTTP requests and sockets.

Owns applying the rules of access, the exchange of a token for a session, and the headers of every answer. Must not
know what is served behind it.
"""

from __future__ import annotations

import asyncio
import re
import secrets
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from html import escape
from http.cookies import CookieError, SimpleCookie
from typing import TYPE_CHECKING, Any, Self, TypeVar
from urllib.parse import parse_qs, quote

from .access import Access, Right, Session

if TYPE_CHECKING:
    from starlette.types import ASGIApp, Message, Receive, Scope, Send

__all__ = ["PEER", "SESSION", "Guard"]

SESSION = "hexwire.session"
"""Key of the scope of a request, with its `Session`."""
PEER = "hexwire.peer"
"""Key of the scope of a request, with the `Right` of the client certificate that was verified, or None."""

_K = TypeVar("_K")
_STOPS = frozenset({"/stop", "/fleet/stop"})
"""Paths that are never refused for what else is under way."""
_UPLOADS = frozenset({("POST", "/wire/open"), ("POST", "/data/recording")})
_NO_PAGES = ("/static/", "/_nicegui", "/data/", "/wire/", "/fleet/", "/favicon.ico")
"""What the addresses begin with that are no pages."""
_PAUSE = 0.01
"""Seconds between two turns at what keeps the loop of the server busy: a STOP that comes meanwhile goes first."""
_SAFE = frozenset({"GET", "HEAD", "OPTIONS"})
_POLICY = (
    "default-src 'self'; script-src 'self' 'unsafe-eval'{}; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data: blob:; font-src 'self' data:; connect-src 'self'; worker-src 'self' blob:; "
    "object-src 'none'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
)
"""Vue compiles templates in the browser and NiceGUI sends it scripts, hence 'unsafe-eval'. The scripts in NiceGUI's
pages get a nonce, so that a script in a text from elsewhere, such as the name of a servo, does not run."""
_CSP = b"content-security-policy"
_SCRIPT = re.compile(rb"<script(?=[\s>])")
_HEADERS = (
    (_CSP, _POLICY.format("").encode()),
    (b"referrer-policy", b"no-referrer"),
    (b"x-content-type-options", b"nosniff"),
    (b"x-frame-options", b"DENY"),
    (b"cross-origin-opener-policy", b"same-origin"),
    (b"cross-origin-resource-policy", b"same-origin"),
)
_NO_SESSION = "Open the address that hexwire studio has printed: it contains the key to this page."
_FORWARD = (
    '<!doctype html><html lang="en"><head><meta charset="utf-8"><title>hexwire studio</title>'
    '<meta http-equiv="refresh" content="0;url={}"></head><body><p><a href="{}">Continue</a></p></body></html>'
)
"""Not a redirection: on one that began at another page, browsers would not send the cookie, which is strict."""
_LOG_IN = (
    '<!doctype html><html lang="en"><head><meta charset="utf-8"><title>hexwire studio</title>'
    '<meta name="viewport" content="width=device-width"></head><body><main><h1>hexwire studio</h1>'
    '<form method="post" action="/login"><label>Password <input type="password" name="password" required autofocus '
    'autocomplete="current-password"></label> <button>Log in</button></form><p>{}</p></main></body></html>'
)
_LOG_IN_BODY = 4096
_POLLING = "/_nicegui_ws"


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
        # The loop builds pages and takes what is uploaded: of each right so many at a time, whatever is asked for.
        self._pages = {right: asyncio.Semaphore(access.limits.pages) for right in Right}
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
        if scope["path"].startswith(_POLLING):
            # Its sockets are bounded and watched; long polling would be a second way.
            await _answer(send, 400, "This is for sockets only.")
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
            async with asked.turns, _Turn(self._turns_for(scope, session.right)) as turn:
                await self.app(scope, bounded, _Secured(turn.ends_with(send)).send)
        finally:
            asked.count -= 1
            if not asked.count:
                del self._requests[session.key]

    def _turns_for(self, scope: Scope, right: Right) -> asyncio.Semaphore | None:
        if (scope["method"], scope["path"]) in _UPLOADS:
            return self._uploads[right]
        return None if scope["path"].startswith(_NO_PAGES) else self._pages[right]

    async def _enter(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer somebody who has no session yet, or shows a token."""
        access, now = self.access, self._clock()
        token = parse_qs(scope["query_string"].decode("latin-1")).get("token", [""])[0]
        if token and scope["method"] == "GET":
            session, refusal = access.enter(token, now), "This key is not valid. " + _NO_SESSION
        elif scope.get(PEER) is not None:
            session, refusal = access.admit(scope[PEER], now), "There are too many sessions."
        elif access.password and scope["path"] == "/login" and scope["method"] == "POST":
            password = parse_qs((await _body(receive, _LOG_IN_BODY)).decode("latin-1")).get("password", [""])[0]
            session = access.log_in(password, now)
            refusal = "That is not the password, or it was tried too often; wait a moment."
            if session is None:
                await _answer(send, 403, _LOG_IN.format(refusal), kind=b"text/html")
                return
        elif access.password:
            await _answer(send, 401, _LOG_IN.format(""), kind=b"text/html")
            return
        else:
            await _answer(send, 401, _NO_SESSION)
            return
        if session is None:
            await _answer(send, 403, refusal)
            return
        path = "/" if scope["path"] == "/login" else escape(quote("/" + scope["path"].lstrip("/\\")))
        await _answer(send, 200, _FORWARD.format(path, path), self._cookie(session), kind=b"text/html")

    async def _socket(self, scope: Scope, receive: Receive, send: Send) -> None:
        host, origin, cookies = _headers(scope)
        access = self.access
        session = access.session(cookies.get(access.cookie), self._clock())
        right = access.allows_host(host) and access.allows_origin(origin, host, needed=True)
        if not right or session is None or self._has_most_sockets(session):
            await receive()
            await send({"type": "websocket.close", "code": 1008, "reason": "not allowed"})
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

    def _has_most_sockets(self, session: Session) -> bool:
        count, limits = self._sockets, self.access.limits
        return count[session.key] >= limits.session_sockets or count[session.right] >= limits.sockets

    def _cookie(self, session: Session) -> tuple[bytes, bytes]:
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
    """Adds the headers to an answer, and the nonce to the scripts of a page.

    Args:
        send: Sends to the browser.
    """

    def __init__(self, send: Send) -> None:
        self._send = send
        self._page: Message | None = None
        self._body = b""

    async def send(self, message: Message) -> None:
        """Send a message of the application."""
        if message["type"] == "http.response.start":
            kept = [row for row in message.get("headers", ()) if row[0].lower() not in dict(_HEADERS)]
            message["headers"] = [*kept, *_HEADERS]
            kind = dict(kept).get(b"content-type", b"")
            if kind.startswith(b"text/html"):
                self._page = message
                return
        elif self._page is not None:
            self._body += message.get("body", b"")
            if message.get("more_body"):
                return
            await self._send_page(self._page)
            self._page = None
            return
        await self._send(message)

    async def _send_page(self, start: Message) -> None:
        nonce = secrets.token_urlsafe(16)
        body = _SCRIPT.sub(f'<script nonce="{nonce}"'.encode(), self._body)
        policy = _POLICY.format(f" 'nonce-{nonce}'").encode()
        rows = [row for row in start["headers"] if row[0].lower() not in (_CSP, b"content-length")]
        length = (b"content-length", str(len(body)).encode())
        await self._send({**start, "headers": [*rows, (_CSP, policy), length]})
        await self._send({"type": "http.response.body", "body": body})


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
