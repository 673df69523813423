"""The stop of shared arms, and of all arms, over HTTP: neither the socket of a page nor another request delays it.

Owns the request and its checks. Behind the gate (`guard`), so each comes from a page of this studio. Must not know
how arms are found or stopped.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from typing import TYPE_CHECKING

from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from hexwire.errors import HexwireError, UsageError

from .guard import SESSION
from .wire_api import refusal

if TYPE_CHECKING:
    from hexwire.control.loop.power import Stopped

    from .app import Studio

__all__ = ["fleet_routes"]

_HEADERS = {"cache-control": "no-store"}


def fleet_routes(present: Callable[[], Studio]) -> list[Route]:
    """The route of the page.

    Args:
        present: The studio.
    """

    async def stop(request: Request) -> Response:
        # In the loop: threads that wait for arms would be too few for a burst, which is one stop.
        try:
            done = await _stop(present(), request)
        except HexwireError as error:
            return refusal(error)
        return JSONResponse([{**asdict(row), "line": str(row)} for row in done], headers=_HEADERS)

    return [Route("/fleet/stop", stop, methods=["POST"])]


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
