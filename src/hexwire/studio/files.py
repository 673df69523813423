"""What pages fetch and send as files: columns for plots, exports, recordings.

Owns the addresses below ``/data`` and the check of what they are asked. Behind the gate as everything else; writing
needs the right to operate. Another process makes them (`page_work`).
"""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Awaitable, Callable
from dataclasses import asdict
from typing import TYPE_CHECKING, Any, TypeVar

from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, Response
from starlette.routing import Route

from hexwire.control.requests.history import BLOCK
from hexwire.errors import HexwireError, UsageError

from .access import WATCHING_ONLY, Right
from .columns import history_columns
from .guard import SESSION
from .sent_files import made, received
from .wire_api import refusal

if TYPE_CHECKING:
    from hexwire.control.requests.history import History

    from .app import Studio
    from .page_process import PageProcess

__all__ = ["make_routes"]

_BYTES = "application/octet-stream"
_PLAIN = {"Cache-Control": "no-store"}
_T = TypeVar("_T")
_Handler = Callable[[Request], Awaitable[Response]]


class _RefusedError(Exception):
    def __init__(self, status: int, text: str) -> None:
        super().__init__(text)
        self.status = status


def make_routes(present: Callable[[], Studio]) -> list[Route]:
    """The addresses.

    Args:
        present: The studio that is served now.
    """
    files = _Files(present)
    rows: list[tuple[str, str, _Handler]] = [
        ("GET", "/data/history", files.history),
        ("GET", "/data/history.csv", files.csv),
        ("GET", "/data/history.mcap", files.mcap),
        ("GET", "/data/twin", files.twin),
        ("GET", "/data/compare", files.compare),
        ("GET", "/data/recording", files.columns),
        ("GET", "/data/recording.mcap", files.download),
        ("GET", "/data/picture", files.picture),
        ("POST", "/data/recording", files.upload),
    ]
    return [Route(path, _told(handler), methods=[method]) for method, path, handler in rows]


def _told(handler: _Handler) -> _Handler:
    """A handler whose errors become one line."""

    async def told(request: Request) -> Response:
        try:
            return await handler(request)
        except _RefusedError as error:
            return JSONResponse({"refused": str(error)}, error.status, _PLAIN)
        except HexwireError as error:
            return refusal(error)
        except OSError as error:
            return refusal(UsageError(f"the file cannot be written or read: {error.strerror or error}"))

    return told


