from __future__ import annotations

import math
import tracemalloc

from hexwire.bus.health import HealthHistory, HealthRow
from hexwire.bus.live_values import LiveValues

NAN = math.nan


def live(
    servo_id: int = 1,
    voltage: float = 7.4,
    temperature: float = 30.0,
    current: float = 0.1,
    load: float = 0.05,
    status: int = 0,
) -> LiveValues:
    return LiveValues(servo_id, 2048, 3.14, 0.0, load, voltage, temperature, current, status)


def gone(servo_id: int = 1) -> LiveValues:
    return LiveValues(servo_id, None, NAN, NAN, NAN, NAN, NAN, NAN, 0, "no answer")


def test_a_second_becomes_one_row_with_what_was_worst_in_it() -> None:
    history = HealthHistory()
    for i, row in enumerate(
        [live(), live(voltage=6.1, load=-0.7), gone(), live(temperature=41.0, current=-0.9, status=4)]
    ):
        history.add(i * 0.25, [row])
    assert history.rows(1) == []
    history.add(1.0, [live()])
    assert history.rows(1) == [HealthRow(0.75, 6.1, 41.0, 0.9, 0.7, 4, 1)]
    history.add(1.25, [live(voltage=5.0)])
    assert history.rows(1, since=1.0) == []
    worst = history.summary(1)
    assert (worst.lowest_voltage, worst.highest_voltage, worst.hottest) == (5.0, 6.1, 41.0)
    assert (worst.most_current, worst.most_load, worst.status, worst.lost, worst.asked) == (0.9, 0.7, 4, 1, 6)


def test_ten_minutes_are_kept_and_the_memory_does_not_grow() -> None:
    history = HealthHistory()

    def fill(first: int, count: int) -> None:
        for t in range(first, first + count):
            for quarter in range(4):
                history.add(t + quarter / 4, [live(servo_id, voltage=7.0 + t % 7 / 10) for servo_id in range(6)])

    fill(0, 700)
    tracemalloc.start()
    before = tracemalloc.get_traced_memory()[0]
    fill(700, 700)
    grown = tracemalloc.get_traced_memory()[0] - before
    tracemalloc.stop()
    rows = history.rows(3)
    assert len(rows) == 600
    assert rows[-1].t - rows[0].t == 599
    assert grown < 1_000_000, "the rows that replaced others"
    assert len(history.servo_ids) == 6


def test_servos_are_apart_bounded_and_can_be_forgotten() -> None:
    history = HealthHistory(most=2)
    for t in (0.0, 1.0):
        history.add(t, [live(1), live(2, voltage=5.0), live(3)])
    assert history.servo_ids == (1, 2)
    assert [history.rows(i)[0].voltage for i in (1, 2)] == [7.4, 5.0]
    history.forget(1)
    assert history.servo_ids == (2,)
    assert history.summary(1).asked == 0
    history.add(2.0, [live(3)])
    assert history.servo_ids == (2, 3)


def test_a_servo_that_never_answered_has_no_values_but_losses() -> None:
    history = HealthHistory()
    for t in (0.0, 0.4, 0.8, 1.0):
        history.add(t, [gone()])
    (row,) = history.rows(1)
    assert (row.lost, row.status) == (3, 0)
    assert all(math.isnan(value) for value in (row.voltage, row.temperature, row.current, row.load))
    assert math.isnan(history.summary(1).hottest)
    assert math.isnan(HealthHistory().summary(9).lowest_voltage)
