"""The frame of every page: facts in sight, and STOP by button and by Escape."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from playwright.sync_api import Page
    from tests.studio.running import RunningStudio


@pytest.mark.parametrize("how", ["button", "Escape"])
def test_stop_is_always_there(studio: RunningStudio, page: Page, how: str) -> None:
    page.locator("#hw-fact-dialect", has_text="2").wait_for()
    if how == "button":
        page.get_by_role("button", name="STOP").click()
    else:
        page.keyboard.press("Escape")
    studio.until(lambda: studio.arm.owner.group.reason is not None, "the stop")
    page.locator("#hw-banner", has_text="Stopped").wait_for()
