"""The frame of every page: facts in sight, and STOP by button and by Escape."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from tests.studio.conftest import ready

if TYPE_CHECKING:
    from playwright.sync_api import Browser, BrowserContext, Page
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
    studio.stopped("the stop by the button")
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


def test_the_facts_have_room_beside_all_buttons(served: RunningStudio, context: BrowserContext) -> None:
    served.studio.source.silence = 5.0
    served.studio.source.open_bus("sim://so101?name=facts")
    try:
        page = context.new_page()
        page.goto(served.operate_url.replace("/?", "/servos?"))
        page.get_by_role("button", name="Take control").click()
        page.get_by_role("button", name="Torque off", exact=True).wait_for()
        boxes = [fact.bounding_box() for fact in page.locator(".hw-fact").all()]
        first, second, last = (box for box in (boxes[0], boxes[1], boxes[-1]) if box is not None)
        assert first["width"] > 90
        assert first["x"] + first["width"] <= second["x"] or first["y"] < second["y"]
        actions = page.locator(".hw-actions").bounding_box()
        assert actions is not None
        assert last["x"] + last["width"] <= actions["x"]
        text = page.locator(".hw-fact").first.evaluate("(fact) => fact.scrollWidth - fact.clientWidth")
        assert text <= 1
    finally:
        served.studio.source.close()
