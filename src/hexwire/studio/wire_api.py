"""What the wire page asks for, over HTTP: rows, one frame, files in and out.

Owns the requests, their checks and bounds. Behind the gate (`guard`), so each comes from a page of this studio.
Must not know how traffic is read.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import TYPE_CHECKING, Any

from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from hexwire.errors import HexwireError, UsageError
from hexwire.trace.saving import FORMATS

from .guard import SESSION
from .wire_feed import LARGEST_FILE

if TYPE_CHECKING:
    from .app import Studio
    from .tabs import Tab

__all__ = ["wire_routes"]

_LARGEST_NUMBER = 2**53
_NAME = 80
_NO_TAB = "this page is no longer known to the studio: load it again"
_HEADERS = {"cache-control": "no-store"}


def wire_routes(present: Callable[[], Studio]) -> list[Route]:
    """The routes of the page.

    Args:
        present: The studio.
    """

    def asked(call: Callable[[Studio, str, Request], Any]) -> Callable[[Request], Awaitable[Response]]:
        """An endpoint, which computes in turn with others; an error is an answer, too."""

        async def endpoint(request: Request) -> Response:
            try:
                studio = present()
                tab = tab_of(studio, request)
                found = await studio.compute(tab.right, lambda: call(studio, tab.key, request))
            except HexwireError as error:
                return refusal(error)
            return found if isinstance(found, Response) else JSONResponse(found, headers=_HEADERS)

        return endpoint

    async def open_file(request: Request) -> Response:
        right = request.scope[SESSION].right
        try:
            studio = present()
            tab = tab_of(studio, request)
            data = bytearray()
            async for part in request.stream():
                data += part
                if len(data) > LARGEST_FILE:
                    raise UsageError(f"the file is larger than {LARGEST_FILE >> 20} MiB")
            name = request.query_params.get("name", "")[:_NAME] or "the file"
            series = request.query_params.get("series", "board")
            await studio.compute(
                right, lambda: studio.wire.open_file(tab.key, bytes(data), name, series, right=right)
            )
        except HexwireError as error:
            return refusal(error)
        return JSONResponse({"opened": name}, headers=_HEADERS)

    return [
        Route("/wire/rows", asked(_rows)),
        Route("/wire/frame", asked(_frame)),
        Route("/wire/save", asked(_save)),
        Route("/wire/open", open_file, methods=["POST"]),
        Route("/wire/live", asked(_live), methods=["POST"]),
        Route("/wire/series", asked(_series), methods=["POST"]),
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


def _number(request: Request, name: str) -> int:
    text = request.query_params.get(name, "0")
    if not (text.isascii() and text.isdigit() and len(text) < 17 and int(text) < _LARGEST_NUMBER):
        raise UsageError(f"{name} is not a number")
    return int(text)


def _rows(studio: Studio, tab: str, request: Request) -> Any:
    return studio.wire.rows(tab, _number(request, "since"), request.query_params.get("filter", ""))


def _frame(studio: Studio, tab: str, request: Request) -> Any:
    return studio.wire.frame(tab, _number(request, "number"))


def _save(studio: Studio, tab: str, request: Request) -> Response:
    form = request.query_params.get("form", "")
    data = studio.wire.saved(tab, form)
    assert form in FORMATS
    name = f'attachment; filename="traffic.{form}"'
    return Response(data, media_type="application/octet-stream", headers={"content-disposition": name, **_HEADERS})


def _live(studio: Studio, tab: str, request: Request) -> Any:
    studio.wire.close_file(tab)
    return {"view": "live"}


def _series(studio: Studio, tab: str, request: Request) -> Any:
    series = request.query_params.get("series", "")
    studio.wire.set_series(tab, series)
    return {"series": series}
