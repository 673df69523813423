from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from tests.studio.running import press, until

if TYPE_CHECKING:
    from tests.studio.servos.conftest import Bench


@pytest.mark.slow
def test_a_wave_lasts_while_its_button_is_held(bench: Bench) -> None:
    page, servo = bench.page, bench.servo(1)
    bench.part("Wave")
    page.get_by_label("Duration, s").fill("60")
    before = servo.motion.position
    press(page, bench.button("Hold to move servo 1"), lambda: bench.bus.job is not None)
    until(lambda: abs(servo.motion.position - before) > 40, "motion")
    page.mouse.up()
    until(lambda: bench.bus.job is None and servo.motion.settled, "the end of the wave")
    there = servo.motion.position
    page.get_by_text("largest error").wait_for()
    assert servo.motion.position == pytest.approx(there, abs=3)
    assert servo.torque_on, "it holds"
    # STOP ends one too, and a held button does not begin another one while stopped.
    bench.button("Hold to move servo 1").focus()
    page.keyboard.down("Enter")
    until(lambda: bench.bus.job is not None, "a wave by keyboard")
    page.keyboard.press("Escape")
    until(lambda: bench.bus.bench.stopped and bench.bus.job is None and servo.motion.settled, "the stop")
    # Until then Resume is refused.
    until(lambda: not bench.bus.bus.epochs._under_way, "the end of the order to stop")
    page.keyboard.up("Enter")
    there = servo.motion.position
    press(page, bench.button("Hold to move servo 1"), page.get_by_text("resume first").first.is_visible)
    page.mouse.up()
    assert servo.motion.position == pytest.approx(there, abs=3)
    page.get_by_role("button", name="Resume").click()
    until(lambda: not bench.bus.bench.stopped, "the end of the stop")
