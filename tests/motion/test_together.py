from __future__ import annotations

import pytest
from tests.motion.arms import rest_to_rest

from hexwire.motion.together import Together

ARM = rest_to_rest(("a", "b"), (0.0, 0.0), (1.0, 2.0), 2.0)
NEXT = rest_to_rest(("a", "b"), (1.0, 2.0), (0.0, 2.0), 1.0)
HAND = rest_to_rest(("c",), (0.5,), (0.0,), 1.0)


def test_each_starts_at_its_own_time_and_rests_before_and_after() -> None:
    both = Together(("c", "a", "b"), {("a", "b"): [(ARM, 0.0)], ("c",): [(HAND, 1.5)]})
    assert both.duration == 2.5
    assert both.sample(0.5).position == (0.5, *ARM.sample(0.5).position)
    assert both.sample(2.2).position == pytest.approx((HAND.sample(0.7).position[0], 1.0, 2.0))
    assert both.sample(2.2).velocity == pytest.approx((HAND.sample(0.7).velocity[0], 0.0, 0.0))
    assert both.goal == (0.0, 1.0, 2.0)


def test_the_next_one_counts_from_its_start_on() -> None:
    path = Together(("a", "b"), {("a", "b"): [(ARM, -1.0), (NEXT, 0.5)]})
    assert path.duration == 1.5
    assert path.sample(0.4) == ARM.sample(1.4)
    assert path.sample(0.5) == NEXT.sample(0.0)
    assert path.sample(1.0) == NEXT.sample(0.5)


def test_nothing_lasts_no_time() -> None:
    assert Together((), {}).duration == 0.0
