"""The twelve tasks of docs/studio.md, done in a browser: what is pressed is what the table says, and as often."""

from __future__ import annotations

import math
import re
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from tests.studio.conftest import ready, shrink_views
from tests.studio.pages.test_arm import _no_arm_is_silent, shaft
from tests.studio.running import attempt, expect

from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.motion.teach import Taught

if TYPE_CHECKING:
    from collections.abc import Callable

    from playwright.sync_api import Locator, Page
    from tests.studio.running import RunningStudio

__all__ = ["_no_arm_is_silent"]

PAGE = Path(__file__).parents[3] / "docs" / "studio.md"


def table() -> dict[str, tuple[list[str], Counter[str]]]:
    """The tasks of the document: what is pressed, in its order, and how often it says."""
    section = PAGE.read_text().partition("\n## Twelve tasks of every day\n")[2].partition("\n## ")[0]
    rows = [
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in section.splitlines()
        if line.startswith("|")
    ]
    return {
        task: (
            re.findall(r"\*\*(.+?)\*\*", how),
            Counter({kind: int(n) for n, kind in re.findall(r"(\d+) (click|hold|field)s?", presses)}),
        )
        for task, how, presses in rows[2:]
    }


class Hand:
    """Whoever does a task: presses and types, and nothing else; the page counts, too."""

    def __init__(self, page: Page) -> None:
        self.page = page
        self.done: Counter[str] = Counter()
        self.pressed: list[str] = []

    def begin(self) -> None:
        """Forget what was done before."""
        self.done, self.pressed = Counter(), []
        self.page.evaluate(
            """() => {
                window.presses = 0;
                window.typed = new Set();
                if (window.counts) return;
                window.counts = true;
                addEventListener("pointerdown", (event) => (presses += event.isTrusted), true);
                addEventListener("input", ({ target, isTrusted }) => {
                    if (isTrusted && target.type !== "checkbox") typed.add(target);
                }, true);
            }"""
        )

    def counted(self) -> tuple[int, int]:
        """Presses and fields, as the page has seen them."""
        presses, fields = self.page.evaluate("[presses, typed.size]")
        return presses, fields

    def _note(self, kind: str, place: Locator) -> None:
        self.done[kind] += 1
        self.pressed.append(place.inner_text().strip())

    def click(self, place: Locator) -> None:
        """A click."""
        expect(place).to_be_enabled()
        self._note("click", place)
        place.click()

    def hold(self, place: Locator, until: Callable[[], object]) -> None:
        """A button that is held until something is true."""
        expect(place).to_be_enabled()
        self._note("hold", place)
        place.hover()

        def again() -> None:
            """What a busy machine has refused is no part of the task."""
            self.page.mouse.up()
            self.page.evaluate("() => { presses -= 1; }")

        attempt(self.page.mouse.down, again, until)
        self.page.mouse.up()

    def type(self, place: Locator, text: str) -> None:
        """A field that is typed into."""
        self.done["field"] += 1
        place.focus()
        place.press("Control+a")
        self.page.keyboard.type(text)


