"""The studio as people use it: with what breaks meanwhile, with a second person, and without a mouse."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from tests.ros1.ros_world import PtyBoard
from tests.studio.conftest import always_known, ready
from tests.studio.running import hold
from tests.studio.test_every_page import walk

from hexwire.studio.server import PAGES

if TYPE_CHECKING:
    from playwright.sync_api import Browser, BrowserContext, Locator, Page
    from tests.studio.running import RunningStudio

_NOTE_FOCUS = """() => {
  window.visited = [];
  document.addEventListener("focusin", (event) => {
    const style = getComputedStyle(event.target);
    const seen = style.outlineStyle !== "none";
    window.visited.push([event.target, Boolean(seen)]);
  }, { capture: true });
}"""
_MISSED = """() => {
  const wanted = "a[href], button, input, select, textarea, summary, [tabindex]";
  const named = (e) => `${e.tagName} ${e.id} ${e.ariaLabel || e.textContent || e.name}`.slice(0, 80);
  const visited = new Map(window.visited);
  const all = [...document.querySelectorAll(wanted)].filter((e) =>
    e.tabIndex >= 0 && !e.disabled && e.checkVisibility({ visibilityProperty: true }) && !e.closest("[inert]")
    && !(e.type === "radio" && !e.checked));
  return all.filter((e) => !visited.get(e)).map((e) => (visited.has(e) ? "no focus to be seen: " : "") + named(e));
}"""
"""What a person does not reach by Tab, or cannot see to have reached."""


_SILENT = (
    ("Move", 'tr[data-joint="J5"] [data-value="state"]', "silent"),
    ("Servos", '[data-frame="flags"][data-joint="4"]', "silent"),
    ("Signals", '.hx-plot-legend tr:has(th:has-text("J5 position")) td:nth-child(3)', "–"),
    ("Arms", ".hw-fleet-table td[data-label=Faults]", "J5: silent"),
)
"""Where each page says how J5 is, and what of it if it is silent."""


def fact(page: Page, name: str, text: str) -> Locator:
    """One of the facts of the header, once it says this."""
    found = page.locator(f"#hw-fact-{name}", has_text=text)
    found.wait_for(state="attached")
    return found


def button(page: Page, name: str) -> Locator:
    return page.get_by_role("button", name=name, exact=True)


@pytest.fixture
def board(studio: RunningStudio, tmp_path: Path) -> Iterator[PtyBoard]:
    """A board with a cable, in the studio in place of the emulated arm."""
    board = PtyBoard(tmp_path / "arm")
    studio.studio.source.open(board.port)
    try:
        yield board
    finally:
        studio.studio.source.close()
        board.close()


# -- what breaks --------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_silent_servo_and_a_pulled_cable(board: PtyBoard, operator: Page) -> None:
    page = operator
    fact(page, "connection", str(board.port))
    button(page, "Torque on").click()
    fact(page, "torque", "on")
    board.faults("silent:4")
    fact(page, "faults", "J5")
    # Every page says the same of it, and nothing that is from before.
    for title, cell, words in _SILENT:
        page.get_by_role("link", name=title, exact=True).click()
        page.locator(cell).filter(has_text=words).first.wait_for()
        for good in ("ok", "holds"):
            assert page.locator(cell).filter(has_text=good).count() == 0
        if title == "Move":
            for name in ("Go", "Take present values"):
                assert button(page, name).is_disabled()
            page.locator("#arm-plan").filter(has_text="J5 does not answer").wait_for()
            page.get_by_role("radio", name="Joint angles").check()
            page.locator("#arm-plan").filter(has_text="J5 does not answer").wait_for()
    board.faults()
    fact(page, "faults", "none")
    board.unplug()
    fact(page, "connection", "lost")
    # What was true before may be wrong now.
    fact(page, "torque", "unknown")
    fact(page, "trip", "–")
    page.get_by_role("status").filter(has_text="The arm is not connected").wait_for()
    board.plug()
    # It comes back by itself, but does not move before somebody says so.
    fact(page, "connection", str(board.port))
    page.get_by_role("status").filter(has_text="Stopped").wait_for()
    button(page, "Resume").click()
    page.locator("body:not(.hw-stopped)").wait_for()
    fact(page, "torque", "on")


# -- two people ---------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_one_moves_and_the_others_watch_and_stop(
    studio: RunningStudio, browser: Browser, context: BrowserContext, operator: Page
) -> None:
    studio.torque()
    viewer = browser.new_context(bypass_csp=True)
    watcher = viewer.new_page()
    watcher.goto(studio.watch_url)
    ready(watcher)
    # It sees who has control, and has no button to take it.
    fact(watcher, "holder", "page")
    assert button(watcher, "Take control").count() == 0
    begin = studio.goals()
    hold(operator, {"J1": 1}, lambda: studio.goals() != begin)
    button(watcher, "STOP").click()
    assert "stopped" in operator.evaluate("window.over")
    studio.until(lambda: studio.arm.owner.group.reason is not None, "the stop")
    operator.get_by_role("status").filter(has_text="Stopped").wait_for()
    # A second tab takes control; the first one is told, and cannot move any more.
    second = context.new_page()
    second.goto(studio.url)
    ready(second)
    button(second, "Take control").click()
    button(second, "Resume").click()
    fact(second, "holder", "this page")
    button(operator, "Take control").wait_for()
    refused = operator.evaluate("hexwire.hold('joint', { directions: { J1: 1 } })")
    assert "does not have control" in refused
    viewer.close()


# -- by keyboard --------------------------------------------------------------------------------------------


def _missed_by_tab(page: Page) -> list[str]:
    """What is not reached, or not seen to be, by Tab from the beginning of a page to its end."""
    page.evaluate("document.activeElement.blur(); window.getSelection().removeAllRanges()")
    page.evaluate(_NOTE_FOCUS)
    count = page.evaluate("document.querySelectorAll('a, button, input, select, textarea, [tabindex]').length")
    for _ in range(count + 5):
        page.keyboard.press("Tab")
    missed: list[str] = page.evaluate(_MISSED)
    return missed


@pytest.mark.slow
def test_everything_is_reached_and_seen_by_tab(operator: Page) -> None:
    wrong: list[str] = []
    for path in PAGES:
        walk(operator, path)
        operator.wait_for_timeout(200)
        missed = _missed_by_tab(operator)
        if missed:
            # On a busy machine a part of the page may have come after the start.
            operator.wait_for_timeout(3000)
            missed = _missed_by_tab(operator)
        wrong += [f"{path}: {each}" for each in missed]
    assert not wrong, "\n".join(wrong)


@pytest.mark.slow
def test_an_arm_is_moved_and_stopped_by_keyboard_only(
    studio: RunningStudio, page: Page, never_silent: None
) -> None:
    always_known(page)
    page.locator("body").press("Tab")
    for name in ("Take control", "Torque on"):
        _tab_to(page, name)
        page.keyboard.press("Enter")
        button(page, {"Take control": "Give back", "Torque on": "Torque off"}[name]).wait_for()
    fact(page, "torque", "on")
    page.keyboard.press("Escape")
    page.get_by_role("status").filter(has_text="Stopped").wait_for()
    _tab_to(page, "Resume")
    page.keyboard.press("Enter")
    page.locator("body:not(.hw-stopped)").wait_for()
    # A whole task: to the page Move, steps of 10 degrees, and two of them.
    _focus(page, page.get_by_role("link", name="Move", exact=True))
    page.keyboard.press("Enter")
    steps = page.locator('input[name="step"]')
    steps.last.and_(page.locator(":enabled")).wait_for()
    _focus(page, steps.first)
    for _ in range(steps.count() - 1):
        page.keyboard.press("ArrowRight")
    begin = studio.arm.owner.newest().positions["J1"]
    _tab_to(page, "Jog J1 up")
    for _ in range(2):
        page.keyboard.press("Enter")
    studio.until(
        lambda: abs(studio.arm.owner.newest().positions["J1"] - begin - math.radians(20.0)) < 0.01, "two steps"
    )
    _tab_to(page, "STOP")
    page.keyboard.press("Enter")
    studio.until(lambda: studio.arm.owner.group.reason is not None, "the stop")


def _tab_to(page: Page, name: str) -> None:
    """Press Tab until a button has the focus."""
    _focus(page, button(page, name))


def _focus(page: Page, wanted: Locator) -> None:
    """Press Tab until something has the focus."""
    wanted.wait_for()
    for _ in range(100):
        if wanted.evaluate("(e) => e === document.activeElement"):
            return
        page.keyboard.press("Tab")
    raise AssertionError(f"Tab does not lead to {wanted}")


@pytest.mark.slow
def test_a_page_that_cannot_be_loaded_says_so_and_is_loaded_when_the_studio_is_back(
    studio: RunningStudio, browser: Browser
) -> None:
    """Nothing was shown, and nothing more when the studio was back."""
    # With errors of the browser about what it did not reach.
    window = browser.new_context(bypass_csp=True)
    try:
        page = window.new_page()
        page.goto(studio.operate_url)
        page.wait_for_function("window.hexwire?.connected")
        page.evaluate(
            "const Real = WebSocket; window.away = true;"
            "window.WebSocket = class extends Real { constructor(to) { super(away ? 'ws://127.0.0.1:1/' : to); } };"
            "window.WebSocket.OPEN = Real.OPEN;"
        )
        page.route("**/static/plots.js", lambda route: route.abort())
        studio.cut(page)
        page.wait_for_function("!hexwire.connected")
        page.locator('.hw-nav-link[data-path="/signals"]').click()
        page.get_by_text("this page is loaded when the studio is back").wait_for()
        page.unroute_all()
        page.evaluate("away = false")
        page.wait_for_function("window.away === undefined && window.hexwire?.connected")
        page.locator(".uplot").first.wait_for()
    finally:
        window.close()