class _Files:
    def __init__(self, present: Callable[[], Studio]) -> None:
        self._present = present

    # -- the open arm -----------------------------------------------------------------------------------

    async def history(self, request: Request) -> Response:
        """The last ten minutes, or what is newer than ``after``."""
        arm = self._present().source.need_arm()
        offset = time.time() - arm.arm.owner.now()
        return await self._rows(request, {"offset": offset}, arm.history)

    async def csv(self, request: Request) -> Response:
        """A part of them as CSV, in SI units."""
        history, span, offset, _ = self._part(request)
        wanted = list(filter(None, request.query_params.get("columns", "").split(",")))

        def write(process: PageProcess, path: str) -> None:
            process.ask("csv", path, _signals(history), wanted, history.rows().between(*span), offset)

        return await self._made(request, write, "text/csv", self._name("csv"))

    async def mcap(self, request: Request) -> Response:
        """A part of them as a recording."""
        history, span, offset, robot = self._part(request)

        def write(process: PageProcess, path: str) -> None:
            rows = history.rows().between(*span)
            if not len(rows):
                raise UsageError("nothing is known of this time")
            process.ask("mcap", path, _signals(history), rows, offset, robot)

        return await self._made(request, write, _BYTES, self._name("mcap"))

    def _part(self, request: Request) -> tuple[History, tuple[float, float], float, str]:
        """The history, the part that is asked for, seconds to add to its times, and whose it is."""
        arm = self._present().source.need_arm()
        span = _number(request, "from", -math.inf), _number(request, "to", math.inf)
        return arm.history, span, time.time() - arm.arm.owner.now(), arm.settings.model.name

    def _name(self, ending: str) -> str:
        robot = self._present().source.need_arm().settings.model.name
        return f"{time.strftime('%Y-%m-%d %H-%M-%S')} {robot}.{ending}"

    # -- recordings -------------------------------------------------------------------------------------

    async def columns(self, request: Request) -> Response:
        """A recording's columns."""
        name, topic = _text(request, "name"), _topic(request, "topic")
        return await self._made(request, lambda process, path: process.ask("recording", path, name, topic))

    async def picture(self, request: Request) -> Response:
        """What a camera of a recording saw at a time, seconds since 1970."""
        name, topic, at = _text(request, "name"), _text(request, "topic"), _number(request, "at", math.nan)
        return await self._made(
            request, lambda process, path: process.ask("picture", path, name, topic, at), "image/jpeg"
        )

    async def download(self, request: Request) -> Response:
        """A recording as it is."""
        name = _text(request, "name")
        path = self._present().recordings.library.present(name)
        return FileResponse(path, media_type=_BYTES, filename=name, headers=_PLAIN)

    async def compare(self, request: Request) -> Response:
        """Two recordings on one time axis."""
        a = _text(request, "a"), _topic(request, "topic_a")
        b = _text(request, "b"), _topic(request, "topic_b")
        align, lag = request.query_params.get("align", "start"), _number(request, "lag", 0.0)
        return await self._made(request, lambda process, path: process.ask("compared", path, a, b, align, lag))

    async def twin(self, request: Request) -> Response:
        """What the twin did, later than ``after``."""
        twin = self._present().recordings.twin
        if twin.history is None:
            raise UsageError("the twin has not moved yet")
        head: dict[str, Any] = {"state": asdict(twin.state), "names": list(twin.history.names)}
        return await self._rows(request, head, twin.history, (".position", ".goal"))

    async def upload(self, request: Request) -> Response:
        """Take a file that somebody brings."""
        if request.scope[SESSION].right < Right.OPERATE:
            raise _RefusedError(403, WATCHING_ONLY)
        name, most = _text(request, "name"), self._present().recordings.library.largest
        async with received(request, most) as path:
            if path is None:
                raise _RefusedError(413, f"it is larger than {most >> 20} MiB")
            added, problem = await self._ask(request, lambda process: process.ask("add", name, str(path)))
        return JSONResponse({"name": added, "problem": problem}, headers=_PLAIN)

    # -- how it is made ---------------------------------------------------------------------------------

    async def _ask(self, request: Request, call: Callable[[PageProcess], _T]) -> _T:
        """What the process for files makes; it is not begun for a browser that has gone."""
        work = asyncio.ensure_future(self._present().ask_files(request.scope[SESSION].right, call))
        gone = asyncio.ensure_future(_gone(request))
        try:
            await asyncio.wait((work, gone), return_when=asyncio.FIRST_COMPLETED)
            if not work.done():
                work.cancel()
                raise _RefusedError(499, "the browser has gone")
            return work.result()
        finally:
            gone.cancel()

    async def _made(
        self, request: Request, make: Callable[[PageProcess, str], None], kind: str = _BYTES, name: str = ""
    ) -> Response:
        """A file made for one answer."""

        async def ask(path: str) -> None:
            await self._ask(request, lambda process: make(process, path))

        return await made(ask, kind, name)

    async def _rows(
        self, request: Request, head: dict[str, Any], history: History, endings: tuple[str, ...] = ("",)
    ) -> Response:
        """What is later than ``after``, as columns."""
        after, signals = _number(request, "after", -math.inf), _signals(history)
        if history.count_after(after) <= BLOCK:
            # What a page that shows it asks for again and again.
            return Response(history_columns(head, signals, history.rows(after), endings), 200, _PLAIN, _BYTES)

        def write(process: PageProcess, path: str) -> None:
            process.ask("history", path, head, signals, history.rows(after), endings)

        return await self._made(request, write)


async def _gone(request: Request) -> None:
    while (await request.receive())["type"] != "http.disconnect":
        pass


def _signals(history: History) -> list[tuple[str, str]]:
    return [(joint, signal.name) for joint, signal in history.columns]


def _text(request: Request, key: str) -> str:
    found = request.query_params.get(key, "")
    if not 0 < len(found) <= 300:
        raise UsageError(f"name a recording ({key})")
    return found


def _topic(request: Request, key: str) -> str | None:
    return request.query_params.get(key) or None


def _number(request: Request, key: str, default: float) -> float:
    text = request.query_params.get(key)
    if text is None:
        return default
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if math.isnan(value):
        raise UsageError(f"{key} must be a number")
    return value
