"""A studio in this process on an emulated arm, and pages of a real browser that show it.

NiceGUI has one app in a program, so there is one server for all tests of a worker; each test that asks for `studio`
gets a fresh emulated arm in it. The browser is started once per worker too; each test has windows of its own.
"""

from __future__ import annotations

import asyncio
import re
import threading
from collections.abc import Iterator
from typing import TYPE_CHECKING

import pytest
from tests.studio.chromium import chromium
from tests.studio.running import PATIENCE, RunningStudio

from hexwire.studio.access import Access
from hexwire.studio.app import Studio

if TYPE_CHECKING:
    from playwright.sync_api import Browser, BrowserContext, Page

_SERVERS_OWN = re.compile(r"AnyIO worker thread|asyncio_\d+|studio( orders| stops)?_\d+")
"""Threads of the server of this worker, which begin when they are first needed."""


@pytest.fixture(autouse=True)
def _no_thread_left() -> Iterator[None]:
    """As for all tests, but for the threads of the server."""
    before = set(threading.enumerate())
    yield
    left = [t for t in threading.enumerate() if t not in before and not _SERVERS_OWN.fullmatch(t.name)]
    for thread in left:
        thread.join(timeout=5.0)
    alive = [thread.name for thread in left if thread.is_alive()]
    assert not alive, f"threads left behind: {alive}"


@pytest.fixture(scope="session")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningStudio]:
    """One server for all tests of this worker; nothing is open in it at first. Tests use `studio`."""
    from hexwire.studio.server import Server

    studio = Studio(Access(frozenset()), tmp_path_factory.mktemp("recordings"))
    server = Server(studio)
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


@pytest.fixture
def studio(served: RunningStudio) -> Iterator[RunningStudio]:
    """The studio on a fresh emulated Hex7Bot."""
    served.open()
    try:
        yield served
    finally:
        served.studio.source.close()
        served.studio.fleet.rest()
        served.studio.access.end_all()


@pytest.fixture(scope="session")
def _chromium() -> Iterator[tuple[Browser, asyncio.AbstractEventLoop]]:
    """One Chromium per worker, and the event loop of Playwright, which the worker's other tests must not see."""
    with chromium() as made:
        loop = asyncio.get_running_loop()
        asyncio._set_running_loop(None)
        try:
            yield made, loop
        finally:
            asyncio._set_running_loop(loop)


@pytest.fixture
def browser(_chromium: tuple[Browser, asyncio.AbstractEventLoop]) -> Iterator[Browser]:
    """The Chromium of this worker."""
    made, loop = _chromium
    # Playwright runs a loop in this thread, beside the test: `asyncio.run` would refuse to work next to it.
    asyncio._set_running_loop(loop)
    try:
        yield made
    finally:
        asyncio._set_running_loop(None)


@pytest.fixture
def context(browser: Browser) -> Iterator[BrowserContext]:
    """A browser without cookies; fails the test if a page wrote an error or asked for anything outside."""
    made = browser.new_context(viewport={"width": 1440, "height": 900})
    made.set_default_timeout(1000 * PATIENCE)
    faults: list[str] = []
    made.on("console", lambda message: faults.append(message.text) if message.type == "error" else None)
    made.on("weberror", lambda error: faults.append(str(error.error)))
    outside: list[str] = []
    made.on("request", lambda request: None if "//127.0.0.1:" in request.url else outside.append(request.url))
    try:
        yield made
    finally:
        made.close()
    assert not faults, faults
    assert not [url for url in outside if not url.startswith(("data:", "blob:"))]


def ready(page: Page) -> Page:
    """Wait until a page has its socket and its first frame."""
    page.wait_for_function("window.did_handshake && window.hexwire && window.hexwire.frame")
    return page


@pytest.fixture
def page(studio: RunningStudio, context: BrowserContext) -> Page:
    """A page of the studio, with its first frame."""
    made = context.new_page()
    made.goto(studio.operate_url)
    return ready(made)


@pytest.fixture
def operator(page: Page) -> Page:
    """A page that has control; torque is off."""
    page.get_by_role("button", name="Take control").click()
    page.get_by_role("button", name="Give back").wait_for()
    return page
