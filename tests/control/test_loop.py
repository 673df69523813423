from __future__ import annotations

import math

import pytest

from hexwire.control.loop.loop import RateLoop
from hexwire.errors import UsageError


class FakeTime:
    """A clock that only sleep and work advance; `oversleep` seconds are added to each sleep."""

    def __init__(self, oversleep: float = 0.0) -> None:
        self.now = 1000.0
        self.oversleep = oversleep
        self.slept: list[float] = []

    def clock(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        assert seconds > 0
        self.slept.append(seconds)
        self.now += seconds + self.oversleep


def make(rate: float, time: FakeTime, **options: float) -> RateLoop:
    return RateLoop(rate, clock=time.clock, sleep=time.sleep, **options)


def test_cycles_start_at_multiples_of_the_period_whatever_a_cycle_takes() -> None:
    time = FakeTime()
    loop = make(10, time)
    starts = []
    for due in loop.ticks(0.5):
        starts.append((due, time.now - 1000.0))
        time.now += 0.03 * len(starts) % 0.09
    assert [due for due, _ in starts] == pytest.approx([0.0, 0.1, 0.2, 0.3, 0.4])
    assert [now for _, now in starts] == pytest.approx([0.0, 0.1, 0.2, 0.3, 0.4])
    assert loop.counters.late == loop.counters.skipped == 0
    assert loop.achieved == pytest.approx(10.0)
    assert time.now - 1000.0 == pytest.approx(0.5), "the last cycle has its whole period"


def test_oversleeping_does_not_add_up() -> None:
    time = FakeTime(oversleep=0.004)
    loop = make(100, time)
    starts = [time.now - 1000.0 for _ in loop.ticks(1.0)]
    assert len(starts) == 100
    assert starts[-1] == pytest.approx(0.99 + 0.004)
    assert loop.counters.worst == pytest.approx(0.004)
    assert loop.counters.late == 99
    assert loop.counters.late_by == pytest.approx(99 * 0.004)
    assert loop.counters.skipped == 0


def test_a_cycle_just_over_its_period_makes_the_next_late_but_skips_nothing() -> None:
    time = FakeTime()
    loop = make(10, time, tolerance=0.01)
    starts = []
    for due in loop.ticks(0.4):
        starts.append(due)
        time.now += 0.105 if len(starts) == 1 else 0.0
    assert starts == pytest.approx([0.0, 0.1, 0.2, 0.3])
    assert loop.counters.skipped == 0
    assert loop.counters.late == 0
    assert loop.counters.worst == pytest.approx(0.005)


def test_a_cycle_that_is_late_by_less_than_a_sleep_is_exact_begins_at_once() -> None:
    """At 10 kHz, which no line has room for: it runs without pauses, instead of sleeping into the next period."""
    time = FakeTime(oversleep=0.0001)
    loop = make(10_000, time)
    ticks = loop.ticks()
    next(ticks)
    for _ in range(10):
        time.now += 0.00095
        next(ticks)
    assert time.slept == []
    assert loop.counters.late == 0


def test_deadlines_that_were_run_over_are_skipped_not_made_up_for() -> None:
    time = FakeTime()
    loop = make(10, time)
    starts = []
    for due in loop.ticks(1.0):
        starts.append((due, time.now - 1000.0))
        time.now += 0.35 if len(starts) == 2 else 0.0
    # The second cycle lasts from 0.1 to 0.45: those due at 0.2, 0.3 and 0.4 never start.
    assert [due for due, _ in starts] == pytest.approx([0.0, 0.1, 0.5, 0.6, 0.7, 0.8, 0.9])
    assert [now for _, now in starts] == pytest.approx([0.0, 0.1, 0.5, 0.6, 0.7, 0.8, 0.9])
    assert loop.counters.skipped == 3
    assert loop.counters.cycles == 7
    assert loop.achieved == pytest.approx(6 / 0.9)


@pytest.mark.parametrize(("duration", "cycles"), [(0.3, 3), (0.31, 4), (0.1, 1), (0.05, 1), (0.0, 0)])
def test_how_many_cycles_a_duration_has(duration: float, cycles: int) -> None:
    time = FakeTime()
    loop = make(10, time)
    assert len(list(loop.ticks(duration))) == loop.counters.cycles == cycles


def test_without_a_duration_it_continues_forever() -> None:
    time = FakeTime()
    loop = make(1000, time)
    for due in loop.ticks():
        if due > 5:
            break
    assert loop.counters.cycles == 5002
    assert loop.achieved == pytest.approx(1000)


def test_before_two_cycles_there_is_no_rate() -> None:
    loop = make(10, FakeTime())
    assert loop.achieved == 0.0
    next(loop.ticks())
    assert loop.achieved == 0.0


@pytest.mark.parametrize("rate", [0, -1, math.nan, math.inf])
def test_a_rate_that_is_none_is_refused(rate: float) -> None:
    with pytest.raises(UsageError, match="is not possible"):
        RateLoop(rate)


def test_delays_of_the_late_alone_are_added() -> None:
    time = FakeTime()
    loop = make(10, time)
    for i, _ in enumerate(loop.ticks(1.0)):
        # Into the next cycle by 5, 15 and 95 ms; the tolerance is 10 ms.
        time.now += {1: 0.105, 4: 0.115, 6: 0.195}.get(i, 0.0)
    assert loop.counters.late == 0, "one that is later than the tolerance is skipped"
    assert loop.counters.skipped == 2
    assert loop.counters.worst == pytest.approx(0.005)
    late = FakeTime(oversleep=0.02)
    loop = make(10, late, tolerance=0.03)
    list(loop.ticks(0.5))
    assert (loop.counters.late, loop.counters.late_by) == (0, 0.0)
    assert loop.counters.worst == pytest.approx(0.02)
    assert loop.due == pytest.approx(0.4)


def test_rates_have_bounds() -> None:
    assert RateLoop(10_000.0).period == 1e-4
    assert RateLoop(1 / 3600).period == pytest.approx(3600.0)
    assert RateLoop(10.0).tolerance == pytest.approx(0.01)
    assert RateLoop(1000.0).tolerance == RateLoop(10_000.0).tolerance == pytest.approx(1e-4)
    assert RateLoop(10.0, tolerance=0.0).tolerance == 0.0
    for rate in (10_001.0, 1 / 3601):
        with pytest.raises(UsageError, match="is not possible"):
            RateLoop(rate)
