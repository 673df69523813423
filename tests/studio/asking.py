"""Requests to routes and calls of the studio without a server: what they answer to whom."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Sequence
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any
from urllib.parse import urlencode

from starlette.routing import BaseRoute, Router

from hexwire.studio.access import BrowserSession
from hexwire.studio.guard import SESSION
from hexwire.studio.live import _Call

if TYPE_CHECKING:
    from hexwire.studio.app import Studio
    from hexwire.studio.tabs import Tab

__all__ = ["Asker", "answer_of"]


def answer_of(studio: Studio, tab: Tab, name: str, args: dict[str, Any]) -> dict[str, Any]:
    """What a page hears of its call: its ``value``, or its ``error`` in words."""
    told = list[str]()
    line: Any = SimpleNamespace(tab=tab, put=told.append)
    asyncio.run(studio.live._answer(line, _Call(1, name, args)))
    return dict(json.loads(told[0]))


class Asker:
    """Asks as a session.

    Args:
        routes: What answers.
        session: Who asks.
    """

    def __init__(self, routes: Sequence[BaseRoute], session: BrowserSession) -> None:
        self._router, self._session = Router(routes), session

    def raw(self, path: str, method: str = "GET", body: Sequence[bytes] = (), **query: object) -> tuple[int, bytes]:
        """Status and body of the answer to a request whose body comes in these pieces, taken from a list."""
        pieces = body if isinstance(body, list) else list(body)
        return asyncio.run(self._ask(path, method, pieces, urlencode(query).encode()))

    def together(self, path: str, method: str, queries: Sequence[dict[str, object]]) -> list[Any]:
        """The answers to requests that are there at the same time."""

        async def ask() -> list[tuple[int, bytes]]:
            return await asyncio.gather(
                *(self._ask(path, method, [], urlencode(query).encode()) for query in queries)
            )

        return [json.loads(data) for _, data in asyncio.run(ask())]

    def __call__(self, path: str, method: str = "GET", body: Sequence[bytes] = (), **query: object) -> Any:
        """The answer, from JSON."""
        status, data = self.raw(path, method, body, **query)
        assert status == 200, data
        return json.loads(data)

    async def _ask(self, path: str, method: str, body: list[bytes], query: bytes) -> tuple[int, bytes]:
        status, answer, ended = 0, b"", False

        async def receive() -> dict[str, Any]:
            nonlocal ended
            if ended:
                # The browser stays.
                await asyncio.Event().wait()
            piece = body.pop(0) if body else b""
            ended = not body
            return {"type": "http.request", "body": piece, "more_body": bool(body)}

        async def send(message: Any) -> None:
            nonlocal status, answer
            status = message.get("status", status)
            answer += message.get("body", b"")

        scope = {
            "type": "http",
            "method": method,
            "path": path,
            "query_string": query,
            "headers": [],
            SESSION: self._session,
        }
        await self._router(scope, receive, send)
        return status, answer
