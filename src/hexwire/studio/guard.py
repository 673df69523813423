"""The gate before everything that the studio serves: HTTP requests and sockets.

Owns applying the rules of access, the exchange of a token for a session, and the headers of every answer. Must not
know what is served behind it.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from http.cookies import CookieError, SimpleCookie
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qs

from .access import COOKIE, Access, Session

if TYPE_CHECKING:
    from starlette.types import ASGIApp, Message, Receive, Scope, Send

__all__ = ["SESSION", "Guard"]

SESSION = "hexwire.session"
"""Key of the scope of a request, with its `Session`."""

_SAFE = frozenset({"GET", "HEAD", "OPTIONS"})
_POLICY = (
    "default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data: blob:; font-src 'self' data:; connect-src 'self'; worker-src 'self' blob:; "
    "object-src 'none'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
)
"""NiceGUI builds its pages with scripts in the page and Vue compiles templates in the browser, hence 'unsafe-*'."""
_HEADERS = (
    (b"content-security-policy", _POLICY.encode()),
    (b"referrer-policy", b"no-referrer"),
    (b"x-content-type-options", b"nosniff"),
    (b"x-frame-options", b"DENY"),
    (b"cross-origin-opener-policy", b"same-origin"),
    (b"cross-origin-resource-policy", b"same-origin"),
)
_NO_SESSION = "Open the address that hexwire studio has printed: it contains the key to this page."


class Guard:
    """An ASGI application around another one.

    Args:
        app: What is served to those who may see it.
        access: The rules.
        clock: Seconds.
    """

    def __init__(self, app: ASGIApp, access: Access, clock: Callable[[], float] = time.monotonic) -> None:
        self.app, self.access, self._clock = app, access, clock
        self.sockets = 0

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
        now = self._clock()
        token = parse_qs(scope["query_string"].decode("latin-1")).get("token", [""])[0]
        if token and scope["method"] == "GET":
            session = access.enter(token, now)
            if session is None:
                await _answer(send, 403, "This key is not valid. " + _NO_SESSION)
                return
            await _answer(send, 303, "", (b"location", scope["path"].encode()), self._cookie(session))
            return
        session = access.session(cookies.get(self._cookie_name), now)
        if session is None:
            await _answer(send, 401, _NO_SESSION)
            return
        scope[SESSION] = session

        async def secured(message: Message) -> None:
            if message["type"] == "http.response.start":
                kept = [row for row in message.get("headers", ()) if row[0].lower() not in dict(_HEADERS)]
                message["headers"] = [*kept, *_HEADERS]
            await send(message)

        await self.app(scope, receive, secured)

    async def _socket(self, scope: Scope, receive: Receive, send: Send) -> None:
        host, origin, cookies = _headers(scope)
        access = self.access
        session = access.session(cookies.get(self._cookie_name), self._clock())
        right = access.allows_host(host) and access.allows_origin(origin, host, needed=True)
        if not right or session is None or self.sockets >= access.limits.sockets:
            await receive()
            await send({"type": "websocket.close", "code": 1008, "reason": "not allowed"})
            return
        scope[SESSION] = session
        self.sockets += 1
        try:
            await self.app(scope, receive, send)
        finally:
            self.sockets -= 1

    @property
    def _cookie_name(self) -> str:
        # Browsers share cookies between the ports of a host: two studios must not overwrite each other's.
        port = next(iter(self.access.hosts)).rpartition(":")[2]
        return f"{COOKIE}_{port}"

    def _cookie(self, session: Session) -> tuple[bytes, bytes]:
        secure = "; Secure" if self.access.secure else ""
        value = f"{self._cookie_name}={session.key}; Path=/; HttpOnly; SameSite=Strict{secure}"
        return b"set-cookie", value.encode()


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


async def _answer(send: Send, status: int, text: str, *headers: tuple[bytes, bytes]) -> None:
    plain = (b"content-type", b"text/plain; charset=utf-8")
    rows: list[Any] = [plain, (b"cache-control", b"no-store"), *_HEADERS, *headers]
    await send({"type": "http.response.start", "status": status, "headers": rows})
    await send({"type": "http.response.body", "body": text.encode()})
