"""What the recordings page asks for: the list, and what is done with recordings.

Owns the requests and the check of every value. Behind the gate; whatever changes something needs the right to
operate, and nothing here moves a real arm. Must not know how the page shows it.
"""

from __future__ import annotations

import functools
import json
import math
from collections.abc import Callable
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from hexwire.control.preview import PLAY_FACTORS
from hexwire.drivers.registry import load_driver
from hexwire.errors import HexwireError, UsageError
from hexwire.model.state import LONGEST, finite

from .access import WATCHING_ONLY, Right
from .geometry import make_geometry
from .guard import SESSION
from .twin import TWINS
from .wire_api import refusal

if TYPE_CHECKING:
    from hexwire.model.arm import ArmModel

    from .app import Studio

__all__ = ["shelf_routes"]

_PLAIN = {"Cache-Control": "no-store"}
_COMPUTES = frozenset({"preview", "recover"})
_MOST = 4096
"""Bytes of a request."""


def shelf_routes(present: Callable[[], Studio]) -> list[Route]:
    """The routes of the page.

    Args:
        present: The studio that is served now.
    """

    async def _answered(request: Request, call: Callable[[], dict[str, Any]], *, computes: bool) -> Response:
        try:
            if computes:
                found = await present().compute(request.scope[SESSION].right, call)
            else:
                found = await run_in_threadpool(call)
        except HexwireError as error:
            return refusal(error)
        except OSError as error:
            return refusal(UsageError(f"the folder of recordings failed: {error.strerror or error}"))
        return JSONResponse(found, headers=_PLAIN)

    async def listed(request: Request) -> Response:
        return await _answered(request, lambda: _listed(present()), computes=True)

    async def done(request: Request) -> Response:
        if request.scope[SESSION].right < Right.OPERATE:
            return JSONResponse({"refused": WATCHING_ONLY}, 403, _PLAIN)
        body = bytearray()
        async for part in request.stream():
            body += part
            if len(body) > _MOST:
                return JSONResponse({"refused": "this is too large"}, 413, _PLAIN)
        try:
            call, computes = _done(present(), bytes(body))
        except HexwireError as error:
            return refusal(error)
        return await _answered(request, call, computes=computes)

    async def geometry(request: Request) -> Response:
        robot = request.query_params.get("robot", "")
        return await _answered(request, lambda: {"geometry": _geometry(present(), robot)}, computes=True)

    return [
        Route("/data/recordings", listed),
        Route("/data/recordings", done, methods=["POST"]),
        Route("/data/geometry", geometry),
    ]


def _listed(studio: Studio) -> dict[str, Any]:
    shelf, arm = studio.shelf, studio.source.arm
    joints = arm.settings.model.names if arm is not None else ()
    state = shelf.recorder.state
    # What is being written is not damaged.
    rows = [asdict(one) for one in shelf.library.entries(without=state.name)]
    for row in rows:
        unknown = [name for name in row["joints"] if name not in joints]
        row["fits"] = bool(row["joints"]) and arm is not None and not unknown
        row["twin"] = twin_for(row["robot"], row["joints"])
    return {
        "folder": str(shelf.library.folder),
        "remark": shelf.library.remark,
        "largest": shelf.library.largest,
        "entries": rows,
        "recorder": asdict(state),
        "twin": {**asdict(shelf.twin.state), "busy": shelf.twin.busy},
        "robot": arm.settings.model.name if arm is not None else "",
    }


def twin_for(robot: str, joints: tuple[str, ...]) -> str:
    """The emulated arm that can play a recording; empty if there is none."""
    if robot in TWINS:
        return robot
    return next((name for name in TWINS if joints and set(joints) <= _joints_of(name)), "")


@functools.cache
def _model_of(robot: str) -> ArmModel:
    return load_driver(robot).from_url(f"sim://{robot}").model


def _joints_of(robot: str) -> frozenset[str]:
    return frozenset(_model_of(robot).names)


