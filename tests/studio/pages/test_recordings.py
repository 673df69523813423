"""The page Recordings, as a person uses it."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from playwright.sync_api import Page


def test_page_has_its_heading(page: Page) -> None:
    page.get_by_role("link", name="Recordings", exact=True).click()
    page.get_by_role("heading", name="Recordings", level=1).wait_for()
