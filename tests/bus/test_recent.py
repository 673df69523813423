from __future__ import annotations

from hexwire.bus.plan import ReadPlan
from hexwire.bus.servo_bus import RecentValues
from hexwire.bus.values import Readings
from hexwire.wire.registers import Series

POSITION = Series.STS_SMS.register("present_position")
NAME = POSITION.name


def test_nothing_is_known_at_first() -> None:
    assert RecentValues().last(NAME, 1, None) is None
    plan = ReadPlan(1, Series.STS_SMS, POSITION.address, 2, POSITION)
    assert RecentValues().last(NAME, 1, plan) is None


def test_the_newest_value_counts_wherever_it_was_read() -> None:
    recent = RecentValues()
    plan = ReadPlan(1, Series.STS_SMS, POSITION.address, 2, POSITION)
    recent.keep(NAME, 1, 10, 100.0)
    assert recent.last(NAME, 1, plan) == (10, 100.0)
    plan.latest, plan.stamp = 11, 101.0
    assert recent.last(NAME, 1, plan) == (11, 101.0)
    recent.syncs[NAME] = Readings(POSITION, (2, 1), (5, 12), 102.0)
    assert recent.last(NAME, 1, plan) == (12, 102.0)
    assert recent.last(NAME, 2, None) == (5, 102.0)
    recent.keep(NAME, 1, 13, 103.0)
    assert recent.last(NAME, 1, plan) == (13, 103.0)
    plan.latest, plan.stamp = 14, 104.0
    assert recent.last(NAME, 1, plan) == (14, 104.0)


def test_a_servo_that_a_sync_read_lacked_keeps_what_was_before() -> None:
    recent = RecentValues()
    recent.keep(NAME, 1, 10, 100.0)
    recent.syncs[NAME] = Readings(POSITION, (1, 2), (None, 5), 102.0)
    assert recent.last(NAME, 1, None) == (10, 100.0)
    assert recent.last("present_speed", 1, None) is None
    assert recent.last(NAME, 3, None) is None


def test_of_two_values_of_the_same_time_the_first_known_stays() -> None:
    recent = RecentValues()
    plan = ReadPlan(1, Series.STS_SMS, POSITION.address, 2, POSITION)
    recent.keep(NAME, 1, 10, 100.0)
    plan.latest, plan.stamp = 11, 100.0
    assert recent.last(NAME, 1, plan) == (10, 100.0)
    recent.syncs[NAME] = Readings(POSITION, (1,), (12,), 100.0)
    assert recent.last(NAME, 1, plan) == (10, 100.0)
    plan.latest, plan.stamp = 0, 101.0
    assert recent.last(NAME, 1, plan) == (0, 101.0)