def _geometry(studio: Studio, robot: str) -> dict[str, Any] | None:
    """The shapes of the open arm, or of one that can be emulated; None if its lengths are unknown."""
    arm = studio.source.arm
    if arm is not None and arm.settings.model.name == robot:
        return make_geometry(arm.settings.model, arm.settings.links)
    if robot not in TWINS:
        raise UsageError("the shapes of this arm are not known")
    return make_geometry(_model_of(robot))


def _done(studio: Studio, body: bytes) -> tuple[Callable[[], dict[str, Any]], bool]:
    """What carries an order out, and whether that computes more than it waits."""
    try:
        order = json.loads(body)
    except (ValueError, RecursionError):
        order = None
    if not isinstance(order, dict):
        raise UsageError("this is no order")
    what = order.get("do")
    calls = {
        "record": _record,
        "end": _end,
        "recover": _recover,
        "remove": _remove,
        "preview": _preview,
        "twin": _twin,
        "twin_stop": _twin_stop,
    }
    call = calls.get(what) if isinstance(what, str) else None
    if call is None:
        raise UsageError("there is no such order")
    return functools.partial(call, studio, order), what in _COMPUTES


def _record(studio: Studio, order: dict[str, Any]) -> dict[str, Any]:
    return {"name": studio.shelf.recorder.start(studio.source.need_arm())}


def _end(studio: Studio, order: dict[str, Any]) -> dict[str, Any]:
    return {"said": studio.shelf.recorder.stop()}


def _recover(studio: Studio, order: dict[str, Any]) -> dict[str, Any]:
    return {"name": studio.shelf.library.recover(_name(order)).name}


def _remove(studio: Studio, order: dict[str, Any]) -> dict[str, Any]:
    studio.shelf.library.remove(_name(order))
    return {}


def _preview(studio: Studio, order: dict[str, Any]) -> dict[str, Any]:
    """What playing it on the open arm would be; nothing moves."""
    arm = studio.source.need_arm()
    taught = studio.shelf.taught(_name(order), _topic(order), arm.settings.model.names)
    begin, end, factor = _part(order)
    args: dict[str, object] = {"what": "play", "begin": begin, "factor": factor}
    if end < LONGEST:
        args["end"] = end
    plan = arm.desk.preview(args, taught=taught)
    return {
        "duration": plan.duration,
        "lead_in": plan.lead_in,
        "refusal": plan.refusal or plan.unready,
    }


def _twin(studio: Studio, order: dict[str, Any]) -> dict[str, Any]:
    """Play it on an emulated arm."""
    name, topic, shelf = _name(order), _topic(order), studio.shelf
    found = shelf.library.find(name)
    robot = twin_for(found.robot, found.joints)
    if not robot:
        raise UsageError(f"there is no emulated arm with the joints of {name}")
    begin, end, factor = _part(order)
    # The table of the open arm is the twin's, too.
    arm = studio.source.arm
    table = arm.settings.table if arm is not None else 0.0
    shelf.twin.play(
        robot,
        name,
        lambda joints: shelf.taught(name, topic, joints),
        begin=begin,
        end=end,
        factor=factor,
        settings={"check_table": False} if table is None else {"table_height": table},
    )
    return asdict(shelf.twin.state)


def _twin_stop(studio: Studio, order: dict[str, Any]) -> dict[str, Any]:
    studio.shelf.twin.stop("stopped")
    return {}


def _name(order: dict[str, Any]) -> str:
    name = order.get("name")
    if not isinstance(name, str):
        raise UsageError("name a recording")
    return name


def _topic(order: dict[str, Any]) -> str | None:
    topic = order.get("topic")
    return topic if isinstance(topic, str) and topic else None


def _part(order: dict[str, Any]) -> tuple[float, float, float]:
    """First and last second, and the factor of the speed."""
    begin = finite(order.get("begin", 0.0), "the beginning")
    end = finite(order.get("end", LONGEST), "the end")
    factor = finite(order.get("factor", 1.0), "the factor of the speed")
    low, high = PLAY_FACTORS
    if not 0.0 <= begin < end or math.isinf(end):
        raise UsageError("the part to play must begin at 0 s or later, and end after its beginning")
    if not low <= factor <= high:
        raise UsageError(f"a recording is played at {low:g} to {high:g} times its speed, not {factor:g}")
    return begin, end, factor
