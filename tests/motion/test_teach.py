from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.motion.arms import HOME

from hexwire.errors import UsageError
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.motion.teach import Taught, approach


def taught(values: list[float], period: float = 0.1, start: float = 1000.0) -> Taught:
    return Taught.of(("J1",), [(start + period * i, (v,)) for i, v in enumerate(values)])


def test_time_starts_at_zero_and_rises() -> None:
    t = Taught.of(
        ("J1",), [(5.0, (0.0,)), (5.1, (1.0,)), (5.05, (9.0,)), (5.1, (9.0,)), (5.2, (2.0,)), (5.3, (math.nan,))]
    )
    assert t.times == pytest.approx((0.0, 0.1, 0.2))
    assert t.rows == ((0.0,), (1.0,), (2.0,))
    assert t.duration == pytest.approx(0.2)


def test_nothing_recorded() -> None:
    with pytest.raises(UsageError, match="nothing was recorded"):
        Taught.of(("J1",), [])
    with pytest.raises(UsageError, match="2 values for 1 joints"):
        Taught.of(("J1",), [(0.0, (1.0, 2.0))])


def test_trim() -> None:
    t = taught([0, 1, 2, 3, 4, 5]).trimmed(0.15, 0.42)
    assert t.rows == ((2,), (3,), (4,))
    assert t.times == pytest.approx((0.0, 0.1, 0.2))
    with pytest.raises(UsageError, match=r"nothing is left between 9 and inf s of 0\.50 s"):
        taught([0, 1, 2, 3, 4, 5]).trimmed(9.0)


def test_stillness_goes_motion_stays() -> None:
    t = taught([0, 0, 0, 0, 0.2, 0.4, 0.6, 0.6, 0.6, 0.6]).without_stillness()
    assert t.rows == ((0,), (0.2,), (0.4,), (0.6,))
    assert t.times[0] == 0.0
    still = taught([0.1] * 5)
    assert still.without_stillness() == still
    assert t.moves
    assert not still.moves


def test_speed() -> None:
    assert taught([0, 1, 2]).faster(2.0).times == pytest.approx((0.0, 0.05, 0.1))
    with pytest.raises(UsageError, match="speed factor must be finite and above 0, not -1"):
        taught([0, 1]).faster(-1.0)


def test_smoothing_takes_tremor_away_and_keeps_the_ends() -> None:
    slow = [math.sin(0.05 * i) for i in range(100)]
    shaky = [v + 0.02 * (-1) ** i for i, v in enumerate(slow)]
    smooth = taught(shaky, 0.02).smoothed(0.1)
    rough = max(abs(a[0] - b) for a, b in zip(smooth.rows[8:-8], slow[8:-8], strict=True))
    assert rough < 0.005
    assert smooth.rows[0] == pytest.approx((shaky[0],))
    assert smooth.rows[-1] == pytest.approx((shaky[-1],))
    assert taught(shaky).smoothed(0.0) == taught(shaky)
    with pytest.raises(UsageError, match="width must be finite and not negative, not -1"):
        taught(shaky).smoothed(-1.0)


@given(st.lists(st.floats(-2, 2), min_size=1, max_size=40), st.floats(0.0, 1.0))
def test_smoothing_stays_within_what_was_taught(values: list[float], width: float) -> None:
    rows = taught(values).smoothed(width).rows
    assert len(rows) == len(values)
    assert all(min(values) - 1e-9 <= row[0] <= max(values) + 1e-9 for row in rows)


def test_trajectory_passes_every_sample_and_rests_at_its_ends() -> None:
    t = taught([0.0, 0.1, 0.3, 0.2])
    way = t.trajectory()
    for time, row in zip(t.times, t.rows, strict=True):
        assert way.at(time).position == pytest.approx(row)
    assert way.at(0.0).velocity == (0.0,)
    assert way.at(way.duration).velocity == pytest.approx((0.0,), abs=1e-12)
    assert way.at(t.times[1]).velocity == pytest.approx((1.5,))


def test_one_sample_is_a_pose() -> None:
    assert taught([0.3]).trajectory().sample(1.0).position == (0.3,)


def test_approach_is_careful() -> None:
    names = ("J1", "J2")
    here = [HOME[n] for n in names]
    way = approach(HEX7BOT, names, here, [here[0] + 1.0, here[1]], speed=0.25)
    assert way.duration >= 1.0 / (0.25 * HEX7BOT.joint("J1").max_speed)
    assert way.goal == (here[0] + 1.0, here[1])


def test_trimming_keeps_samples_at_both_times() -> None:
    t = taught([0, 1, 2, 3, 4, 5], 0.25, 0.0)
    assert t.trimmed(0.25, 0.75) == taught([1, 2, 3], 0.25)
    assert t.trimmed(0.5, 0.5) == taught([2], 0.25)
    assert t.trimmed() == t
    with pytest.raises(UsageError, match="nothing is left"):
        t.trimmed(0.3, 0.4)


