"""Every page, as everybody meets it: at three sizes, light and dark, and by a screen reader."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from axe_playwright_python.sync_playwright import Axe

from hexwire.studio.pages import PAGES

if TYPE_CHECKING:
    from playwright.sync_api import Page

SIZES = ((1440, 900), (1024, 768), (390, 844))
FAULTY = ("serious", "critical")


def walk(page: Page, path: str) -> None:
    """Go to a page by its link in the header."""
    page.locator(f'.hw-nav-link[data-path="{path}"]').click()
    page.locator(f'.hw-nav-link[data-path="{path}"][aria-current="page"]').wait_for()
    page.get_by_role("heading", level=1).wait_for()


def faults(page: Page, **options: Any) -> list[str]:
    """What axe-core finds that is serious."""
    found = Axe().run(page, options={"resultTypes": ["violations"], **options}).response["violations"]
    return [
        f"{row['id']}: {row['help']}: {[node['html'][:200] for node in row['nodes'][:3]]}"
        for row in found
        if row["impact"] in FAULTY
    ]


def test_accessible_and_never_wider_than_the_screen(operator: Page) -> None:
    wrong: list[str] = []
    for path in [page.path for page in PAGES]:
        operator.set_viewport_size({"width": SIZES[0][0], "height": SIZES[0][1]})
        walk(operator, path)
        wrong += [f"{path}: {fault}" for fault in faults(operator)]
        operator.emulate_media(color_scheme="dark")
        wrong += [f"{path} dark: {f}" for f in faults(operator, runOnly=["color-contrast"])]
        operator.emulate_media(color_scheme="light")
        for width, height in SIZES:
            operator.set_viewport_size({"width": width, "height": height})
            wide = operator.evaluate("document.documentElement.scrollWidth")
            if wide > width:
                wrong.append(f"{path} is {wide} wide at {width}x{height}")
            stop = operator.locator("#hw-stop").bounding_box()
            assert stop is not None
            if not (0 <= stop["x"] <= width - stop["width"] and 0 <= stop["y"] <= height - stop["height"]):
                wrong.append(f"{path}: STOP is out of sight at {width}x{height}")
    assert not wrong, "\n".join(wrong)
