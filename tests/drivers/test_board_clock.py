"""When a frame was sent, by the clock of the board that sent it."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexwire.drivers.board2 import BoardClock


def test_frames_that_waited_were_sent_when_the_board_says() -> None:
    clock = BoardClock()
    assert clock.sent(5.0, 100.0) == 100.0
    # The program could not run for 3 s; then all that waited arrives at once.
    waited = [clock.sent(5.0 + 0.5 * i, 103.0) for i in range(1, 7)]
    assert waited == pytest.approx([100.0 + 0.5 * i for i in range(1, 7)], abs=0.0301)
    assert clock.sent(8.1, 103.1) == pytest.approx(103.1)


def test_a_faster_frame_corrects_those_before() -> None:
    clock = BoardClock()
    assert clock.sent(5.0, 100.2) == 100.2
    assert clock.sent(6.0, 101.0) == 101.0
    assert clock.sent(7.0, 102.2) == pytest.approx(102.0, abs=0.0121)


def test_reports_that_waited_behind_a_later_answer_are_not_dated_by_arrival() -> None:
    clock = BoardClock()
    assert clock.sent(5.0, 100.0) == 100.0
    assert clock.sent(8.0, 103.0) == 103.0
    assert [clock.sent(6.0, 103.1), clock.sent(7.0, 103.1), clock.sent(8.0, 103.1)] == [101.0, 102.0, 103.0]
    assert clock.sent(8.2, 103.2) == 103.2


@pytest.mark.parametrize(("to", "arrived"), [(0.1, 100.1), (49.9, 101.5)])
def test_a_board_that_was_reset_is_dated_by_arrival(to: float, arrived: float) -> None:
    clock = BoardClock()
    clock.sent(50.0, 100.0)
    assert clock.sent(to, arrived) == arrived


def test_a_board_without_a_clock_is_dated_by_arrival() -> None:
    clock = BoardClock()
    assert [clock.sent(0.0, at) for at in (100.0, 100.1, 103.0)] == [100.0, 100.1, 103.0]


def test_a_board_that_was_reset_soon_after_its_start_is_dated_right_after_a_second() -> None:
    clock = BoardClock()
    clock.sent(9.0, 100.0)
    # Until then its frames may be reports that waited: they are taken for older than they are, never for newer.
    assert clock.sent(0.5, 100.5) == pytest.approx(91.5)
    assert clock.sent(1.1, 101.1) == pytest.approx(101.1)


@given(
    st.floats(-0.009, 0.009),
    st.lists(st.tuples(st.floats(0.001, 5.0), st.floats(0.0, 5.0)), min_size=1, max_size=30),
)
def test_no_frame_is_later_than_its_arrival_nor_earlier_than_it_was(
    drift: float, frames: list[tuple[float, float]]
) -> None:
    clock, time, arrived = BoardClock(), 100.0, 0.0
    for since, under_way in frames:
        time += since
        arrived = max(arrived, time + under_way)
        sent = clock.sent((1.0 + drift) * (time - 100.0), arrived)
        assert time - 1e-9 <= sent <= arrived + 1e-9
