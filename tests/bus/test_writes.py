from __future__ import annotations

import pytest
from tests.bus.bus_bench import make_bus

from hexwire.bus.writes import in_range
from hexwire.errors import PreemptedError, StoppedError, UsageError
from hexwire.wire.registers import Series
from hexwire.wire.servo_packet import make_ping, make_write


def test_an_acknowledgement_nobody_waits_for_is_never_an_answer() -> None:
    bus, _device = make_bus((1,))
    bus.set_acknowledges(1, False)
    answer = bus.write_raw(1, "acceleration", 3)
    assert answer.ok
    assert not answer.confirmed
    assert bus.read(1, "present_voltage").ok
    bus.write_raw(1, "acceleration", 4)
    assert bus.ping(1).ok
    assert bus.counters.settled == 1


def test_status_level_is_learned_from_a_servo_that_does_not_acknowledge() -> None:
    bus, device = make_bus((1,))
    device.wire[1].registers.put_stored("status_return_level", 0)
    device.wire[1].registers.put("status_return_level", 0)
    assert bus.write_raw(1, "acceleration", 3).confirmed is False
    assert bus.acknowledges(1) is False
    before = len(bus.link.written)
    assert bus.write_raw(1, "acceleration", 4).ok
    assert len(bus.link.written) == before + 1


def test_the_echo_of_an_earlier_ping_is_no_acknowledgement() -> None:
    bus, device = make_bus((5,), retries=0)
    assert bus.ping(5).ok
    assert bus.write_raw(5, "acceleration", 1).confirmed
    bus._line.exchange = lambda data, window, rest=None: make_ping(5)
    device.wire.servos = []
    answer = bus.write_raw(5, "acceleration", 7)
    assert not answer.confirmed
    assert answer.error


def test_a_servo_with_a_low_supply_acknowledges_in_the_bytes_of_a_ping() -> None:
    bus, device = make_bus((1,))
    device.wire[1].protection.forced |= 1
    bus.pause(0.1)
    assert bus.ping(1).faults == ("voltage",)
    answer = bus.write_raw(1, "acceleration", 9)
    assert answer.confirmed
    assert answer.faults == ("voltage",)
    assert device.wire[1].registers.get("acceleration") == 9


def test_a_write_whose_acknowledgement_could_be_an_earlier_ones_is_read_back() -> None:
    bus, device = make_bus((1,))
    bus._machine.gave_up((1,), 0, make_write(1, 41, b"\x01"), bus.now(), bus.now())
    before = len(bus.link.written)
    assert bus.write_raw(1, "acceleration", 9).confirmed
    assert device.wire[1].registers.get("acceleration") == 9
    assert [packet[4] for packet in bus.link.written[before:]] == [3, 2]
    assert bus.counters.settled == 1


def test_an_order_in_doubt_is_given_only_once_something_else_was_answered() -> None:
    bus, device = make_bus((1,))
    bus._machine.gave_up((1,), 0, make_ping(1), bus.now(), bus.now())
    before = len(bus.link.written)
    assert bus.calibrate(1).ok
    assert [packet[4] for packet in bus.link.written[before:]] == [2, 11]
    bus._machine.gave_up((1,), 0, make_ping(1), bus.now(), bus.now())
    device.wire.servos = []
    before = len(bus.link.written)
    assert bus.calibrate(1).error == "no answer"
    assert 11 not in [packet[4] for packet in bus.link.written[before:]]


def test_a_write_to_all_is_not_waited_for() -> None:
    bus, device = make_bus((1, 2))
    answer = bus.write_raw(254, "acceleration", 7)
    assert answer.ok
    assert not answer.confirmed
    bus.pause(0.01)
    assert [device.wire[i].registers.get("acceleration") for i in (1, 2)] == [7, 7]


def test_what_was_called_before_a_stop_is_not_written_after_it() -> None:
    bus, device = make_bus((1,))
    before = len(bus.link.written)
    with bus.epochs.calling("move"):
        bus.epochs.begin(object())
        for call in (
            lambda: bus.write_raw(1, "acceleration", 7),
            lambda: bus.sync_write_raw("goal_position", {1: 1000}),
            lambda: bus.sync_write_raw("torque_enable", {1: 1}),
            lambda: bus.reboot(1),
            lambda: bus.read_block(1, 56, 3),
        ):
            with pytest.raises(StoppedError):
                call()
    assert len(bus.link.written) == before
    assert not bus._machine.doubtful, "what was not sent is not answered late"
    assert device.wire[1].registers.get("acceleration") != 7


def test_a_stop_that_comes_as_a_goal_is_sent_is_told() -> None:
    bus, _ = make_bus((1,))
    plain = bus.link.write

    def stopping(data: bytes, deadline: float | None = None) -> None:
        plain(data, deadline)
        bus.epochs.begin(object())

    bus.link.write = stopping
    with pytest.raises(PreemptedError):
        bus.sync_write_raw("goal_position", {1: 1000})


def test_a_value_outside_a_registers_range_is_refused() -> None:
    register = Series.STS_SMS.register("max_temperature")
    assert in_range(1, register, 70) == 70
    with pytest.raises(UsageError, match=r"max_temperature of servo 1 takes 0\.\.100, not 101; nothing was sent"):
        in_range(1, register, 101)