def test_stillness_is_less_than_a_threshold_of_any_joint() -> None:
    # Half a degree counts as rest, and a little more as motion.
    half = math.radians(0.5)
    rows = [(0.0, 0.0), (half, 0.0), (0.0, -2 * half), (0.0, 2 * half), (0.0, half), (0.0, 0.0)]
    t = Taught.of(("J1", "J2"), [(5.0 + i, row) for i, row in enumerate(rows)])
    assert t.without_stillness().rows == tuple(rows[1:5])
    assert t.without_stillness().times == (0.0, 1.0, 2.0, 3.0)
    slow = taught([0, half, 2.5 * half, 4 * half, 4 * half])
    assert slow.without_stillness().rows == ((half,), (2.5 * half,), (4 * half,))
    # A step between two samples, and a creep, are motions too.
    assert taught([0, 0, 1, 1, 1]).without_stillness().rows == ((0,), (1,))
    assert taught([0, 0, half, 2 * half, 2 * half]).without_stillness().rows == ((0,), (half,), (2 * half,))


def test_what_takes_too_long_to_smooth_is_refused() -> None:
    many = Taught(("J1",), tuple(i / 1000 for i in range(20_000)), ((0.0,),) * 20_000)
    with pytest.raises(UsageError, match="20000 samples are too many to be smoothed by 2 s: take less"):
        many.smoothed(2.0)
    assert many.trimmed(0.0, 1.0).smoothed(2.0).duration == 1.0


def test_smoothing_is_a_raised_cosine() -> None:
    # One peak: the neighbours half a width away get half the weight of the middle, those at the width none.
    smooth = taught([0, 0, 0, 4, 0, 0, 0], 0.25, 0.0).smoothed(0.5)
    assert [row[0] for row in smooth.rows] == pytest.approx([0, 0, 1.0, 2.0, 1.0, 0, 0])
    assert smooth.times == taught([0] * 7, 0.25, 0.0).times
    # Next to the ends the window is one sample wide.
    assert [r[0] for r in taught([4, 1, 1, 1, 4], 0.25, 0.0).smoothed(0.25).rows] == pytest.approx([4, 1, 1, 1, 4])
    with pytest.raises(UsageError, match="not inf"):
        taught([0, 1]).smoothed(math.inf)


def test_speed_factors() -> None:
    t = taught([0, 1, 2], 0.25, 0.0)
    assert t.faster(0.5).times == (0.0, 0.5, 1.0)
    assert t.faster(0.5).rows == t.rows
    for factor in (0.0, math.inf, math.nan):
        with pytest.raises(UsageError, match="speed factor"):
            t.faster(factor)


def test_a_recording_may_last_an_hour() -> None:
    assert taught([0, 1], 3600.0, 0.0).trajectory().duration == 3600.0
    with pytest.raises(UsageError, match=r"lasts 3601.* s, and a motion may take 3600 s"):
        taught([0, 1], 3601.0, 0.0).trajectory()


def test_an_approach_takes_the_time_of_its_limits() -> None:
    here = [HOME["J1"], HOME["J2"]]
    half = 0.5 * HEX7BOT.joint("J1").max_speed
    usual = approach(HEX7BOT, ("J1", "J2"), here, [here[0] + 1.0, here[1]])
    # Full acceleration, 4 rad/s^2, takes a fifteenth of a second at 60 rad/s^3.
    assert usual.duration == pytest.approx(1.0 / half + half / 4.0 + 4.0 / 60.0)
    slow = approach(HEX7BOT, ("J1", "J2"), here, [here[0] + 1.0, here[1]], speed=0.25)
    assert slow.duration == pytest.approx(2.0 / half + half / 8.0 + 4.0 / 60.0)


def test_a_sample_that_is_no_number_or_not_later_is_left_out() -> None:
    samples = [(math.inf, (9.0,)), (2.0, (0.0,)), (2.0, (9.0,)), (3.0, (math.inf,)), (3.0, (1.0,))]
    assert Taught.of(["J1"], samples) == Taught(("J1",), (0.0, 1.0), ((0.0,), (1.0,)))
    with pytest.raises(UsageError, match="nothing was recorded"):
        Taught.of(["J1"], [(math.nan, (0.0,))])


def test_where_joints_rested_on_their_stops_they_are_at_their_limits() -> None:
    end = HEX7BOT.joint("J1").maximum
    t = taught([0.0, end + 0.01, end - 0.01, end + 0.1])
    assert t.within(HEX7BOT).rows == ((0.0,), (end,), (end - 0.01,), (end + 0.1,))
    assert t.within(HEX7BOT).times == t.times
