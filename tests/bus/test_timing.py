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
    assert not timing.holds_back


def test_a_latency_timer_is_seen_and_allowed_for() -> None:
    timing = LineTiming(1_000_000)
    assert math.isnan(timing.overhead)
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
