from __future__ import annotations

import pytest

from hexwire.emulator.board_rate import LineRate


def test_a_change_waits_for_the_bytes_that_leave() -> None:
    line = LineRate(115_200)
    line.change(500_000)
    assert (line.changing, line.due) == (True, None)
    line.sent(48, 10.0)
    due = line.due
    assert due == pytest.approx(10.0 + 480 / 115_200 + 0.002)
    assert not line.step(10.005)
    assert line.step(due)
    assert (line.now, line.changing) == (500_000, False)


def changed(at: float) -> LineRate:
    line = LineRate(115_200)
    line.change(500_000)
    line.sent(0, at - 0.002)
    assert line.step(at)
    return line


def test_it_goes_back_after_a_second_without_a_frame() -> None:
    line = changed(10.0)
    assert not line.step(10.99)
    assert line.step(11.0)
    assert (line.now, line.due) == (115_200, None)


def test_it_goes_back_two_seconds_after_the_last_frame() -> None:
    line = changed(10.0)
    line.heard(10.5)
    assert not line.step(12.49)
    line.heard(12.4)
    assert not line.step(14.39)
    assert line.step(14.4)
    assert line.now == 115_200


def test_its_own_rate_stays() -> None:
    line = LineRate(115_200)
    line.heard(1.0)
    assert (line.due, line.step(100.0)) == (None, False)
    line.change(115_200)
    assert not line.changing
    back = changed(10.0)
    back.heard(10.1)
    back.change(115_200)
    back.sent(48, 10.2)
    assert back.step(10.3)
    assert (back.now, back.due) == (115_200, None)


@pytest.mark.parametrize(("rate", "known"), [(9600, True), (115_200, True), (1_000_000, True), (230_400, False)])
def test_the_rates_that_it_knows(rate: int, known: bool) -> None:
    assert LineRate(9600).knows(rate) is known
