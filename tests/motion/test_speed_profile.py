"""One joint between two points: times, distances, limits."""

from __future__ import annotations

import math

import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st

from hexwire.motion.speed_profile import JointLimits, Passing, SpeedPiece, change_time, profile, time_window

LIMITS = st.builds(JointLimits, st.floats(0.1, 10.0), st.floats(0.1, 50.0), st.floats(1.0, 1000.0))
SHARE = st.floats(0.0, 1.0)


def run(pieces: list[SpeedPiece], begin: Passing) -> tuple[float, float, float, list[float], list[float]]:
    """Distance, speed and acceleration at the end; speeds and accelerations between the pieces."""
    p, v, a = 0.0, begin.speed, begin.turn
    speeds, accelerations = [v], [a]
    for u, j in pieces:
        p, v, a = p + u * (v + u * (0.5 * a + u * j / 6.0)), v + u * (a + 0.5 * u * j), a + u * j
        speeds.append(v)
        accelerations.append(a)
    return p, v, a, speeds, accelerations


def test_known_times() -> None:
    limits = JointLimits(1.0, 4.0, 40.0)
    # A tenth of a second each to gain and to lose 4 rad/s^2, which changes the speed by 0.4.
    assert change_time(0.4, limits) == pytest.approx(0.2)
    assert change_time(1.0, limits) == pytest.approx(1.0 / 4.0 + 0.1)
    assert change_time(0.1, limits) == pytest.approx(2.0 * math.sqrt(0.1 / 40.0))
    assert change_time(0.0, limits) == 0.0
    assert time_window(1.0, Passing(), Passing(), limits) == (pytest.approx(1.0 + 1.0 / 4.0 + 0.1), math.inf)
    # At full speed at both points it cannot be faster, and can stop between them.
    assert time_window(1.0, Passing(1.0), Passing(1.0), limits) == (pytest.approx(1.0), math.inf)
    # Too short to stop: 0.35 s at a mean speed of 0.5 take 0.175.
    low, high = time_window(0.2, Passing(1.0), Passing(1.0), limits)
    assert low == pytest.approx(0.2)
    assert 0.2 < high < 0.5
    # It could stop, and take any time then, but many times between are left out.
    wide = JointLimits(9.5, 14.0, 102.0)
    low, high = time_window(0.59375, Passing(2.078125), Passing(2.078125), wide)
    assert 0.25 < low < high < 0.6
    assert time_window(0.65, Passing(2.078125), Passing(2.078125), wide)[1] == math.inf
    assert time_window(0.17, Passing(1.0), Passing(), limits) == (math.inf, 0.0)
    assert time_window(0.175, Passing(1.0), Passing(), limits)[0] == pytest.approx(0.35)


def passing(share: float, limits: JointLimits, *, turns: bool) -> Passing:
    if turns:
        # At least a thousandth of the limit, since finer values make no difference.
        return Passing(
            turn=(0.001 + 0.999 * share) * min(limits.acceleration, math.sqrt(2.0 * limits.speed * limits.jerk))
        )
    return Passing(share * limits.speed)


# Where the joint could stop, but cannot take every longer time.
@example(JointLimits(9.5, 14.0, 102.0), 0.59375, 0.21875, 0.21875, False, False, 0.5)
@example(JointLimits(9.5, 14.0, 102.0), 0.59375, 0.21875, 0.21875, False, False, 1.0)
@given(LIMITS, st.floats(1e-4, 10.0), SHARE, SHARE, st.booleans(), st.booleans(), SHARE)
def test_every_time_within_the_window_is_kept_under_the_limits(
    limits: JointLimits, distance: float, first: float, second: float, back: bool, again: bool, share: float
) -> None:
    begin, end = passing(first, limits, turns=back), passing(second, limits, turns=again)
    low, high = time_window(distance, begin, end, limits)
    assume(low < math.inf)
    assert low <= high * (1.0 + 1e-9)
    seconds = low + share * (min(high, 3.0 * low) - low)
    pieces = profile(distance, begin, end, seconds, limits)
    assert all(piece.seconds >= 0.0 and abs(piece.jerk) <= limits.jerk for piece in pieces)
    assert sum(piece.seconds for piece in pieces) == pytest.approx(seconds, rel=1e-6, abs=1e-9)
    p, v, a, speeds, accelerations = run(pieces, begin)
    assert p == pytest.approx(distance, rel=1e-6)
    assert v == pytest.approx(end.speed, abs=1e-7 * limits.speed)
    # It slows down to a turn.
    assert a == pytest.approx(-end.turn, abs=1e-7 * limits.acceleration)
    # Between two pieces are the extremes, and it never turns back on its way.
    assert max(map(abs, accelerations)) <= limits.acceleration * (1.0 + 1e-9)
    assert -1e-7 * limits.speed <= min(speeds) <= max(speeds) <= limits.speed * (1.0 + 1e-9)


@given(LIMITS, st.floats(1e-3, 10.0), SHARE, SHARE, st.booleans())
def test_no_time_outside_the_window_could_be_kept(
    limits: JointLimits, distance: float, first: float, second: float, back: bool
) -> None:
    begin, end = passing(first, limits, turns=back), passing(second, limits, turns=False)
    low, high = time_window(distance, begin, end, limits)
    assume(low < math.inf)
    quick = profile(distance, begin, end, 0.99 * low, limits)
    # Too short for the change of speed, or for the distance.
    assert sum(piece.seconds for piece in quick) > 0.99 * low * (1.0 + 1e-9) or run(quick, begin)[0] < distance
    # Much longer times are beyond what can be computed without rounding.
    if high < 100.0 * low:
        assert run(profile(distance, begin, end, 1.01 * high, limits), begin)[0] > distance


def test_a_turn_without_a_pause_saves_its_time() -> None:
    limits = JointLimits(1.0, 4.0, 40.0)
    still, _ = time_window(1.0, Passing(), Passing(), limits)
    turning, longest = time_window(1.0, Passing(turn=4.0), Passing(), limits)
    # The acceleration is there already: that saves a tenth of a second at full jerk, and costs some way.
    assert still - 0.1 < turning < still - 0.04
    # Its acceleration makes it too fast to wait.
    assert turning < longest < math.inf
    _, _, _, speeds, accelerations = run(
        profile(1.0, Passing(turn=4.0), Passing(), turning, limits), Passing(turn=4.0)
    )
    assert (speeds[0], accelerations[0]) == (0.0, 4.0)
    assert max(speeds) == pytest.approx(1.0)
    # From turn to turn, the time is shorter once more.
    assert time_window(1.0, Passing(turn=4.0), Passing(turn=4.0), limits)[0] == pytest.approx(2 * turning - still)
