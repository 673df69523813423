from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexwire.bus.timing import LineTiming


def test_the_line_is_arithmetic() -> None:
    timing = LineTiming(1_000_000)
    assert timing.line_time(71) == pytest.approx(0.00071)
    assert LineTiming(0).line_time(71) == 0.0


def test_the_allowance_shrinks_to_what_the_adapter_needs() -> None:
    timing = LineTiming(1_000_000)
    assert timing.allowance >= 0.032
    for _ in range(200):
        timing.measured(0.00016 + 0.0003, 16)
    assert timing.allowance == pytest.approx(0.001)
    assert timing.overhead == pytest.approx(0.0003)
    assert timing.round_trips == (timing.overhead,)
    assert not timing.holds_back


def test_a_latency_timer_is_seen_and_allowed_for() -> None:
    timing = LineTiming(1_000_000)
    assert math.isnan(timing.overhead)
    assert timing.round_trips == ()
    for i in range(100):
        timing.measured(0.00016 + 0.0155 + 0.0005 * (i % 2), 16)
    assert timing.holds_back
    assert 0.0155 < timing.allowance < 0.05


@given(st.lists(st.floats(0, 10), max_size=100))
def test_the_allowance_stays_in_bounds(times: list[float]) -> None:
    timing = LineTiming(115200)
    for seconds in times:
        timing.measured(seconds, 16)
        assert 0.001 <= timing.allowance <= 0.1


def test_an_answer_that_was_late_is_waited_for_from_then_on() -> None:
    timing = LineTiming(1_000_000)
    for _ in range(200):
        timing.measured(0.0004, 16)
    assert timing.allowance < 0.002
    # The adapter's timer is 16 ms now.
    timing.late(0.0165, 16)
    for _ in range(300):
        assert timing.allowance > 0.0163
        timing.measured(0.0165, 16)
    timing.late(3.0, 16)
    assert timing.allowance <= 0.1


def test_mean_and_deviation_are_those_of_a_round_trip() -> None:
    timing, mean, deviation = LineTiming(100_000), 0.0, 0.0
    for i, over in enumerate((0.010, 0.020, 0.004, 0.0, 0.030) * 4):
        timing.measured(0.002 + over, 20)
        if i:
            deviation += (abs(over - mean) - deviation) / 16
            mean += (over - mean) / 16
        else:
            mean, deviation = over, over / 2
        assert timing.answers == i + 1
        assert timing.overhead == pytest.approx(mean)
        # Nothing is granted on few answers; then four deviations.
        assert timing.allowance == pytest.approx(0.060 if i < 15 else min(mean + 4 * deviation, 0.1))


def test_less_than_the_lines_time_is_no_overhead() -> None:
    timing = LineTiming(1_000_000)
    for _ in range(16):
        timing.measured(0.0, 100)
    assert timing.overhead == 0.0
    assert timing.allowance == 0.001


def test_what_holds_every_answer_back_is_at_least_four_milliseconds() -> None:
    for least, answers, held in ((0.0041, 16, True), (0.0041, 15, False), (0.0039, 16, False)):
        timing = LineTiming(0)
        timing.measured(least, 16)
        for _ in range(answers - 1):
            timing.measured(0.016, 16)
        assert timing.holds_back is held


def test_how_long_noise_may_push_an_answer_back() -> None:
    timing = LineTiming(1_000_000)
    assert timing.linger(8) == pytest.approx(16 * 10e-6 + 0.004)
    for _ in range(200):
        timing.measured(0.0, 16)
    assert timing.linger(8) == pytest.approx(16 * 10e-6 + 0.001)


def test_a_late_answer_is_granted_what_it_took_up_to_the_first_allowance() -> None:
    for took, granted in ((0.0, 0.001), (0.020, 0.020), (0.060, 0.060), (5.0, 0.060)):
        timing = LineTiming(1_000_000)
        for _ in range(200):
            timing.measured(0.00016, 16)
        timing.late(0.00016 + took, 16)
        assert timing.allowance == pytest.approx(granted)
        timing.measured(0.00016, 16)
        # It is forgotten as slowly as a deviation is.
        assert timing.allowance == pytest.approx(max(0.001, granted * 15 / 16 if took else 0.001), rel=1e-3)
    timing = LineTiming(1_000_000)
    timing.late(0.010, 16)
    assert timing.allowance == 0.060, "it never shrinks by that"
