from __future__ import annotations

import math

import pytest
from tests.bus.bus_bench import make_bus

from hexwire.bus.registers import make_table, people_unit, read_table
from hexwire.errors import ServoError
from hexwire.wire.registers import Series

ALL = (Series.SEVEN_BOT, Series.SCS, Series.STS_SMS, Series.HLS)


@pytest.mark.parametrize("series", ALL)
def test_the_table_has_every_register_with_the_value_of_a_single_read(series: Series) -> None:
    bus, device = make_bus((5,), (series,), paced=False)
    rows = read_table(bus, 5)
    assert [row.register.name for row in rows] == list(series.registers)
    for row in rows:
        if row.register.name.startswith("present"):
            continue
        assert row.raw == device.wire[5].registers.get(row.register.name), row.register.name
    position = next(row for row in rows if row.register.name == "present_position")
    assert position.raw is not None
    assert position.unit == "deg"
    assert position.value == pytest.approx(math.degrees(position.register.to_si(position.raw)))


def test_a_feetech_servo_is_read_in_a_few_requests() -> None:
    bus, _ = make_bus((5,))
    before = len(bus.link.written)  # type: ignore[attr-defined]
    read_table(bus, 5)
    sent = len(bus.link.written) - before  # type: ignore[attr-defined]
    assert sent <= 6 < len(Series.STS_SMS.registers)


def test_values_and_ranges_are_in_units_for_people() -> None:
    raws = {"max_torque": 500, "goal_position": 1024, "overload_time": 150, "max_temperature": 65, "goal_speed": -3}
    rows = {row.register.name: row for row in make_table(Series.STS_SMS, raws)}
    assert (rows["max_torque"].value, rows["max_torque"].unit, rows["max_torque"].high) == (50.0, "%", 100.0)
    assert (rows["goal_position"].value, rows["goal_position"].unit) == (pytest.approx(90.0), "deg")
    assert (rows["overload_time"].value, rows["overload_time"].unit) == (pytest.approx(1.5), "s")
    assert (rows["max_temperature"].value, rows["max_temperature"].unit) == (65.0, "°C")
    assert (rows["goal_speed"].value, rows["goal_speed"].unit) == (pytest.approx(-150 * 360 / 4096), "deg/s")
    assert rows["mode"].raw is None
    assert math.isnan(rows["mode"].value)
    assert (rows["mode"].low, rows["mode"].high) == (0, 3)
    assert rows["present_load"].low is None


def test_what_differs_is_marked() -> None:
    raws = {"max_temperature": 65, "id": 9, "baud_code": 4, "position_p": 32, "mode": 0, "torque_enable": 1}
    saved = {"max_temperature": 65, "position_p": 16, "mode": 0, "status_return_level": 1}
    rows = {row.register.name: row for row in make_table(Series.STS_SMS, raws, saved)}
    assert rows["max_temperature"].differs_from_factory
    assert not rows["max_temperature"].differs_from_backup
    assert not rows["position_p"].differs_from_factory
    assert rows["position_p"].differs_from_backup
    assert rows["position_p"].saved == 16
    # Every servo of an arm has its own id; torque is no setting; an unknown value differs from nothing.
    for name in ("id", "mode", "torque_enable", "status_return_level"):
        assert not rows[name].differs_from_factory, name
        assert not rows[name].differs_from_backup, name
    assert rows["baud_code"].differs_from_factory


def test_bits_have_names_and_areas_are_told() -> None:
    rows = {row.register.name: row for row in make_table(Series.STS_SMS, {"status": 0b100001})}
    assert rows["status"].words == ("voltage", "overload")
    assert (rows["mode"].stored, rows["mode"].writable) == (True, True)
    assert (rows["status"].stored, rows["status"].writable) == (False, False)


def test_a_silent_servo_is_named() -> None:
    for series in ALL:
        bus, device = make_bus((5,), (series,))
        device.wire.servos = []
        with pytest.raises(ServoError, match="servo 5: no answer"):
            read_table(bus, 5)


def test_units_without_a_better_one_stay() -> None:
    assert people_unit("V") == ("V", 1.0)
    assert people_unit("") == ("", 1.0)
    assert people_unit("rad") == ("deg", pytest.approx(math.pi / 180))
