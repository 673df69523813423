"""What is in sight: at a desk all of Move that moves the arm every day, on a phone one part of it at a time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from tests.studio.conftest import ready
from tests.studio.running import expect

if TYPE_CHECKING:
    from playwright.sync_api import Page
    from tests.studio.running import RunningStudio

PHONE = {"width": 390, "height": 844}
PARTS = {
    "Joints": "Jog J1 up",
    "Space": "Move along x, plus",
    "Gripper": "Close",
    "Go to": "Go",
    "Poses": "Save present pose",
}
"""The parts, and a button of each."""
FINGER = 44
"""Pixels that a finger hits."""

_SMALL = """(least) => {
    const pressed = "button, select, input, summary, nav a, [role=slider]";
    return [...document.querySelectorAll(pressed)].flatMap((one) => {
        if (!one.checkVisibility({ visibilityProperty: true }) || one.closest(".hw-hidden, .hw-skip")) return [];
        // The words beside a box are pressed, too.
        const box = ["checkbox", "radio"].includes(one.type) && one.closest("label") || one;
        const { height } = box.getBoundingClientRect();
        return height < least - 0.5 ? [`${one.id || one.className || one.name} ${height}`] : [];
    });
}"""


@pytest.fixture
def move(studio: RunningStudio, blank: Page) -> Page:
    """The page Move, with control and torque."""
    blank.goto(studio.operate_url.replace("/?", "/move?"))
    ready(blank)
    studio.torque()
    blank.get_by_role("button", name="Take control").click()
    blank.get_by_role("button", name="Give back").wait_for()
    return blank


def in_sight(page: Page, selector: str) -> bool:
    """Whether an element is whole within the window, and nothing covers it."""
    found: bool = page.locator(selector).evaluate(
        """(one) => {
            const { left, top, right, bottom } = one.getBoundingClientRect();
            const there = document.elementFromPoint((left + right) / 2, (top + bottom) / 2);
            return left >= 0 && top >= 0 && right <= innerWidth && bottom <= innerHeight && one.contains(there);
        }"""
    )
    return found


def test_all_that_moves_the_arm_every_day_is_in_sight_at_a_desk(move: Page) -> None:
    last = 'tr[data-joint="J7"] [data-turn="1"]'
    for kind in ("place", "joints"):
        move.locator(f'#arm-goto input[value="{kind}"]').check()
        for selector in ("#arm-view canvas", last, '[data-axis="5"][data-turn="1"]', '[data-share="1"]', "#arm-go"):
            assert in_sight(move, selector), (kind, selector)
    # Also with the fields of the tool's angles.
    move.locator('#arm-goto input[value="place"]').check()
    move.locator('select[name="aim"]').select_option("rpy")
    assert in_sight(move, "#arm-go")
    # Nor is an axis below the others in a narrower window, nor Go in a lower one.
    for width, height in ((1280, 800), (1280, 720), (1024, 768)):
        move.set_viewport_size({"width": width, "height": height})
        rows = move.locator(".arm-axes, #arm-grip").evaluate_all("(rows) => rows.map((row) => row.clientHeight)")
        assert max(rows) < 40, width
        for aim in ("arm", "rpy"):
            move.locator('select[name="aim"]').select_option(aim)
            for selector in ("#arm-view canvas", last, '[data-axis="5"][data-turn="1"]', "#arm-go"):
                assert in_sight(move, selector), (width, height, aim, selector)
    # At a desk there is nothing to choose.
    assert not move.locator(".arm-parts").is_visible()


@pytest.mark.slow
def test_a_phone_shows_one_part_below_the_arm(move: Page) -> None:
    move.set_viewport_size(PHONE)
    assert in_sight(move, "#hw-stop")
    view = move.locator("#arm-view").bounding_box()
    assert view is not None
    assert view["height"] <= PHONE["height"] / 3
    for part in PARTS:
        move.get_by_role("tab", name=part, exact=True).click()
        for other, its in PARTS.items():
            expect(move.get_by_role("button", name=its, exact=True)).to_be_visible(visible=other == part)
        assert move.evaluate("document.documentElement.scrollWidth") == PHONE["width"], part
        assert not move.evaluate(_SMALL, FINGER), part
    move.get_by_role("tab", name="Go to", exact=True).click()
    for selector in ("#arm-view canvas", "#arm-go", "#hw-stop"):
        assert in_sight(move, selector), selector
    # It stays as it is while somebody looks at another page.
    move.get_by_role("navigation", name="Pages").get_by_role("link", name="Signals", exact=True).click()
    move.get_by_role("heading", name="Signals", level=1).wait_for()
    move.get_by_role("navigation", name="Pages").get_by_role("link", name="Move", exact=True).click()
    expect(move.get_by_role("button", name="Go", exact=True)).to_be_visible()


@pytest.mark.slow
def test_the_other_ways_to_move_the_arm_are_for_fingers_too(move: Page) -> None:
    move.set_viewport_size(PHONE)
    for way in ("Teach and play", "Program", "Leader arm"):
        move.get_by_role("tab", name=way).click()
        move.locator(f'[role="tabpanel"][aria-label="{way}"] > *').first.wait_for(state="attached")
        assert not move.evaluate(_SMALL, FINGER), way
        assert move.evaluate("document.documentElement.scrollWidth") == PHONE["width"], way


@pytest.mark.slow
def test_names_of_joints_that_are_long_have_room(served: RunningStudio, blank: Page) -> None:
    served.open("so101")
    try:
        blank.set_viewport_size(PHONE)
        blank.goto(served.operate_url.replace("/?", "/move?"))
        ready(blank)
        wide = "(rows) => rows.filter((row) => row.scrollWidth > row.clientWidth + 1).map((row) => row.textContent)"
        names = blank.locator(".arm-joints tbody th")
        names.first.wait_for()
        assert names.evaluate_all(wide) == []
    finally:
        served.studio.source.close()


@pytest.mark.slow
def test_on_a_phone_plots_and_the_chosen_servo_are_in_sight(move: Page) -> None:
    move.set_viewport_size(PHONE)
    pages = move.get_by_role("navigation", name="Pages")
    pages.get_by_role("link", name="Signals", exact=True).click()
    move.locator(".uplot").first.wait_for()
    assert in_sight(move, ".hx-plot-bar select")
    top = move.locator(".uplot").first.evaluate("(one) => one.getBoundingClientRect().top")
    assert top < PHONE["height"] / 3
    pages.get_by_role("link", name="Servos", exact=True).click()
    move.get_by_role("button", name="J5, servo 4").click()
    move.get_by_role("heading", name="J5, servo 4").wait_for()
    assert in_sight(move, '.sv-right [role="tab"][data-part="registers"]')
    assert in_sight(move, ".sv-part h2")
    assert in_sight(move, "#hw-stop")
