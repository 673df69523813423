from __future__ import annotations

import math

import pytest

from hexwire.model.kinematics import JointRange, Singularity, Solution, wrap


def test_wrap_stays_within_half_a_turn() -> None:
    assert wrap(3.5 * math.pi, math.pi) == pytest.approx(1.5 * math.pi)
    assert wrap(-3.0) == pytest.approx(-3.0)
    assert wrap(4.0) == pytest.approx(4.0 - math.tau)


def test_excess_has_a_sign_and_forgives_rounding() -> None:
    limit = JointRange("J1", -1.0, 2.0)
    assert limit.excess(2.5) == pytest.approx(0.5)
    assert limit.excess(-1.25) == pytest.approx(-0.25)
    assert limit.excess(2.0 + 1e-12) == 0.0


@pytest.mark.parametrize(
    ("angle", "expected"), [(0.1 - math.tau, 0.1), (5.0, 5.0), (5.0 - math.tau, 5.0), (-1.2, 5.083185)]
)
def test_nearest_turn_finds_the_turn_that_limits_allow(angle: float, expected: float) -> None:
    assert JointRange("t5", 0.0, math.tau).nearest_turn(angle) == pytest.approx(expected)


def test_nearest_turn_of_a_range_over_one_turn() -> None:
    wide = JointRange("J4", math.radians(-384), math.radians(194))
    for angle in (-6.0, -3.0, 0.0, 3.0):
        assert wide.excess(wide.nearest_turn(angle)) == 0.0


def test_solution_distance_is_the_largest_turn() -> None:
    assert Solution((1.0, 2.0), "x").distance((1.5, 1.8)) == pytest.approx(0.5)
    assert not Solution((1.0,), "x", ("J1 too far",)).allowed


def test_near_names_small_measures_only() -> None:
    assert Singularity({"elbow": 0.04, "wrist": 0.06}, 0.1).near == ("elbow",)