@pytest.mark.slow
def test_the_twelve_tasks_are_as_the_document_says(studio: RunningStudio, blank: Page) -> None:
    page, hand, said = blank, Hand(blank), table()
    assert len(said) == 12
    page.goto(studio.operate_url.replace("/?", "/move?"))
    ready(page)
    shrink_views(page)

    def button(name: str, place: Locator | None = None) -> Locator:
        return (place or page).get_by_role("button", name=name, exact=True)

    def link(name: str) -> Locator:
        return page.get_by_role("link", name=name, exact=True)

    def tab(name: str) -> Locator:
        return page.get_by_role("tab", name=name, exact=True)

    def take() -> None:
        hand.click(button("Take control"))
        hand.click(button("Torque on"))
        expect(page.locator("#hw-fact-torque")).to_have_text("on")

    def jog() -> None:
        before = shaft(studio, "J1")
        hand.hold(button("Jog J1 up"), lambda: shaft(studio, "J1") > before + math.radians(2))

    def go() -> None:
        field = page.locator('#arm-goto input[name="z"]')
        expect(field).not_to_have_value("")
        hand.type(field, "220")
        expect(page.locator("#arm-plan")).to_contain_text("Takes")
        hand.click(button("Go"))
        expect(page.locator("#arm-plan")).to_have_text("Arrived.")
        expect(page.locator('[data-tip="z"]')).to_have_text(re.compile(r"^2(19|20)\."))

    def keep() -> None:
        hand.type(page.locator('#arm-pose-form input[name="name"]'), "over the table")
        hand.click(button("Save present pose"))
        expect(button("Go to over the table")).to_be_visible()

    def back() -> None:
        hand.click(button("Go to home"))
        expect(page.locator("#arm-pose-note")).to_have_text("At home.")

    def stop() -> None:
        hand.click(button("STOP"))
        studio.stopped("the stop")

    def teach() -> None:
        hand.click(tab("Teach and play"))
        hand.click(page.locator("label", has_text="I hold the arm"))
        hand.click(button("Start teaching"))
        expect(page.locator("#arm-teach-note")).to_contain_text("move the arm by hand")
        joint, positions = HEX7BOT.joint("J1"), studio.servos[0].motion
        for _ in range(10):
            positions.position += math.radians(2) / joint.scale * joint.sign
            there = shaft(studio, "J1")
            studio.until(
                lambda there=there: abs(studio.arm.owner.newest().positions["J1"] - there) < 0.01,  # type: ignore[misc]
                "what a hand did",
            )
        hand.click(button("End teaching: hold here"))
        studio.until(lambda: studio.arm.teach_mode.taught is not None, "the taught motion")
        # On a busy machine what a hand did may be too fast by far: J1 by 20 degrees, evenly, and for another time.
        by_hand = studio.arm.teach_mode.taught
        assert by_hand is not None
        seconds = 1.0 if by_hand.times[-1] > 1.5 else 2.0
        rows = [(HEX7BOT.joint("J1").offset + math.radians(i),) for i in range(21)]
        studio.arm.teach_mode.taught = Taught(("J1",), tuple(seconds * i / 20 for i in range(21)), tuple(rows))
        expect(page.locator("#arm-time-value")).to_have_text(f"0.0 of {seconds:.1f} s")
        expect(page.locator("#arm-play-plan")).to_contain_text("Takes")
        hand.click(button("Play"))
        expect(page.locator("#arm-play-plan")).to_have_text("Played.")
        assert shaft(studio, "J1") == pytest.approx(rows[-1][0], abs=0.05)

    def program() -> None:
        part = page.locator("#arm-program")
        hand.click(tab("Program"))
        for _ in range(2):
            hand.click(button("Add step", part))
        hand.click(button("Run", part))
        expect(part.locator("[role=status]")).to_have_text("The program has ended.")
        assert shaft(studio, "J1") == pytest.approx(HEX7BOT.joint("J1").offset, abs=0.05)

    def record() -> None:
        recordings = studio.studio.recordings
        hand.click(link("Recordings"))
        hand.click(button("Record the arm"))
        studio.until(lambda: recordings.recorder.state.states > 10, "states")
        hand.click(button("End the recording"))
        expect(page.locator(".rc-list [role=row], .rc-list tbody tr").first).to_be_visible()

    def look_up() -> None:
        hand.click(link("Servos"))
        hand.click(button("J5, servo 4"))
        hand.click(tab("Registers"))
        page.get_by_role("region", name="Registers of servo 4").get_by_text("max_temperature").wait_for()

    def open_other() -> None:
        hand.click(link("Arms"))
        hand.click(button("Open sim://so101"))
        expect(page.get_by_role("slider", name="elbow_flex", exact=True)).to_be_visible()

    def first_run() -> None:
        hand.click(page.locator("#hw-banner").get_by_role("link", name="First run"))
        hand.click(button("Begin with what is open"))
        expect(page.locator(".fr-steps li").nth(1)).to_have_attribute("aria-current", "step")

    tasks = (take, jog, go, keep, back, stop, teach, program, record, look_up, open_other, first_run)
    try:
        for act, (task, (pressed, presses)) in zip(tasks, said.items(), strict=True):
            hand.begin()
            act()
            assert (hand.pressed, hand.done) == (pressed, presses), task
            assert hand.counted() == (presses["click"] + presses["hold"], presses["field"]), task
            if act is stop:
                button("Resume").click()
                expect(button("Resume")).to_be_hidden()
            if act in (record, look_up):
                link("Move").click()
    finally:
        studio.studio.source.close()
