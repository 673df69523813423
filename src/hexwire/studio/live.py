"""The tab's own socket: frames of state down; signs of life, holds, stops and calls up, their answers down.

Owns the messages, their bounds, and that a slow reader gets fewer frames and is then dropped. Runs in the loop of
the server and never waits for the arm: what may wait runs in threads. Must not know pages.

Up, JSON: ``{"do": "seen", "frames": 10}``, ``{"do": "hold", "id": 1, "kind": "joint", "args": {}, "stops": 0}``,
``{"do": "beat", "id": 1}`` (with ``args`` to change what is held), ``{"do": "release", "id": 1}``,
``{"do": "stop", "id": 1}``, ``{"do": "call", "id": 1, "name": "arm.poses", "args": {}, "opened": 1}``.
Down: frames (`hexwire.studio.frames`), or a single 0 as a sign of life; and JSON with a ``kind``: ``hello``,
``facts``, ``held``, ``ended``, ``stopping``, ``answer`` (with ``value``, or ``error`` in words), ``news``, ``run``
(how far a motion to a goal is), ``leader`` (what is known of a leader arm), and those of the page Servos.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import math
from collections import deque
from typing import TYPE_CHECKING, Annotated, Any, Protocol

import msgspec
from starlette.websockets import WebSocket, WebSocketDisconnect

from hexwire.errors import HexwireError

from .guard import SESSION
from .memory import FullPasses

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping
    from concurrent.futures import ThreadPoolExecutor

    from hexwire.control.motion.hold_to_run import HeldMotion

    from .access import Access
    from .holds import Holds
    from .source import ArmSource, Source
    from .tabs import Tab, Tabs

__all__ = ["Count", "Desk", "Live", "end_tasks"]

_log = logging.getLogger(__name__)

_FRAMES = 60.0
"""Frames per second at most."""
_FACTS = 0.25
"""Seconds between two messages with facts that changed, and between two about a leader arm."""
_LOOK = 5.0
"""Seconds between two looks at how much memory there is: each holds the interpreter for a millisecond."""
_SIGN_OF_LIFE = b"\0"
"""In place of a frame while there is no new one: without it a page takes what it shows for what is no more."""
_MOST_TEXTS, _MOST_WAITING = 64, 4 << 20
"""Messages that may wait for a slow reader, and letters of them before the last one."""
_AHEAD = 40
"""Frames that a page may not have seen yet; further ones are dropped, not kept in the buffers of the system."""
_BURST, _RATE, _PIECE = 500.0, 250.0, 1024
"""Messages of one socket that are taken at once and per second; a long one counts once more for so many letters.
Pages send some ten a second, below 200 while a slider is dragged. Who sends more waits; nobody else does."""
_BEAT = 0.2
"""Seconds between two renewals of the lease for a tab that has its socket."""


Count = Annotated[int, msgspec.Meta(ge=0, lt=1 << 53)]
"""A number that scripts of pages count up."""


class _Seen(msgspec.Struct, tag_field="do", tag="seen"):
    frames: int


class _Hold(msgspec.Struct, tag_field="do", tag="hold"):
    id: Count
    kind: str
    stops: int
    args: dict[str, Any] = {}


class _Beat(msgspec.Struct, tag_field="do", tag="beat"):
    id: Count
    args: dict[str, Any] | None = None


class _Release(msgspec.Struct, tag_field="do", tag="release"):
    id: Count


class _Stop(msgspec.Struct, tag_field="do", tag="stop"):
    id: Any = None


class _Call(msgspec.Struct, tag_field="do", tag="call"):
    id: Count
    name: str
    args: dict[str, Any] = {}
    opened: int | None = None


_Order = _Seen | _Hold | _Beat | _Release | _Stop | _Call


class Desk(Protocol):
    """What the sockets need of their studio."""

    access: Access
    source: Source
    tabs: Tabs
    holds: Holds
    orders: ThreadPoolExecutor

    def soon(self, call: Callable[[], object]) -> None:
        """Call something in the loop of the server, from any thread."""

    def stop(self, who: str) -> None:
        """Stop the arm; returns at once."""

    def gone(self, tab: Tab) -> None:
        """The socket of a tab is closed."""

    def refused(self, entry: HeldMotion, why: str) -> None:
        """A motion that was announced did not begin."""

    def facts(self) -> dict[str, object]:
        """What is always in sight, for JSON."""

    def model(self) -> dict[str, object]:
        """The joints of what is open, for JSON."""

    def running(self) -> dict[str, object] | None:
        """How far the motion to a goal is, for JSON; None if there is none."""

    async def call(self, tab: Tab, name: str, args: Mapping[str, object], opened: int | None = None) -> object:
        """Do what a page asks for by name."""


async def end_tasks(tasks: Collection[asyncio.Task[Any]]) -> None:
    """End the tasks of a socket; what failed otherwise than by the end of the connection is logged."""
    for task in tasks:
        task.cancel()
    for failed in await asyncio.gather(*tasks, return_exceptions=True):
        expected = WebSocketDisconnect | TimeoutError | asyncio.CancelledError | RuntimeError
        if isinstance(failed, BaseException) and not isinstance(failed, expected):
            _log.error("a socket failed", exc_info=failed)


class _Socket:
    """What waits for one browser: the newest frame, and all texts."""

    def __init__(self, socket: WebSocket, tab: Tab, patience: float) -> None:
        self.socket, self.tab = socket, tab
        self._patience = patience
        self._frame: bytes | None = None
        self._texts: deque[str] = deque()
        self._waiting = 0
        self._wake = asyncio.Event()
        self._sent = 0
        self.seen = 0
        self.too_slow = False
        self.replaced = asyncio.Event()
        self.over = asyncio.Event()

    def put_frame(self, frame: bytes) -> None:
        if self._sent - self.seen < _AHEAD:
            self._frame = frame
            self._wake.set()

    def put_sign_of_life(self) -> None:
        """Unless a frame waits, which is one, too."""
        if self._frame is None:
            self.put_frame(_SIGN_OF_LIFE)

    def put(self, message: dict[str, Any] | str) -> None:
        if len(self._texts) >= _MOST_TEXTS or self._waiting > _MOST_WAITING:
            self.too_slow = True
        else:
            text = message if isinstance(message, str) else json.dumps(message)
            self._texts.append(text)
            self._waiting += len(text)
        self._wake.set()

    async def send_all(self) -> None:
        """Send until the socket closes or is too slow."""
        while not self.too_slow:
            await self._wake.wait()
            self._wake.clear()
            async with asyncio.timeout(self._patience):
                while self._texts:
                    text = self._texts.popleft()
                    await self.socket.send_text(text)
                    self._waiting -= len(text)
                frame, self._frame = self._frame, None
                if frame is not None:
                    self._sent += 1
                    await self.socket.send_bytes(frame)


class Live:
    """All sockets of a studio.

    Args:
        studio: The studio.
    """

    def __init__(self, studio: Desk) -> None:
        self._studio = studio
        self._sockets: set[_Socket] = set()
        self._opened = asyncio.Event()
        self._facts = self._leader = ""
        self._answering: set[asyncio.Task[None]] = set()

    # -- down ---------------------------------------------------------------------------------------------

    async def pump(self) -> None:
        """Send frames and facts until cancelled; without sockets, only look after the memory."""
        loop = asyncio.get_running_loop()
        last, next_facts, next_beat, next_look = None, 0.0, 0.0, 0.0
        passes = FullPasses()
        while True:
            if self._sockets:
                await asyncio.sleep(1.0 / _FRAMES)
            else:
                # What a socket gets as it opens may be older than what comes next.
                self._facts = self._leader = ""
                self._opened.clear()
                with contextlib.suppress(TimeoutError):
                    async with asyncio.timeout(_LOOK):
                        await self._opened.wait()
            now = loop.time()
            arm = self._studio.source.arm
            try:
                state = arm.arm.owner.state if arm is not None else None
                if self._sockets and arm is not None and state is not None and state is not last:
                    frame = arm.frame(state)
                    for socket in self._sockets:
                        socket.put_frame(frame)
                last = state
                if now >= next_beat:
                    next_beat = now + _BEAT
                    self._renew()
                if now >= next_facts:
                    next_facts = now + _FACTS
                    self.tell_facts()
                    self._tell_leader(arm)
                    for socket in self._sockets:
                        socket.put_sign_of_life()
                if now >= next_look:
                    next_look = now + _LOOK
                    passes.look(moving=arm is not None and arm.arm.owner.group.busy)
            except Exception:  # noqa: BLE001  # logged; the next frame may be right
                _log.exception("a frame failed")

    def tell_facts(self) -> None:
        """Send the facts if they have changed."""
        facts = json.dumps({"kind": "facts", **self._studio.facts()})
        if facts != self._facts:
            self._facts = facts
            for socket in self._sockets:
                socket.put(facts)

    def _tell_leader(self, arm: ArmSource | None) -> None:
        """Send what is known of the leader of an arm, if that has changed."""
        leader = None if arm is None else arm.leader
        text = json.dumps({"kind": "leader", "leader": None if leader is None else leader.row()})
        if text != self._leader:
            self._leader = text
            for socket in self._sockets:
                socket.put(text)

    def tell(self, message: dict[str, Any] | Callable[[], dict[str, Any]], tab_key: str | None = None) -> None:
        """Send a message to one tab, or to all. Any thread may call this.

        Args:
            message: The message; or for what several threads tell, a function that returns what is true when it is
                sent: what one of them knew before must not come last.
            tab_key: Of the tab; None for all.
        """
        self._studio.soon(lambda: self._tell(message if isinstance(message, dict) else message(), tab_key))

    def _tell(self, message: dict[str, Any], tab_key: str | None) -> None:
        text = json.dumps(message)
        for socket in self._sockets:
            if tab_key in (None, socket.tab.key):
                socket.put(text)

    def _renew(self) -> None:
        """Renew the lease of the tab that has control, while its socket is open."""
        present = self._studio.source.present
        if present is None:
            return
        for socket in self._sockets:
            if socket.tab.grant:
                try:
                    present.beat(socket.tab.grant)
                except HexwireError:
                    socket.tab.grant = 0

    # -- up -----------------------------------------------------------------------------------------------

    async def serve(self, websocket: WebSocket) -> None:
        """Serve one socket to its end."""
        studio = self._studio
        session = websocket.scope[SESSION]
        tab = studio.tabs.find(websocket.query_params.get("tab", ""), session.key)
        await websocket.accept()
        if tab is None:
            await websocket.close(4404, "this page is not open any more; load it again")
            return
        # After a change of its network a browser is back before the server knows that the first socket is dead.
        while (old := next((each for each in self._sockets if each.tab is tab), None)) is not None:
            old.replaced.set()
            await old.over.wait()
        # All before it counts: if one fails, nothing would tell the next socket of this page that it is over.
        model, facts, run = studio.model(), studio.facts(), studio.running()
        tab.live = True
        socket = _Socket(websocket, tab, studio.access.limits.patience)
        self._sockets.add(socket)
        self._opened.set()
        socket.put({"kind": "hello", "tab": tab.name, "right": int(tab.right), **model})
        socket.put({"kind": "facts", **facts})
        if run is not None:
            socket.put(run)
        if self._leader:
            socket.put(self._leader)
        sender = asyncio.create_task(socket.send_all())
        receiver = asyncio.create_task(self._receive(socket))
        follower = asyncio.create_task(socket.replaced.wait())
        tasks = (sender, receiver, follower)
        try:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        finally:
            tab.live = False
            self._sockets.discard(socket)
            studio.gone(tab)
            socket.over.set()
            await end_tasks(tasks)
            with contextlib.suppress(RuntimeError, WebSocketDisconnect):
                # A page that hears of its replacement is a copy: it loads itself again and is a page of its own.
                gone = 4404 if socket.replaced.is_set() else 1000
                await websocket.close(1008 if socket.too_slow else gone)

    async def _receive(self, socket: _Socket) -> None:
        most = self._studio.access.limits.message
        loop = asyncio.get_running_loop()
        due = -math.inf
        while True:
            due = max(due, loop.time() - _BURST / _RATE)
            # The loop would do nothing but read: a STOP that somebody else sends goes first.
            await asyncio.sleep(max(0.0, due - loop.time()))
            message = await socket.socket.receive()
            if message["type"] == "websocket.disconnect":
                return
            text = message.get("text")
            if text is None or len(text) > most:
                return
            due += (1.0 + len(text) / _PIECE) / _RATE
            try:
                # Of JSON that is not what a page sends only the order is dropped: a stop behind it is heard.
                found = json.loads(text)
                order = msgspec.convert(found, _Order) if isinstance(found, dict) else None
            except msgspec.ValidationError:
                continue
            except (ValueError, RecursionError):
                return
            if order is None:
                return
            try:
                self._obey(socket, order)
            except HexwireError as error:
                socket.put({"kind": "ended", "id": getattr(order, "id", None), "why": str(error)})

    def _obey(self, socket: _Socket, order: _Order) -> None:
        tab, studio = socket.tab, self._studio
        if isinstance(order, _Stop):
            studio.stop(tab.name)
            socket.put({"kind": "stopping"})
            # Now, and not before: until then the same stop by HTTP is none too many.
            if isinstance(order.id, int):
                tab.stops.append(order.id)
            return
        if isinstance(order, _Seen):
            socket.seen = max(socket.seen, order.frames)
            return
        if isinstance(order, _Call):
            answering = asyncio.create_task(self._answer(socket, order))
            self._answering.add(answering)
            answering.add_done_callback(self._answering.discard)
            return
        present = studio.source.present
        if present is None:
            if isinstance(order, _Hold):
                # Refused in words: what a page holds lasts there until it hears of its end.
                studio.source.need_arm()
            return
        if isinstance(order, _Beat):
            if present.hold_to_run.beat(tab.key, order.id) and order.args is not None:
                studio.holds.update(tab, order.args)
        elif isinstance(order, _Release):
            present.hold_to_run.end(tab.key, "released", order.id)
        elif order.stops != present.stops & 0xFFFFFFFF:
            socket.put({"kind": "ended", "id": order.id, "why": "the arm was stopped meanwhile"})
        else:
            # At once: it would end what another page holds, and wait among the orders of that page.
            studio.source.need_control(tab)
            arrived = present.mark()
            studio.holds.forget(tab)
            entry = present.hold_to_run.begin(tab.key, order.id)
            if entry is not None:
                self._begin(socket, entry, order, arrived)

    async def _answer(self, socket: _Socket, order: _Call) -> None:
        """Do what a page asks for, and tell it what has become of it."""
        try:
            told = {"value": await self._studio.call(socket.tab, order.name, order.args, order.opened)}
        except HexwireError as error:
            told = {"error": str(error)}
        try:
            # What is not a number has no JSON: it becomes null.
            text = msgspec.json.encode({"kind": "answer", "id": order.id, **told}).decode()
        except (UnicodeEncodeError, OverflowError):
            # Of what the page itself has sent, or of a file: half a letter has no bytes.
            text = json.dumps({"kind": "answer", "id": order.id, "error": "the answer cannot be sent as JSON"})
        socket.put(text)

    def _begin(self, socket: _Socket, entry: HeldMotion, order: _Hold, arrived: Any) -> None:
        def begin() -> None:
            try:
                self._studio.holds.begin(socket.tab, entry, order.kind, order.args, arrived)
            except HexwireError as error:
                self._studio.refused(entry, str(error))
            except Exception:  # noqa: BLE001  # logged and answered
                _log.exception("a hold failed")
                self._studio.refused(entry, "the studio failed at this; see its log")
            else:
                self.tell({"kind": "held", "id": entry.number}, entry.who)

        self._studio.orders.submit(begin)
