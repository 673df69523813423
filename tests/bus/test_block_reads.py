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


def test_blocks_teach_how_long_answers_take_at_any_time() -> None:
    bus, _ = make_bus((1, 2))
    for _ in range(70):
        bus.read(1, "id")
    before = bus.timing.answers
    for i in range(1, 6):
        bus.sync_read_blocks(56, 4, (1, 2))
        assert bus.timing.answers == before + i
    assert bus.counters.requests == 75
    assert bus.counters.answers == 80


def test_a_troubled_servos_block_has_its_error() -> None:
    bus, device = make_bus((1, 2, 3), retries=0)
    device.wire[2].protection.forced |= 32
    device.wire.servos = [servo for servo in device.wire.servos if servo.servo_id != 3]
    bus.pause(0.1)
    one, two, three = bus.sync_read_blocks(5, 1, (1, 2, 3))
    assert (one.data, one.status, one.error, one.address) == (b"\x01", 0, "", 5)
    assert (two.data, two.status, two.error, two.address) == (b"\x02", 32, "", 5)
    assert (three.data, three.status, three.error, three.address) == (b"", 0, "no answer", 5)
    alone = bus.read_block(2, 5, 1)
    assert (alone.servo_id, alone.address, alone.data, alone.status, alone.error) == (2, 5, b"\x02", 32, "")


def test_a_block_in_doubt_is_read_around() -> None:
    bus, _ = make_bus((1, 2))
    bus._machine.gave_up((2,), 4, b"something else", bus.now(), bus.now())
    before = len(bus.link.written)
    blocks = bus.sync_read_blocks(56, 4, (1, 2))
    assert [len(block.data) for block in blocks] == [4, 4]
    assert [packet[6] for packet in bus.link.written[before:]] == [5]
