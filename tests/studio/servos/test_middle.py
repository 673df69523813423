from __future__ import annotations

from typing import TYPE_CHECKING

from tests.studio.running import PATIENCE

if TYPE_CHECKING:
    from tests.studio.servos.conftest import Bench


def test_calibration_stress_and_backup_work_on_the_page(bench: Bench) -> None:
    page = bench.page
    bench.part("Stress test")
    page.get_by_label("Reads").fill("50")
    bench.button("Start").click()
    page.get_by_role("region", name="Histogram of the times").wait_for()
    bench.part("Backup")
    with page.expect_download(timeout=1000 * PATIENCE) as file:
        bench.button("Back up all servos").click()
    assert file.value.suggested_filename == "servos.json"
    page.get_by_text("No differences.").nth(5).wait_for()
    bench.part("Calibration")
    bench.button("Begin: torque off").click()
    bench.button("I hold it: torque off").click()
    page.get_by_role("region", name="Ranges").get_by_text("not moved yet").first.wait_for()
    bench.button("Cancel").last.click()
    page.get_by_text("nothing was stored").wait_for()
    assert bench.bus.job is None
