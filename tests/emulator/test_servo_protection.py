from __future__ import annotations

from dataclasses import replace

from hypothesis import given
from hypothesis import strategies as st

from hexwire.emulator.servo_protection import (
    CURRENT,
    NO_LIMITS,
    OVERLOAD,
    TEMPERATURE,
    VOLTAGE,
    Protection,
    ProtectionLimits,
)

LIMITS = ProtectionLimits(
    overload_torque=0.8,
    overload_ticks=2000,
    current=1.0,
    current_ticks=500,
    held_torque=0.2,
    temperature=70.0,
    voltage=(4.0, 8.0),
    switch=VOLTAGE | TEMPERATURE | OVERLOAD,
)


def pass_time(
    protection: Protection, ticks: int, torque: float = 0.0, current: float = 0.0, volts: float = 6.0
) -> int:
    """Ticks until the status changes, or all of them."""
    for tick in range(ticks):
        if protection.advance(tick, 1, torque, current, volts):
            return tick + 1
    return ticks


def test_overload_trips_after_its_time_and_not_before() -> None:
    protection = Protection(LIMITS, 25.0)
    assert pass_time(protection, 1999, torque=0.8) == 1999
    assert protection.status == 0
    pass_time(protection, 1, torque=0.1)  # a breath starts the count again
    assert pass_time(protection, 5000, torque=0.8) == 2000
    assert protection.status == OVERLOAD
    assert protection.ceiling == 0.2
    protection.clear()
    assert (protection.status, protection.ceiling) == (0, 1.0)


def test_overcurrent_is_reported_but_acts_only_if_switched() -> None:
    protection = Protection(LIMITS, 25.0)
    assert pass_time(protection, 5000, current=1.1) == 500
    assert (protection.status, protection.ceiling) == (CURRENT, 1.0)
    protection.limits = replace(LIMITS, switch=CURRENT)
    assert protection.ceiling == 0.2


def test_supply_out_of_range() -> None:
    protection = Protection(LIMITS, 25.0)
    for volts, status in ((3.9, VOLTAGE), (4.0, 0), (8.0, 0), (8.1, VOLTAGE)):
        protection.sense(volts)
        assert protection.status == status
        assert protection.ceiling == (0.0 if status else 1.0)


def test_heat_comes_with_torque_and_goes_without() -> None:
    protection = Protection(LIMITS, 25.0)
    pass_time(protection, 200_000, torque=0.7)
    warm = protection.temperature
    assert 35 < warm < 90
    pass_time(protection, 200_000)
    assert 25 < protection.temperature < warm
    protection.ambient = protection.temperature = 71.0
    protection.sense(6.0)
    assert protection.status == TEMPERATURE
    assert protection.ceiling == 0.0


def test_a_forced_bit_stays() -> None:
    protection = Protection(LIMITS, 25.0)
    protection.forced = OVERLOAD
    protection.sense(6.0)
    protection.clear()
    protection.sense(6.0)
    assert protection.status == OVERLOAD


def test_no_limits_never_trip() -> None:
    protection = Protection(NO_LIMITS, 25.0)
    assert pass_time(protection, 5000, torque=1.0, current=9.0, volts=0.0) == 5000
    assert protection.status == 0


@given(st.floats(0, 1), st.floats(0, 2), st.integers(1, 5000))
def test_many_ticks_at_once_are_as_good_as_one_by_one(torque: float, current: float, total: int) -> None:
    one, many = Protection(LIMITS, 25.0), Protection(LIMITS, 25.0)
    for tick in range(total):
        one.advance(tick, 1, torque, current, 6.0)
    tick = 0
    while tick < total:
        count = min(total - tick, many.horizon(tick, torque, current))
        many.advance(tick, count, torque, current, 6.0)
        tick += count
    assert (one.status, one.temperature) == (many.status, many.temperature)
