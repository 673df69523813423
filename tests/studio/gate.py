"""A browser behind the studio's gate, for the tests of what it is served."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from hexwire.studio.access import BrowserSession, Right
from hexwire.studio.app import Studio
from hexwire.studio.guard import SESSION

if TYPE_CHECKING:
    from starlette.routing import BaseRoute


class GatedClient:
    """`right` is what its session may do."""

    def __init__(self, studio: Studio, routes: list[BaseRoute]) -> None:
        from starlette.applications import Starlette
        from starlette.testclient import TestClient

        self.studio, self.right = studio, Right.OPERATE
        app = Starlette(routes=routes)

        async def served(scope: Any, receive: Any, send: Any) -> None:
            scope[SESSION] = BrowserSession("key", self.right, 0.0)
            await app(scope, receive, send)

        self.http = TestClient(served)
