"""The page Arms, as a person uses it."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

import pytest
from tests.studio.running import expect

from hexwire.drivers.board_reset import RESET_WARNING
from hexwire.studio.plugged import Plugged

if TYPE_CHECKING:
    from playwright.sync_api import Page
    from tests.studio.running import RunningStudio

_ROWS = [
    Plugged("/dev/ttyUSB7", "CH340 (USB 1a86:7523)", ("hex7bot",), "it is open in minicom (pid 7)", "end it"),
]


@pytest.mark.slow
def test_a_port_is_shown_with_its_obstacle_and_an_arm_is_opened(
    served: RunningStudio, blank: Page, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hexwire.studio.plugged.find_plugged", lambda: _ROWS)
    monkeypatch.setattr(served.studio, "plugged", None)
    page = blank
    try:
        page.goto(served.operate_url)
        page.get_by_role("heading", name="Arms", level=1).wait_for()
        row = page.get_by_role("row", name="/dev/ttyUSB7")
        row.get_by_text("it is open in minicom (pid 7)").wait_for()
        row.get_by_text("end it").wait_for()
        # What an address leads to is not known before it is open.
        page.get_by_text("drives the arm to its middle pose: keep clear").wait_for()
        row.get_by_role("button", name="Open /dev/ttyUSB7").click()
        page.get_by_text("Not opened:").wait_for()
        # A port that leads to no arm may lead to servos that are none yet.
        page.get_by_role("navigation", name="Pages").get_by_role("link", name="Servos", exact=True).click()
        expect(page.get_by_label("Port or address of the adapter")).to_have_value("/dev/ttyUSB7")
        page.get_by_text("drives the arm to its middle pose: keep clear").wait_for()
        page.get_by_role("navigation").get_by_role("link", name="Arms", exact=True).click()
        page.get_by_role("button", name="Open sim://so101", exact=True).click()
        page.wait_for_url("**/move")
        page.locator("#hw-name", has_text="so101").wait_for()
        page.get_by_role("navigation").get_by_role("link", name="Arms", exact=True).click()
        page.get_by_role("button", name="Close what is open").click()
        page.get_by_text("Nothing is open.").wait_for()
        assert served.studio.source.mode == "none"
    finally:
        served.studio.source.close()
        served.studio.fleet.rest()
        served.studio.access.end_all()


def test_that_a_port_may_reset_its_board_is_said_once(
    served: RunningStudio, blank: Page, monkeypatch: pytest.MonkeyPatch
) -> None:
    advice = f"{RESET_WARNING}; set the latency timer"
    rows = [Plugged(f"/dev/ttyUSB{i}", "CH340", ("hex7bot",), "", advice) for i in range(2)]
    monkeypatch.setattr("hexwire.studio.plugged.find_plugged", lambda: rows)
    monkeypatch.setattr(served.studio, "plugged", rows)
    try:
        blank.goto(served.operate_url)
        row = blank.get_by_role("row", name="/dev/ttyUSB0")
        expect(row).to_contain_text("can be opened; keep clear, see below")
        expect(row).to_contain_text("Set the latency timer")
        expect(blank.get_by_text("drives the arm to its middle pose")).to_have_count(1)
    finally:
        served.studio.fleet.rest()
        served.studio.access.end_all()


def test_a_watcher_opens_nothing(served: RunningStudio, blank: Page) -> None:
    page = blank
    try:
        page.goto(served.watch_url)
        page.get_by_role("listitem").filter(has_text="an emulated SO-100").first.wait_for()
        assert page.get_by_role("button", name="Open").count() == 0
    finally:
        served.studio.fleet.rest()
        served.studio.access.end_all()


@pytest.mark.slow
def test_what_has_not_changed_is_not_drawn_again(
    studio: RunningStudio, blank: Page, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A button that is made again loses the focus, and the press that has begun on it."""
    looks: list[object] = []
    monkeypatch.setattr(studio.studio, "plugged", None)
    monkeypatch.setattr("hexwire.studio.plugged.find_plugged", lambda: looks.append(None) or _ROWS)
    page = blank
    page.goto(studio.operate_url)
    page.get_by_role("row", name="/dev/ttyUSB7").wait_for()
    buttons = [page.get_by_role("button", name=name) for name in ("Close what is open", "Open /dev/ttyUSB7")]
    for button in buttons:
        button.evaluate("(button) => (button.marked = true)")
    # It looks again every two seconds.
    seen = len(looks)
    studio.until(lambda: len(looks) > seen + 2, "further looks")
    for button in buttons:
        assert button.evaluate("(button) => button.marked")


@pytest.mark.slow
def test_what_was_plugged_in_a_moment_ago_is_there_at_once(
    served: RunningStudio, blank: Page, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A table that comes later pushes its neighbours away, under the pointer of whoever has come back."""
    going_on = threading.Event()
    monkeypatch.setattr("hexwire.studio.plugged.find_plugged", lambda: going_on.wait(30) and _ROWS)
    monkeypatch.setattr(served.studio, "plugged", _ROWS)
    try:
        blank.goto(served.operate_url)
        blank.get_by_role("row", name="/dev/ttyUSB7").wait_for()
    finally:
        going_on.set()
        served.studio.fleet.rest()
        served.studio.access.end_all()
