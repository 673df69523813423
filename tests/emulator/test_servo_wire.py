from __future__ import annotations

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexwire.emulator.board import make_hex7bot_board
from hexwire.emulator.faults import FaultPlan
from hexwire.emulator.servo import EmulatedServo
from hexwire.emulator.servo_wire import ServoWire, heard_at, listen, same_rate
from hexwire.errors import UsageError
from hexwire.wire import servo_packet as sp
from hexwire.wire.registers import Series
from hexwire.wire.servo_packet import iter_packets, iter_status, make_ping, make_status

RATES = sorted(Series.STS_SMS.baud_codes.values())


@given(st.binary(max_size=40), st.sampled_from(RATES), st.floats(0.975, 1.025))
def test_a_rate_that_is_a_little_off_is_understood(data: bytes, sent: int, off: float) -> None:
    heard = round(sent * off)
    assert same_rate(sent, heard)
    assert heard_at(data, sent, heard) == data
    assert listen([(data, 3.0)], sent, heard) == data


def test_bytes_at_another_rate_are_the_wrong_bytes_of_a_real_line() -> None:
    # At half the rate each bit is seen twice, the start bit too: FF begins with one 0 more.
    assert heard_at(b"\xff", 500_000, 1_000_000) == b"\xfe"
    assert heard_at(b"\xff", 250_000, 1_000_000) == b"\xf8"
    # Nearly nine times slower: the byte is over before the start bit is.
    assert heard_at(b"\xff", 115_200, 1_000_000) == b"\x00"
    assert heard_at(b"\x00", 115_200, 1_000_000, whole=True) == b""
    # Much faster: pulses too short for a start bit, then nothing or little.
    assert len(heard_at(make_ping(1), 1_000_000, 115_200)) <= 1
    assert heard_at(b"", 1_000_000, 115_200) == b""


def test_no_ping_and_no_answer_survives_another_rate() -> None:
    """All the rates that servos have are far enough apart."""
    for sent, heard, servo_id in itertools.product(RATES, RATES, range(254)):
        request, answer = make_ping(servo_id), make_status(servo_id)
        where = f"servo {servo_id} at {sent} heard at {heard} baud"
        assert bool(list(iter_packets(heard_at(request, sent, heard, whole=True)))) is (sent == heard), where
        assert bool(list(iter_status(heard_at(answer, sent, heard, whole=True)))) is (sent == heard), where


@given(st.binary(min_size=1, max_size=20), st.binary(min_size=1, max_size=20))
def test_senders_in_step_overlay_bit_by_bit(one: bytes, other: bytes) -> None:
    short = min(len(one), len(other))
    both = bytes(a & b for a, b in zip(one, other, strict=False))
    assert listen([(one, 0.0), (other, 0.0)], 115_200) == both + one[short:] + other[short:]
    assert listen([(one, 0.0), (one, 0.0)], 115_200) == one


@given(st.binary(max_size=20), st.binary(max_size=20), st.floats(0, 1e-3))
def test_senders_out_of_step_are_survived(one: bytes, other: bytes, later: float) -> None:
    heard = listen([(one, 0.0), (other, later)], 115_200)
    assert len(heard) <= len(one) + len(other)


BYTE = 10 / 115200


def hls(servo_id: int, position: int = 2048, **settings: int) -> EmulatedServo:
    return EmulatedServo(Series.HLS, servo_id, position=position, settings={"baud_code": 4, **settings})


def legacy(servo_id: int, position: int = 2047) -> EmulatedServo:
    return EmulatedServo(Series.SEVEN_BOT, servo_id, position=position)


def test_an_unlimited_line_costs_no_time() -> None:
    wire = ServoWire([legacy(0, 2053)])
    answer, end = wire.transact(sp.make_read(0, 56, 2), 1.5)
    assert (answer, end) == (bytes.fromhex("FF F5 00 04 00 08 05 EE"), 1.5)


def test_a_paced_line_takes_ten_bits_a_byte_and_the_answer_delay() -> None:
    wire = ServoWire([legacy(0)], baud=115200)
    _, end = wire.transact(sp.make_read(0, 56, 2), 1.0)
    assert end == pytest.approx(1.0 + 16 * BYTE + 250e-6)
    # Too early: the line is still busy.
    _, later = wire.transact(sp.make_ping(0), 1.0)
    assert later == pytest.approx(end + 12 * BYTE + 250e-6)


def test_nobody_answers_an_absent_id() -> None:
    wire = ServoWire([legacy(0)], baud=115200)
    answer, end = wire.transact(sp.make_ping(9), 0.0)
    assert answer == b""
    assert end == pytest.approx(6 * BYTE)
    with pytest.raises(KeyError):
        wire[9]
    assert wire[0].servo_id == 0


