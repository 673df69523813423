from __future__ import annotations

from collections.abc import Callable

import pytest
from tests.bus.bus_bench import exchange_by, make_bus

from hexwire.bus.servo_bus import ServoBus, in_range
from hexwire.errors import PreemptedError, ServoError, StoppedError, UsageError
from hexwire.wire.registers import Series
from hexwire.wire.servo_packet import BROADCAST_ID, ServoPacket, make_ping, make_status, make_sync_write, make_write


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
    exchange_by(bus, lambda data, window, rest=None: make_ping(5))
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


SENDING: dict[str, Callable[[ServoBus], object]] = {
    "write": lambda bus: bus.write(1, "acceleration", 7),
    "write_raw": lambda bus: bus.write_raw(1, "acceleration", 7),
    "write_raw to all": lambda bus: bus.write_raw(BROADCAST_ID, "acceleration", 7),
    "write_bytes": lambda bus: bus.write_bytes(1, 41, b"\x07"),
    "reg_write": lambda bus: bus.reg_write(1, "acceleration", 7),
    "action": lambda bus: bus.action(1),
    "action of all": lambda bus: bus.action(),
    "sync_write": lambda bus: bus.sync_write("acceleration", {1: 7}),
    "sync_write_raw": lambda bus: bus.sync_write_raw("goal_position", {1: 1000}),
    "sync_write_raw of torque": lambda bus: bus.sync_write_raw("torque_enable", {1: 1}),
    "sync_write_bytes": lambda bus: bus.sync_write_bytes(41, {1: b"\x07"}),
    "post": lambda bus: bus.post(make_write(1, 41, b"\x07")),
    "raw": lambda bus: bus.raw(make_write(1, 41, b"\x07")),
    "raw with an answer": lambda bus: bus.raw(make_write(1, 41, b"\x07"), (1,)),
    "ask": lambda bus: bus.ask(make_write(1, 41, b"\x07"), 1, 0),
    "restore": lambda bus: bus.restore(1),
    "reboot": lambda bus: bus.reboot(1),
    "backup": lambda bus: bus.backup(1),
    "reset_turns": lambda bus: bus.reset_turns(1),
    "calibrate": lambda bus: bus.calibrate(1),
    "read_block": lambda bus: bus.read_block(1, 56, 3),
}


@pytest.mark.parametrize("acknowledges", [True, False])
def test_a_call_made_before_a_stop_writes_nothing_after_it(acknowledges: bool) -> None:
    bus, device = make_bus((1,))
    bus.set_acknowledges(1, acknowledges)
    before = len(bus.link.written)
    with bus.epochs.calling("move"):
        bus.epochs.begin(object())
        for name, call in SENDING.items():
            with pytest.raises(StoppedError):
                call(bus)
            assert len(bus.link.written) == before, name
    assert not bus._machine.doubtful, "what was not sent is not answered late"
    assert device.wire[1].registers.get("acceleration") != 7


def test_a_stop_during_the_sending_of_a_goal_is_reported() -> None:
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


@pytest.mark.parametrize("retries", [0, 2])
def test_a_write_in_doubt_is_repeated_until_it_is_seen(retries: int) -> None:
    bus, device = make_bus((1,), retries=retries)
    plain = device.wire[1].receive
    device.wire[1].receive = lambda packet, now: None if packet.instruction == 3 else plain(packet, now)
    bus._machine.gave_up((1,), 0, make_write(1, 41, b"\x01"), bus.now(), bus.now())
    before = len(bus.link.written)
    answer = bus.write_raw(1, "acceleration", 9)
    assert answer.error
    assert not answer.confirmed
    sent = [packet[4] for packet in bus.link.written[before:]]
    # Written and read back each time, and then once more as where nothing is in doubt, with its repeats.
    assert sent[: 2 * (1 + retries)] == [3, 2] * (1 + retries)
    assert sent.count(3) == 2 * (1 + retries)


def test_a_write_that_is_not_acknowledged_is_repeated_and_one_of_a_kind_is_not() -> None:
    for retries in (0, 2):
        bus, device = make_bus((1,), retries=retries)
        assert bus.write_raw(1, "acceleration", 1).confirmed
        device.wire.servos = []
        before = len(bus.link.written)
        answer = bus.write_raw(1, "acceleration", 2)
        assert (answer.error, answer.confirmed) == ("no answer", False)
        assert [packet[4] for packet in bus.link.written[before:]] == [3] * (1 + retries)


def test_a_register_that_lies_elsewhere_is_written_in_a_packet_of_its_own() -> None:
    bus, device = make_bus((1, 2, 3), (Series.STS_SMS, Series.SCS, Series.STS_SMS), paced=False)
    before = len(bus.link.written)
    bus.sync_write_raw("lock", {1: 0, 2: 0, 3: 0})
    bus.pause(0.01)
    assert bus.link.written[before:] == [
        make_sync_write(55, {1: b"\0", 3: b"\0"}),
        make_sync_write(48, {2: b"\0"}),
    ]
    with pytest.raises(UsageError, match="of servo 2 takes"):
        bus.sync_write_raw("lock", {1: 0, 2: 2})
    with pytest.raises(UsageError, match="register present_position of servo 1 is read-only"):
        bus.sync_write_raw("present_position", {1: 0, 2: 0})
    assert len(bus.link.written) == before + 2
    assert [device.wire[i].registers.get("lock") for i in (1, 2, 3)] == [0, 0, 0]


def test_an_error_names_the_failed_call() -> None:
    bus, device = make_bus((1,), retries=0)
    device.wire.servos = []
    for call, words in (
        (lambda: bus.write_raw(1, "acceleration", 1), "to a write of acceleration"),
        (lambda: bus.write_bytes(1, 41, b"\x01"), "to a write at 41"),
        (lambda: bus.reg_write(1, "goal_position", 1.0), "to a delayed write of goal_position"),
        (lambda: bus.backup(1), "to backup"),
        (lambda: bus.reset_turns(1), "to reset of turns"),
        (lambda: bus.calibrate(1), "to calibration"),
        (lambda: bus.restore(1), "to factory reset"),
        (lambda: bus.ping(1), "to ping"),
        (lambda: bus.action(1), "to action"),
    ):
        with pytest.raises(ServoError, match=f"^servo 1: no answer {words} "):
            call().check()


def test_range_ends_are_in_range() -> None:
    register = Series.STS_SMS.register("max_temperature")
    assert in_range(1, register, 0) == 0
    assert in_range(1, register, 100) == 100
    with pytest.raises(UsageError):
        in_range(1, register, -1)


def test_an_error_byte_of_a_servo_comes_with_its_acknowledgement() -> None:
    bus, device = make_bus((1,))
    device.wire[1].protection.status = 32
    plain = device.wire[1].receive

    def receive(packet: ServoPacket, now: float) -> bytes | None:
        answer = plain(packet, now)
        return make_status(1, 32) if answer is not None and packet.instruction == 3 else answer

    device.wire[1].receive = receive
    answer = bus.write_raw(1, "acceleration", 3)
    assert (answer.status, answer.error, answer.confirmed) == (32, "", True)
