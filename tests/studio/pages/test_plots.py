"""The page Signals, as a person uses it."""

from __future__ import annotations

import csv
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from playwright.sync_api import Page
    from tests.studio.running import RunningStudio


def _open(page: Page) -> None:
    page.get_by_role("navigation", name="Pages").get_by_role("link", name="Signals", exact=True).click()
    page.get_by_role("heading", name="Signals", level=1).wait_for()
    page.locator(".uplot").first.wait_for()


@pytest.mark.slow
def test_signals_of_joints_are_drawn_with_their_history_and_saved(page: Page, studio: RunningStudio) -> None:
    began = studio.studio.source.arm.history.rows().times[0]
    _open(page)
    # What was before the page was opened is there, and it goes on.
    row = page.get_by_role("row", name="J3 position")
    row.wait_for()
    page.wait_for_function("document.querySelectorAll('.hx-plot-legend tbody td')[1].textContent !== '–'")
    assert page.locator(".uplot").count() == 1
    assert page.evaluate("document.scrollingElement.scrollHeight <= innerHeight"), "the plot fills the page"
    # A signal in another unit gets a panel of its own; a joint less, and its rows are gone.
    page.get_by_role("checkbox", name="voltage").check()
    page.wait_for_function("document.querySelectorAll('.uplot').length === 2")
    page.get_by_role("group", name="Joints").get_by_role("checkbox", name="J3").uncheck()
    row.wait_for(state="detached")
    page.get_by_role("row", name="J4 voltage").wait_for()
    page.get_by_role("checkbox", name="all ten minutes").check()
    with page.expect_download() as saved:
        page.get_by_role("button", name="Save what is shown as CSV").click()
    assert saved.value.suggested_filename.endswith("hex7bot.csv")
    with open(saved.value.path(), encoding="utf-8") as file:  # noqa: PTH123
        head, *rows = csv.reader(file)
    assert "J4.voltage" in head
    assert "J3.position" not in head
    # A difference is saved as the two values that it is of, also alone.
    signals = page.get_by_role("group", name="Signals")
    for name in ("position °", "goal °", "voltage V"):
        signals.get_by_role("checkbox", name=name, exact=True).uncheck()
    signals.get_by_role("checkbox", name="goal − position").check()
    page.get_by_role("row", name="J4 goal − position").wait_for()
    with page.expect_download() as saved:
        page.get_by_role("button", name="Save what is shown as CSV").click()
    with open(saved.value.path(), encoding="utf-8") as file:  # noqa: PTH123
        head = next(csv.reader(file))
    assert head[1:] == [f"J{i}.{key}" for i in (1, 2, 4, 5, 6, 7) for key in ("position", "goal")]
    kept = studio.studio.source.arm.history.rows()
    assert len(rows) > 5
    assert kept.times[0] == began


@pytest.mark.slow
def test_the_page_says_why_it_is_empty(page: Page, studio: RunningStudio) -> None:
    _open(page)
    studio.studio.source.close()
    page.locator(".uplot").wait_for(state="detached")
    page.get_by_text("No arm is open").wait_for()
