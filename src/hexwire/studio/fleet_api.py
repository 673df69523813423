"""What the fleet page asks for, over HTTP: the arms, a stop, opening one in this studio.

Owns the requests and their checks. Behind the gate (`guard`), so each comes from a page of this studio. Must not
know how arms are found or stopped.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from hexwire.errors import HexwireError, UsageError

from .guard import SESSION
from .wire_api import refusal, tab_of

if TYPE_CHECKING:
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

    return [
        Route("/fleet/arms", asked(lambda studio, _: studio.fleet.look())),
        Route("/fleet/stop", asked(_stop), methods=["POST"]),
        Route("/fleet/open", asked(_open), methods=["POST"]),
    ]


def _stop(studio: Studio, request: Request) -> Any:
    """Stop one arm, or all; whoever sees the page may do this, as far as the studio's certificate allows."""
    name = request.query_params.get("name")
    if (name is None) == (request.query_params.get("all") != "1"):
        raise UsageError("nothing was stopped: name an arm, or say all")
    # Of a page that the studio has forgotten, too: a stop is never refused for that.
    tab = studio.tabs.find(request.query_params.get("tab", ""), request.scope[SESSION].key)
    return studio.fleet.stop(name, tab.name if tab is not None else "the studio")


def _open(studio: Studio, request: Request) -> Any:
    """Open an arm in place of what is open; it must be one that was seen, and no address from elsewhere."""
    tab = tab_of(studio, request)
    url = studio.fleet.known(request.query_params.get("name", ""))
    studio.open(tab, url)
    return {"opened": url}
