"""Stamps with clocks that are put aside, adjusted and set."""

from __future__ import annotations

import itertools
import random

import pytest

from hexwire.control.loop.stamps import StampClock


class Clocks:
    """A monotonic clock and a wall clock; `stall` seconds pass between a look at the one and at the other."""

    def __init__(self) -> None:
        self.now, self.ahead, self.stall = 1000.0, 1.7e9, 0.0

    def monotonic(self) -> float:
        self.now += self.stall
        return self.now

    def wall(self) -> float:
        self.now += self.stall
        return self.now + self.ahead

    def stamps(self) -> StampClock:
        return StampClock(self.wall, self.monotonic)


def test_a_stamp_is_the_wall_clocks_time_of_the_moment() -> None:
    clocks = Clocks()
    stamps = clocks.stamps()
    assert stamps.stamp(1000.0) == pytest.approx(1.7e9 + 1000.0, abs=1e-6)
    clocks.now += 0.02
    assert stamps.stamp(1000.013) == pytest.approx(1.7e9 + 1000.013, abs=1e-6)


def test_a_thread_that_is_put_aside_between_two_looks_stamps_nothing_too_early() -> None:
    clocks, chance = Clocks(), random.Random(7)
    stamps = clocks.stamps()
    stamps.stamp(clocks.now)
    last = -1.0
    for _ in range(1000):
        clocks.now += 0.01
        moment = clocks.now
        clocks.stall = chance.choice([0.0, 0.0, 0.0, 0.03])
        stamp = stamps.stamp(moment)
        assert stamp > last
        assert stamp == pytest.approx(1.7e9 + moment, abs=1e-5)
        last = stamp


@pytest.mark.parametrize("by", [0.2, -0.2])
def test_a_clock_that_is_adjusted_is_followed_while_stamps_rise(by: float) -> None:
    clocks = Clocks()
    stamps = clocks.stamps()
    rows = [stamps.stamp(clocks.now)]
    clocks.ahead += by
    for _ in range(6000):
        clocks.now += 0.01
        rows.append(stamps.stamp(clocks.now))
    assert all(b > a for a, b in itertools.pairwise(rows))
    assert rows[-1] == pytest.approx(clocks.now + clocks.ahead, abs=1e-5)


def test_moments_as_near_as_they_come_keep_their_order_while_it_is_adjusted() -> None:
    clocks = Clocks()
    stamps = clocks.stamps()
    rows = [stamps.stamp(clocks.now)]
    clocks.ahead -= 0.2
    clocks.now += 10.0
    # What waited in a buffer together: the clock went on by far more than the moments.
    rows += [stamps.stamp(1000.0 + 1e-4 * (i + 1)) for i in range(50)]
    assert all(b > a for a, b in itertools.pairwise(rows))


@pytest.mark.parametrize("by", [3600.0, -3600.0, -0.3])
def test_a_clock_that_is_set_is_followed_at_once(by: float) -> None:
    clocks = Clocks()
    stamps = clocks.stamps()
    stamps.stamp(clocks.now)
    clocks.ahead += by
    clocks.now += 0.01
    assert stamps.stamp(clocks.now) == pytest.approx(clocks.now + clocks.ahead, abs=1e-5)


def test_an_older_moment_has_its_own_stamp() -> None:
    clocks = Clocks()
    stamps = clocks.stamps()
    late = stamps.stamp(1000.0)
    assert stamps.stamp(999.5) == pytest.approx(late - 0.5, abs=1e-6)


def test_older_moments_in_between_leave_the_order_of_the_others_alone() -> None:
    clocks = Clocks()
    stamps = clocks.stamps()
    last = stamps.stamp(clocks.now)
    clocks.ahead -= 0.2
    for i in range(50):
        stamps.stamp(990.0)
        stamp = stamps.stamp(1000.0 + 1e-4 * (i + 1))
        assert stamp > last
        last = stamp
