"""The cameras of the studio's computer for pages: which there are, and the pictures of each over a socket.

Owns that a page gets the newest picture and no queue of old ones, and how many may look at a time. What a page
sends here does nothing but ask for the next picture. Runs in the loop of the server; a camera calls it from its
thread.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections import Counter
from typing import TYPE_CHECKING

from starlette.websockets import WebSocket, WebSocketDisconnect

from hexwire.errors import UsageError

from .calls import Arguments, Asked, call
from .guard import SESSION
from .live import end_tasks

if TYPE_CHECKING:
    from .access import Right
    from .cameras import Cameras, Picture

__all__ = ["CameraViews"]

_AHEAD = 2
"""Pictures that a page may not have shown yet; further ones are dropped, not kept in the buffers of the system."""
_MOST_VIEWERS = 8
"""Of those who may operate, and again of those who may only watch."""
_PAUSE = 0.02
"""Seconds between two messages that are taken from a page."""


@call("cameras", Arguments)
def _cameras(asked: Asked, args: Arguments) -> object:
    """The names of the cameras of this computer, and why one that somebody looks at has no picture."""
    rows = asked.studio.cameras.rows.values()
    return [{"name": camera.name, "device": camera.device, "problem": camera.problem} for camera in rows]


class _Slot:
    """The newest picture for one page, which the thread of its camera sets.

    Args:
        loop: That of the server.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop, self._due, self._ahead = loop, False, 0
        self._newest: Picture | str | None = None
        self._wake = asyncio.Event()

    def put(self, picture: Picture | None, why: str) -> None:
        """Keep what is newest. Any thread may call it."""
        self._newest = why if picture is None else picture
        # Once until the loop has looked: while it hangs, nothing is queued.
        if not self._due:
            self._due = True
            with contextlib.suppress(RuntimeError):
                self._loop.call_soon_threadsafe(self._look)

    def _look(self) -> None:
        self._due = False
        self._wake.set()

    def shown(self) -> None:
        """The page has shown a picture."""
        self._ahead = max(0, self._ahead - 1)
        self._wake.set()

    async def take(self) -> Picture | str:
        """What is newest, once it is there and the page has shown what it has."""
        while True:
            await self._wake.wait()
            self._wake.clear()
            found = self._newest
            if isinstance(found, str) or (found is not None and self._ahead < _AHEAD):
                self._newest = None
                self._ahead += not isinstance(found, str)
                return found


class CameraViews:
    """Serves the sockets at which pages look at cameras.

    Args:
        cameras: The cameras.
        patience: Seconds that a socket may take to accept a picture.
    """

    def __init__(self, cameras: Cameras, patience: float) -> None:
        self._cameras, self._patience = cameras, patience
        self._viewers: Counter[Right] = Counter()

    async def serve(self, websocket: WebSocket) -> None:
        """Serve one socket, which has passed the gate, until it closes."""
        right = websocket.scope[SESSION].right
        await websocket.accept()
        try:
            camera = self._cameras.find(websocket.path_params["name"])
            if self._viewers[right] >= _MOST_VIEWERS:
                raise UsageError(f"{_MOST_VIEWERS} pages look at cameras already: close one")
        except UsageError as error:
            await websocket.send_text(json.dumps({"refused": str(error)}))
            await websocket.close(1008)
            return
        self._viewers[right] += 1
        slot = _Slot(asyncio.get_running_loop())
        end = camera.look(slot.put)
        tasks = [asyncio.create_task(work) for work in (self._send(websocket, slot), _receive(websocket, slot))]
        try:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        finally:
            end()
            self._viewers[right] -= 1
            await end_tasks(tasks)
            with contextlib.suppress(RuntimeError, WebSocketDisconnect):
                await websocket.close()

    async def _send(self, websocket: WebSocket, slot: _Slot) -> None:
        while True:
            found = await slot.take()
            async with asyncio.timeout(self._patience):
                if isinstance(found, str):
                    await websocket.send_text(json.dumps({"problem": found}))
                else:
                    await websocket.send_bytes(found.jpeg)


async def _receive(websocket: WebSocket, slot: _Slot) -> None:
    while (await websocket.receive())["type"] != "websocket.disconnect":
        # Whatever it is: a page that asks without end gets no more than the camera gives.
        slot.shown()
        await asyncio.sleep(_PAUSE)
