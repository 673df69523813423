"""How a motion is run: the values that are refused."""

from __future__ import annotations

import math

import pytest

from hexwire.control.motion.motion_options import MotionObserver, MotionOptions
from hexwire.errors import UsageError


def test_by_default_the_board_keeps_the_time_and_the_watchdog_is_armed() -> None:
    options = MotionOptions()
    assert not options.host_timed
    assert not options.outlives
    assert options.watchdog == 1.0


def test_the_goal_has_the_tolerance_of_each_joint() -> None:
    goal = MotionOptions(tolerance=0.02, standing=0.1).goal(("J1", "J2"))
    assert list(goal) == ["J1", "J2"]
    assert (goal["J1"].position, goal["J1"].velocity) == (0.02, 0.1)


@pytest.mark.parametrize(
    "wrong",
    [
        {"tolerance": 0.0},
        {"tolerance": math.nan},
        {"grace": 0.0},
        {"grace": math.inf},
        {"standing": -1.0},
        {"watchdog": math.nan},
        {"rate": 1e9},
        {"rate": math.nan},
        {"rate": -20.0},
        {"table": math.nan},
    ],
)
def test_options_that_make_no_sense_are_refused(wrong: dict[str, float]) -> None:
    """A tolerance of 0 would be there at once, a grace of 0 never end."""
    with pytest.raises(UsageError, match=next(iter(wrong))):
        MotionOptions(**wrong)  # type: ignore[arg-type]


def test_an_observer_does_nothing_unless_it_is_told_to() -> None:
    observer = MotionObserver()
    observer.unwatched(1.0)
    observer.powered(("J1",))
