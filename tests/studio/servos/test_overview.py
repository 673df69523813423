from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from hexwire.wire.tables import STATUS_BITS

if TYPE_CHECKING:
    from playwright.sync_api import BrowserContext
    from tests.studio.servos.conftest import Bench


@pytest.mark.slow
def test_a_page_without_control_changes_nothing(bench: Bench, context: BrowserContext) -> None:
    other = context.new_page()
    other.goto(bench.running.watch_url.replace("/?", "/servos?"))
    other.get_by_role("button", name="Torque of servo 1 on").click()
    other.get_by_text("does not have control").wait_for()
    assert not bench.servo(1).torque_on


@pytest.mark.slow
def test_an_overload_is_ended_and_a_middle_set_on_the_page(bench: Bench) -> None:
    page, servo = bench.page, bench.servo(1)
    servo.protection.forced |= STATUS_BITS["overload"]
    bench.button("Recover from overload").click()
    bench.button("Switch torque off and wait").click()
    page.get_by_text("still reports overload: remove the cause").wait_for()
    servo.protection.forced = 0
    bench.button("Recover from overload").click()
    bench.button("Switch torque off and wait").click()
    page.get_by_text("servo 1 has no fault, and no torque").wait_for()
    assert not servo.torque_on
    servo.motion.position = 1500
    bench.part("Calibration")
    bench.button("Set the middle of servo 1 here").click()
    bench.button("This is the middle").click()
    page.get_by_text("here now").wait_for()
    assert servo.registers.stored("position_offset") != 0
