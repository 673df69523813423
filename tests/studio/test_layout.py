"""The frame of every page: facts in sight, and STOP by button and by Escape."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from tests.studio.conftest import ready

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page
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


def test_the_theme_is_chosen_and_kept(page: Page) -> None:
    button = page.locator("#hw-theme")
    button.filter(has_text="auto").click()
    button.filter(has_text="light").click()
    page.wait_for_function("document.body.classList.contains('body--dark')")
    page.reload()
    page.wait_for_function("document.body.classList.contains('body--dark')")


def test_stop_works_while_a_dialog_is_open(studio: RunningStudio, page: Page) -> None:
    page.evaluate(
        """() => window.Quasar.Dialog.create({title: "Sure?", message: "A question.", persistent: true})"""
    )
    page.get_by_text("A question.").wait_for()
    page.get_by_role("button", name="STOP").click()
    studio.until(lambda: studio.arm.owner.group.reason is not None, "the stop by the button")
    studio.arm.owner.reset()
    page.get_by_text("A question.").click()
    page.keyboard.press("Escape")
    studio.until(lambda: studio.arm.owner.group.reason is not None, "the stop by Escape")


def test_a_script_in_a_text_from_elsewhere_does_not_run(studio: RunningStudio, browser: Browser) -> None:
    # A context of its own: the browser reports what it refuses as an error.
    context = browser.new_context()
    try:
        page = context.new_page()
        page.goto(studio.operate_url)
        ready(page)
        page.evaluate(
            """() => {
                const main = document.getElementById("hw-main");
                main.insertAdjacentHTML("beforeend", "<img src='data:x' onerror='window.ran = 1'>");
                const script = document.createElement("script");
                script.textContent = "window.ran = 2";
                main.append(script);
            }"""
        )
        page.wait_for_timeout(300)
        assert page.evaluate("window.ran === undefined")
    finally:
        context.close()
