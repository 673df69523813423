from __future__ import annotations

import pytest
from tests.bus.bus_bench import exchange_by, make_bus

from hexwire.bus.servo_bus import ServoBus
from hexwire.bus.values import Answer
from hexwire.errors import NotSupportedError
from hexwire.link.memory import memory_pair
from hexwire.wire import servo_packet as packets
from hexwire.wire.registers import Series
from hexwire.wire.servo_packet import make_status


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
    with pytest.raises(NotSupportedError, match="has no reboot"):
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


def test_bytes_received_instead_of_an_answer_are_reported() -> None:
    bus, device = make_bus((1, 2), retries=0)
    device.wire.servos = []
    assert bus.ping(1) == Answer(1, "ping", 0, "no answer", False)
    exchange_by(bus, lambda data, window, rest=None: make_status(2))
    assert bus.ping(1) == Answer(1, "ping", 0, "no answer, but an answer of servo 2", False)


def test_orders_are_these_packets_and_only_some_are_repeated() -> None:
    bus, device = make_bus((1,))
    bus.write_raw(1, "acceleration", 1)
    device.wire.servos = []
    for call, packet, times in (
        (lambda: bus.restore(1), packets.make_restore(1), 1),
        (lambda: bus.backup(1), packets.make_backup(1), 3),
        (lambda: bus.reset_turns(1), packets.make_reset_state(1), 3),
        (lambda: bus.calibrate(1), packets.make_calibrate(1, None), 1),
        (lambda: bus.calibrate(1, 1000), packets.make_calibrate(1, b"\xe8\x03"), 1),
        (lambda: bus.action(1), packets.make_action(1), 1),
    ):
        bus._machine.late_replies.clear()
        before = len(bus.link.written)
        assert call().error
        assert bus.link.written[before:] == [packet] * times
    before = len(bus.link.written)
    bus.reboot(1)
    bus.action()
    assert bus.link.written[before:] == [packets.make_reboot(1), packets.make_action()]


def test_an_unknown_servo_may_be_of_either_kind_but_a_legacy_one_is_known() -> None:
    bus, _ = make_bus((1, 2), (Series.SEVEN_BOT, Series.STS_SMS), paced=False)
    bus.set_series(1, Series.STS_SMS)
    assert bus.ping(1).ok
    bus.set_series(1, Series.SEVEN_BOT)
    assert bus.ping(1).ok
    bus.set_series(2, Series.SEVEN_BOT)
    assert bus.ping(2).error, "it does not answer as a legacy one"


def test_several_servos_answer_a_packet_made_by_hand() -> None:
    bus, device = make_bus((1, 2, 3))
    assert bus.raw(packets.make_sync_read(5, 1, (2, 1)), (2, 1), 1) == {2: b"\x02", 1: b"\x01"}
    # Whose answer may be a late one is asked otherwise first, and left out where nothing is answered.
    bus._machine.gave_up((2,), 1, b"something else", bus.now(), bus.now())
    device.wire.servos = [servo for servo in device.wire.servos if servo.servo_id != 2]
    assert bus.raw(packets.make_sync_read(5, 1, (1, 2)), (1, 2), 1) == {1: b"\x01"}
    bus._machine.gave_up((2,), 4, b"something else", bus.now(), bus.now())
    before = len(bus.link.written)
    assert bus.ask(packets.make_read(2, 5, 4), 2, 4) == (None, "")
    assert packets.make_read(2, 5, 4) not in bus.link.written[before:]


def test_what_is_sent_by_hand_and_not_waited_for_is_in_doubt_by_its_length() -> None:
    bus, _ = make_bus((1, 2))
    doubts = bus._machine.late_replies
    bus.raw(packets.make_sync_read(56, 4, (1, 2)))
    assert set(doubts.servos) == {1, 2}
    assert all(doubts.holds(i, 4, bus.now()) and not doubts.holds(i, 2, bus.now()) for i in (1, 2))
    doubts.clear()
    bus.raw(b"no packet at all")
    assert not doubts.servos


def test_a_pause_takes_its_time_and_drops_what_comes() -> None:
    bus, _ = make_bus((1,))
    start = bus.now()
    bus.link.write(packets.make_ping(1))
    bus.pause(0.25)
    assert bus.now() - start == pytest.approx(0.25, abs=0.001)
    bus.pause(0.0)
    assert bus.now() - start == pytest.approx(0.25, abs=0.001)
    assert bus.read(1, "id").raw == 1
    assert bus.counters.stray_bytes == 0


def test_a_broadcast_ping_counts_what_is_no_answer() -> None:
    bus, device = make_bus((3,))
    plain = bus._line.exchange
    exchange_by(bus, lambda data, window, rest=None: b"\x01\x02" + plain(data, window, rest))
    assert bus.broadcast_ping(2) == ((3,), 2)
    device.wire.servos = []
    assert bus.broadcast_ping(2) == ((), 2)
