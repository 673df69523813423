"""Fifty emulated arms and their drivers in one process."""

from __future__ import annotations

import pytest
from tests.system.fleet import run_fleet

from hexwire.emulator.serve import FakeClock


@pytest.mark.slow
@pytest.mark.system
def test_fifty_arms_in_one_process() -> None:
    arms, _, _ = run_fleet(50, 1.0, rate=50.0, clock=FakeClock(1000.0))
    assert [arm.cycles for arm in arms] == [50] * 50
    for arm in arms:
        counters = arm.driver.host_counters()
        # Each had every answer, and only its own.
        assert counters["requests"] == counters["replies"] > 50
        assert (counters["timeouts"], counters["retries"], counters["stale_frames"]) == (0, 0, 0)
        assert counters["bad_frames"] == 0


def test_each_arm_follows_its_own_set_points() -> None:
    arms, _, _ = run_fleet(3, 3.0, rate=50.0, clock=FakeClock(1000.0))
    assert all(arm.worst < 0.1 for arm in arms)
