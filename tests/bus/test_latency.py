from __future__ import annotations

import math
import random
import sys

import pytest
from tests.bus.bus_bench import make_bus

from hexwire.bus.latency import Bins, LatencyCounts, StressTest
from hexwire.emulator.faults import FaultPlan
from hexwire.wire.registers import Series


def counted(durations: list[float]) -> LatencyCounts:
    counts = LatencyCounts()
    for seconds in durations:
        counts.add(seconds)
    return counts


def test_percentiles_are_those_of_the_sorted_durations() -> None:
    dice = random.Random(3)
    durations = [dice.lognormvariate(math.log(0.0005), 1.5) for _ in range(5000)]
    counts, ordered = counted(durations), sorted(durations)
    for share in (0.0, 0.5, 0.9, 0.99, 1.0):
        # A microsecond, or three digits.
        expected = ordered[min(4999, int(5000 * share))]
        assert counts.percentile(share) == pytest.approx(expected, rel=0.011, abs=1.1e-6)
    assert counts.longest == ordered[-1]
    assert math.isnan(LatencyCounts().percentile(0.5))


def test_a_million_durations_take_little_memory() -> None:
    counts = LatencyCounts()
    dice = random.Random(4)
    for _ in range(100_000):
        counts.add(dice.expovariate(1 / 0.05))
    held = counts._counts
    assert counts.total == 100_000
    # A thousand microseconds, and at most nine hundred values for each power of ten.
    assert len(held) <= 1000 + 4 * 900
    assert sys.getsizeof(held) < 1_000_000


def test_bins_go_up_to_the_99th_percentile_and_hold_everything() -> None:
    bins = counted([0.001 + 0.00001 * i for i in range(100)] + [0.1]).bins()
    assert len(bins.edges) == len(bins.counts) == 11
    assert sum(bins.counts) == 101
    assert bins.edges[0] == pytest.approx(0.001)
    assert bins.edges[10] == pytest.approx(bins.p99)
    assert bins.counts[10] == 2
    assert max(bins.counts[:10]) <= 11
    assert bins.p50 == pytest.approx(0.0015)
    assert bins.longest == 0.1
    assert LatencyCounts().bins() == Bins(
        (), (), pytest.approx(math.nan, nan_ok=True), *[pytest.approx(math.nan, nan_ok=True)] * 2
    )
    assert counted([0.002] * 7).bins().counts[0] == 7


def test_a_stress_test_counts_what_is_missing_and_of_whom() -> None:
    bus, device = make_bus((1, 2, 3), faults=FaultPlan(["silent:2:0.3"], seed=5), retries=0)
    test = StressTest((1, 2, 3))
    clock = bus.link.clock  # type: ignore[attr-defined]
    each: list[float] = []
    test.run(bus, 100, clock=clock, each=each.append)
    assert (test.reads, test.values, len(each)) == (100, 300, 100)
    assert 5 < test.missing[2] == test.lost < 95
    assert test.worst == 2
    assert test.seconds == pytest.approx(sum(each))
    assert device.wire[1].series is Series.STS_SMS


def test_it_ends_when_it_is_asked_to_and_may_go_on() -> None:
    bus, _ = make_bus((1, 2))
    test = StressTest((1, 2), "present_voltage")
    left = iter([True] * 7 + [False])
    test.run(bus, 1000, go_on=lambda: next(left))
    assert test.reads == 7
    test.run(bus, 3)
    assert (test.reads, test.values, test.lost) == (10, 20, 0)
