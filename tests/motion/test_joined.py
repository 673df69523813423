from __future__ import annotations

import pytest
from tests.motion.arms import rest_to_rest

from hexwire.errors import UsageError
from hexwire.motion.joined import Joined, WithResting, sampled

OUT = rest_to_rest(("a", "b"), (0.0, 0.0), (1.0, 2.0), 2.0)
BACK = rest_to_rest(("a", "b"), (1.0, 2.0), (0.0, 0.5), 1.0)


def test_legs_follow_one_another() -> None:
    path = Joined([OUT, BACK])
    assert path.duration == 3.0
    assert path.sample(1.0) == OUT.sample(1.0)
    assert path.sample(2.0).position == (1.0, 2.0)
    assert path.sample(2.5) == BACK.sample(0.5)
    assert path.goal == (0.0, 0.5)
    assert path.start == (0.0, 0.0)


def test_a_leg_without_duration_is_passed_over() -> None:
    still = rest_to_rest(("a", "b"), (1.0, 2.0), (1.0, 2.0), 1e-12)
    path = Joined([OUT, still, BACK])
    assert path.sample(2.5).position == pytest.approx(BACK.sample(0.5).position)


def test_legs_must_move_the_same_joints() -> None:
    with pytest.raises(UsageError, match="same joints"):
        Joined([OUT, rest_to_rest(("b", "a"), (0.0, 0.0), (1.0, 1.0), 1.0)])
    with pytest.raises(UsageError, match="without a part"):
        Joined([])


def test_other_joints_rest() -> None:
    path = WithResting(OUT, ("c", "b", "a"), {"c": 0.7, "a": 9.0})
    moving = OUT.sample(0.5)
    assert path.duration == 2.0
    assert path.sample(0.5).position == (0.7, moving.position[1], moving.position[0])
    assert path.sample(0.5).velocity == (0.0, moving.velocity[1], moving.velocity[0])
    assert path.sample(0.5).acceleration[0] == 0.0
    with pytest.raises(UsageError, match="nothing moves a; there are b"):
        WithResting(OUT, ("b",), {})


@pytest.mark.parametrize(
    ("step", "most", "count"), [(0.5, 100, 4), (0.3, 100, 6), (0.1, 5, 5), (5.0, 100, 1), (0.4, 1, 1)]
)
def test_samples_leave_out_the_start_and_end_exactly_at_the_end(step: float, most: int, count: int) -> None:
    rows = list(sampled(OUT, step, most))
    assert len(rows) == count
    times = [t for t, _ in rows]
    assert times[0] == pytest.approx(2.0 / count)
    assert times[-1] == 2.0
    assert rows[-1][1].position == (1.0, 2.0)
    assert all(sample == OUT.sample(t) for t, sample in rows)
