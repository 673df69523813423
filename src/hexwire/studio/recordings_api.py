"""What the recordings page asks for: the list, and what is done with recordings.

Owns the requests and the check of every value. Behind the gate; whatever changes something needs the right to
operate, and nothing here moves a real arm.
"""

from __future__ import annotations

import functools
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import asdict
from typing import TYPE_CHECKING, Any, cast

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from hexwire.control.requests.preview import check_factor
from hexwire.errors import HexwireError, UsageError
from hexwire.inputs import Item, parse_json
from hexwire.model.state import LONGEST

from .access import WATCHING_ONLY, Right
from .guard import SESSION
from .wire_api import refusal

if TYPE_CHECKING:
    from .app import Studio
    from .page_process import PageProcess

__all__ = ["recordings_routes"]

_PLAIN = {"Cache-Control": "no-store"}
_MOST = 4096
"""Bytes of a request."""
_Order = Mapping[str, Item]


def recordings_routes(present: Callable[[], Studio]) -> list[Route]:
    """The routes of the page.

    Args:
        present: The studio that is served now.
    """

    async def _answered(found: Awaitable[dict[str, Any] | bytes]) -> Response:
        try:
            answer = await found
        except HexwireError as error:
            return refusal(error)
        except OSError as error:
            return refusal(UsageError(f"the folder of recordings failed: {error.strerror or error}"))
        if isinstance(answer, bytes):
            return Response(answer, 200, _PLAIN, "application/json")
        return JSONResponse(answer, headers=_PLAIN)

    async def listed(request: Request) -> Response:
        studio = present()
        return await _answered(studio.ask_files(request.scope[SESSION].right, lambda one: _listed(studio, one)))

    async def done(request: Request) -> Response:
        if request.scope[SESSION].right < Right.OPERATE:
            return JSONResponse({"refused": WATCHING_ONLY}, 403, _PLAIN)
        body = bytearray()
        async for part in request.stream():
            body += part
            if len(body) > _MOST:
                return JSONResponse({"refused": "this is too large"}, 413, _PLAIN)
        return await _answered(_done(present(), request.scope[SESSION].right, bytes(body)))

    async def geometry(request: Request) -> Response:
        studio, robot = present(), request.query_params.get("robot", "")
        right = request.scope[SESSION].right
        return await _answered(studio.ask_files(right, lambda process: _geometry(studio, process, robot)))

    return [
        Route("/data/recordings", listed),
        Route("/data/recordings", done, methods=["POST"]),
        Route("/data/geometry", geometry),
    ]


def _listed(studio: Studio, process: PageProcess) -> bytes:
    recordings, arm = studio.recordings, studio.source.arm
    state = recordings.recorder.state
    rest = {
        "folder": str(recordings.library.folder),
        "largest": recordings.library.largest,
        "recorder": asdict(state),
        "twin": {**asdict(recordings.twin.state), "busy": recordings.twin.busy},
        "cameras": list(studio.cameras.rows),
        "robot": arm.settings.model.name if arm is not None else "",
    }
    joints = arm.settings.model.names if arm is not None else None
    return cast("bytes", process.ask("listed", state.name, joints, rest))


def _geometry(studio: Studio, process: PageProcess, robot: str) -> bytes:
    """The shapes of the open arm, or of one that can be emulated; None if its lengths are unknown."""
    arm = studio.source.arm
    if arm is not None and arm.settings.model.name == robot:
        return cast("bytes", process.ask("geometry", arm.settings.model, arm.settings.links))
    return cast("bytes", process.ask("geometry_of", robot))


async def _done(studio: Studio, right: Right, body: bytes) -> dict[str, Any]:
    """Carry an order out."""
    order = parse_json(body).table(needed=("do",))
    what = order["do"].choice(("recover", "preview", *_ORDERS))
    if what == "recover":
        name = _name(order)
        return {"name": await studio.ask_files(right, lambda process: process.ask("recover", name))}
    if what == "preview":
        return await studio.compute(right, functools.partial(_preview, studio, order))
    return await run_in_threadpool(_ORDERS[what], studio, order)


def _record(studio: Studio, order: _Order) -> dict[str, Any]:
    cameras = studio.cameras.rows.values() if "cameras" in order and order["cameras"].flag() else ()
    return {"name": studio.recordings.recorder.start(studio.source.need_arm(), cameras)}


def _end(studio: Studio, order: _Order) -> dict[str, Any]:
    return {"said": studio.recordings.recorder.stop()}


def _remove(studio: Studio, order: _Order) -> dict[str, Any]:
    studio.recordings.library.remove(_name(order))
    return {}


def _preview(studio: Studio, order: _Order) -> dict[str, Any]:
    """What playing it on the open arm would be; nothing moves."""
    arm = studio.source.need_arm()
    taught = studio.recordings.taught(_name(order), _topic(order), arm.settings.model.names)
    begin, end, factor = _part(order)
    args: dict[str, object] = {"what": "play", "begin": begin, "factor": factor}
    if end < LONGEST:
        args["end"] = end
    plan = arm.motions.preview(args, taught=taught)
    return {
        "duration": plan.duration,
        "lead_in": plan.lead_in,
        "refusal": plan.refusal or plan.unready,
        "fits": plan.fits,
    }


def _twin(studio: Studio, order: _Order) -> dict[str, Any]:
    """Play it on an emulated arm."""
    name, topic, recordings = _name(order), _topic(order), studio.recordings
    robot = recordings.twin_of(name)
    if not robot:
        raise UsageError(f"there is no emulated arm with the joints of {name}")
    begin, end, factor = _part(order)
    # The table of the open arm is the twin's, too.
    arm = studio.source.arm
    table = arm.settings.table if arm is not None else 0.0
    recordings.twin.play(
        robot,
        name,
        lambda joints: recordings.taught(name, topic, joints),
        begin=begin,
        end=end,
        factor=factor,
        settings={"check_table": False} if table is None else {"table_height": table},
    )
    return asdict(recordings.twin.state)


def _twin_stop(studio: Studio, order: _Order) -> dict[str, Any]:
    studio.recordings.twin.stop("stopped")
    return {}


def _name(order: _Order) -> str:
    if "name" not in order:
        raise UsageError("name a recording")
    return order["name"].text()


def _topic(order: _Order) -> str | None:
    return order["topic"].text() or None if "topic" in order else None


def _part(order: _Order) -> tuple[float, float, float]:
    """First and last second, and the factor of the speed."""
    begin = order["begin"].number(0.0, unit="s") if "begin" in order else 0.0
    end = order["end"].number(0.0, unit="s") if "end" in order else LONGEST
    factor = check_factor(order["factor"].number()) if "factor" in order else 1.0
    if begin >= end:
        raise UsageError("the part to play must end after its beginning")
    return begin, end, factor


_ORDERS: dict[str, Callable[[Studio, _Order], dict[str, Any]]] = {
    "record": _record,
    "end": _end,
    "remove": _remove,
    "twin": _twin,
    "twin_stop": _twin_stop,
}
"""What only needs a thread."""
