"""The offset of another computer's clock: the truth is always within the stated uncertainty."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexwire.fleet.clock import ClockOffset


def test_without_an_exchange_nothing_is_known() -> None:
    clock = ClockOffset()
    assert not clock.known
    assert clock.at(5.0) == (0.0, math.inf)


def test_half_the_shortest_round_trip_is_the_uncertainty() -> None:
    clock = ClockOffset()
    clock.add(10.0, 110.3, 11.0)
    clock.add(12.0, 112.05, 12.1)
    offset, doubt = clock.at(12.05)
    assert offset == pytest.approx(100.0)
    assert doubt == pytest.approx(0.05, rel=1e-3)


_WAY = st.floats(0.0, 0.5)


@given(
    offset=st.floats(-1e9, 1e9),
    drift=st.floats(-1e-4, 1e-4),
    steps=st.lists(st.tuples(st.floats(0.0, 300.0), _WAY, _WAY), min_size=1, max_size=60),
    later=st.floats(0.0, 3600.0),
)
def test_the_true_offset_is_within_the_uncertainty_for_any_delays_and_drift(
    offset: float, drift: float, steps: list[tuple[float, float, float]], later: float
) -> None:
    clock, now = ClockOffset(), 0.0
    for wait, there, back in steps:
        sent = now + wait
        clock.add(sent, sent + there + offset + drift * (sent + there), sent + there + back)
        now = sent + there + back
        for when in (now, now + later):
            estimate, doubt = clock.at(when)
            assert abs(estimate - (offset + drift * when)) <= doubt
    assert clock.jumps == 0, "drift is no jump"


@given(
    jump=st.floats(1.5, 1e6).flatmap(lambda far: st.sampled_from([far, -far])),
    before=st.lists(st.tuples(_WAY, _WAY), min_size=1, max_size=40),
    there=_WAY,
    back=_WAY,
)
def test_a_clock_that_jumps_is_noticed_by_the_next_exchange_and_followed(
    jump: float, before: list[tuple[float, float]], there: float, back: float
) -> None:
    clock, now = ClockOffset(), 0.0
    for way, home in before:
        clock.add(now, now + way, now + way + home)
        now += way + home
    clock.add(now, now + there + jump, now + there + back)
    now += there + back
    assert clock.jumps == 1
    offset, doubt = clock.at(now)
    assert abs(offset - jump) <= doubt


def test_a_jump_that_is_smaller_than_what_is_known_does_not_count_as_drift_for_long() -> None:
    clock = ClockOffset()
    clock.add(0.0, 0.001, 0.002)
    clock.add(1.0, 1.0 + 0.010 + 0.001, 1.002)
    offset, doubt = clock.at(1.0)
    assert clock.jumps == 1
    assert abs(offset - 0.010) <= doubt


@pytest.mark.parametrize(
    ("sent", "other", "received"),
    [
        (1.0, 5.0, 0.9),
        (1.0, math.nan, 1.1),
        (1.0, math.inf, 1.1),
        (1.0, -1e308, 1.1),
        (math.nan, 5.0, 1.1),
        (-math.inf, 5.0, 1.1),
        (1.0, 5.0, math.inf),
    ],
)
def test_what_is_no_exchange_is_ignored(sent: float, other: float, received: float) -> None:
    clock = ClockOffset()
    clock.add(sent, other, received)
    assert not clock.known
    clock.add(1.0, 5.0, 1.0)
    clock.add(sent, other, received)
    assert clock.at(1.0)[0] == 4.0
    assert clock.jumps == 0


def test_a_clock_of_which_little_is_known_is_compared_again_soon() -> None:
    clock = ClockOffset()
    assert clock.period(0.0) == 0.5
    clock.add(0.0, 100.1, 0.2)
    assert clock.period(0.2) == 0.5
    clock.add(0.3, 100.301, 0.302)
    assert clock.period(0.302) == 5.0


def test_a_better_exchange_counts_at_once() -> None:
    clock = ClockOffset()
    clock.add(0.0, 100.1, 0.2)
    assert clock.at(0.25)[1] == pytest.approx(0.1, rel=0.01)
    clock.add(0.3, 100.301, 0.302)
    offset, doubt = clock.at(0.31)
    assert offset == pytest.approx(100.0, abs=doubt)
    assert doubt < 0.0011
