"""A studio that is served in this process, as the tests use it."""

from __future__ import annotations

import dataclasses
import http.client
import itertools
import re
import socket
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING, Any, Self

from tests.waits import PATIENCE
from websockets.sync.client import connect

from hexwire.control.requests.history import History
from hexwire.drivers.abilities import BareServos

if TYPE_CHECKING:
    from playwright.sync_api import Locator, LocatorAssertions, Page

    from hexwire.emulator.servo import EmulatedServo
    from hexwire.studio.app import Studio

__all__ = [
    "PATIENCE",
    "PICTURES",
    "RunningStudio",
    "Visitor",
    "attempt",
    "expect",
    "fill_history",
    "hold",
    "press",
    "serve",
    "until",
]

PICTURES = "new Promise((drawn) => requestAnimationFrame(() => requestAnimationFrame(() => drawn(true))))"
"""For `Page.evaluate`: wait until what has come before is drawn."""

_names = itertools.count(1)


def until(true: Callable[[], object], what: str, seconds: float = PATIENCE) -> None:
    """Wait until something is true, at most so long."""
    deadline = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < deadline, f"not in time: {what}"
        time.sleep(0.01)


def fill_history(source: Any, rows: int = 60_000) -> None:
    """Give an arm that is open a history: ten minutes at most, until now."""
    state, history = source.arm.owner.state, History(source.settings.model.names)
    now = source.arm.owner.now()
    for at in range(rows):
        history.append(dataclasses.replace(state, stamp=now - 0.01 * (rows - at)), {})
    # Only now: what the arm adds is newer than all of it.
    source.history = history


def expect(shown: Locator) -> LocatorAssertions:
    """Playwright's, which waits as long as everything here; imported when it is needed."""
    from playwright.sync_api import expect

    expect.set_options(timeout=1000 * PATIENCE)
    return expect(shown)


def press(page: Page, button: Locator, begun: Callable[[], object], *, key: bool = False) -> None:
    """Hold a button, by the mouse or a key, until something has begun; see `attempt`."""

    def down() -> None:
        if key:
            button.focus()
            page.keyboard.down("Space")
        else:
            button.hover()
            page.mouse.down()

    attempt(down, lambda: page.keyboard.up("Space") if key else page.mouse.up(), begun)


def hold(page: Page, directions: Mapping[str, float], begun: Callable[[], object], speed: float = 0.2) -> None:
    """Let a page hold a jog until something has begun; `window.over` says then why it ended. See `attempt`."""
    jog = {"directions": dict(directions), "speed": speed}
    attempt(
        lambda: page.evaluate("(jog) => { window.over = hexwire.hold('joint', jog); }", jog),
        lambda: page.evaluate("hexwire.release()"),
        begun,
    )


def attempt(begin: Callable[[], object], undo: Callable[[], object], begun: Callable[[], object]) -> None:
    """Begin something until it has begun; again if it has not.

    On a busy machine an arm that has not answered for a moment refuses a motion, and what was entered before may
    still shift a page under the mouse.
    """
    for _ in range(5):
        begin()
        deadline = time.monotonic() + PATIENCE / 5
        while time.monotonic() < deadline:
            if begun():
                return
            time.sleep(0.02)
        undo()
    raise AssertionError("nothing has begun")


