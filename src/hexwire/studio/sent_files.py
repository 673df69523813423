"""Files on their way from and to a browser, on this disk meanwhile: never as a whole in memory.

Owns the folder of each, which is removed when it has arrived.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote

from starlette.background import BackgroundTask
from starlette.concurrency import run_in_threadpool
from starlette.responses import FileResponse, Response

if TYPE_CHECKING:
    from starlette.requests import Request

__all__ = ["made", "received"]

_PART = 256 * 1024
"""Bytes that are read at once: each time, the loop of the server waits for another thread."""


class _Made(FileResponse):
    chunk_size = _PART


async def made(make: Callable[[str], Awaitable[object]], kind: str, name: str = "") -> Response:
    """A file that is made for one answer.

    Args:
        make: Makes the file of this path, which does not exist.
        kind: Its media type.
        name: Under which the browser saves it; it does not if this is empty.
    """
    folder = tempfile.mkdtemp(prefix="hexwire-")
    path = Path(folder) / "file"
    try:
        await make(str(path))
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    headers = {"Cache-Control": "no-store"}
    if name:
        headers["Content-Disposition"] = f"attachment; filename*=UTF-8''{quote(name)}"
    task = BackgroundTask(shutil.rmtree, folder, ignore_errors=True)
    return _Made(path, media_type=kind, headers=headers, background=task)


@asynccontextmanager
async def received(request: Request, most: int) -> AsyncIterator[Path | None]:
    """A file that a browser sends, for this block; None if it is more than `most` bytes.

    It is counted, since a length that is given may be wrong.
    """
    with tempfile.TemporaryDirectory(prefix="hexwire-") as folder:
        path = Path(folder) / "file"
        yield path if await _written(request, path, most) else None


async def _written(request: Request, path: Path, most: int) -> bool:
    size = 0
    with path.open("wb") as file:
        async for part in request.stream():
            size += len(part)
            if size > most:
                return False
            await run_in_threadpool(file.write, part)
    return True
