"""Two clocks that are related by exchanges: the bounds hold, whatever the delays, and a drift is followed."""

from __future__ import annotations

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexwire.drivers.board2_path import ClockRelation, WrappingClock
from hexwire.errors import UsageError


def run(relation: ClockRelation, *, drift: float, seconds: float, dice: random.Random, every: float = 0.2) -> float:
    """Exchange with random delays; returns the host's time at the end. Board time 5 is host time 100."""
    host = 100.0
    end = host + seconds
    while host < end:
        up, down = dice.uniform(0.004, 0.006), dice.choice([0.006, 0.007, 0.009, 0.1])
        relation.add(host, host + up + down, 5.0 + (host + up - 100.0) / (1.0 + drift))
        host += every
    return host


def test_before_the_first_exchange_nothing_is_known() -> None:
    relation = ClockRelation()
    assert not relation
    with pytest.raises(UsageError, match="not compared"):
        relation.host_time(1.0)
    with pytest.raises(UsageError, match="not compared"):
        relation.board_time(1.0)


def test_one_exchange_bounds_the_difference_and_time_widens_the_bounds() -> None:
    relation = ClockRelation()
    relation.add(10.0, 10.02, 3.0)
    assert relation
    time, uncertainty = relation.host_time(3.0)
    assert time == pytest.approx(10.01)
    assert uncertainty == pytest.approx(0.01)
    assert relation.host_time(4.0).uncertainty == pytest.approx(0.02)
    assert relation.host_time(2.0).uncertainty == pytest.approx(0.02)
    assert relation.board_time(10.01) == pytest.approx(3.0)


def test_a_reply_before_its_request_is_an_error() -> None:
    with pytest.raises(UsageError, match="cannot end"):
        ClockRelation().add(10.0, 9.0, 1.0)


@pytest.mark.parametrize("drift", [-500e-6, -3e-3, 0.0, 500e-6, 3e-3])
def test_a_crystal_that_is_off_is_followed(drift: float) -> None:
    relation = ClockRelation()
    host = run(relation, drift=drift, seconds=30.0, dice=random.Random(1))
    assert relation.drift == pytest.approx(drift, abs=300e-6)
    # Two seconds ahead, as far as a start is planned.
    board = 5.0 + (host + 2.0 - 100.0) / (1.0 + drift)
    time, uncertainty = relation.host_time(board)
    assert abs(time - (host + 2.0)) <= uncertainty <= 0.008
    assert relation.board_time(host + 2.0) == pytest.approx(board, abs=0.008)


@given(
    st.floats(-0.009, 0.009),
    st.lists(st.tuples(st.floats(0.001, 5.0), st.floats(0.0, 0.5), st.floats(0.0, 0.5)), min_size=1, max_size=60),
    st.floats(-10.0, 10.0),
)
def test_the_truth_is_within_the_bounds(
    drift: float, exchanges: list[tuple[float, float, float]], ahead: float
) -> None:
    relation = ClockRelation()
    host = 50.0
    for pause, up, down in exchanges:
        host += pause
        relation.add(host, host + up + down, 7.0 + (host + up) / (1.0 + drift))
    at = host + ahead
    time, uncertainty = relation.host_time(7.0 + at / (1.0 + drift))
    assert abs(time - at) <= uncertainty + 1e-9


def test_a_reset_of_the_board_begins_anew() -> None:
    relation = ClockRelation()
    run(relation, drift=0.0, seconds=10.0, dice=random.Random(2))
    relation.add(200.0, 200.01, 0.5)
    assert relation.host_time(0.5).time == pytest.approx(200.005)


def test_a_clock_of_the_host_that_was_set_begins_anew() -> None:
    relation = ClockRelation()
    run(relation, drift=0.0, seconds=10.0, dice=random.Random(3))
    relation.add(5000.0, 5000.01, 16.0)
    assert relation.host_time(16.0).time == pytest.approx(5000.005, abs=1e-6)


def test_two_exchanges_that_contradict_each_other_leave_the_newer_one() -> None:
    relation = ClockRelation()
    relation.add(10.0, 10.01, 3.0)
    relation.add(5000.0, 5000.02, 4.0)
    assert relation.host_time(4.0) == pytest.approx((5000.01, 0.01), abs=1e-6)


def test_of_exchanges_close_together_the_shortest_is_kept() -> None:
    for at in (5.2, 5.4):
        relation = ClockRelation()
        for board in (0.0, 5.0, 5.2, 5.4, 5.6):
            relation.add(100.0 + board, 100.0 + board + (0.002 if board == at else 0.5), board)
        assert relation.host_time(at).uncertainty == pytest.approx(0.001, abs=1e-6), at


def test_its_memory_is_bounded() -> None:
    relation = ClockRelation()
    run(relation, drift=0.0, seconds=30.0, dice=random.Random(4), every=0.05)
    assert len(relation._exchanges) <= 24


def test_a_clock_of_32_bits_goes_on_over_its_end() -> None:
    clock = WrappingClock()
    assert clock.read(0xFFFFFF00) == pytest.approx(0xFFFFFF00 * 1e-6)
    assert clock.read(0x100) == pytest.approx((0x100000000 + 0x100) * 1e-6)
    assert clock.read(0xFFFFFFF0) == pytest.approx(0xFFFFFFF0 * 1e-6)
