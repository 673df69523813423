from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from playwright.sync_api import BrowserContext
    from tests.studio.servos.conftest import Bench


def test_a_page_without_control_changes_nothing(bench: Bench, context: BrowserContext) -> None:
    other = context.new_page()
    other.goto(bench.running.watch_url.replace("/?", "/servos?"))
    other.get_by_role("button", name="Torque of servo 1 on").click()
    other.get_by_text("does not have control").wait_for()
    assert not bench.servo(1).torque_on
