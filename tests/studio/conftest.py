"""A studio in this process on an emulated arm, and pages of a real browser that show it.

There is one server for all tests of a worker; each test that asks for `studio` gets a fresh emulated arm in it. The
browser is started once per worker too, and its tests share a window in turn.
"""

from __future__ import annotations

import asyncio
import re
import threading
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import pytest
from tests.studio.chromium import chromium
from tests.studio.running import PATIENCE, RunningStudio, serve
from tests.threads import left_behind

from hexwire.control.loop import known_state, owner
from hexwire.control.requests.settings_reader import read_settings
from hexwire.control.sharing.lease import Lease
from hexwire.studio import arm_source, source
from hexwire.studio.access import Access
from hexwire.studio.app import Studio

if TYPE_CHECKING:
    from playwright.sync_api import (
        Browser,
        BrowserContext,
        ConsoleMessage,
        Page,
        Request,
        ViewportSize,
        WebError,
    )

_SERVERS_OWN = re.compile(
    r"AnyIO worker thread|asyncio_\d+|(studio|fleet) stops(_\d+)?|studio (orders|waits|computes|files)_\d+"
)
"""Threads of the server of this worker, which begin when they are first needed."""
_VIEWPORT: ViewportSize = {"width": 1440, "height": 900}


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put first what needs the server: workers take over tests from the end, so one starts a browser, not four."""
    items.sort(key=lambda item: "served" not in getattr(item, "fixturenames", ()))


@pytest.fixture(autouse=True)
def _no_thread_left() -> Iterator[None]:
    """As for all tests, but for the threads of the server."""
    before = set(threading.enumerate())
    yield
    left = left_behind(before, lambda thread: _SERVERS_OWN.fullmatch(thread.name) is not None)
    assert not left, f"threads left behind: {left}"


@pytest.fixture(autouse=True)
def _patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """A busy machine is taken neither for a program that has died nor for an arm that lags behind its path.

    What ends a motion or a lease after how long is tested in simulated time, in `tests/control`.
    """
    usual: dict[str, Any] = {"watchdog": 30.0, "safety": {"following_time": 5.0, "lag": 2.0, "max_age": 5.0}}

    def read(given: dict[str, object], *rest: Any) -> Any:
        emulated = str(given["port"]).startswith("sim://")
        return read_settings((usual if emulated else {}) | given, *rest)

    monkeypatch.setattr(source, "read_settings", read)
    monkeypatch.setattr(arm_source, "Lease", lambda timeout: Lease(timeout=PATIENCE))


@pytest.fixture
def never_silent(monkeypatch: pytest.MonkeyPatch) -> None:
    """A busy machine is not taken for an arm that is silent, whose page forgets what was typed.

    Nor are motions refused meanwhile, for which a page that does not know of it would not ask again.
    """
    monkeypatch.setattr(known_state, "KNOWN_FOR", PATIENCE)
    monkeypatch.setattr(owner, "_FRESH", PATIENCE)


@pytest.fixture(scope="session")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningStudio]:
    """One server for all tests of this worker; nothing is open in it at first. Tests use `studio`."""
    from hexwire.studio.foxglove import Foxglove

    recordings = tmp_path_factory.mktemp("recordings")
    with serve(Studio(Access(frozenset()), recordings, Foxglove("hexwire studio"))) as running:
        yield running


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
    with chromium(one_renderer=True) as made:
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


class _Windows:
    """The windows of this worker's tests: a new process of the browser costs a second, so one page stays for all.

    Between two tests it forgets what it has shown and stored; whatever a test does to it that cannot be taken back,
    such as closing it, costs it its place.
    """

    def __init__(self) -> None:
        self.context: BrowserContext | None = None
        self.page: Page | None = None

    def open(self, browser: Browser) -> tuple[BrowserContext, Page]:
        """The context and its page, as if both were new."""
        if self.context is None or self.page is None:
            # Playwright evaluates what a test waits for as a text, which the policy of pages forbids. That pages
            # keep to it is seen in `test_every_page.py`.
            self.context = browser.new_context(viewport=_VIEWPORT, bypass_csp=True)
            self.context.set_default_timeout(1000 * PATIENCE)
            self.page = self.context.new_page()
        return self.context, self.page

    def forget(self) -> None:
        """Leave what is shown, and everything that the browser keeps of it."""
        from playwright.sync_api import Error

        if self.context is None or self.page is None:
            return
        try:
            for other in self.context.pages:
                if other is not self.page:
                    other.close()
            self.page.mouse.up()
            self.page.mouse.move(0, 0)
            if self.page.url.startswith("http"):
                self.page.evaluate("localStorage.clear(); sessionStorage.clear()")
            self.page.goto("about:blank")
            self.page.unroute_all()
            self.context.unroute_all()
            self.context.clear_cookies()
            self.page.set_viewport_size(_VIEWPORT)
            self.page.emulate_media(color_scheme="light")
            # A clock that a test has installed stays, for every page of the window.
            if "native code" not in self.page.evaluate("String(Date.now)"):
                self.close()
        except Error:
            self.close()

    def close(self) -> None:
        """Close the window, and with it every connection of the browser."""
        if self.context is not None:
            self.context.close()
        self.context = self.page = None


@pytest.fixture(scope="session")
def _windows(_chromium: tuple[Browser, asyncio.AbstractEventLoop]) -> _Windows:
    return _Windows()


@pytest.fixture
def context(browser: Browser, _windows: _Windows) -> Iterator[BrowserContext]:
    """A browser without cookies; fails the test if a page wrote an error or asked for anything outside."""
    made, _ = _windows.open(browser)
    faults: list[str] = []
    outside: list[str] = []

    def said(message: ConsoleMessage) -> None:
        if message.type == "error":
            faults.append(message.text)

    def raised(error: WebError) -> None:
        faults.append(str(error.error))

    def asked(request: Request) -> None:
        if "//127.0.0.1:" not in request.url:
            outside.append(request.url)

    made.on("console", said)
    made.on("weberror", raised)
    made.on("request", asked)
    try:
        yield made
    finally:
        made.remove_listener("console", said)
        made.remove_listener("weberror", raised)
        made.remove_listener("request", asked)
        _windows.forget()
    assert not faults, faults
    assert not [url for url in outside if not url.startswith(("data:", "blob:"))]


@pytest.fixture
def blank(context: BrowserContext, _windows: _Windows) -> Page:
    """A page that shows nothing yet; cheaper than `context.new_page()`."""
    assert _windows.page is not None
    return _windows.page


def shrink_views(page: Page) -> None:
    """Draw arms in 3D as a narrow strip until the page is loaded again: without a graphics chip pixels are dear."""
    page.evaluate(
        """() => {
            const sheet = new CSSStyleSheet();
            sheet.replaceSync("#arm-view, .rc-arm, .fr-view { height: 32px !important; min-height: 0 !important }");
            document.adoptedStyleSheets.push(sheet);
        }"""
    )


def always_known(page: Page) -> None:
    """Let a page not take a busy machine for a silent studio, until it is loaded again."""
    page.evaluate(
        "() => { Object.defineProperty(hexwire, 'known', { get: () => Boolean(hexwire.facts?.known) }); }"
    )


def ask_for_long(page: Page) -> None:
    """Let a question such as "Sure?" wait longer for its second press than in earnest, for a busy machine."""
    page.evaluate(
        """() => {
            const plain = window.setTimeout;
            window.setTimeout = (call, ms, ...more) => plain(call, [3000, 4000].includes(ms) ? 60000 : ms, ...more);
        }"""
    )


def ready(page: Page) -> Page:
    """Wait until a page has its socket and its first frame."""
    page.wait_for_function("window.hexwire && window.hexwire.frame")
    return page


@pytest.fixture
def page(studio: RunningStudio, blank: Page) -> Page:
    """A page of the studio, with its first frame."""
    blank.goto(studio.operate_url)
    return ready(blank)


@pytest.fixture
def operator(page: Page) -> Page:
    """A page that has control; torque is off."""
    page.get_by_role("button", name="Take control").click()
    page.get_by_role("button", name="Give back").wait_for()
    return page
