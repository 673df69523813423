"""What goes on at the servos while something else is looked at is found again, and so is what came of it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from tests.studio.running import expect, until
from tests.studio.test_every_page import walk

if TYPE_CHECKING:
    from tests.studio.servos.conftest import Bench

pytestmark = pytest.mark.slow


def leave_and_return(bench: Bench, part: str) -> None:
    """Look at another part, then at another page, and come back."""
    bench.part("Overview")
    bench.page.get_by_role("heading", name="Torque").wait_for()
    bench.part(part)
    walk(bench.page, "/wire")
    walk(bench.page, "/servos")
    bench.part(part)


def test_a_calibration_is_finished_after_its_part_was_left(bench: Bench) -> None:
    bench.bus.switch_torque(True)
    bench.part("Calibration")
    bench.page.get_by_label("Arm", exact=True).select_option("servos")
    bench.button("Begin: torque off").click()
    bench.button("I hold it: torque off").click()
    finish = bench.button("Finish")
    finish.wait_for()
    leave_and_return(bench, "Calibration")
    finish.wait_for()
    expect(bench.button("Cancel")).to_be_visible()
    expect(bench.button("Begin: torque off")).to_be_hidden()
    expect(bench.page.get_by_label("Arm", exact=True)).to_have_value("servos")
    job = bench.bus.job
    assert job is not None
    assert job.what == "a calibration"
    assert not bench.servo(1).torque_on
    rows = bench.page.get_by_role("region", name="Ranges").locator("tbody tr")
    now = rows.first.locator("td").nth(1)
    for step in range(11):
        before = now.inner_text()
        for servo_id in range(1, 7):
            bench.servo(servo_id).motion.position = 1500 + 100 * step
        expect(now).not_to_have_text(before)
    expect(rows.filter(has_text="nothing")).to_have_count(6)
    finish.click()
    bench.page.get_by_text("Calibrated.").wait_for()
    until(lambda: bench.bus.job is None, "its end")
    # What was measured is still there to be stored.
    leave_and_return(bench, "Calibration")
    bench.page.get_by_text("Calibrated.").wait_for()
    bench.button("Store in the servos").wait_for()
    bench.button("Begin: torque off").wait_for()
    assert not bench.servo(1).torque_on


def test_a_stress_test_is_cancelled_after_its_part_was_left(bench: Bench) -> None:
    bench.part("Stress test")
    bench.page.get_by_label("Reads").fill("100000")
    bench.button("Start").click()
    bench.button("Cancel").wait_for()
    leave_and_return(bench, "Stress test")
    expect(bench.button("Start")).to_be_hidden()
    bench.button("Cancel").click()
    bench.button("Start").wait_for()
    expect(bench.button("Cancel")).to_be_hidden()
    until(lambda: bench.bus.job is None, "its end")
    bench.page.get_by_role("region", name="Histogram of the times").wait_for()
    leave_and_return(bench, "Stress test")
    bench.page.get_by_role("region", name="Histogram of the times").wait_for()


def test_searches_are_cancelled_after_their_part_was_left(bench: Bench) -> None:
    page = bench.page
    page.get_by_label("Rates").select_option(label="all rates")
    page.get_by_label("Ids").fill("0-253")
    bench.button("Search").click()
    bench.button("Cancel").wait_for()
    walk(page, "/wire")
    walk(page, "/servos")
    bench.button("Cancel").click()
    bench.button("Search").wait_for()
    until(lambda: bench.bus.job is None, "its end")
    bench.part("Set up an arm")
    page.get_by_label("Leader or follower").select_option("leader")
    bench.button("Look at every id and rate").click()
    bench.button("Cancel").wait_for()
    leave_and_return(bench, "Set up an arm")
    expect(page.get_by_label("Leader or follower")).to_have_value("leader")
    expect(bench.button("Look what is connected")).to_be_hidden()
    bench.button("Cancel").click()
    bench.button("Look what is connected").click()
    page.locator(".sv-part .sv-facts").get_by_text("shoulder_pan").wait_for()
    leave_and_return(bench, "Set up an arm")
    page.locator(".sv-part .sv-facts").get_by_text("shoulder_pan").wait_for()
