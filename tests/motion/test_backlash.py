from __future__ import annotations

import math
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexwire.motion.backlash import BACKLASH_AMPLITUDE, BACKLASH_SECONDS, backlash, backlash_angle

TIMES = [0.02 * i for i in range(round(BACKLASH_SECONDS / 0.02) + 1)]


def test_the_wave_is_small_and_ends_where_it_began() -> None:
    angles = [backlash_angle(t) for t in TIMES]
    assert max(angles) == BACKLASH_AMPLITUDE
    assert min(angles) == -BACKLASH_AMPLITUDE
    assert backlash_angle(0.0) == backlash_angle(BACKLASH_SECONDS) == backlash_angle(1e6) == 0.0
    # At most 12 degrees per second, without a jump.
    assert max(abs(b - a) for a, b in pairwise(angles)) <= math.radians(0.25) + 1e-9


@given(st.floats(0.0, BACKLASH_AMPLITUDE), st.floats(-3.0, 3.0))
def test_play_is_measured_wherever_the_joint_stands(play: float, place: float) -> None:
    here, samples = 0.0, []
    for t in TIMES:
        goal = backlash_angle(t)
        # The joint is dragged along once the play is taken up.
        here = min(max(here, goal - play / 2), goal + play / 2)
        samples.append((t, place + here))
    assert backlash(samples) == pytest.approx(play, abs=1e-6)


def test_a_joint_that_goes_where_it_should_has_none() -> None:
    assert backlash((t, backlash_angle(t - 0.05)) for t in TIMES) == 0.0


def test_too_few_samples() -> None:
    assert math.isnan(backlash([]))
    assert math.isnan(backlash((t, 0.0) for t in TIMES if t < 3.0))
