"""Every page, as everybody meets it: at three sizes, light and dark, and by a screen reader."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

import pytest
from tests.studio.conftest import shrink_views
from tests.studio.first_picture import first_picture
from tests.studio.running import PATIENCE

from hexwire.studio.server import PAGES

if TYPE_CHECKING:
    from pathlib import Path

    from playwright.sync_api import Browser, Page
    from tests.studio.running import RunningStudio

SIZES = ((1440, 900), (1024, 768), (390, 844))


def connected(page: Page) -> None:
    """Wait until what is pressed is heard: on a busy machine a page that is examined loses its connection."""
    page.wait_for_function("window.hexwire?.connected")


def walk(page: Page, path: str) -> None:
    """Go to a page by its link in the header."""
    connected(page)
    page.locator(f'.hw-nav-link[data-path="{path}"]').click()
    page.locator(f'.hw-nav-link[data-path="{path}"][aria-current="page"]').wait_for()
    page.get_by_role("heading", level=1).wait_for()


def faults(page: Page, *rules: str, whole: bool = False) -> list[str]:
    """What axe-core finds, by all of its rules or these, with or without the header."""
    from axe_playwright_python.sync_playwright import Axe

    if not page.evaluate("Boolean(window.axe)"):
        page.evaluate(Axe().axe_script)
    place = "document" if whole else "document.getElementById('hw-main')"
    options: dict[str, Any] = {"resultTypes": ["violations"]} | ({"runOnly": rules} if rules else {})
    found = page.evaluate(f"(options) => axe.run({place}, options)", options)["violations"]
    return [f"{row['id']}: {row['help']}: {[node['html'][:200] for node in row['nodes'][:3]]}" for row in found]


def theme(page: Page, name: Literal["light", "dark"]) -> None:
    """Change the colours as a desktop does, and wait until they have changed."""
    page.emulate_media(color_scheme=name)
    page.wait_for_function("(dark) => document.body.classList.contains('body--dark') === dark", arg=name == "dark")
    page.wait_for_function(
        "document.getAnimations().every((a) => a.playState !== 'running' || !a.transitionProperty)"
    )


def resize(page: Page, width: int, height: int) -> None:
    """Give the page another size, and wait until it is drawn so: a click would meet what was there before."""
    page.set_viewport_size({"width": width, "height": height})
    page.wait_for_function(
        """([width, height]) => innerWidth === width && innerHeight === height
            && new Promise((drawn) => requestAnimationFrame(() => requestAnimationFrame(() => drawn(true))))""",
        arg=[width, height],
    )


def examine(page: Page, what: str, *, whole: bool = False, dark: bool = True) -> list[str]:
    """What is wrong with what is shown on every screen; with or without the header, and the dark colours."""
    resize(page, *SIZES[0])
    wrong = [f"{what}: {fault}" for fault in faults(page, whole=whole)]
    if dark:
        theme(page, "dark")
        wrong += [f"{what} dark: {fault}" for fault in faults(page, "color-contrast", whole=whole)]
        theme(page, "light")
    for width, height in SIZES:
        wrong += misfits(page, what, width, height)
    resize(page, *SIZES[0])
    return wrong


def misfits(page: Page, what: str, width: int, height: int) -> list[str]:
    """What does not fit a screen: a page that is wider, plots' buttons in two rows, STOP out of sight."""
    from playwright.sync_api import TimeoutError  # not a subclass of Python's

    wrong: list[str] = []
    resize(page, width, height)
    try:
        # Plots follow a frame or two later.
        page.wait_for_function(f"document.documentElement.scrollWidth <= {width}", timeout=1000 * PATIENCE)
    except TimeoutError:
        wide = page.evaluate("document.documentElement.scrollWidth")
        wrong.append(f"{what} is {wide} wide at {width}x{height}")
    # The title may have a row of its own.
    ends = page.evaluate(
        "[...document.querySelectorAll('.hx-plot-bar')].map((bar) => bar.lastElementChild.offsetTop"
        " - bar.querySelector('button').offsetTop)"
    )
    if any(ends):
        wrong.append(f"{what}: the buttons of a plot take two rows at {width}x{height}")
    stop = page.locator("#hw-stop").bounding_box()
    assert stop is not None
    if not (0 <= stop["x"] <= width - stop["width"] and 0 <= stop["y"] <= height - stop["height"]):
        wrong.append(f"{what}: STOP is out of sight at {width}x{height}")
    return wrong


