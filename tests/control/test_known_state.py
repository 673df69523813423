from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.model import states

from hexwire.control.loop.known_state import KnownState, SampleClock, StateFilter
from hexwire.model.state import JointFlag, JointState

NAN = math.nan
SILENT = int(JointFlag.SILENT)


def make_state(
    stamp: float,
    position: tuple[float, ...],
    **known: Any,
) -> JointState:
    return states.make_state(*position, stamp=stamp, **known)


def take(states: StateFilter, *args: object, **more: object) -> KnownState:
    known = states.take(make_state(*args, **more))  # type: ignore[arg-type]  # handed through
    assert known is not None
    return known


def test_what_is_known_is_returned_as_it_is() -> None:
    known = take(StateFilter(), 5.0, (0.1, 0.2), velocity=(1.0, -1.0), age=(0.02, 0.01))
    assert known == KnownState(("J1", "J2"), (0.1, 0.2), (1.0, -1.0), 0.01)


def test_a_state_in_which_nothing_is_missing_is_filtered_as_any_other() -> None:
    complete = make_state(5.0, (0.1, 0.2), velocity=(1.0, -1.0), age=(0.02, 0.01))
    assert StateFilter()._complete(complete)
    assert StateFilter().take(complete) == StateFilter()._part(complete, (1.0, -1.0))
    without_velocity = make_state(5.0, (0.1, 0.2), velocity=(1.0, NAN), age=(0.02, 0.01))
    assert StateFilter().take(without_velocity) == StateFilter()._part(without_velocity, (1.0, 0.0))
    for missing in (
        make_state(5.0, (0.1, NAN), velocity=(1.0, -1.0)),
        make_state(5.0, (0.1, 0.2), velocity=(1.0, -1.0), age=(math.inf, 0.01)),
        make_state(5.0, (0.1, 0.2), velocity=(1.0, -1.0), age=(0.6, 0.01)),
        make_state(5.0, (), velocity=()),
    ):
        assert not StateFilter(max_age=0.5)._complete(missing)


@pytest.mark.parametrize("bad", [NAN, math.inf, -math.inf])
def test_a_joint_without_a_position_is_left_out(bad: float) -> None:
    known = take(StateFilter(), 5.0, (bad, 0.2, 0.3), age=(0.0, 0.02, 0.03))
    assert known.names == ("J2", "J3")
    assert known.age == 0.02, "the age of what is known, not of what is left out"


def test_a_joint_that_was_never_sampled_is_left_out() -> None:
    assert take(StateFilter(), 5.0, (0.0, 0.2), age=(math.inf, 0.0)).names == ("J2",)


def test_a_silent_joint_goes_when_its_sample_is_old() -> None:
    states = StateFilter(max_age=0.5)
    assert take(states, 5.0, (0.1, 0.2)).names == ("J1", "J2")
    assert take(states, 5.4, (0.1, 0.2), flags=(SILENT, 0), age=(0.4, 0.0)).names == ("J1", "J2")
    assert take(states, 5.6, (0.1, 0.2), flags=(SILENT, 0), age=(0.6, 0.0)).names == ("J2",)
    assert take(states, 5.7, (0.1, 0.2)).names == ("J1", "J2")


def test_an_answering_joint_stays_on_a_slow_line() -> None:
    assert take(StateFilter(), 5.0, (0.1, 0.2), age=(0.7, 0.0)).names == ("J1", "J2")


def test_without_a_known_joint_there_is_nothing() -> None:
    states = StateFilter()
    assert states.take(make_state(5.0, (NAN, NAN))) is None
    assert states.take(make_state(5.1, (0.1, 0.2), flags=(SILENT, SILENT), age=(0.6, 0.7))) is None
    assert states.take(make_state(5.2, ())) is None


def test_the_same_sample_is_returned_once() -> None:
    states = StateFilter()
    take(states, 5.0, (0.1,))
    assert states.take(make_state(5.0, (0.1,))) is None
    assert states.take(make_state(5.25, (0.1,), age=(0.25,))) is None
    take(states, 5.3, (0.1,), age=(0.2,))


def test_the_board_tells_that_a_sample_is_the_same_though_the_line_jitters() -> None:
    states = StateFilter()
    take(states, 5.0, (0.1,), board_time=100.0)
    assert states.take(make_state(5.004, (0.1,), board_time=100.0)) is None
    take(states, 5.012, (0.1,), board_time=100.010)


def test_states_that_waited_together_do_not_share_a_stamp() -> None:
    states = StateFilter()
    take(states, 5.020, (0.1,), board_time=100.0)
    assert states.take(make_state(5.020, (0.2,), board_time=100.010)) is None
    # But what it said of the speed is not lost.
    assert take(states, 5.025, (0.3,), board_time=100.020).velocity == pytest.approx((10.0,))


def test_states_continue_after_a_reset_of_the_board() -> None:
    states = StateFilter()
    take(states, 5.0, (0.1,), board_time=100.0)
    assert take(states, 5.5, (0.2,), board_time=0.3).velocity == pytest.approx((0.2,))
    assert take(states, 5.52, (0.2,), board_time=0.32).names == ("J1",)


