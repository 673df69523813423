"""The page Servos with an arm that is open; its parts are tested in tests/studio/servos."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from playwright.sync_api import Page
    from tests.studio.running import RunningStudio


@pytest.mark.slow
def test_page_has_its_heading(page: Page) -> None:
    page.get_by_role("navigation", name="Pages").get_by_role("link", name="Servos", exact=True).click()
    page.get_by_role("heading", name="Servos", level=1).wait_for()


@pytest.mark.slow
def test_an_arm_on_an_adapter_is_left_for_its_servos(served: RunningStudio, blank: Page) -> None:
    served.open("so101")
    page = blank
    page.goto(served.operate_url.replace("/?", "/servos?"))
    # What is wrong with the arm leads to where it is mended.
    page.locator("#hw-banner").get_by_role("link", name="First run").wait_for()
    page.get_by_role("button", name="Take control").click()
    page.get_by_role("button", name="Give back").wait_for()
    page.get_by_role("button", name="Work at the servos").click()
    page.get_by_role("button", name="Close the arm, open its servos").click()
    page.get_by_role("button", name="Search", exact=True).wait_for()
    try:
        assert served.studio.source.mode == "bus"
        page.get_by_role("button", name="Give back").wait_for()
    finally:
        served.studio.source.close()