class RunningStudio:
    """A studio that is served, and the servos of the emulated arm that it has open.

    Attributes:
        studio: The studio.
        url: Its address, without a token.
    """

    def __init__(self, studio: Studio, url: str) -> None:
        self.studio, self.url = studio, url

    @property
    def operate_url(self) -> str:
        """The address for somebody who may take control."""
        return f"{self.url}/?token={self.studio.access.operate_token}"

    @property
    def watch_url(self) -> str:
        """The address for somebody who only watches."""
        return f"{self.url}/?token={self.studio.access.watch_token}"

    def open(self, kind: str = "hex7bot", *, silence: float = 5.0, **options: object) -> None:
        """Open a fresh emulated arm in the studio.

        Args:
            kind: ``hex7bot`` (with a board), ``so101`` or ``so100``.
            silence: Seconds without a beat after which a hold ends; more than in earnest, for a busy machine.
            **options: Further options of the address.
        """
        self.studio.source.silence = silence
        rows = "&".join([f"name=studio{next(_names)}", *(f"{key}={value}" for key, value in options.items())])
        self.studio.source.open(f"sim://{kind}?{rows}")
        self.until(lambda: self.arm.owner.state is not None, "a state")

    @property
    def arm(self) -> Any:
        """The `ControlledArm`."""
        source = self.studio.source.arm
        assert source is not None
        return source.arm

    @property
    def servos(self) -> dict[int, EmulatedServo]:
        """The emulated servos by id."""
        link: Any = _link_of(self.arm.owner.robot)
        device = link.device
        servos = device.wire.servos if hasattr(device, "wire") else device.servos
        return {servo.servo_id: servo for servo in servos}

    def goals(self) -> dict[int, int]:
        """Goal position of each emulated servo by id, in its counts."""
        found = {}
        for number, servo in self.servos.items():
            name = "goal_position" if "goal_position" in servo.registers.rows else "target_position"
            found[number] = servo.registers.get(name)
        return found

    def torque(self) -> None:
        """Switch torque on, without anybody's control."""
        self.arm.owner.torque(True, self.arm.settings.model.names)

    def until(self, true: Callable[[], object], what: str, seconds: float = PATIENCE) -> None:
        """Wait until something is true, at most so long."""
        until(true, what, seconds)

    def cut(self, page: Page) -> None:
        """End the connection of a page, and wait until the server has; the page then opens another."""
        key, live = page.evaluate("hexwire.key"), self.studio.live

        def sockets() -> list[Any]:
            return [each for each in list(live._sockets) if each.tab.key == key]

        # A browser may know that it is connected before the server keeps its socket.
        self.until(sockets, "the page's socket")
        (ended,) = sockets()
        ended.too_slow = True
        self.studio.soon(ended._wake.set)
        self.until(ended.over.is_set, "the end of the page's socket")

    def stopped(self, what: str) -> None:
        """Wait until the arm is stopped and the board has said so: then a reset is asked for after the stop."""
        owner = self.arm.owner
        until(lambda: owner.group.reason is not None and owner.state is not None and owner.state.stopped, what)


@contextmanager
def serve(studio: Studio) -> Iterator[RunningStudio]:
    """Serve a studio in a thread of this process, at a free port; nothing is open in it at first."""
    from hexwire.studio.server import Server, make_app

    server = Server(partial(make_app, studio), studio.access)
    port = server.bind()
    studio.access.hosts = frozenset({f"127.0.0.1:{port}", f"localhost:{port}"})
    ready = threading.Event()
    thread = threading.Thread(target=server.run, args=(ready.set,), name="studio server", daemon=True)
    thread.start()
    assert ready.wait(PATIENCE)
    try:
        yield RunningStudio(studio, f"http://127.0.0.1:{port}")
    finally:
        server.end()
        thread.join(PATIENCE)
        studio.close()


def _link_of(robot: Any) -> Any:
    session = getattr(robot, "session", None)
    return session.ipc.link if session is not None else BareServos.of(robot).servo_link


class Visitor:
    """Somebody who talks to a studio without a browser.

    Args:
        running: The studio.
        token: With which a session is begun; none if empty.
        host: The Host header.
        origin: The Origin header; that of the studio if None, left out if empty.
    """

    def __init__(
        self, running: RunningStudio, token: str = "", *, host: str | None = None, origin: str | None = None
    ) -> None:
        self.port = int(running.url.rpartition(":")[2])
        self.host = f"127.0.0.1:{self.port}" if host is None else host
        self.origin = running.url if origin is None else origin
        self.cookie = ""
        if token:
            status, headers, _ = self.ask(f"/?token={token}", Origin="")
            assert status == 200
            self.cookie = headers["set-cookie"].partition(";")[0]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def ask(self, path: str, method: str = "GET", body: bytes | None = None, **headers: str) -> Any:
        """Status, headers by lower-case name, and body of a request; empty headers are left out."""
        line = http.client.HTTPConnection("127.0.0.1", self.port, timeout=PATIENCE)
        try:
            rows = {"Host": self.host, "Origin": self.origin, "Cookie": self.cookie} | headers
            line.putrequest(method, path, skip_host=True, skip_accept_encoding=True)
            for name, value in rows.items():
                if value:
                    line.putheader(name, value)
            if body is not None and "Content-Length" not in headers:
                line.putheader("Content-Length", str(len(body)))
            line.endheaders(body)
            answer = line.getresponse()
            return answer.status, {k.lower(): v for k, v in answer.getheaders()}, answer.read()
        finally:
            line.close()

    def page(self, path: str = "/") -> str:
        """Load a page; the key of its tab."""
        status, _, body = self.ask(path, Origin="")
        assert status == 200
        found = re.search(rb'name="hexwire-tab" content="([^"]+)"', body)
        assert found is not None
        return found[1].decode()

    def socket(self, path: str, **options: Any) -> Any:
        """Open a socket; a context manager."""
        rows = {"Host": self.host, "Origin": self.origin, "Cookie": self.cookie}
        line = socket.create_connection(("127.0.0.1", self.port), timeout=PATIENCE)
        headers = {name: value for name, value in rows.items() if value and name != "Host"}
        try:
            return connect(f"ws://{self.host}{path}", sock=line, additional_headers=headers, **options)
        except BaseException:
            line.close()
            raise