def test_servos_at_another_rate_do_not_hear() -> None:
    wire = ServoWire([EmulatedServo(Series.HLS, 4), legacy(0)], baud=115200)
    assert wire.transact(sp.make_ping(4), 0.0)[0] == b""
    assert wire.transact(sp.make_ping(0), 0.1)[0]
    fast = ServoWire([EmulatedServo(Series.HLS, 4), legacy(0)], baud=1_000_000)
    assert fast.transact(sp.make_ping(4), 0.0)[0]
    assert fast.transact(sp.make_ping(0), 0.1)[0] == b""
    row = Series.HLS.register("baud_code")
    assert fast.transact(sp.make_write(4, row.address, b"\x04"), 0.2)[0]
    assert fast.transact(sp.make_ping(4), 0.3)[0] == b""


def test_a_wrong_checksum_is_not_answered_and_noise_before_a_packet_is_skipped() -> None:
    wire = ServoWire([legacy(0)])
    packet = sp.make_ping(0)
    assert wire.transact(packet[:-1] + b"\x00", 0.0)[0] == b""
    assert wire.transact(b"\x00\xff\xff\xff\x12" + packet, 0.0)[0] == sp.make_legacy_ping_status(0)
    assert wire.transact(packet + packet, 0.0)[0] == sp.make_legacy_ping_status(0) * 2
    assert wire.transact(b"", 0.0)[0] == b""


def test_echo_comes_first() -> None:
    packet = sp.make_read(4, 56, 2)
    for wire in (ServoWire([hls(4, 1304)], echo=True), ServoWire([hls(4, 1304)], faults=FaultPlan(["echo"]))):
        answer, _ = wire.transact(packet, 0.0)
        assert answer == packet + sp.make_status(4, 0, b"\x18\x05")
        found = sp.find_status(sp.strip_echo(answer, packet), 4, 2)
        assert found is not None
        assert found[0].params == b"\x18\x05"


def test_broadcast_ping_of_one_servo_is_answered() -> None:
    assert ServoWire([hls(4)]).transact(sp.make_ping(254), 0.0)[0] == sp.make_status(4)


def test_broadcast_ping_of_several_servos_collides() -> None:
    wire = ServoWire([hls(4), hls(5), hls(6)], baud=115200)
    answer, _ = wire.transact(sp.make_ping(254), 0.0)
    assert len(answer) == 6
    assert answer == bytes(a & b & c for a, b, c in zip(*(sp.make_status(i) for i in (4, 5, 6)), strict=True))
    assert list(sp.iter_status(answer)) == []


def test_answers_with_different_delays_overlap() -> None:
    slow, quick = hls(4), hls(5)
    slow.return_delay = quick.return_delay + 2 * BYTE
    answer, end = ServoWire([slow, quick], baud=115200).transact(sp.make_ping(254), 0.0)
    assert len(answer) == 8
    assert end == pytest.approx(14 * BYTE + 250e-6)
    slow.return_delay = quick.return_delay + 20 * BYTE
    answer, _ = ServoWire([slow, quick], baud=115200).transact(sp.make_ping(254), 0.0)
    assert answer == sp.make_status(5) + sp.make_status(4)  # a pause is no byte


def test_two_servos_with_one_id_collide() -> None:
    wire = ServoWire([hls(4, 0x0123), hls(4, 0x0456)])
    answer, _ = wire.transact(sp.make_read(4, 56, 2), 0.0)
    assert sp.find_status(answer, 4, 2) is None
    assert wire.transact(sp.make_ping(4), 0.0)[0] == sp.make_status(4)  # alike, so nobody notices


def test_sync_read_answers_in_the_order_asked_with_gaps_for_the_missing() -> None:
    servos = [hls(4, 1000), hls(5, 1001), hls(6, 1002)]
    wire = ServoWire(servos, baud=115200)
    answer, end = wire.transact(sp.make_sync_read(56, 2, [6, 9, 4, 5]), 0.0)
    statuses = list(sp.iter_status(answer))
    assert [(s.servo_id, int.from_bytes(s.params, "little")) for s in statuses] == [(6, 1002), (4, 1000), (5, 1001)]
    assert len(answer) == 24
    assert end == pytest.approx((12 + 4 * 8) * BYTE + 4 * 250e-6)


def test_sync_read_leaves_legacy_servos_silent() -> None:
    wire = ServoWire([legacy(0), hls(4)])
    answer, _ = wire.transact(sp.make_sync_read(56, 2, [0, 4]), 0.0)
    assert [s.servo_id for s in sp.iter_status(answer)] == [4]


def test_sync_write_moves_all_and_says_nothing() -> None:
    wire = ServoWire([legacy(0), legacy(1)])
    data = {i: (1500 + i).to_bytes(2, "big") + b"\x00\x00" for i in (0, 1)}
    assert wire.transact(sp.make_sync_write(42, data), 0.0) == (b"", 0.0)
    wire.step(2.0)
    assert [servo.present_position for servo in wire.servos] == [1500, 1501]


