"""Foxglove's WebSocket protocol, for watching only: states, targets, log and 3D scene of arms, and cameras, live.

Owns the protocol (`foxglove.sdk.v1`), the topics of an arm, and that a slow viewer gets less and keeps nobody
waiting; a camera is open only while a viewer has subscribed to it. The messages are those of recordings
(`hexwire.trace.foxglove`). Whoever connects has passed the gate. Nothing that a viewer sends reaches an arm. Runs
in the loop of its server; an arm calls it from its owner's thread, a camera from its own.

Source: https://github.com/foxglove/ws-protocol/blob/main/docs/spec.md
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import math
import struct
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import msgspec
from starlette.websockets import WebSocketDisconnect

from hexwire.model.geometry import kinematics_for, make_shapes
from hexwire.trace.foxglove import (
    SCHEMAS,
    compressed_image,
    frame_transforms,
    joint_states,
    log_line,
    nanoseconds,
    picture_topic,
    positions,
    scene_update,
)

from .live import end_tasks

if TYPE_CHECKING:
    from starlette.websockets import WebSocket

    from hexwire.model.arm import ArmModel
    from hexwire.model.shapes import ArmShapes
    from hexwire.model.state import JointState

    from .cameras import Camera, CameraPicture, Cameras

__all__ = ["SUBPROTOCOL", "Foxglove", "Viewer"]

SUBPROTOCOL = "foxglove.sdk.v1"
"""Of the WebSocket; whoever does not offer it is refused."""
_PERIOD = 1.0 / 60.0
"""Seconds between two states that are passed on: as for pages."""
_MOST_WAITING = 256
"""Messages, without states, that wait for a slow viewer; then it is dropped. Of states only the newest waits."""
_PAUSE = 0.02
"""Seconds between two messages that are taken from a viewer."""
_PATIENCE = 5.0
"""Seconds that a viewer may take to accept a message."""
_MOST_LETTERS = 64 * 1024
"""Of a message of a viewer, which names subscriptions."""
_MOST_SUBSCRIPTIONS = 256
_MOST_LOG = 100
"""Lines of the log that wait for the loop; further ones are lost."""
_MOST_VIEWERS = 8
_DATA = struct.Struct("<BIQ")
"""Head of a message: its kind, which is 1, subscription, nanoseconds since 1970."""
_ERROR = 2
"""Level of a status."""
_NEWEST, _EACH, _LASTING = "newest", "each", "lasting"
_TOPICS = (
    ("joint_states", "foxglove.JointStates", _NEWEST),
    ("joint_targets", "foxglove.JointStates", _NEWEST),
    ("tf", "foxglove.FrameTransforms", _NEWEST),
    ("scene", "foxglove.SceneUpdate", _LASTING),
)
"""Of an arm: name, schema, and what a viewer gets of it. What lasts is sent to whoever subscribes later, too."""
_PICTURES = "foxglove.CompressedImage"
_LOG = "/log"
_LOG_CHANNEL = 1
_LEVELS = ((logging.CRITICAL, 5), (logging.ERROR, 4), (logging.WARNING, 3), (logging.INFO, 2))


class _Wanted(msgspec.Struct):
    id: int
    channelId: int  # noqa: N815  # as the protocol writes it


class _Subscribe(msgspec.Struct, tag_field="op", tag="subscribe"):
    subscriptions: list[_Wanted]


class _Unsubscribe(msgspec.Struct, tag_field="op", tag="unsubscribe"):
    subscriptionIds: list[int]  # noqa: N815


_ORDERS = msgspec.json.Decoder(_Subscribe | _Unsubscribe)


@dataclass(frozen=True, slots=True)
class _Channel:
    number: int
    topic: str
    schema: str
    keeps: str

    def row(self) -> dict[str, Any]:
        return {
            "id": self.number,
            "topic": self.topic,
            "encoding": "json",
            "schemaName": self.schema,
            "schemaEncoding": "jsonschema",
            "schema": msgspec.json.encode(SCHEMAS[self.schema]).decode(),
        }


class Viewer:
    """What one viewer has subscribed to, and what waits to be sent to it. Without input and output.

    Attributes:
        closed: It broke the protocol, or is too slow; nothing more is taken from it.
    """

    def __init__(self) -> None:
        self.closed = False
        self._channels: dict[int, _Channel] = {}
        self._subscribed: dict[int, list[int]] = {}
        self._waiting: deque[str | bytes] = deque()
        self._newest: dict[int, bytes] = {}

    def begin(self, name: str) -> None:
        """Tell who serves: somebody who offers nothing but channels."""
        self._say({"op": "serverInfo", "name": name, "capabilities": [], "metadata": {}})

    def advertise(self, channels: list[_Channel]) -> None:
        """Tell of further channels."""
        self._channels |= {channel.number: channel for channel in channels}
        self._say({"op": "advertise", "channels": [channel.row() for channel in channels]})

    def unadvertise(self, numbers: list[int]) -> None:
        """Tell that channels have ended; what waits of them is not sent any more."""
        for number in numbers:
            self._channels.pop(number, None)
            for subscription in self._subscribed.pop(number, ()):
                self._newest.pop(subscription, None)
        self._say({"op": "unadvertise", "channelIds": numbers})

    def receive(self, data: str | bytes) -> list[int]:
        """Take a message of the viewer; returns the channels that it has subscribed to with it.

        What is no message of the protocol closes the viewer; what the protocol knows and this server does not offer
        is answered with a status.
        """
        if isinstance(data, bytes) or len(data) > _MOST_LETTERS:
            # A binary message would publish something or call a service: nobody was offered that.
            self._refuse("this server is for watching only")
            self.closed = self.closed or not isinstance(data, bytes)
            return []
        try:
            order = _ORDERS.decode(data)
        except msgspec.ValidationError as error:
            self._refuse(f"this server is for watching only, and takes subscriptions: {error}")
            return []
        except (msgspec.DecodeError, UnicodeEncodeError, RecursionError):
            self.closed = True
            return []
        if isinstance(order, _Unsubscribe):
            for number in order.subscriptionIds:
                self._forget(number)
            return []
        return [wanted.channelId for wanted in order.subscriptions if self._subscribe(wanted)]

    def _subscribe(self, wanted: _Wanted) -> bool:
        known = {number for numbers in self._subscribed.values() for number in numbers}
        if wanted.channelId not in self._channels:
            self._refuse(f"there is no channel {wanted.channelId}")
        elif not 0 <= wanted.id < 1 << 32 or wanted.id in known:
            self._refuse(f"subscription {wanted.id} is in use, or no number of 32 bits")
        elif self.wants(wanted.channelId) and self._channels[wanted.channelId].schema == _PICTURES:
            self._refuse(f"channel {wanted.channelId} has pictures: it is sent to a viewer once")
        elif len(known) >= _MOST_SUBSCRIPTIONS:
            self._refuse(f"these are more than {_MOST_SUBSCRIPTIONS} subscriptions")
        else:
            self._subscribed.setdefault(wanted.channelId, []).append(wanted.id)
            return True
        return False

    def _forget(self, subscription: int) -> None:
        self._newest.pop(subscription, None)
        for numbers in self._subscribed.values():
            if subscription in numbers:
                numbers.remove(subscription)

    def wants(self, number: int) -> bool:
        """Whether it has subscribed to a channel."""
        return bool(self._subscribed.get(number))

    def put(self, channel: _Channel, ns: int, body: bytes) -> None:
        """Let a message wait to be sent, if the viewer has subscribed to its channel."""
        for subscription in self._subscribed.get(channel.number, ()):
            data = _DATA.pack(1, subscription, ns) + body
            if channel.keeps == _NEWEST:
                self._newest[subscription] = data
            else:
                self._wait(data)

    def take(self) -> list[str | bytes]:
        """What is to be sent now."""
        found = [*self._waiting, *self._newest.values()]
        self._waiting.clear()
        self._newest.clear()
        return found

    def _wait(self, data: str | bytes) -> None:
        if len(self._waiting) < _MOST_WAITING:
            self._waiting.append(data)
        else:
            self.closed = True

    def _say(self, message: dict[str, Any]) -> None:
        self._wait(msgspec.json.encode(message).decode())

    def _refuse(self, why: str) -> None:
        self._say({"op": "status", "level": _ERROR, "message": why})


OnState = Callable[["JointState", Mapping[str, float]], object]
"""Called with each state of an arm, and the last position that was sent to each joint, radians; it never waits."""


class _Shown:
    """One arm: its channels, and its newest state, which any thread may set."""

    def __init__(
        self,
        arm: ArmModel,
        links: str,
        prefix: str,
        first: int,
        wall: Callable[[], float],
        come: Callable[[], object],
    ) -> None:
        self.prefix, self._wall, self._come = prefix, wall, come
        kinematics = kinematics_for(arm, links)
        self._shapes: ArmShapes | None = make_shapes(kinematics) if kinematics is not None else None
        self._names = arm.names
        topics = _TOPICS if self._shapes is not None else _TOPICS[:2]
        self.channels = {
            name: _Channel(first + i, f"/{prefix}{name}", schema, keeps)
            for i, (name, schema, keeps) in enumerate(topics)
        }
        self.numbers = {channel.number for channel in self.channels.values()}
        self._positions: dict[str, float] = {}
        self._newest: tuple[JointState, float, dict[str, float]] | None = None

    def see(self, state: JointState, goals: Mapping[str, float]) -> None:
        """Keep a state; never waits."""
        self._newest = state, self._wall(), dict(goals)
        self._come()

    def take(self, wanted: Callable[[int], bool]) -> list[tuple[_Channel, float, dict[str, Any]]]:
        """What is new, as channel, time and body."""
        newest, self._newest = self._newest, None
        if newest is None:
            return []
        state, stamp, goals = newest
        known = zip(state.names, state.position, strict=True)
        # A joint that is silent stays where it was.
        self._positions |= {name: position for name, position in known if math.isfinite(position)}
        rows: list[tuple[_Channel, float, dict[str, Any]]] = []
        for name, channel in self.channels.items():
            if not wanted(channel.number) or channel.keeps == _LASTING:
                continue
            if name == "tf":
                assert self._shapes is not None
                body = frame_transforms(self._shapes, self._positions, stamp, self.prefix)
            elif name == "joint_targets":
                body = positions(goals, stamp)
            else:
                body = joint_states(state, stamp, goals)
            rows.append((channel, stamp, body))
        return rows

    def lasting(self) -> list[tuple[_Channel, float, dict[str, Any]]]:
        """What a viewer gets that subscribes."""
        if self._shapes is None:
            return []
        stamp = self._wall()
        return [(self.channels["scene"], stamp, scene_update(self._shapes, self._names, stamp, self.prefix))]


class _Seen:
    """One camera: its channel, and its newest picture, which its thread sets."""

    def __init__(self, camera: Camera, number: int, wall: Callable[[], float], come: Callable[[], object]) -> None:
        self._camera, self._wall, self._come = camera, wall, come
        self.channel = _Channel(number, picture_topic(camera.name), _PICTURES, _NEWEST)
        self._newest: CameraPicture | None = None
        self._end: Callable[[], None] | None = None

    def look(self, wanted: bool) -> None:
        """Look at it, or do not any more."""
        if wanted and self._end is None:
            self._end = self._camera.look(self._see)
        elif not wanted and self._end is not None:
            self._end()
            self._end = self._newest = None

    def _see(self, picture: CameraPicture | None, why: str) -> None:
        # Why there is none is in the log, which viewers have, too.
        self._newest = picture
        self._come()

    def take(self) -> list[tuple[_Channel, float, dict[str, Any]]]:
        """What is new, as channel, time and body."""
        picture, self._newest = self._newest, None
        if picture is None:
            return []
        stamp = picture.stamp + self._wall() - time.monotonic()
        return [(self.channel, stamp, compressed_image(picture.jpeg, self._camera.name, stamp))]


class Foxglove(logging.Handler):
    """The arms that viewers may watch, and the viewers. As a handler it passes the log of hexwire on.

    Args:
        name: Of the server, for viewers.
        wall: Seconds since 1970.
        cameras: Cameras of this computer that viewers may see; none if None.
    """

    def __init__(self, name: str, wall: Callable[[], float] = time.time, cameras: Cameras | None = None) -> None:
        super().__init__(logging.INFO)
        self.name_of_server, self._wall = name, wall
        self._loop: asyncio.AbstractEventLoop | None = None
        self._log_channel = _Channel(_LOG_CHANNEL, _LOG, "foxglove.Log", _EACH)
        self._next = _LOG_CHANNEL + 1
        self._cameras: list[_Seen] = []
        for camera in cameras.rows.values() if cameras is not None else ():
            self.add_camera(camera)
        self._arms: dict[str, _Shown] = {}
        self._viewers: dict[Viewer, asyncio.Event] = {}
        self._lines: deque[tuple[float, dict[str, Any]]] = deque(maxlen=_MOST_LOG)
        self._due = False
        self._passed = -math.inf

    # -- any thread -------------------------------------------------------------------------------------

    def emit(self, record: logging.LogRecord) -> None:
        """Keep a line of the log; never waits."""
        if not self._viewers:
            return
        level = next((found for least, found in _LEVELS if record.levelno >= least), 1)
        stamp = record.created
        try:
            body = log_line(level, record.getMessage(), record.name, stamp, record.filename, record.lineno)
        except Exception:  # noqa: BLE001  # as a handler does: whoever logs must not fail
            self.handleError(record)
            return
        self._lines.append((stamp, body))
        self._soon()

    def add_camera(self, camera: Camera) -> None:
        """Show a camera to viewers that come later."""
        self._cameras.append(_Seen(camera, self._next, self._wall, self._soon))
        self._next += 1

    def show(
        self, prefix: str, arm: ArmModel, links: str = "A"
    ) -> Callable[[JointState, Mapping[str, float]], object]:
        """Show an arm, in place of the one that had this prefix.

        Args:
            prefix: Before the names of its topics and frames, such as ``lab/arm1/``; may be empty.
            arm: The arm.
            links: Link set of a 7Bot, as in `kinematics_for`.

        Returns:
            What is to be called with its states.
        """
        first, self._next = self._next, self._next + len(_TOPICS)
        shown = _Shown(arm, links, prefix, first, self._wall, self._soon)
        self._call(lambda: self._replace(prefix, shown))
        return shown.see

    def hide(self, prefix: str) -> None:
        """End the channels of an arm."""
        self._call(lambda: self._replace(prefix, None))

    def _call(self, call: Callable[[], object]) -> None:
        loop = self._loop
        if loop is None:
            call()
            return
        with contextlib.suppress(RuntimeError):
            loop.call_soon_threadsafe(call)

    def _soon(self) -> None:
        if self._viewers and not self._due:
            self._due = True
            self._call(self._schedule)

    # -- the loop ---------------------------------------------------------------------------------------

    @contextlib.contextmanager
    def running(self) -> Iterator[None]:
        """While the server runs, in its loop; the log is passed on."""
        self._loop = asyncio.get_running_loop()
        log = logging.getLogger("hexwire")
        log.addHandler(self)
        try:
            yield
        finally:
            log.removeHandler(self)

    def _replace(self, prefix: str, shown: _Shown | None) -> None:
        former = self._arms.pop(prefix, None)
        if shown is not None:
            self._arms[prefix] = shown
        for viewer, due in self._viewers.items():
            if former is not None:
                viewer.unadvertise([channel.number for channel in former.channels.values()])
            if shown is not None:
                viewer.advertise(list(shown.channels.values()))
            due.set()

    def _schedule(self) -> None:
        loop = asyncio.get_running_loop()
        loop.call_at(max(loop.time(), self._passed + _PERIOD), self._pass)

    def _pass(self) -> None:
        self._passed = asyncio.get_running_loop().time()
        # Before what is new is taken: what comes meanwhile is passed on next time.
        self._due = False
        rows = [row for arm in self._arms.values() for row in arm.take(self._is_wanted)]
        rows += [row for camera in self._cameras for row in camera.take()]
        while self._lines:
            rows.append((self._log_channel, *self._lines.popleft()))
        for channel, stamp, body in rows:
            self._put(channel, stamp, body, self._viewers)

    def _look(self) -> None:
        """Look at the cameras that somebody has subscribed to, and at no other."""
        for camera in self._cameras:
            camera.look(self._is_wanted(camera.channel.number))

    def _is_wanted(self, number: int) -> bool:
        return any(viewer.wants(number) for viewer in self._viewers)

    def _put(self, channel: _Channel, stamp: float, body: dict[str, Any], viewers: Iterable[Viewer]) -> None:
        data, ns = msgspec.json.encode(body), nanoseconds(stamp)
        for viewer in viewers:
            viewer.put(channel, ns, data)
            self._viewers[viewer].set()

    async def serve(self, websocket: WebSocket) -> None:
        """Serve one viewer, which has passed the gate, until it leaves."""
        if SUBPROTOCOL not in websocket.scope["subprotocols"] or len(self._viewers) >= _MOST_VIEWERS:
            await websocket.close(1008)
            return
        await websocket.accept(SUBPROTOCOL)
        viewer, due = Viewer(), asyncio.Event()
        viewer.begin(self.name_of_server)
        shown = (channel for arm in self._arms.values() for channel in arm.channels.values())
        viewer.advertise([self._log_channel, *(camera.channel for camera in self._cameras), *shown])
        self._viewers[viewer] = due
        due.set()
        works = (self._send(websocket, viewer, due), self._receive(websocket, viewer))
        tasks = [asyncio.create_task(work) for work in works]
        try:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        finally:
            del self._viewers[viewer]
            self._look()
            await end_tasks(tasks)
            with contextlib.suppress(RuntimeError, WebSocketDisconnect, TimeoutError):
                async with asyncio.timeout(_PATIENCE):
                    await websocket.close(1008 if viewer.closed else 1000)

    async def _send(self, websocket: WebSocket, viewer: Viewer, due: asyncio.Event) -> None:
        while not viewer.closed:
            await due.wait()
            due.clear()
            for data in viewer.take():
                async with asyncio.timeout(_PATIENCE):
                    await (websocket.send_text(data) if isinstance(data, str) else websocket.send_bytes(data))

    async def _receive(self, websocket: WebSocket, viewer: Viewer) -> None:
        while not viewer.closed:
            message = await websocket.receive()
            if message["type"] == "websocket.disconnect":
                return
            data = message.get("text")
            begun = set(viewer.receive(message["bytes"] if data is None else data))
            for arm in self._arms.values():
                for channel, stamp, body in arm.lasting() if begun & arm.numbers else ():
                    if channel.number in begun:
                        self._put(channel, stamp, body, (viewer,))
            self._look()
            self._viewers[viewer].set()
            await asyncio.sleep(_PAUSE)
