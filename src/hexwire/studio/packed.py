"""The files of pages, in memory: found by name, compressed once; and the page itself, another one each time.

Owns their bytes and headers. Nothing else of a disk can be reached by an address.
"""

from __future__ import annotations

import asyncio
import gzip
import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from starlette.requests import Request
from starlette.responses import Response

__all__ = ["Packed"]

_KINDS = {".css": "text/css", ".js": "text/javascript", ".svg": "image/svg+xml", ".html": "text/html"}


@dataclass(frozen=True)
class _File:
    kind: str
    body: bytes

    @cached_property
    def tag(self) -> str:
        return f'"{hashlib.sha256(self.body).hexdigest()[:32]}"'

    @cached_property
    def packed(self) -> bytes:
        return _pack(self.body)


class Packed:
    """Serves the files of a folder.

    Args:
        folder: The folder; what is in it and below is read now.
    """

    def __init__(self, folder: Path) -> None:
        self._files = {
            file.relative_to(folder).as_posix(): _File(_KINDS[file.suffix], file.read_bytes())
            for file in sorted(folder.rglob("*"))
            if file.suffix in _KINDS
        }

    def page(self, request: Request, name: str, values: Mapping[str, str]) -> Response:
        """A file with values in it, for this request alone.

        Args:
            request: Its browser can or cannot read what is compressed.
            name: The file.
            values: What is in the place of each ``{name}`` of it. Nothing that others choose: beside the key of a
                tab, it would let the length of the compressed page tell of the key.
        """
        file = self._files[name]
        body = file.body
        for key, value in values.items():
            body = body.replace(f"{{{key}}}".encode(), value.encode())
        headers = {"cache-control": "no-store", "vary": "accept-encoding"}
        if _reads_packed(request):
            headers["content-encoding"] = "gzip"
            body = _pack(body)
        return Response(body, 200, headers, file.kind)

    async def answer(self, request: Request) -> Response:
        """A file, compressed for a browser that can read it so."""
        file = self._files.get(request.path_params["name"])
        if file is None:
            return Response("There is no such file.", 404)
        headers = {"cache-control": "no-cache", "etag": file.tag, "vary": "accept-encoding"}
        if request.headers.get("if-none-match") == file.tag:
            return Response(None, 304, headers)
        body = file.body
        if _reads_packed(request):
            headers["content-encoding"] = "gzip"
            # By a thread of asyncio: what Starlette loads for one of its own takes 5 MB.
            body = await asyncio.to_thread(lambda: file.packed)
        return Response(body, 200, headers, file.kind)


def _pack(body: bytes) -> bytes:
    return gzip.compress(body, 9, mtime=0)


def _reads_packed(request: Request) -> bool:
    return "gzip" in request.headers.get("accept-encoding", "")
