from __future__ import annotations

import math
import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexwire.errors import UsageError
from hexwire.model import pose as p

ANGLES = st.floats(-math.pi, math.pi)


def flat(m: p.Matrix) -> list[float]:
    return [v for row in m for v in row]


@given(ANGLES, ANGLES, ANGLES)
def test_quaternion_turns_as_the_matrix_does(roll: float, pitch: float, yaw: float) -> None:
    m = p.rotation_from_rpy(roll, pitch, yaw)
    x, y, z, w = p.quaternion(m)
    assert math.hypot(x, y, z, w) == pytest.approx(1.0)
    assert w >= 0
    again = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
        (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
        (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
    )
    assert flat(again) == pytest.approx(flat(m), abs=1e-12)


@pytest.mark.parametrize("axis", range(3))
def test_the_quaternion_of_a_half_turn_is_its_axis(axis: int) -> None:
    """Exactly half a turn: all but one of the four numbers are 0."""
    a, b, c = (1.0 if i == axis else -1.0 for i in range(3))
    x, y, z, w = p.quaternion(((a, 0.0, 0.0), (0.0, b, 0.0), (0.0, 0.0, c)))
    assert (abs(x), abs(y), abs(z), w) == tuple(float(i == axis) for i in range(4))


@given(ANGLES, ANGLES, ANGLES, st.floats(0, 1))
def test_slerp_ends_where_it_should_and_turns_evenly(roll: float, pitch: float, yaw: float, part: float) -> None:
    a, b = p.rotation_from_rpy(0.3, -0.2, 1.0), p.rotation_from_rpy(roll, pitch, yaw)
    assert flat(p.slerp(a, b, 0.0)) == pytest.approx(flat(a), abs=1e-9)
    assert flat(p.slerp(a, b, 1.0)) == pytest.approx(flat(b), abs=1e-6)
    _, whole = p.rotation_between(a, b)
    _, some = p.rotation_between(a, p.slerp(a, b, part))
    assert some == pytest.approx(part * whole, abs=1e-6)


def test_rotations_turn_the_right_way() -> None:
    quarter = math.pi / 2
    assert p.apply(p.rotation_z(quarter), (1, 0, 0)) == pytest.approx((0, 1, 0))
    assert p.apply(p.rotation_x(quarter), (0, 1, 0)) == pytest.approx((0, 0, 1))
    assert p.apply(p.rotation_y(quarter), (0, 0, 1)) == pytest.approx((1, 0, 0))
    assert flat(p.multiply(p.rotation_x(0.3), p.transpose(p.rotation_x(0.3)))) == pytest.approx(flat(p.IDENTITY))


def test_printed_rotations_are_made_square_again() -> None:
    rng = random.Random(3)
    for _ in range(50):
        m = p.rotation_from_rpy(*(rng.uniform(-3, 3) for _ in range(3)))
        again = p.rotation_from_numbers([round(v, 4) for v in flat(m)])
        assert flat(again) == pytest.approx(flat(m), abs=2e-4)
        assert flat(p.multiply(again, p.transpose(again))) == pytest.approx(flat(p.IDENTITY), abs=1e-14)


@pytest.mark.parametrize(
    "numbers", [[1.0] * 9, [1, 0, 0, 0, 1, 0, 0, 0, -1], [1, 0, 0], [math.nan] * 9, [1, 0, 0, 0, 1, 0.2, 0, 0, 1]]
)
def test_what_is_no_rotation_is_refused(numbers: list[float]) -> None:
    with pytest.raises(UsageError, match="rotation"):
        p.rotation_from_numbers(numbers)


def test_no_turn_has_some_axis() -> None:
    assert p.rotation_between(p.IDENTITY, p.IDENTITY) == ((1.0, 0.0, 0.0), 0.0)
    assert p.column(p.rotation_z(math.pi / 2), 0) == pytest.approx((0, 1, 0))
    assert p.cross((1, 0, 0), (0, 1, 0)) == (0, 0, 1)
