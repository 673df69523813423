from __future__ import annotations

import json
from typing import TYPE_CHECKING

import pytest
from tests.studio.running import PATIENCE

from hexwire.drivers.arm_file import load_profile

if TYPE_CHECKING:
    from tests.studio.servos.conftest import Bench


@pytest.mark.slow
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


@pytest.mark.slow
def test_a_calibration_of_lerobot_is_loaded_and_stored_on_the_page(bench: Bench) -> None:
    page = bench.page
    row = {"drive_mode": 0, "homing_offset": 15, "range_min": 900, "range_max": 3100}
    rows = {name: {"id": i, **row} for i, name in enumerate(load_profile("so101").model.names, 1)}
    bench.part("Calibration")
    with page.expect_file_chooser(timeout=1000 * PATIENCE) as chooser:
        bench.button("Load a calibration").click()
    file = {"name": "arm.json", "mimeType": "application/json", "buffer": json.dumps(rows).encode()}
    chooser.value.set_files([file])  # type: ignore[list-item]
    page.get_by_text("Loaded from arm.json.").wait_for()
    with page.expect_download(timeout=1000 * PATIENCE) as saved:
        bench.button("Save for LeRobot").click()
    assert json.loads(saved.value.path().read_text()) == rows
    bench.button("Store in the servos").click()
    bench.button("Store them").click()
    page.get_by_text("stored: shoulder_pan").wait_for()
    assert bench.servo(2).registers.stored("max_position_limit") == 3100
