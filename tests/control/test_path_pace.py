from __future__ import annotations

import pytest

from hexwire.control.motion.board_path_feeder import PathPace


def pace(period: float, *exchanges: float) -> PathPace:
    made = PathPace()
    made.period = period
    for seconds in exchanges:
        made.measure(seconds)
    return made


def test_a_serial_line_is_the_usual_one() -> None:
    usual = pace(0.05, 0.02, 0.005)
    assert usual.ahead == 0.12
    assert usual.transit == 0.015
    assert usual.apart(64) == (0.02, 0.03)
    assert usual.most(64) == 6
    assert usual.pause == 0.0


def test_a_slow_line_is_told_earlier_and_gets_more_at_once() -> None:
    slow = pace(0.05, 0.125)
    assert slow.ahead == pytest.approx(0.32)
    assert slow.transit == pytest.approx(0.115)
    assert slow.most(64) * slow.apart(64)[0] >= 2 * 0.25
    assert slow.pause == pytest.approx(0.2)
    once = slow.ahead
    slow.measure(0.01)
    assert 0.12 < slow.ahead < once
    for _ in range(100):
        slow.measure(0.01)
    assert slow.ahead == pytest.approx(0.12, abs=1e-3)


def test_where_turns_are_rare_points_are_further_apart_and_last() -> None:
    rare = pace(1.0)
    least, most = rare.apart(64)
    assert least == most == pytest.approx(2.0 / 64)
    assert rare.most(64) == 64
