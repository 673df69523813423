"""What the fleet page asks for, over HTTP: the arms, a stop, opening one in this studio.

Owns the requests and their checks. Behind the gate (`guard`), so each comes from a page of this studio. Must not
know how arms are found or stopped.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from hexwire.errors import HexwireError, UsageError

from .guard import SESSION
from .wire_api import refusal, tab_of

if TYPE_CHECKING:
    from hexwire.control.loop.power import Stopped

    from .app import Studio

__all__ = ["fleet_routes"]

_HEADERS = {"cache-control": "no-store"}


def fleet_routes(present: Callable[[], Studio]) -> list[Route]:
    """The routes of the page.

    Args:
        present: The studio.
    """

    def asked(call: Callable[[Studio, Request], Any]) -> Callable[[Request], Response]:
        def endpoint(request: Request) -> Response:
            try:
                return JSONResponse(call(present(), request), headers=_HEADERS)
            except HexwireError as error:
                return refusal(error)

        return endpoint

    async def stop(request: Request) -> Response:
        # In the loop: threads that wait for arms would be too few for a burst, which is one stop.
        try:
            done = await _stop(present(), request)
        except HexwireError as error:
            return refusal(error)
        return JSONResponse([{**asdict(row), "line": str(row)} for row in done], headers=_HEADERS)

    return [
        Route("/fleet/arms", asked(lambda studio, _: studio.arms())),
        Route("/fleet/stop", stop, methods=["POST"]),
        Route("/fleet/open", asked(_open), methods=["POST"]),
    ]


async def _stop(studio: Studio, request: Request) -> list[Stopped]:
    """Stop one shared arm, what is open here, or all; whoever sees the page may do this.

    Of the shared arms it stops those that the studio's certificate allows.
    """
    asked = request.query_params
    name, own, every = asked.get("name"), asked.get("own") == "1", asked.get("all") == "1"
    if (name is not None) + own + every != 1:
        raise UsageError("nothing was stopped: name an arm, or say all")
    # Of a page that the studio has forgotten, too: a stop is never refused for that.
    tab = studio.tabs.find(request.query_params.get("tab", ""), request.scope[SESSION].key)
    who = tab.name if tab is not None else "the studio"
    if name is not None:
        return await studio.fleet.stop(name, who)
    return await (studio.stop_all(who) if every else studio.stop_own(who))


def _open(studio: Studio, request: Request) -> Any:
    """Open an arm in place of what is open; it must be one that was seen, and no address from elsewhere."""
    tab = tab_of(studio, request)
    url = studio.fleet.known(request.query_params.get("name", ""))
    studio.open(tab, url)
    return {"opened": url}
