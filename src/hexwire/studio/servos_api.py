"""What the page Servos sends over HTTP: a file of backups, which is too large for the live socket.

Owns the request and its bounds. Behind the gate (`guard`), so each comes from a page of this studio. Must not know
what a backup is.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from hexwire.errors import HexwireError, LeaseError, LinkLostError, UsageError

from .access import WATCHING_ONLY, Right
from .calls import Asked
from .servos.backup import LARGEST, keep
from .wire_api import refusal, tab_of

if TYPE_CHECKING:
    from .app import Studio

__all__ = ["servos_routes"]


def servos_routes(present: Callable[[], Studio]) -> list[Route]:
    """The route of the page.

    Args:
        present: The studio.
    """

    async def load(request: Request) -> Response:
        try:
            return JSONResponse({"servos": await _load(present(), request)}, headers={"cache-control": "no-store"})
        except HexwireError as error:
            return refusal(error)

    return [Route("/servos/backup", load, methods=["POST"])]


async def _load(studio: Studio, request: Request) -> list[int]:
    tab = tab_of(studio, request)
    if tab.right < Right.OPERATE:
        raise LeaseError(WATCHING_ONLY)
    data = bytearray()
    async for part in request.stream():
        data += part
        if len(data) > LARGEST:
            raise UsageError(f"the file is larger than {LARGEST >> 20} MiB")
    if request.query_params.get("opened") != str(studio.source.opened):
        raise LinkLostError("this servo bus was closed; load the page again")
    asked = Asked(studio, tab, studio.source.present, None)
    return await run_in_threadpool(keep, asked, bytes(data))
