"""The page First run: an SO-101 that was just assembled, from its cable to its first jog, by keyboard alone."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest
from tests.studio.conftest import shrink_views
from tests.studio.running import expect, press, until
from tests.studio.test_every_page import examine

from hexwire.studio.access import Right

if TYPE_CHECKING:
    from playwright.sync_api import Page
    from tests.studio.running import RunningStudio


def enter(page: Page, name: str) -> None:
    """Press a button by the keyboard."""
    button = page.get_by_role("button", name=name, exact=True)
    expect(button).to_be_enabled()
    button.focus()
    page.keyboard.press("Enter")


def titled(page: Page, title: str) -> None:
    """Wait for a step; whoever does not see it hears its title."""
    expect(page.get_by_role("heading", name=title, level=2)).to_be_focused()


@pytest.mark.slow
def test_an_arm_goes_from_uncalibrated_to_its_first_jog_by_keyboard_alone(
    served: RunningStudio, blank: Page
) -> None:
    page, source = blank, served.studio.source
    source.silence = 5.0
    page.goto(served.operate_url)
    page.get_by_role("link", name="First run").wait_for()
    shrink_views(page)
    page.get_by_role("link", name="First run").focus()
    page.keyboard.press("Enter")
    wrong: list[str] = []
    try:
        enter(page, "Begin at sim://so101?any_horns=1")
        titled(page, "What it is")
        enter(page, "Is it calibrated?")
        titled(page, "Calibrated?")
        page.get_by_text("Not calibrated:").wait_for()
        enter(page, "Calibrate it by hand")
        titled(page, "Range of each joint")
        enter(page, "Begin: torque off")
        enter(page, "I hold it: torque off")
        enter(page, "wrist_roll: in its middle now")
        link: Any = source.need_bus().bus.link
        row = page.locator(".sv-table tbody tr")
        for share in (0.25, 0.0, 0.5, 1.0):
            seen = row.first.inner_text()
            for servo in link.device.wire.servos:
                low, high = servo.motion.stops or (servo.motion.position,) * 2
                servo.motion.position = low + share * (high - low)
            until(lambda seen=seen: row.first.inner_text() != seen, "what a hand did")  # type: ignore[misc]
        wrong += examine(page, "ranges", dark=False)
        enter(page, "Finish")
        # What is written is said, and nothing is before.
        enter(page, "Store in the servos")
        page.get_by_role("dialog").get_by_text("shoulder_pan, servo 1: offset 0 →").wait_for()
        assert link.device.wire.servos[0].registers.stored("position_offset") == 0
        enter(page, "Store them")
        enter(page, "To the first jog: open the arm")
        titled(page, "First jog")
        enter(page, "Torque on: it holds where it is")
        minus = page.get_by_role("button", name="shoulder_pan minus")
        expect(minus).to_be_enabled()
        press(page, minus, lambda: page.get_by_text("moved −").count(), key=True)
        page.keyboard.up("Space")
        wrong += examine(page, "jog")
        enter(page, "Done")
        enter(page, "Go to Move")
        page.locator("#arm-view canvas").wait_for()
    finally:
        source.close()
    assert not wrong, "\n".join(wrong)


@pytest.mark.slow
def test_a_watcher_sees_the_step_and_can_press_nothing(served: RunningStudio, blank: Page) -> None:
    studio = served.studio
    tab = studio.tabs.open("somebody", Right.OPERATE)
    studio.first.begin(tab, "sim://so101?name=watched", "so101")
    try:
        blank.goto(served.watch_url.replace("/?", "/first?"))
        blank.get_by_text("You watch").wait_for()
        for button in blank.locator(".fr-panel button").all():
            assert button.is_disabled() or button.inner_text() == "Leave"
    finally:
        studio.source.close()
