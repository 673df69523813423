"""What the firmware promises about time. Simulated time, so the same on every machine."""

from __future__ import annotations

import pytest
from tests.bench import bench_firmware as bench
from tests.bench import bench_path

# The first one builds.

BUS_HZ = 1 / bench.CYCLE
MOVING_HZ = 1 / (bench.CYCLE + bench.MOVE)


def test_the_limits_are_those_of_the_wire() -> None:
    assert 96 < BUS_HZ < 97
    assert 64 < MOVING_HZ < 65


@pytest.mark.slow
def test_reports_come_as_fast_as_the_servo_line_lets_them() -> None:
    assert bench.report_rate() >= 0.9 * BUS_HZ


@pytest.mark.slow
def test_moves_and_states_in_each_cycle() -> None:
    assert min(bench.move_rate()) >= 0.9 * MOVING_HZ


def test_a_read_in_the_chapters_dialect() -> None:
    assert bench.read_time() <= 0.012
    # The first one may find that a sync read has begun.
    assert bench.read_time(busy=True) <= 0.012 + bench.SYNC_READ


@pytest.mark.slow
def test_a_stop_under_full_load() -> None:
    assert bench.stop_time(load=False) <= 0.015
    assert bench.stop_time(load=True) <= 0.015


@pytest.mark.slow
def test_a_faster_host_line_is_no_limit_any_more() -> None:
    slow, fast = bench.report_rate(115200, bench.EVERYTHING), bench.line_use(500000)
    assert slow < 0.85 * BUS_HZ
    assert fast.rate >= 0.95 * BUS_HZ
    assert fast.positions == pytest.approx(1e3 * bench.CYCLE)
    assert fast.idle < 0.3


@pytest.mark.slow
def test_states_and_targets_while_a_trajectory_runs() -> None:
    assert min(bench_path.path_rate()) >= 0.92 * MOVING_HZ


@pytest.mark.slow
def test_a_trajectorys_targets_come_at_the_time_of_their_positions() -> None:
    for fed in (False, True):
        for error in bench_path.time_error(fed=fed):
            assert error.count > (250 if fed else 30)
            assert error.p99 <= 0.3e-3, (fed, error)
