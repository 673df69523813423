"""Cameras for pages: which there are, the pictures of each over a socket, and a page's own camera for the studio.

Owns that a page gets the newest picture and no queue of old ones, how many may look at a time, and that a page
sends pictures of its own camera only while somebody looks at them. Whoever looks can only ask for the next picture.
Runs in the loop of the server; a camera calls it from its thread.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import json
from collections import Counter
from typing import TYPE_CHECKING

from starlette.websockets import WebSocket, WebSocketDisconnect

from hexwire.errors import HexwireError, LeaseError, UsageError

from .access import WATCHING_ONLY, Right
from .calls import Arguments, Asked, call
from .cameras import RATE, Camera, Pushed
from .guard import SESSION
from .live import end_tasks

if TYPE_CHECKING:
    from .cameras import CameraPicture, Cameras
    from .tabs import Tabs

__all__ = ["CameraViews"]

_AHEAD = 2
"""Pictures that a page may not have shown yet; further ones are dropped, not kept in the buffers of the system."""
_MOST_VIEWERS = 8
"""Of those who may operate, and again of those who may only watch."""
_PAUSE = 0.02
"""Seconds between two messages that are taken from a page that looks."""
_TAKEN = 0.8 / RATE
"""Seconds between two pictures that are taken from a page."""


@call("cameras", Arguments)
def _cameras(asked: Asked, args: Arguments) -> object:
    """The names of the cameras of this computer, and why one that somebody looks at has no picture."""
    rows = list(asked.studio.cameras.rows.values())
    return [{"name": camera.name, "device": camera.device, "problem": camera.problem} for camera in rows]


class _Slot:
    """The newest picture for one page, which the thread of its camera sets.

    Args:
        loop: That of the server.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop, self._due, self._ahead = loop, False, 0
        self._newest: CameraPicture | str | None = None
        self._wake = asyncio.Event()

    def put(self, picture: CameraPicture | None, why: str) -> None:
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

    async def take(self) -> CameraPicture | str:
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
        tabs: The open tabs.
        patience: Seconds that a socket may take to accept a picture.
    """

    def __init__(self, cameras: Cameras, tabs: Tabs, patience: float) -> None:
        self._cameras, self._tabs, self._patience = cameras, tabs, patience
        self._viewers: Counter[Right] = Counter()

    async def serve(self, websocket: WebSocket) -> None:
        """Serve one socket, which has passed the gate, until it closes."""
        right = websocket.scope[SESSION].right
        try:
            camera = self._cameras.find(websocket.path_params["name"])
            if self._viewers[right] >= _MOST_VIEWERS:
                raise UsageError(f"{_MOST_VIEWERS} pages look at cameras already: close one")
        except UsageError as error:
            await self._refuse(websocket, error)
            return
        # Before it is accepted: whoever is accepted counts, and looks.
        slot = _Slot(asyncio.get_running_loop())
        end = camera.look(slot.put)
        self._viewers[right] += 1
        tasks: list[asyncio.Task[None]] = []
        try:
            await websocket.accept()
            works = (self._send(websocket, slot), _receive(websocket, slot))
            tasks += [asyncio.create_task(work) for work in works]
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        finally:
            end()
            self._viewers[right] -= 1
            await end_tasks(tasks)
            with contextlib.suppress(RuntimeError, WebSocketDisconnect):
                await websocket.close()

    async def take(self, websocket: WebSocket) -> None:
        """Take the pictures of a page's own camera until its socket closes; only of those who may operate."""
        session = websocket.scope[SESSION]
        tab = self._tabs.find(websocket.query_params.get("tab", ""), session.key)
        loop, wanted = asyncio.get_running_loop(), asyncio.Event()
        looked = False

        def want(is_wanted: bool) -> None:
            nonlocal looked
            looked = is_wanted
            with contextlib.suppress(RuntimeError):
                loop.call_soon_threadsafe(wanted.set)

        async def tell() -> None:
            while True:
                await wanted.wait()
                wanted.clear()
                async with asyncio.timeout(self._patience):
                    await websocket.send_text(json.dumps({"wanted": looked}))

        source = Pushed(want)
        try:
            if session.right < Right.OPERATE:
                raise LeaseError(WATCHING_ONLY)
            if tab is None:
                raise UsageError("this page is no longer known to the studio: load it again")
            names = (f"{tab.name} camera {number}" for number in itertools.count(1))
            made = (Camera(name, source.open) for name in names)
            camera = next(one for one in made if one.name not in self._cameras.rows)
            self._cameras.add(camera)
        except HexwireError as error:
            await self._refuse(websocket, error)
            return
        tasks: list[asyncio.Task[None]] = []
        try:
            await websocket.accept()
            tasks += [asyncio.create_task(work) for work in (tell(), _taken(websocket, source))]
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        finally:
            self._cameras.rows.pop(camera.name, None)
            await end_tasks(tasks)
            # It waits for the thread of the camera.
            await asyncio.to_thread(camera.close)
            with contextlib.suppress(RuntimeError, WebSocketDisconnect):
                await websocket.close()

    async def _refuse(self, websocket: WebSocket, error: HexwireError) -> None:
        await websocket.accept()
        await websocket.send_text(json.dumps({"refused": str(error)}))
        await websocket.close(1008)

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


async def _taken(websocket: WebSocket, source: Pushed) -> None:
    while (message := await websocket.receive())["type"] != "websocket.disconnect":
        source.put(message.get("bytes") or b"")
        await asyncio.sleep(_TAKEN)