def test_a_velocity_that_is_not_given_is_the_slope_of_the_last_tenth_of_a_second() -> None:
    states = StateFilter()
    assert take(states, 1.0, (0.5,)).velocity == (0.0,)
    assert take(states, 1.02, (0.52,)).velocity == pytest.approx((1.0,))
    for i in range(2, 6):
        take(states, 1.0 + 0.02 * i, (0.5 + 0.02 * i,))
    # It stops: after a tenth of a second nothing is left of the motion.
    speeds = [take(states, 1.1 + 0.02 * i, (0.6,)).velocity[0] for i in range(1, 6)]
    assert speeds == pytest.approx([0.8, 0.6, 0.4, 0.2, 0.0], abs=1e-6)


def test_the_driver_is_believed_where_it_gives_a_velocity() -> None:
    states = StateFilter()
    take(states, 1.0, (0.0, 0.0), velocity=(0.0, NAN))
    assert take(states, 1.1, (0.1, 0.1), velocity=(7.0, NAN)).velocity == pytest.approx((7.0, 1.0))


def test_a_joint_without_a_new_sample_keeps_its_velocity() -> None:
    states = StateFilter()
    take(states, 1.0, (0.0, 0.0))
    take(states, 1.1, (0.1, 0.1))
    kept = take(states, 1.2, (0.1, 0.1), age=(0.1, 0.0), flags=(SILENT, 0))
    assert kept.velocity == pytest.approx((1.0, 0.0), abs=1e-6)


def test_a_slow_line_gives_slopes_between_neighbours() -> None:
    states = StateFilter()
    take(states, 1.0, (0.0,))
    assert take(states, 1.7, (0.7,)).velocity == pytest.approx((1.0,))
    assert take(states, 2.4, (0.0,)).velocity == pytest.approx((-1.0,))


def test_after_a_gap_the_estimate_starts_afresh() -> None:
    states = StateFilter()
    take(states, 1.0, (0.0,))
    take(states, 1.1, (0.1,))
    assert take(states, 2.2, (0.9,)).velocity == (0.0,)
    assert take(states, 2.3, (0.8,)).velocity == pytest.approx((-1.0,))


def test_a_lost_joint_starts_afresh_while_the_others_continue() -> None:
    states = StateFilter()
    take(states, 1.0, (0.0, 0.0))
    for i in range(1, 16):
        age = 0.1 * i
        take(states, 1.0 + age, (0.0, 0.1 * i), age=(age, 0.0), flags=(SILENT, 0))
    assert take(states, 2.6, (0.5, 1.6)).velocity == pytest.approx((0.0, 1.0))


def test_the_board_clock_takes_the_jitter_of_the_line_out_of_velocities() -> None:
    states = StateFilter()
    late = [0.0, 0.008, 0.001, 0.009, 0.0, 0.004]
    for i, delay in enumerate(late):
        known = states.take(make_state(1.0 + 0.01 * i + delay, (0.01 * i,), board_time=50.0 + 0.01 * i))
        if known is not None and i:
            assert known.velocity == pytest.approx((1.0,))


def test_the_clock_goes_by_the_board_where_it_can() -> None:
    clock = SampleClock()
    times = [
        clock.time(make_state(stamp, (0.0,), board_time=board))
        for stamp, board in [(5.0, 70.0), (5.013, 70.01), (5.3, 0.1), (5.4, NAN), (5.5, 4000.0), (5.6, 4000.11)]
    ]
    assert times == pytest.approx([5.0, 5.01, 5.297, 5.397, 5.497, 5.607])


@st.composite
def histories(draw: st.DrawFn) -> list[JointState]:
    """Any states whose stamps do not fall, with whatever a bad line makes of them."""
    step = st.sampled_from([0.0, 1e-6, 0.001, 0.01, 0.02, 0.7, 3.0])
    value = st.sampled_from([0.0, 0.5, -1.0, NAN])
    out, stamp, board = [], 10.0, 3.0
    for _ in range(draw(st.integers(1, 25))):
        elapsed = draw(step)
        stamp += elapsed
        board = draw(st.sampled_from([board + elapsed, board, 0.0, NAN]))
        out.append(
            make_state(
                stamp,
                (draw(value), draw(value)),
                velocity=(draw(value), NAN),
                age=(draw(st.sampled_from([0.0, 0.01, 0.4, 0.9, math.inf])), draw(st.sampled_from([0.0, 2.0]))),
                flags=(draw(st.sampled_from([0, SILENT])), 0),
                board_time=board,
            )
        )
    return out


@given(histories())
def test_whatever_comes_stamps_rise_and_values_are_numbers(history: list[JointState]) -> None:
    states, last = StateFilter(), -math.inf
    for state in history:
        known = states.take(state)
        if known is None:
            continue
        assert state.stamp - known.age > last
        last = state.stamp - known.age
        assert known.age >= 0
        assert len(known.names) == len(known.position) == len(known.velocity) > 0
        assert all(map(math.isfinite, (*known.position, *known.velocity, known.age)))
        for name, position in zip(known.names, known.position, strict=True):
            joint = state[name]
            assert position == joint.position
            assert not (joint.flags & JointFlag.SILENT and joint.age > 0.5)
