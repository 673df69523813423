from __future__ import annotations

import math

import pytest
from tests.few import few

from hexwire.errors import UsageError
from hexwire.motion.compare import best_lag, compare

NAMES = ("J1", "J2")


def _motion(
    lag: float = 0.0, offset: float = 0.0, rate: float = 50.0, start: float = 0.0, duration: float = 8.0
) -> list[tuple[float, tuple[float, float]]]:
    """A swing that begins after a second, `lag` later."""
    rows = []
    for i in range(int(duration * rate) + 1):
        t = i / rate
        s = min(max(t - 1.0 - lag, 0.0), 5.0)
        rows.append((start + t, (0.6 * math.sin(2.0 * s) + offset, 0.3 * (1 - math.cos(s)))))
    return rows


def test_the_same_motion_has_no_difference() -> None:
    found = compare(NAMES, _motion(), _motion(rate=20.0))
    assert found.lag == 0
    assert [joint.name for joint in found.joints] == ["J1", "J2"]
    # Straight lines between 20 points a second.
    assert all(joint.rms < 0.001 for joint in found.joints)
    assert found.times[0] == 0.0
    assert found.times[-1] == pytest.approx(8.0)


def test_an_offset_is_rms_and_greatest_difference_of_its_joint_only() -> None:
    first, second = compare(NAMES, _motion(), _motion(offset=-0.1)).joints
    assert (first.rms, first.largest) == pytest.approx((0.1, -0.1))
    assert second.rms == pytest.approx(0.0, abs=1e-12)


def test_the_greatest_difference_has_its_time() -> None:
    second = [(t, (a + (0.2 if abs(t - 4.0) < 0.011 else 0.0), b)) for t, (a, b) in _motion()]
    joint = compare(NAMES, _motion(), second).joints[0]
    assert joint.largest == pytest.approx(0.2, abs=0.01)
    assert joint.at == pytest.approx(4.0, abs=0.02)


@few("lag", [-0.8, -0.013, 0.0, 0.37, 1.5], -0.8, 0.37)
def test_the_best_lag_is_found_and_removes_the_difference(lag: float) -> None:
    first, second = _motion(), _motion(lag)
    found = best_lag(first, second)
    assert found == pytest.approx(lag, abs=0.004)
    assert all(joint.rms < 0.005 for joint in compare(NAMES, first, second, found).joints)


def test_clocks_of_two_recordings_need_not_agree() -> None:
    first, second = _motion(start=100.0), _motion(0.25, start=2000.0)
    found = best_lag(first, second)
    assert found == pytest.approx(1900.25, abs=0.004)
    assert compare(NAMES, first, second, found).times[0] == pytest.approx(100.0)


def test_nothing_moves_then_there_is_no_lag() -> None:
    still = [(i / 50, (0.1, 0.2)) for i in range(200)]
    assert best_lag(still, still) == 0


def test_unknown_positions_are_left_out() -> None:
    second = [(t, (math.nan, b)) for t, (_, b) in _motion()]
    first, other = compare(NAMES, _motion(), second).joints
    assert math.isnan(first.rms)
    assert other.rms == pytest.approx(0.0, abs=1e-12)
    assert best_lag(_motion(), second) == pytest.approx(0.0, abs=0.004)


def test_what_cannot_be_compared_is_refused() -> None:
    with pytest.raises(UsageError, match="do not overlap when one is moved by 99"):
        compare(NAMES, _motion(), _motion(), 99.0)
    with pytest.raises(UsageError, match="an empty motion"):
        best_lag(_motion(), [])


@few("speed, lag", [(1.4, 0.3), (3.1, -0.417), (6.0, 0.233)], (3.1, -0.417))
def test_of_a_motion_that_repeats_itself_the_shortest_lag_is_found(speed: float, lag: float) -> None:
    def swing(lag: float) -> list[tuple[float, tuple[float, ...]]]:
        return [(i / 50, tuple(math.sin(speed * (i / 50 - lag) + k) for k in range(3))) for i in range(2000)]

    assert best_lag(swing(0.0), swing(lag)) == pytest.approx(lag, abs=0.004)
