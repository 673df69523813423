from __future__ import annotations

import pytest
from tests.bus.bus_bench import make_bus

from hexwire.errors import UsageError
from hexwire.wire.registers import Series


def test_blocks() -> None:
    bus, device = make_bus((1, 2, 3), (Series.STS_SMS, Series.SCS, Series.HLS), paced=False)
    blocks = bus.sync_read_blocks(56, 8, (3, 1, 2))
    assert [block.servo_id for block in blocks] == [3, 1, 2]
    for block in blocks:
        register = bus.series_of(block.servo_id).register("present_voltage")
        assert block.raw(register) == device.wire[block.servo_id].registers.get("present_voltage")
        assert block.raw(bus.series_of(1).register("lock")) is None
    legacy, _ = make_bus((1,), (Series.SEVEN_BOT,))
    assert legacy.read_block(1, 56, 4).data[:2] == (2047).to_bytes(2, "big")


def test_servos_of_one_series_are_asked_at_once() -> None:
    bus, device = make_bus((1, 2, 3))
    before = len(bus.link.written)
    blocks = bus.sync_read_blocks(56, 8, [2, 1, 3])
    assert len(bus.link.written) == before + 1
    assert [block.servo_id for block in blocks] == [2, 1, 3]
    assert bus.counters.answers == 3
    device.wire.servos = [servo for servo in device.wire.servos if servo.servo_id != 1]
    for _ in range(2):
        two, one, three = bus.sync_read_blocks(56, 8, [2, 1, 3])
        assert one.error == "no answer"
        assert one.data == b""
        assert len(two.data) == len(three.data) == 8


def test_a_servo_alone_that_is_silent_has_no_data() -> None:
    bus, _ = make_bus((1,))
    assert bus.read_block(9, 56, 8).error == "no answer"
    with pytest.raises(UsageError):
        bus.read_block(1, 300, 2)
