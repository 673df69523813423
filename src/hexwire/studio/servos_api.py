"""What the page Servos sends over HTTP: files of backups and calibrations, which are too large for the live socket.

Owns the requests and their bounds. Behind the gate (`guard`), so each comes from a page of this studio. Must not
know what is in a file.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import TYPE_CHECKING, Any

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from hexwire.errors import HexwireError, LeaseError, LinkLostError, UsageError

from .access import WATCHING_ONLY, Right
from .calls import Asked
from .servos.backup import LARGEST, keep
from .servos.calibration_run import loaded
from .wire_api import refusal, tab_of

if TYPE_CHECKING:
    from .app import Studio

__all__ = ["servos_routes"]

_Load = Callable[["Studio", Request], Awaitable[dict[str, Any]]]
_CALIBRATION = 256 * 1024
"""Bytes of a file of a calibration."""


def servos_routes(present: Callable[[], Studio]) -> list[Route]:
    """The routes of the page.

    Args:
        present: The studio.
    """

    def taken(load: _Load) -> Callable[[Request], Awaitable[Response]]:
        async def endpoint(request: Request) -> Response:
            try:
                return JSONResponse(await load(present(), request), headers={"cache-control": "no-store"})
            except HexwireError as error:
                return refusal(error)

        return endpoint

    return [
        Route("/servos/backup", taken(_load_backup), methods=["POST"]),
        Route("/servos/calibration", taken(_load_calibration), methods=["POST"]),
    ]


async def _load_backup(studio: Studio, request: Request) -> dict[str, Any]:
    asked, data = await _sent(studio, request, LARGEST, Right.OPERATE)
    return {"servos": await run_in_threadpool(keep, asked, data)}


async def _load_calibration(studio: Studio, request: Request) -> dict[str, Any]:
    asked, data = await _sent(studio, request, _CALIBRATION, Right.WATCH)
    name, arm = (request.query_params.get(key, "") for key in ("name", "arm"))
    return await run_in_threadpool(loaded, asked, name, data, arm)


async def _sent(studio: Studio, request: Request, most: int, right: Right) -> tuple[Asked, bytes]:
    """Who sends a file, and what is in it."""
    tab = tab_of(studio, request)
    if tab.right < right:
        raise LeaseError(WATCHING_ONLY)
    data = bytearray()
    async for part in request.stream():
        data += part
        if len(data) > most:
            raise UsageError(f"the file is larger than {most >> 10} KiB")
    if request.query_params.get("opened") != str(studio.source.opened):
        raise LinkLostError("what this page shows was closed; load the page again")
    return Asked(studio, tab, studio.source.present, None), bytes(data)