def test_every_page_opens_without_a_fault_and_fits_a_phone(page: Page) -> None:
    """At least this of every page; `context` fails if one of them writes an error."""
    wrong: list[str] = []
    shrink_views(page)
    for path in PAGES:
        resize(page, *SIZES[0])
        walk(page, path)
        wrong += misfits(page, path, *SIZES[-1])
    assert not wrong, "\n".join(wrong)


_DRAWN = {
    "/move": "#arm-view canvas",
    "/servos": ".sv-list .sv-table",
    "/signals": ".uplot",
    "/wire": ".hw-wire-list",
    "/recordings": ".rc-list",
    # The ports of a computer without any are none.
    "/": ".hw-emulated",
}
"""What a page has drawn in the end."""


@pytest.mark.slow
def test_every_page_keeps_to_its_policy(studio: RunningStudio, browser: Browser) -> None:
    """The other tests evaluate texts, which it forbids; the browser reports what it refuses as an error."""
    context = browser.new_context()
    context.set_default_timeout(1000 * PATIENCE)
    refused: list[str] = []
    context.on("console", lambda message: refused.append(message.text) if message.type == "error" else None)
    try:
        page = context.new_page()
        page.goto(studio.operate_url)
        for path in PAGES:
            page.locator(f'.hw-nav-link[data-path="{path}"]').click()
            page.locator(_DRAWN[path]).first.wait_for()
    finally:
        context.close()
    assert list(_DRAWN) == list(PAGES)
    assert not refused


@pytest.mark.slow
@pytest.mark.parametrize("size", SIZES)
def test_the_first_picture_is_small(studio: RunningStudio, browser: Browser, size: tuple[int, int]) -> None:
    width, height = size
    context = browser.new_context(viewport={"width": width, "height": height})
    context.set_default_timeout(1000 * PATIENCE)
    try:
        picture = first_picture(context.new_page(), studio.operate_url)
    finally:
        context.close()
    assert picture.requests <= 12
    assert picture.sent <= 250_000
    assert picture.raw <= 1_000_000


@pytest.mark.slow
def test_pages_are_accessible_and_never_wider_than_the_screen(operator: Page) -> None:
    wrong: list[str] = []
    for path in PAGES:
        walk(operator, path)
        wrong += examine(operator, path, whole=path == "/")
        if path == "/move":
            for name, drawn in (
                ("Teach and play", "#arm-timeline"),
                ("Program", ".arm-steps"),
                ("Leader arm", "table.arm-leader"),
            ):
                operator.get_by_role("tab", name=name).click()
                operator.locator(drawn).wait_for(state="attached")
                wrong += examine(operator, name)
    assert not wrong, "\n".join(wrong)


@pytest.mark.slow
def test_a_page_without_an_arm_is_readable_in_the_dark_and_leads_on(served: RunningStudio, blank: Page) -> None:
    blank.goto(served.operate_url.replace("/?", "/move?"))
    blank.get_by_text("No arm is open.").wait_for()
    theme(blank, "dark")
    assert not faults(blank, "color-contrast")
    blank.locator("#hw-main").get_by_role("link", name="Servos").click()
    blank.get_by_role("button", name="Open the servo bus").wait_for()


@pytest.mark.slow
def test_the_work_at_servos_is_accessible_too(studio: RunningStudio, blank: Page, tmp_path: Path) -> None:
    studio.studio.source.open_bus(f"sim://so101?name={tmp_path.name}")
    page = blank
    page.goto(studio.operate_url.replace("/?", "/servos?"))
    page.get_by_role("button", name="Take control").click()
    page.get_by_role("button", name="Search", exact=True).click()
    page.get_by_text("6 servos found").wait_for()
    tabs = page.get_by_role("tab")
    wrong: list[str] = []
    for i in range(tabs.count()):
        connected(page)
        tabs.nth(i).click()
        page.locator('[role="tab"][aria-selected="true"]', has_text=tabs.nth(i).inner_text()).wait_for()
        wrong += examine(page, f"servos, {tabs.nth(i).inner_text()}", dark=i == 0)
    assert not wrong, "\n".join(wrong)
    # What is no backup is refused in words.
    connected(page)
    tabs.filter(has_text="Backup").click()
    file = tmp_path / "backup.json"
    file.write_text("[1]")
    with page.expect_file_chooser() as chooser:
        page.get_by_role("button", name="Load a backup").click()
    chooser.value.set_files(file)
    page.get_by_text("not a file of servo settings").wait_for()
