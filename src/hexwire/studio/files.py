"""What pages fetch and send as files: columns for plots, exports, recordings.

Owns the addresses below ``/data`` and the check of what they are asked. Behind the gate as everything else; writing
needs the right to operate. What may wait runs in threads. Must not know how a page shows it.
"""

from __future__ import annotations

import asyncio
import math
import os
import tempfile
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar
from urllib.parse import quote

from starlette.background import BackgroundTask
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, Response, StreamingResponse
from starlette.routing import Route

from hexwire.errors import HexwireError, UsageError
from hexwire.trace.series import write_csv, write_mcap

from .access import WATCHING_ONLY, Right
from .columns import history_columns, serialize_columns, series_columns, transposed
from .guard import SESSION
from .wire_api import refusal

if TYPE_CHECKING:
    from hexwire.control.history import History

    from .app import Studio

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
        after = _number(request, "after", -math.inf)
        return await self._columns(request, lambda: history_columns(arm.history, after, offset))

    async def csv(self, request: Request) -> Response:
        """A part of them as CSV, in SI units."""

        def write(path: Path) -> None:
            arm = self._present().source.need_arm()
            wanted = request.query_params.get("columns", "").split(",")
            columns = [(joint, signal.name) for joint, signal in arm.history.columns]
            names = [f"{joint}.{name}" if joint else name for joint, name in columns]
            places = [i for i, name in enumerate(names) if wanted == [""] or name in wanted]
            rows = arm.history.rows().between(*_span(request))
            chosen = ((at, [row[i] for i in places]) for at, row in rows)
            offset = time.time() - arm.arm.owner.now()
            with path.open("wb") as out:
                write_csv(out, [columns[i] for i in places], chosen, offset)

        return await self._written(request, write, self._name("csv"), "text/csv")

    async def mcap(self, request: Request) -> Response:
        """A part of them as a recording."""

        def write(path: Path) -> None:
            arm = self._present().source.need_arm()
            columns = [(joint, signal.name) for joint, signal in arm.history.columns]
            rows = arm.history.rows().between(*_span(request))
            if not len(rows):
                raise UsageError("nothing is known of this time")
            path.unlink()
            offset = time.time() - arm.arm.owner.now()
            write_mcap(path, columns, rows, offset, robot=arm.settings.model.name)

        return await self._written(request, write, self._name("mcap"), _BYTES)

    def _name(self, ending: str) -> str:
        robot = self._present().source.need_arm().settings.model.name
        return f"{time.strftime('%Y-%m-%d %H-%M-%S')} {robot}.{ending}"

    # -- recordings -------------------------------------------------------------------------------------

    async def columns(self, request: Request) -> Response:
        """A recording's columns."""
        shelf = self._present().shelf
        name, topic = _text(request, "name"), _topic(request, "topic")
        return await self._columns(request, lambda: series_columns(shelf.series(name, topic)))

    async def download(self, request: Request) -> Response:
        """A recording as it is."""
        name = _text(request, "name")
        library = self._present().shelf.library
        await self._compute(request, lambda: library.find(name))
        return FileResponse(library.path(name), media_type=_BYTES, filename=name, headers=_PLAIN)

    async def compare(self, request: Request) -> Response:
        """Two recordings on one time axis."""
        shelf = self._present().shelf
        a = _text(request, "a"), _topic(request, "topic_a")
        b = _text(request, "b"), _topic(request, "topic_b")
        align, lag = request.query_params.get("align", "start"), _number(request, "lag", 0.0)
        return await self._columns(request, lambda: shelf.compared(a, b, align, lag))

    async def twin(self, request: Request) -> Response:
        """What the twin did, later than ``after``."""
        twin = self._present().shelf.twin
        if twin.history is None:
            raise UsageError("the twin has not moved yet")
        history, after = twin.history, _number(request, "after", -math.inf)
        head: dict[str, Any] = {"state": asdict(twin.state), "names": list(history.names)}
        return await self._columns(request, lambda: _positions(head, history, after))

    async def upload(self, request: Request) -> Response:
        """Take a file that somebody brings."""
        if request.scope[SESSION].right < Right.OPERATE:
            raise _RefusedError(403, WATCHING_ONLY)
        name, library = _text(request, "name"), self._present().shelf.library
        # Not in memory; and the bound counts bytes, since a length that is given may be wrong.
        with tempfile.TemporaryFile() as file:
            size = 0
            async for part in request.stream():
                size += len(part)
                if size > library.largest:
                    raise _RefusedError(413, f"it is larger than {library.largest >> 20} MiB")
                await run_in_threadpool(file.write, part)
            file.seek(0)
            found = await self._compute(request, lambda: library.add(name, file))
        return JSONResponse({"name": found.name, "problem": found.problem}, headers=_PLAIN)

    # -- how it is made ---------------------------------------------------------------------------------

    async def _compute(self, request: Request, call: Callable[[], _T]) -> _T:
        """What a call makes; it is not begun for a browser that has gone."""
        work = asyncio.ensure_future(self._present().compute(request.scope[SESSION].right, call))
        gone = asyncio.ensure_future(_gone(request))
        try:
            await asyncio.wait((work, gone), return_when=asyncio.FIRST_COMPLETED)
            if not work.done():
                work.cancel()
                raise _RefusedError(499, "the browser has gone")
            return work.result()
        finally:
            gone.cancel()

    async def _columns(self, request: Request, make: Callable[[], list[bytes]]) -> Response:
        """Columns, sent part by part: a slow reader makes the rest wait, and nothing is copied as a whole."""
        parts = await self._compute(request, make)

        async def each() -> AsyncIterator[bytes]:
            for part in parts:
                yield part

        headers = {**_PLAIN, "Content-Length": str(sum(map(len, parts)))}
        return StreamingResponse(each(), media_type=_BYTES, headers=headers)

    async def _written(self, request: Request, write: Callable[[Path], None], name: str, kind: str) -> Response:
        """A file made for one answer."""
        fd, text = tempfile.mkstemp(prefix="hexwire-", suffix=Path(name).suffix)
        os.close(fd)
        path = Path(text)
        try:
            await self._compute(request, lambda: write(path))
        except BaseException:
            path.unlink(missing_ok=True)
            raise
        headers = {**_PLAIN, "Content-Disposition": f"attachment; filename*=UTF-8''{quote(name)}"}
        task = BackgroundTask(path.unlink, missing_ok=True)
        return FileResponse(path, media_type=kind, headers=headers, background=task)


async def _gone(request: Request) -> None:
    while (await request.receive())["type"] != "http.disconnect":
        pass


def _positions(head: dict[str, Any], history: History, after: float) -> list[bytes]:
    rows = history.rows(after)
    names = [f"{joint}.{signal.name}" if joint else signal.name for joint, signal in history.columns]
    pairs = list(zip(names, transposed(rows), strict=True))
    return serialize_columns(head, rows.times, [pair for pair in pairs if pair[0].endswith((".position", ".goal"))])


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


def _span(request: Request) -> tuple[float, float]:
    return _number(request, "from", -math.inf), _number(request, "to", math.inf)