def test_scs_return_delay_register_counts() -> None:
    servo = EmulatedServo(Series.SCS, 1, settings={"baud_code": 4})
    assert servo.answer_delay == pytest.approx(500e-6)
    servo.registers.put("return_delay", 10)
    assert servo.answer_delay == pytest.approx(100e-6)
    assert hls(1).answer_delay == 250e-6


def test_a_negative_rate_is_refused() -> None:
    with pytest.raises(UsageError):
        ServoWire([], baud=-1)


@given(st.binary(max_size=60), st.integers(0, 2))
def test_any_bytes_are_survived(data: bytes, kind: int) -> None:
    baud = (0, 115200, 1_000_000)[kind]
    wire = ServoWire([legacy(0), hls(4), hls(4), EmulatedServo(Series.STS_SMS, 1)], baud=baud, echo=kind == 1)
    answer, end = wire.transact(data, 1.0)
    assert end >= 1.0
    assert len(answer) < 4000


def test_silent_servos_obey_but_do_not_answer() -> None:
    wire = ServoWire([hls(4), hls(5)], faults=FaultPlan(["silent:4"]))
    assert wire.transact(sp.make_write(4, 40, b"\x01"), 0.0)[0] == b""
    assert wire[4].torque_on
    assert wire.transact(sp.make_ping(5), 0.0)[0]


def test_late_answers_are_late() -> None:
    for baud in (0, 115200):
        wire = ServoWire([hls(4)], baud=baud, faults=FaultPlan(["late:4:0.05"]))
        answer, end = wire.transact(sp.make_ping(4), 1.0)
        assert answer == sp.make_status(4)
        assert 1.05 <= end < 1.06


def test_a_babbling_servo_spoils_answers_of_others() -> None:
    wire = ServoWire([hls(2), hls(4)], faults=FaultPlan(["babble:2:1"]))
    spoilt = [wire.transact(sp.make_read(4, 56, 2), 0.0)[0] for _ in range(20)]
    assert any(sp.find_status(answer, 4, 2) is None for answer in spoilt)
    answer, _ = wire.transact(sp.make_sync_read(56, 2, [4]), 0.0)
    assert sp.find_status(answer, 4, 2) is not None
    assert len(answer) > 8


def test_overloaded_and_hot_servos_say_so() -> None:
    wire = ServoWire([hls(4), hls(5)], faults=FaultPlan(["overload:4", "hot:5"]))
    wire.step(0.01)
    for servo_id, error in ((4, 0x20), (5, 0x04)):
        assert wire.transact(sp.make_ping(servo_id), 0.01)[0] == sp.make_status(servo_id, error)
    wire.transact(sp.make_write(4, 42, b"\x00\x01"), 0.02)
    wire.step(1.0)
    assert wire.transact(sp.make_ping(4), 1.0)[0] == sp.make_status(4, 0x20)


def test_a_servo_on_another_supply_measures_and_reports_it() -> None:
    wire = ServoWire([hls(4), hls(5)], faults=FaultPlan(["supply:4:3.2"]))
    assert wire.transact(sp.make_ping(4), 0.0)[0] == sp.make_status(4, 0x01)
    assert wire.transact(sp.make_read(4, 62, 1), 0.1)[0] == sp.make_status(4, 0x01, b"\x20")
    assert wire.transact(sp.make_ping(5), 0.2)[0] == sp.make_status(5)


def test_brownout_silences_the_servos_and_clears_their_memory() -> None:
    wire = ServoWire([hls(4)], faults=FaultPlan(["brownout:3:0.5"]))
    wire.transact(sp.make_write(4, 40, b"\x01"), 1.0)
    assert wire[4].torque_on
    assert wire.transact(sp.make_ping(4), 3.2)[0] == b""
    assert wire.transact(sp.make_ping(4), 3.5)[0] == sp.make_status(4)
    assert not wire[4].torque_on


def test_faults_of_the_bus_spoil_requests_and_answers() -> None:
    wire = ServoWire([hls(4)], faults=FaultPlan(["bus.flip:0.3"], seed=3))
    good = sum(wire.transact(sp.make_ping(4), 0.0)[0] == sp.make_status(4) for _ in range(400))
    assert 150 < good < 260  # 0.7 * 0.7 of 400, give or take


def test_a_fault_of_a_servo_that_is_not_there_is_refused() -> None:
    with pytest.raises(
        UsageError, match=r"'silent' is for servo 99, which is not on the bus; servos: 0, 1, 2, 3, 4, 5, 6$"
    ):
        make_hex7bot_board(faults=["silent:99"])
