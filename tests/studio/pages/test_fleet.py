"""All arms on the page Arms, as a person uses it, and what it asks for."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import pytest
from tests.fleet.conftest import Serve, runtime, serve

from hexwire.studio.access import Right

if TYPE_CHECKING:
    from pathlib import Path

    from playwright.sync_api import BrowserContext, Page
    from tests.studio.running import RunningStudio

__all__ = ["runtime", "serve"]


@pytest.fixture
def fleet_page(runtime: Path, studio: RunningStudio, page: Page) -> Iterator[Page]:
    page.get_by_role("navigation", name="Pages").get_by_role("link", name="Arms", exact=True).click()
    page.get_by_role("heading", name="Arms", level=1).wait_for()
    yield page
    # It asks no more before the fleet rests.
    page.goto("about:blank")
    studio.studio.fleet.rest()


@pytest.mark.slow
def test_without_shared_arms_all_arms_are_what_is_open_here(fleet_page: Page, studio: RunningStudio) -> None:
    fleet_page.get_by_text("start 'hexwire serve --name lab/arm1'").wait_for()
    fleet_page.get_by_text("1 arm on this machine").wait_for()
    row = fleet_page.get_by_role("row").filter(has_text="open here")
    row.get_by_text("off", exact=True).wait_for()
    studio.arm.owner.robot.torque(True, ["J1", "J2"])
    row.get_by_text("J1 J2", exact=True).wait_for()
    fleet_page.get_by_role("button", name="Stop all arms").click()
    fleet_page.get_by_text(": stopped, holding: J1 J2; limp: J3 J4 J5 J6 J7 (").wait_for()
    row.get_by_text("stopped: page").wait_for()
    # Nothing is open: there is nothing to be stopped.
    studio.studio.source.close()
    row.wait_for(state="detached")
    fleet_page.get_by_role("button", name="Stop all arms").click()
    fleet_page.get_by_text("all arms: NOT CONFIRMED").wait_for()


@pytest.mark.slow
def test_an_operator_opens_an_arm_and_a_watcher_stops_it(
    serve: Serve, studio: RunningStudio, context: BrowserContext, fleet_page: Page
) -> None:
    serve("lab/arm1", robot="sim")
    serve("lab/arm2", robot="sim")
    fleet_page.get_by_role("button", name="Open lab/arm1").click()
    fleet_page.get_by_role("heading", name="Move", level=1).wait_for()
    assert studio.arm.owner.robot.url.startswith("zenoh:lab/arm1")
    fleet_page.get_by_role("navigation", name="Pages").get_by_role("link", name="Wire", exact=True).click()
    fleet_page.get_by_text("shared by another program").wait_for()
    studio.studio.source.close()
    # A viewer: in this browser its session takes the place of the operator's.
    fleet_page.get_by_role("navigation", name="Pages").get_by_role("link", name="Arms", exact=True).click()
    viewer = context.new_page()
    viewer.goto(studio.watch_url)
    viewer.get_by_role("navigation", name="Pages").get_by_role("link", name="Arms", exact=True).click()
    row = viewer.get_by_role("row").filter(has_text="lab/arm1")
    row.get_by_text("hex7bot").wait_for()
    viewer.get_by_role("button", name="Stop lab/arm1").click()
    viewer.get_by_text("lab/arm1: stopped, limp: J1").wait_for()
    row.get_by_text("stopped: page").wait_for()
    other = viewer.get_by_role("row").filter(has_text="lab/arm2")
    assert "stopped" not in other.inner_text()
    # A viewer cannot open it, neither by a button nor without one.
    assert viewer.get_by_role("button", name="Open lab/arm1").count() == 0
    refused = viewer.evaluate("hexwire.call('fleet.open', { name: 'lab/arm1' }).catch((error) => error.message)")
    assert "watching only" in refused
    viewer.get_by_role("button", name="Stop all arms").click()
    viewer.get_by_text("lab/arm2: stopped, limp: J1").wait_for()
    viewer.close()
    # What another page has control of is not replaced; the page says so, and keeps saying it.
    studio.open()
    studio.studio.take(studio.studio.tabs.open("another", Right.OPERATE))
    fleet_page.get_by_role("button", name="Open lab/arm1").click()
    fleet_page.get_by_text("lab/arm1 is not open here").wait_for()
    fleet_page.wait_for_timeout(700)
    assert fleet_page.get_by_text("lab/arm1 is not open here").is_visible()
