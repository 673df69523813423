"""Backlash of an emulated servo: the whole way of the wave."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest
from tests.bus.bus_bench import make_bus

from hexwire.bus.servo_bus import ServoBus
from hexwire.emulator.servo import EmulatedServo
from hexwire.errors import HexwireError, ServoError, UsageError
from hexwire.setup.servo_wave import measure_backlash


def measure(bus: ServoBus, go_on: Callable[[], bool] = lambda: True) -> float:
    clock = bus.link.clock  # type: ignore[attr-defined]
    return measure_backlash(bus, 2, clock=clock, sleep=clock.advance, go_on=go_on)


def loosen(servo: EmulatedServo, play: float) -> None:
    """Give a servo's output a play of some counts: it shows where the other end of its gears is."""
    shown, last = servo._present, [servo.motion.position]

    def present(shaft: float) -> int:
        last[0] = min(max(last[0], shaft - play / 2), shaft + play / 2)
        return shown(last[0])

    servo._present = present  # type: ignore[method-assign]


@pytest.mark.slow
@pytest.mark.parametrize("torque", [0, 1])
def test_a_new_servo_has_none_and_is_left_as_it_was(torque: int) -> None:
    bus, device = make_bus((1, 2, 3))
    servo = device.wire[2]
    bus.write_raw(2, "torque_enable", torque)
    before = servo.motion.position
    assert measure(bus) == pytest.approx(0.0, abs=math.radians(0.1))
    assert servo.motion.position == pytest.approx(before, abs=1.0)
    assert servo.registers.get("torque_enable") == torque
    assert device.wire[1].motion.position == 2048


def test_play_of_a_worn_servo_is_found() -> None:
    bus, device = make_bus((1, 2, 3))
    loosen(device.wire[2], 17.0)
    assert math.degrees(measure(bus)) == pytest.approx(17 * 360 / 4096, abs=0.2)


def test_it_ends_early_and_returns() -> None:
    bus, device = make_bus((1, 2, 3))
    left = iter([True] * 40)
    before = device.wire[2].motion.position
    assert math.isnan(measure(bus, lambda: next(left, False)))
    assert device.wire[2].motion.position == pytest.approx(before, abs=1.0)
    assert not device.wire[2].torque_on


def test_ctrl_c_brings_it_back_without_torque() -> None:
    bus, device = make_bus((1, 2, 3))
    left = iter([True] * 40)

    def interrupt() -> bool:
        if not next(left, False):
            raise KeyboardInterrupt
        return True

    with pytest.raises(KeyboardInterrupt):
        measure(bus, interrupt)
    assert device.wire[2].motion.position == pytest.approx(2051, abs=1.0)
    assert not device.wire[2].torque_on


def test_a_servo_that_falls_silent_is_reported_first() -> None:
    bus, device = make_bus((1, 2, 3))
    servo, left = device.wire[2], iter([True] * 20)

    def mute() -> bool:
        if not next(left, False):
            servo.receive = lambda packet, now: None  # type: ignore[method-assign]
        return True

    with pytest.raises(ServoError, match="servo 2 fell silent"):
        measure(bus, mute)


def test_a_servo_too_near_to_its_limit_is_not_moved() -> None:
    bus, device = make_bus((1, 2, 3))
    device.wire[2].motion.position = 20.0
    with pytest.raises(UsageError, match="too much"):
        measure(bus)
    assert not device.wire[2].torque_on


def test_a_stop_lets_it_hold() -> None:
    bus, device = make_bus((1, 2, 3))
    left = iter([True] * 20)

    def stop() -> bool:
        if not next(left, False) and not bus.epochs.stopped:
            with bus.epochs.stopping():
                pass
        return True

    with pytest.raises(HexwireError, match="stop"):
        measure(bus, stop)
    assert device.wire[2].torque_on
