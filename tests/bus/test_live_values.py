from __future__ import annotations

import math

import pytest
from tests.bus.bus_bench import make_bus

from hexwire.bus.live_values import read_live
from hexwire.emulator.faults import FaultPlan
from hexwire.wire.registers import Series


def test_servos_of_every_series_say_what_they_measure() -> None:
    series = (Series.STS_SMS, Series.HLS, Series.SCS, Series.SEVEN_BOT)
    bus, device = make_bus((1, 2, 3, 4), series, paced=False)
    rows = read_live(bus, (4, 1, 2, 3))
    assert [row.servo_id for row in rows] == [4, 1, 2, 3]
    for row, kind in zip(rows, (series[3], *series[:3]), strict=True):
        assert row.counts is not None
        assert abs(row.counts - device.wire[row.servo_id].motion.position) <= 2
        assert row.position == pytest.approx(kind.register("present_position").to_si(row.counts))
        assert (row.error, row.faults) == ("", ())
        measures = kind is not Series.SEVEN_BOT
        assert math.isfinite(row.voltage) is math.isfinite(row.temperature) is math.isfinite(row.load) is measures
        # An SCS has a current in some models only, and in no known unit.
        assert math.isfinite(row.current) is (kind in (Series.STS_SMS, Series.HLS))
    assert rows[1].voltage == pytest.approx(7.4, abs=0.2)


def test_a_silent_servo_has_no_values_and_a_hot_one_a_fault() -> None:
    bus, device = make_bus((1, 2, 3), faults=FaultPlan(["hot:2"]))
    bus.pause(0.5)
    device.wire.servos = [servo for servo in device.wire.servos if servo.servo_id != 3]
    one, hot, gone = read_live(bus, (1, 2, 3))
    assert one.error == hot.error == ""
    assert hot.faults == ("temperature",)
    assert gone.error == "no answer"
    assert gone.counts is None
    assert all(math.isnan(value) for value in gone[2:8])
