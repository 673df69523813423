"""What the page Wire sends and saves over HTTP: files of traffic.

Owns the requests, their checks and bounds. Behind the gate (`guard`), so each comes from a page of this studio.
"""

from __future__ import annotations

import time
from collections.abc import Awaitable, Callable
from typing import TYPE_CHECKING, Any

from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from hexwire.errors import HexwireError, UsageError

from .guard import SESSION
from .sent_files import made, received
from .wire_view import LARGEST_FILE

if TYPE_CHECKING:
    from .app import Studio
    from .page_process import PageProcess
    from .tabs import Tab

__all__ = ["wire_routes"]

_NAME = 80
_NO_TAB = "this page is no longer known to the studio: load it again"
_HEADERS = {"cache-control": "no-store"}


def wire_routes(present: Callable[[], Studio]) -> list[Route]:
    """The routes of the page.

    Args:
        present: The studio.
    """

    def asked(call: Callable[[Studio, Tab, Request], Awaitable[Any]]) -> Callable[[Request], Awaitable[Response]]:
        """An endpoint; an error is an answer, too."""

        async def endpoint(request: Request) -> Response:
            try:
                studio = present()
                found = await call(studio, tab_of(studio, request), request)
            except HexwireError as error:
                return refusal(error)
            return found if isinstance(found, Response) else JSONResponse(found, headers=_HEADERS)

        return endpoint

    return [
        Route("/wire/save", asked(_save)),
        Route("/wire/open", asked(_open), methods=["POST"]),
    ]


def tab_of(studio: Studio, request: Request) -> Tab:
    """The tab that asks; it belongs to the session of the request.

    Raises:
        UsageError: There is no such tab.
    """
    found = studio.tabs.find(request.query_params.get("tab", ""), request.scope[SESSION].key)
    if found is None:
        raise UsageError(_NO_TAB)
    return found


def refusal(error: HexwireError) -> Response:
    """The answer to a request that cannot be carried out. Its status is 200: browsers report others as faults."""
    return JSONResponse({"refused": str(error)}, headers=_HEADERS)


async def _open(studio: Studio, tab: Tab, request: Request) -> Any:
    name = request.query_params.get("name", "")[:_NAME] or "the file"
    series = request.query_params.get("series", "board")
    async with received(request, LARGEST_FILE) as path:
        if path is None:
            raise UsageError(f"the file is larger than {LARGEST_FILE >> 20} MiB")
        await studio.ask_files(
            tab.right, lambda process: process.ask("wire_open", tab.key, str(path), name, series)
        )
    tab.file = True
    return {"opened": name}


async def _save(studio: Studio, tab: Tab, request: Request) -> Any:
    form = request.query_params.get("form", "")

    def save(process: PageProcess, path: str) -> None:
        if not (tab.file and process.ask("wire_save", path, tab.key, form)):
            process.ask("traffic", path, *studio.wire.kept(), form)

    async def make(path: str) -> None:
        await studio.ask_files(tab.right, lambda process: save(process, path))

    return await made(make, "application/octet-stream", f"traffic-{time.strftime('%Y%m%d-%H%M%S')}.{form}")
