from __future__ import annotations

import pytest
from tests.bus.bus_bench import make_bus

from hexwire.bus.servo_bus import ServoBus
from hexwire.errors import NotSupportedError
from hexwire.link.memory import memory_pair
from hexwire.wire.registers import Series


def test_a_series_may_be_told_later() -> None:
    bus, device = make_bus((1, 2), (Series.STS_SMS, Series.SCS), paced=False)
    right = device.wire[2].registers.get("max_position_limit")
    bus.set_series(2, "sts_sms")
    assert bus.read(2, "max_position_limit").raw != right
    bus.set_series(2, Series.SCS)
    assert bus.read(2, "max_position_limit").raw == right
    assert bus.series_of(2) is Series.SCS


def test_a_servo_that_does_not_know_an_instruction_is_not_asked() -> None:
    bus, _ = make_bus((1,), (Series.SCS,))
    before = len(bus.link.written)
    with pytest.raises(NotSupportedError, match="knows no reboot"):
        bus.reboot(1)
    assert len(bus.link.written) == before


def test_calibrate_and_action_are_not_repeated_blindly() -> None:
    bus, device = make_bus((1,))
    bus.ping(1)
    bus.write_raw(1, "acceleration", 1)
    device.wire.servos = []
    before = len(bus.link.written)
    assert bus.calibrate(1).error
    assert len(bus.link.written) == before + 1
    assert bus.write_raw(1, "acceleration", 1).error


def test_a_link_without_a_rate_cannot_change_it() -> None:
    link, _ = memory_pair()
    with pytest.raises(NotSupportedError, match="no line rate"):
        ServoBus(link).set_baud(115200)
