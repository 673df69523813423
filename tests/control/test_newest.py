from __future__ import annotations

import math
import random
from dataclasses import replace

import pytest
from tests.motion.arms import NAMES, state

from hexwire.control.loop.known_state import LatestState
from hexwire.model.state import JointFlag


def test_before_the_first_state_nothing_is_known() -> None:
    latest = LatestState(100.0)
    assert latest.state is None
    assert latest.age(5.0) == math.inf
    assert latest.rate(5.0) == 0.0
    assert all(map(math.isnan, latest.speeds(NAMES)))


def test_the_newest_state_and_its_speeds() -> None:
    latest = LatestState(100.0)
    for i in range(20):
        now = 1.0 + 0.01 * i
        given = replace(state({"J1": 0.02 * i}, stamp=now), velocity=(math.nan,) * 7)
        assert latest.take(given, now) is not None
        assert latest.state is given
    assert latest.heard == pytest.approx(1.19)
    speeds = latest.speeds(("J1", "J2", "nobody"))
    assert speeds[:2] == pytest.approx([2.0, 0.0])
    assert math.isnan(speeds[2])
    assert latest.rate(1.19) == pytest.approx(100.0)
    assert latest.age(1.5) == pytest.approx(0.31)


def test_states_without_a_new_sample_are_counted_but_not_published() -> None:
    latest = LatestState(100.0)
    silent = dict.fromkeys(NAMES, JointFlag.SILENT)
    latest.take(state(stamp=1.0), 1.0)
    for i in range(10):
        old = state(flags=silent, age=dict.fromkeys(NAMES, 0.1 * i), stamp=1.0 + 0.1 * i)
        assert latest.take(old, 1.0 + 0.1 * i) is None
    assert latest.heard == pytest.approx(1.9)
    assert latest.age(1.9) == pytest.approx(0.9)
    assert latest.rate(1.9) == 0.0


@pytest.mark.parametrize(("rate", "between", "count"), [(10.0, 0.01, 10), (50.0, 0.01, 50), (30.0, 0.01, 30)])
def test_more_states_than_are_published(rate: float, between: float, count: int) -> None:
    latest = LatestState(rate)
    latest.begin(between, 0.5)
    taken = [latest.take(state(stamp=1.0 + between * i), 1.0 + between * i) for i in range(300)]
    assert sum(published is not None for published in taken) == pytest.approx(3 * count, abs=2)
    assert latest.rate(3.99) == pytest.approx(rate, rel=0.06)


@pytest.mark.parametrize("rate", [30.0, 50.0])
def test_what_is_published_is_what_is_nearest_to_its_time(rate: float) -> None:
    latest = LatestState(rate)
    latest.begin(0.01, 0.5)
    chance = random.Random(3)
    times = [1.0 + 0.01 * i + chance.uniform(-0.0003, 0.0003) for i in range(300)]
    taken = [now for now in times if latest.take(state(stamp=now), now) is not None]
    late = [now - (taken[0] + i / rate) for i, now in enumerate(taken)]
    assert max(map(abs, late)) <= 0.006


def test_fewer_states_than_are_wanted_are_all_published() -> None:
    latest = LatestState(100.0)
    latest.begin(0.5, 0.5)
    assert all(latest.take(state(stamp=1.0 + 0.5 * i), 1.0 + 0.5 * i) for i in range(10))


def test_a_restart_forgets_the_boards_clock_and_speeds_but_stamps_keep_increasing() -> None:
    latest = LatestState(100.0)
    for i in range(5):
        latest.take(replace(state({"J1": 0.1 * i}, stamp=100.0 + 0.01 * i), velocity=(math.nan,) * 7), 100.0)
    assert latest.speeds(("J1",)) != [0.0]
    latest.begin(0.01, 0.5)
    # The sample that was published last, and one a little before it, as the line's jitter makes them.
    for stamp in (100.04, 100.038):
        assert latest.take(replace(state(stamp=stamp), board_time=3.0), 100.1) is None
    published = latest.take(replace(state(stamp=100.05), velocity=(math.nan,) * 7, board_time=3.01), 100.2)
    assert published is not None
    assert published.velocity[0] == 0.0
