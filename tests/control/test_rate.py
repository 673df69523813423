from __future__ import annotations

import itertools

import pytest

from hexwire.control.loop.rate import Periodic, RateMeter


def asked(periodic: Periodic, times: list[float], period: float = 1.0) -> list[float]:
    """Those of the times at which it says yes; what is due is done."""
    yes = []
    for now in times:
        if periodic.due(now, period):
            periodic.done(now)
            yes.append(now)
    return yes


def test_the_first_time_is_at_once_and_then_once_a_period() -> None:
    times = [i * 0.25 for i in range(17)]
    assert asked(Periodic(), times) == [0.0, 1.0, 2.0, 3.0, 4.0]


def test_a_slightly_late_call_does_not_shift_the_due_times() -> None:
    times = [i * 0.3 for i in range(100)]
    yes = asked(Periodic(), times)
    assert len(yes) == 30
    assert yes[-1] < 29.3


def test_missed_periods_are_not_made_up_for() -> None:
    periodic = Periodic()
    assert asked(periodic, [0.0, 5.7, 5.8, 6.2, 6.7, 6.8, 7.7]) == [0.0, 5.7, 6.7, 7.7]


def test_a_hurry_after_a_pause_is_at_once() -> None:
    periodic = Periodic()
    assert periodic.due(0.0, 1.0)
    assert periodic.due(1.0, 1.0)
    # Looked at, but nothing to do: `done` was not called.
    periodic.hurry()
    assert periodic.due(1.1, 1.0)
    periodic.done(1.1)
    assert not periodic.due(1.2, 1.0)
    assert not periodic.due(2.0, 1.0)
    assert periodic.due(2.1, 1.0)


def test_a_hurry_is_never_more_than_once_a_period() -> None:
    periodic = Periodic()
    yes = []
    for i in range(1000):
        periodic.hurry()
        if periodic.due(i * 0.01, 1.0):
            periodic.done(i * 0.01)
            yes.append(i * 0.01)
    assert len(yes) == 10
    assert min(b - a for a, b in itertools.pairwise(yes)) > 0.99


def test_a_hurry_waits_until_it_may() -> None:
    periodic = Periodic()
    assert periodic.due(0.0, 1.0)
    periodic.done(0.6)
    periodic.hurry()
    assert not periodic.due(0.9, 1.0)
    assert periodic.due(1.0, 1.0)
    # That was the time of the periodic; the hurry is over with it.
    assert not periodic.due(1.7, 1.0)


def test_the_period_may_change() -> None:
    periodic = Periodic()
    assert periodic.due(0.0, 10.0)
    assert not periodic.due(9.0, 0.1)
    assert periodic.due(10.0, 0.1)
    assert periodic.due(10.1, 0.1)


def test_a_rate() -> None:
    meter = RateMeter(window=2.0)
    assert meter.rate(0.0) == 0.0
    meter.count(0.0)
    assert meter.rate(0.0) == 0.0
    for i in range(1, 101):
        meter.count(i * 0.1)
    assert meter.rate(10.0) == pytest.approx(10.0)
    assert meter.rate(13.0) == 0.0


def test_a_rate_forgets_what_is_over_without_being_asked() -> None:
    meter = RateMeter(window=1.0)
    for i in range(10_000):
        meter.count(i * 0.1)
    assert len(meter._times) <= 12


def test_an_early_action_keeps_the_due_times() -> None:
    schedule = Periodic()
    assert schedule.due(0.0, 1.0)
    assert not schedule.due(0.74, 1.0, 0.25)
    assert schedule.due(0.75, 1.0, 0.25)
    assert not schedule.due(1.5, 1.0)
    assert schedule.due(2.0, 1.0)
    # A whole period late begins a new one, less keeps the old.
    assert schedule.due(3.875, 1.0)
    assert schedule.due(4.0, 1.0)
    assert schedule.due(6.0, 1.0)
    assert not schedule.due(6.5, 1.0)
    assert schedule.due(7.0, 1.0)


def test_a_hurry_counts_from_what_was_done() -> None:
    schedule = Periodic()
    assert schedule.due(0.0, 1.0)
    schedule.done(0.0)
    schedule.due(1.0, 1.0)
    schedule.hurry()
    assert schedule.due(1.0, 1.0), "nothing was done for exactly a period"
    assert not schedule.due(1.5, 1.0), "and it is over"


def test_a_rate_counts_what_is_within_its_window() -> None:
    meter = RateMeter()
    for now in (0.0, 1.0, 2.0):
        meter.count(now)
    assert meter.rate(2.0) == 1.0
    assert meter.rate(3.0) == 1.0
    assert meter.rate(3.01) == 0.0
    both = RateMeter()
    both.count(5.0)
    both.count(5.0)
    assert both.rate(5.0) == pytest.approx(1e9)
