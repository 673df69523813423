from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from playwright.sync_api import Page


@pytest.mark.slow
def test_a_board_tells_what_it_knows_and_that_registers_need_an_adapter(page: Page) -> None:
    page.get_by_role("link", name="Servos", exact=True).click()
    page.get_by_role("heading", name="Servos", level=1).wait_for()
    page.get_by_text("Registers, ids and rates need an adapter").wait_for()
    row = page.get_by_role("row").filter(has_text="J5").first
    page.wait_for_function(
        "[...document.querySelectorAll('[data-frame=position]')].every((c) => c.textContent !== '–')"
    )
    # A busy machine is taken for a silent arm meanwhile.
    row.filter(has_text="ok").wait_for()
    page.get_by_role("button", name="Ping every servo").click()
    page.get_by_role("region", name="Pings").get_by_text("ok").nth(6).wait_for()
