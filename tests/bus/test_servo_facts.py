from __future__ import annotations

import math

import pytest

from hexwire.bus.setup import ServoInfo
from hexwire.bus.survey import Remark, remarks, voltage_class
from hexwire.wire.registers import Series


def info(
    firmware: str = "3.10", series: Series | None = Series.STS_SMS, servo_id: int = 1, **rest: bool
) -> ServoInfo:
    return ServoInfo(servo_id, series, firmware, 777, 1_000_000, rest.get("acknowledges", True), 0.0, 0)


def words(*args: object, **options: object) -> str:
    return " | ".join(row.text for row in remarks(*args, **options))  # type: ignore[arg-type]


@pytest.mark.parametrize(("limit", "kind"), [(8.0, "7.4 V"), (9.0, "7.4 V"), (14.0, "12 V"), (10.0, ""), (0.0, "")])
def test_the_class_follows_from_the_stored_limit(limit: float, kind: str) -> None:
    assert voltage_class(limit) == kind
    assert voltage_class(math.nan) == ""


def test_a_good_servo_needs_no_remark() -> None:
    assert remarks(info(), {"max_voltage": 8.0, "min_voltage": 4.0, "mode": 0.0}, 7.4, [info(servo_id=2)]) == []


@pytest.mark.parametrize(("firmware", "told"), [("3.9", True), ("3.6", True), ("3.10", False), ("3.11", False)])
def test_an_old_sts_firmware_is_named(firmware: str, told: bool) -> None:
    found = remarks(info(firmware), {})
    assert bool(found) is told
    if told:
        assert found[0].bad
        assert f"firmware {firmware} is older than 3.10" in found[0].text
    assert not remarks(info(firmware, Series.HLS), {})


def test_other_firmwares() -> None:
    assert remarks(info("3.42", Series.HLS), {}) == [
        Remark(False, "firmware 3.42: a middle can be set at the present position only (3.43: at any)")
    ]
    assert "no register table" in words(info("1.7", None), {})
    assert remarks(info("", Series.SEVEN_BOT, acknowledges=False), {}) == []


def test_mixed_firmware_on_one_bus_is_named() -> None:
    text = words(info("3.10"), {}, others=[info("3.10", servo_id=2), info("3.11", servo_id=3)])
    assert "different firmware (3.10, 3.11)" in text
    other_model = info("3.11", servo_id=3)._replace(model=2825)
    assert words(info("3.10"), {}, others=[other_model, info("3.43", Series.HLS, 4)]) == ""


def test_a_wrong_supply_is_named() -> None:
    low, high = {"max_voltage": 8.0, "min_voltage": 4.0}, {"max_voltage": 14.0, "min_voltage": 4.0}
    assert "supply 12.1 V is above its limit of 8.0 V" in words(info(), low, 12.1)
    assert "below its limit" in words(info(), low, 3.9)
    assert remarks(info(), high, 7.4)[0].text == "made for 12 V: with 7.4 V it is slower and weaker"
    assert words(info(), high, 12.0) == ""
    # Legacy parts measure nothing.
    assert words(info(), low, 0.0) == words(info(), low, math.nan) == ""


def test_settings_that_surprise() -> None:
    assert "mode 1" in words(info(), {"mode": 1.0})
    assert "does not acknowledge" in words(info(acknowledges=False), {})
