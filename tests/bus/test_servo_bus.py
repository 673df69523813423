from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.bus.bus_bench import exchange_by, make_bus

from hexwire.bus.servo_bus import ServoBus
from hexwire.emulator.faults import FaultPlan
from hexwire.errors import LinkClosedError, NotSupportedError, ServoError, UsageError
from hexwire.wire.registers import Series
from hexwire.wire.servo_packet import ServoPacket, make_read, make_status, make_sync_write

SEVEN = (1, 2, 3, 4, 5, 6, 7)
ALL = (Series.SEVEN_BOT, Series.SCS, Series.STS_SMS, Series.HLS)


@pytest.mark.parametrize("series", ALL)
def test_ping_read_write_of_every_series(series: Series) -> None:
    bus, device = make_bus((3, 4), (series,))
    assert bus.ping(3).ok
    assert bus.ping(9).error == "no answer"
    assert bus.read(4, "present_position").raw == device.wire[4].registers.get("present_position")
    answer = bus.write_raw(3, "torque_enable", 1)
    assert answer.confirmed is (series is not Series.SEVEN_BOT)
    assert bus.read(3, "torque_enable").raw == 1
    assert device.wire[3].registers.get("torque_enable") == 1


def test_values_are_si() -> None:
    bus, device = make_bus()
    reading = bus.read(1, "present_position")
    assert reading.raw is not None
    assert reading.value == pytest.approx(reading.raw * 2 * math.pi / 4096)
    assert bus.read(1, "present_voltage").value == pytest.approx(
        device.wire[1].registers.get("present_voltage") / 10
    )
    bus.write(1, "goal_position", math.pi)
    assert device.wire[1].registers.get("goal_position") == 2048


def test_registers_that_make_no_sense_are_refused_before_anything_is_sent() -> None:
    bus, _ = make_bus()
    before = len(bus.link.written)
    for call in (
        lambda: bus.read(1, "present_postion"),
        lambda: bus.write(1, "present_position", 1.0),
        lambda: bus.write_raw(1, "max_temperature", 101),
        lambda: bus.sync_write_raw("goal_position", {1: 2048, 2: 40000}),
        lambda: bus.sync_write_raw("goal_position", {}),
        lambda: bus.sync_read("present_position", ()),
    ):
        with pytest.raises(UsageError):
            call()
    assert len(bus.link.written) == before


def test_sync_read_is_one_request() -> None:
    bus, device = make_bus()
    bus.read(1, "present_position")
    before = len(bus.link.written)
    readings = bus.sync_read("present_position", SEVEN)
    assert len(bus.link.written) == before + 1
    assert readings.raw == tuple(device.wire[i].registers.get("present_position") for i in SEVEN)
    assert readings.ok
    assert [reading.servo_id for reading in readings] == list(SEVEN)
    assert readings[3].value == readings.values[2]
    assert readings[3].age == 0.0


def test_sync_write_moves_each_servo_to_its_own_goal() -> None:
    bus, device = make_bus()
    goals = {i: 1000 + i for i in SEVEN}
    bus.sync_write_raw("goal_position", goals)
    bus.pause(0.01)
    assert {i: device.wire[i].registers.get("goal_position") for i in SEVEN} == goals
    bus.sync_write("goal_position", {2: 1.0, 5: -1.0})
    bus.pause(0.01)
    assert device.wire[5].registers.get("goal_position") == -652
    assert bus.read(5, "goal_position").raw == -652
    bus.sync_write_raw("torque_enable", {1: 0, 2: 1})
    bus.pause(0.01)
    assert device.wire[2].registers.get("torque_enable") == 1


def test_a_wire_with_all_series() -> None:
    bus, device = make_bus((0, 10, 20, 30, 31), (*ALL, Series.HLS), paced=False)
    readings = bus.sync_read("present_position", (30, 0, 10, 31, 20))
    assert readings.ids == (30, 0, 10, 31, 20)
    assert readings.raw == tuple(device.wire[i].registers.get("present_position") for i in readings.ids)
    assert readings[10].register.byte_order == "big"
    bus.sync_write_raw("acceleration", {20: 5, 30: 6})
    bus.sync_write_raw("lock", {10: 0, 20: 0})
    bus.pause(0.01)
    assert device.wire[20].registers.get("acceleration") == 5
    assert device.wire[10].registers.get("lock") == 0 == device.wire[20].registers.get("lock")


def test_loops_over_different_servos_keep_them_apart() -> None:
    bus, device = make_bus(SEVEN[:4])
    arms = ((1, 2), (3, 4))
    for _ in range(2):
        for arm in arms:
            # The same servos as the same object, as an equal tuple, and as a list.
            for ids in (arm, (*arm,), list(arm)):
                readings = bus.sync_read("present_position", ids)
                assert readings.ids == arm
                assert readings.raw == tuple(device.wire[i].registers.get("present_position") for i in arm)
            goals = {i: 2000 + 10 * i for i in arm}
            bus.sync_write_raw("goal_position", goals)
            bus.pause(0.01)
            assert {i: device.wire[i].registers.get("goal_position") for i in arm} == goals
    bus.sync_write_raw("goal_position", {4: 1004, 3: 1003})
    bus.pause(0.01)
    assert [device.wire[i].registers.get("goal_position") for i in (3, 4)] == [1003, 1004]


def test_a_changed_series_changes_the_packets_of_a_loop() -> None:
    bus, _ = make_bus((1, 2))
    ids = (1, 2)
    bus.sync_read("present_position", ids)
    bus.sync_write_raw("goal_position", dict.fromkeys(ids, 100))
    for servo_id in ids:
        bus.set_series(servo_id, Series.SCS)
    sent: list[bytes] = []
    bus._line._post = sent.append
    bus.sync_write_raw("goal_position", dict.fromkeys(ids, 100))
    assert sent == [make_sync_write(Series.SCS.register("goal_position").address, dict.fromkeys(ids, b"\0\x64"))]
    assert bus.sync_read("present_position", ids)[1].register.byte_order == "big"


def test_reg_write_waits_for_action() -> None:
    bus, device = make_bus()
    assert bus.reg_write(1, "goal_position", 1.0).ok
    bus.reg_write(2, "goal_position", 2.0)
    assert device.wire[1].registers.get("goal_position") != 652
    assert bus.read(1, "reg_write_pending").raw == 1
    assert bus.action() is None
    bus.pause(0.01)
    assert device.wire[1].registers.get("goal_position") == 652
    bus.reg_write(2, "goal_position", 1.0)
    answer = bus.action(2)
    assert answer is not None
    assert answer.ok


def test_the_other_instructions() -> None:
    bus, device = make_bus((1, 2))
    assert bus.calibrate(1).ok
    assert bus.read(1, "present_position").raw == 2048
    assert bus.backup(1).ok
    assert bus.reset_turns(1).ok
    assert bus.restore(2).ok
    bus.reboot(1)
    assert bus.ping(1).error
    bus.pause(1.0)
    assert bus.ping(1).ok
    ids, garbage = bus.broadcast_ping(2)
    assert ids == ()
    assert garbage  # both answered at once
    device.wire.servos.pop()
    assert bus.broadcast_ping() == ((1,), 0)
    legacy, _ = make_bus((1,), (Series.SEVEN_BOT,))
    for call in (legacy.restore, legacy.reboot, legacy.calibrate, legacy.backup):
        with pytest.raises(NotSupportedError):
            call(1)


@pytest.mark.parametrize("last", [4, 7])
def test_one_mute_servo_leaves_the_others_their_values(last: int) -> None:
    bus, device = make_bus(faults=FaultPlan([f"silent:{last}"]))
    others = [i for i in SEVEN if i != last]
    for _ in range(20):
        readings = bus.sync_read("present_position", SEVEN)
        assert readings.missing == (last,)
        for i in others:
            assert readings[i].raw == device.wire[i].registers.get("present_position")
    silent = readings[last]
    assert (silent.raw, silent.error, silent.age) == (None, "no answer", math.inf)
    assert math.isnan(silent.value)
    with pytest.raises(ServoError, match=f"servo {last}: no answer to present_position"):
        readings.check()


def test_only_the_missing_servo_is_asked_again() -> None:
    bus, _ = make_bus()
    bus.sync_read("present_position", SEVEN)
    link = bus.link
    lost = iter([True])
    plain = bus._line.exchange

    def lossy(data: bytes, window: float, rest: object = None) -> bytes:
        heard = plain(data, window, rest)
        if data[4] == 0x82 and next(lost, False):
            while len(heard) < 56:
                heard += link.read(link.clock() + 1.0)
            return heard[:16] + heard[24:]
        return heard

    exchange_by(bus, lossy)
    before = len(link.written)
    assert bus.sync_read("present_position", SEVEN).ok
    assert [packet[2:5] for packet in link.written[before:]] == [b"\xfe\x0b\x82", b"\x03\x04\x02"]
    assert bus.counters.repeats == 1


def test_a_silent_servo_keeps_its_last_value_and_tells_its_age() -> None:
    bus, device = make_bus()
    first = bus.sync_read("present_position", SEVEN)
    device.wire.servos = [servo for servo in device.wire.servos if servo.servo_id != 5]
    for _ in range(2):
        now = bus.sync_read("present_position", SEVEN)
    assert now[5].raw is None
    assert now[5].last == first[5].raw
    assert now[5].age == pytest.approx(now.stamp - first.stamp)
    bus.read(6, "present_speed")
    device.wire.servos = []
    assert bus.read(6, "present_speed").last == 0


def test_a_servo_that_comes_back_is_taken_back() -> None:
    bus, device = make_bus()
    everyone = device.wire.servos
    device.wire.servos = everyone[:3] + everyone[4:]
    for _ in range(3):
        assert bus.sync_read("present_position", SEVEN).missing == (4,)
    device.wire.servos = everyone
    assert bus.sync_read("present_position", SEVEN).ok
    assert bus.sync_read("present_position", SEVEN).ok


def test_faults_are_named_with_servo_and_register() -> None:
    bus, _ = make_bus(faults=FaultPlan(["overload:2"]))
    bus.pause(3.0)
    reading = bus.sync_read("present_position", SEVEN)[2]
    assert reading.raw is not None
    assert reading.faults == ("overload",)
    with pytest.raises(ServoError, match=r"servo 2 reports overload at present_position .*recover"):
        reading.check()
    assert bus.read(2, "present_load").faults == ("overload",)
    assert bus.ping(2).faults == ("overload",)


@pytest.mark.parametrize("paced", [True, False])
@pytest.mark.parametrize("start", [0, 3])
def test_an_echo_is_never_a_value(paced: bool, start: int) -> None:
    bus, device = make_bus(paced=paced)
    for turn in range(8):
        device.wire.echo = start <= turn < 6
        for i in (1, 5):
            assert bus.read(i, "present_position").raw == device.wire[i].registers.get("present_position")
        assert bus.sync_read("present_position", SEVEN).ok
        assert bus.ping(3).ok
        assert bus.write_raw(2, "acceleration", turn).confirmed
    assert bus.echo is False
    assert bus.counters.echoes


def test_an_answer_that_equals_its_request_is_believed_in_the_end() -> None:
    bus, device = make_bus((1,))
    device.wire[1].protection.status = 2
    # The answer with error 2 and value 0x0238 to a 2-byte read at 0x38 is the request itself.
    request = bytes.fromhex("ff ff 01 04 02 38 02 be")
    assert make_status(1, 2, b"\x38\x02") == request
    plain = bus._line.exchange
    exchange_by(bus, lambda data, window, rest=None: request if data == request else plain(data, window, rest))
    reading = bus.read(1, "present_position")
    assert reading.raw == device.wire[1].registers.get("present_position")


@pytest.mark.parametrize(
    "fault", ["bus.flip:0.05", "bus.drop:0.05", "bus.junk:0.1", "bus.cut:0.05", "bus.dup:0.05"]
)
def test_under_faults_a_value_is_right_or_missing(fault: str) -> None:
    bus, device = make_bus(faults=FaultPlan([fault], seed=7))
    fresh = 0
    for turn in range(150):
        name = ("present_position", "present_voltage", "present_temperature")[turn % 3]
        for reading in bus.sync_read(name, SEVEN):
            assert reading.raw in (None, device.wire[reading.servo_id].registers.get(name))
            fresh += reading.raw is not None
        one = bus.read(1 + turn % 7, "id")
        assert one.raw in (None, 1 + turn % 7)
    assert fresh > 0.98 * 150 * 7


def test_a_late_answer_never_answers_the_next_question() -> None:
    bus, device = make_bus((1, 2), retries=0)
    for _ in range(100):
        bus.read(1, "id")
    window = bus.timing.allowance
    assert window < 0.005
    late = FaultPlan([f"late:1:{window + 0.004}:0.3"], seed=3)
    device.wire.faults = late
    wrong = 0
    for turn in range(200):
        name = ("id", "present_voltage", "present_temperature", "max_temperature")[turn % 4]
        value = bus.read(1, name).raw
        wrong += value not in (None, device.wire[1].registers.get(name))
        two = ("present_position", "goal_position", "max_position_limit")[turn % 3]
        value = bus.read(1, two).raw
        wrong += value not in (None, device.wire[1].registers.get(two))
    assert wrong == 0
    assert bus.counters.settled


@given(st.binary(max_size=80))
def test_any_noise_in_front_of_an_answer_costs_no_wrong_value(noise: bytes) -> None:
    bus, device = make_bus((1, 2))
    plain = bus._line.exchange
    exchange_by(bus, lambda data, window, rest=None: noise + plain(data, window, rest))
    raw = bus.read(1, "present_position").raw
    genuine = device.wire[1].registers.get("present_position")
    assert raw in (None, genuine) or make_status(1, 0, b"")[:3] in noise
    assert bus.sync_read("present_position", (1, 2)).ids == (1, 2)


def test_only_the_link_raises() -> None:
    bus, _ = make_bus()
    bus.close()
    with pytest.raises(LinkClosedError):
        bus.read(1, "present_position")


def test_a_rate_can_be_followed() -> None:
    bus, _device = make_bus((1,))
    assert bus.ping(1).ok
    bus.set_baud(115200)
    assert bus.timing.baud == 115200
    assert bus.ping(1).error
    bus.set_baud(1_000_000)
    assert bus.ping(1).ok


def prefixed(bus: ServoBus, before: list[bytes]) -> None:
    """Let something be heard in front of what the next requests bring."""
    plain = bus._line.exchange
    exchange_by(bus, lambda data, window, rest=None: (before.pop(0) if before else b"") + plain(data, window, rest))


@pytest.mark.parametrize("copies", [1, 2, 3])
def test_several_copies_of_a_request_are_no_value(copies: int) -> None:
    bus, device = make_bus((5,))
    request = make_read(5, 56, 2)
    prefixed(bus, [request * copies] * 20)
    for _ in range(20):
        assert bus.read(5, "present_position").raw == device.wire[5].registers.get("present_position")


def test_the_echo_of_an_earlier_read_is_no_value() -> None:
    bus, device = make_bus((5,))
    bus.read(5, "goal_position")
    prefixed(bus, [make_read(5, 42, 2)])
    reading = bus.read(5, "present_position")
    assert reading.raw == device.wire[5].registers.get("present_position")


def test_how_long_an_answer_takes_is_never_learned_from_an_echo() -> None:
    bus, device = make_bus((1,), baud=38400)
    device.wire.echo = True
    for _ in range(200):
        assert bus.read(1, "present_position").ok
    # Twice eight bytes at 38400 baud, and what the servo waits, less than what is granted.
    assert bus.timing.answers > 50
    assert bus.timing.overhead > 0
    device.wire.echo = False
    for _ in range(50):
        assert bus.read(1, "present_position").ok
    assert bus.counters.lost == 0


def test_a_servo_at_568_with_error_2_can_be_read_behind_an_echo_too() -> None:
    for echo in (False, True):
        bus, device = make_bus((1, 2), retries=0)
        device.wire.echo = echo
        servo = device.wire[1]
        plain = servo.receive
        memory = bytes(56) + b"\x38\x02" + bytes(200)

        def receive(packet: ServoPacket, now: float, memory: bytes = memory, plain: object = plain) -> bytes | None:
            if packet.instruction == 2 and packet.servo_id == 1:
                first, count = packet.params
                return make_status(1, 2, memory[first : first + count])
            if packet.instruction == 0x82:
                first, count = packet.params[:2]
                return make_status(1, 2, memory[first : first + count])
            return plain(packet, now)  # type: ignore[operator]

        servo.receive = receive
        for _ in range(10):
            reading = bus.read(1, "present_position")
            assert (reading.raw, reading.faults) == (568, ("encoder",))
            bus.pause(0.3)
        bus.retries = 2
        assert bus.sync_read("present_position", (1, 2))[1].raw == 568
        assert bus.read_block(1, 56, 2).data == b"\x38\x02"


def test_an_interrupted_read_leaves_a_doubt() -> None:
    bus, device = make_bus((1,))
    bus.read(1, "present_position")
    plain = bus._line.exchange

    def interrupted(data: bytes, window: float, rest: object = None) -> bytes:
        bus.link.write(data)
        raise KeyboardInterrupt

    for call in (
        lambda: bus.read(1, "present_position"),
        lambda: bus.sync_read("present_position", (1,)),
        lambda: bus.sync_read_blocks(56, 2, (1,)),
    ):
        exchange_by(bus, interrupted)
        with pytest.raises(KeyboardInterrupt):
            call()
        exchange_by(bus, plain)
        device.wire[1].registers.put("goal_position", 1234)
        for _ in range(3):
            assert bus.read(1, "goal_position").raw == 1234
    exchange_by(bus, interrupted)
    with pytest.raises(KeyboardInterrupt):
        bus.write_raw(1, "acceleration", 3)
    exchange_by(bus, plain)
    device.wire.servos = []
    assert bus.ping(1).error


def test_answers_that_come_later_than_before_are_waited_for_soon() -> None:
    bus, device = make_bus((1, 2))
    for _ in range(100):
        bus.read(1, "present_position")
    assert bus.timing.allowance < 0.003
    device.wire.faults = FaultPlan(["late:1:0.016", "late:2:0.016"])
    came = [bus.read(1, "present_position").raw for _ in range(40)]
    assert all(raw in (None, device.wire[1].registers.get("present_position")) for raw in came)
    assert None not in came[10:]


def test_an_answer_that_was_not_awaited_is_not_taken_later() -> None:
    bus, device = make_bus((1,))
    bus.read(1, "present_position")
    bus.raw(make_read(1, 42, 2))
    assert bus.read(1, "present_position").raw == device.wire[1].registers.get("present_position")
    assert bus.counters.settled == 1


def test_an_adapter_that_adds_a_byte_is_read_by_asking_twice() -> None:
    bus, device = make_bus((1, 2))
    plain = bus._line.exchange
    exchange_by(bus, lambda data, window, rest=None: plain(data, window, rest) + b"\0")
    assert bus.read(1, "present_position").raw == device.wire[1].registers.get("present_position")
    assert bus.counters.repeats == 1


def test_a_broadcast_ping_tells_a_low_supply_from_an_echo() -> None:
    bus, device = make_bus((1,))
    device.wire[1].protection.forced |= 1
    bus.pause(0.1)
    bus.ping(1)
    assert bus.broadcast_ping(3) == ((1,), 0)


def test_an_answer_is_not_believed_before_what_has_come_behind_it_was_looked_at() -> None:
    bus, device = make_bus((1,), retries=0)
    device.wire.servos = []
    # The error byte 2 is lost and a 2 is added at the end: sound, but for the two bytes that are there already.
    answer = make_status(1, 2, b"\x38\x02\x29")
    forged = answer[:4] + answer[5:] + b"\x02"
    assert sum(forged[2:]) & 0xFF == 0xFF
    pieces = [b"\x9c\x38"]
    exchange_by(bus, lambda data, window, rest=None: forged)
    plain = bus.link.read
    bus.link.read = lambda deadline: pieces.pop() if pieces else plain(deadline)
    assert bus.read_block(1, 56, 3).data == b""


@pytest.mark.parametrize("noise", [make_read(1, 56, 2), b"\0", b"\xff", make_status(2, 0, b"abc")])
@pytest.mark.parametrize("answers", [True, False])
def test_a_line_that_never_stops_talking_does_not_hold_a_read_for_ever(noise: bytes, answers: bool) -> None:
    bus, device = make_bus((1,), retries=0)
    position = device.wire[1].registers.get("present_position")
    heard = make_status(1, 0, position.to_bytes(2, "little")) if answers else noise
    exchange_by(bus, lambda data, window, rest=None: make_read(1, 56, 2) + heard)
    bus.link.read = lambda deadline: noise
    assert bus.read(1, "present_position").raw in (None, position)


@pytest.mark.parametrize(
    ("url", "series", "baud"),
    [
        ("serial:///dev/none", Series.STS_SMS, 1_000_000),
        ("serial:///dev/none", Series.SEVEN_BOT, 115_200),
        ("serial:///dev/none?low_latency=0", Series.SEVEN_BOT, 115_200),
        ("serial:///dev/none?baud=38400", Series.STS_SMS, 38_400),
    ],
)
def test_a_serial_url_without_a_rate_gets_that_of_the_series(url: str, series: Series, baud: int) -> None:
    bus = ServoBus.from_url(url, series=series, retries=5)
    assert bus.timing.baud == baud
    assert bus.series is series
    assert bus.retries == 5
    assert f"baud={baud}" in bus.link.url
    assert ServoBus.from_url("serial:///dev/none").timing.baud == 1_000_000


def test_two_of_a_series_are_asked_together_on_a_mixed_wire() -> None:
    bus, device = make_bus((1, 2, 3), (Series.STS_SMS, Series.SCS, Series.STS_SMS), paced=False)
    before = len(bus.link.written)
    readings = bus.sync_read("present_position", (1, 2, 3))
    assert [packet[4] for packet in bus.link.written[before:]] == [0x82, 2]
    assert readings.raw == tuple(device.wire[i].registers.get("present_position") for i in (1, 2, 3))
    before = len(bus.link.written)
    bus.sync_read("present_position", (1, 2))
    assert [packet[4] for packet in bus.link.written[before:]] == [2, 2]


def test_a_value_that_comes_with_a_fault_is_remembered() -> None:
    bus, device = make_bus((1, 2), retries=0)
    device.wire[1].protection.forced |= 32
    bus.pause(0.1)
    assert bus.read(1, "present_voltage").faults == ("overload",)
    both = bus.sync_read("present_voltage", (1, 2))
    value, stamp = both[1].raw, bus.now()
    device.wire.servos = []
    bus.pause(1.5)
    gone = bus.read(1, "present_voltage")
    assert (gone.raw, gone.last, gone.status, gone.error) == (None, value, 0, "no answer")
    assert gone.age == pytest.approx(bus.now() - stamp, abs=0.01)
    assert bus.read(2, "present_voltage").last == both[2].raw
    never = bus.read(2, "present_temperature")
    assert (never.last, never.age) == (None, math.inf)


def test_an_answer_with_a_negative_value_is_counted_once() -> None:
    bus, device = make_bus((1, 2))
    device.wire[1].registers.put("goal_position", -5)
    before = bus.counters
    readings = bus.sync_read("goal_position", (1, 2))
    assert readings.raw[0] == -5
    after = bus.counters
    assert (after.requests - before.requests, after.answers - before.answers, after.careful) == (
        1,
        2,
        before.careful,
    )


def test_every_answer_to_every_request_is_counted() -> None:
    bus, device = make_bus()
    before = bus.counters
    for name, value in (("present_position", 2048), ("goal_position", -5)):
        device.wire[1].registers.put("goal_position", value)
        for _ in range(3):
            assert bus.sync_read(name, SEVEN).ok
    after = bus.counters
    assert (after.requests - before.requests, after.answers - before.answers) == (6, 42)


@pytest.mark.parametrize("series", ALL)
def test_the_careful_path_gives_what_the_fast_one_gives(series: Series) -> None:
    bus, _ = make_bus((1, 2), (series,))
    for name in ("present_position", "present_temperature", "torque_enable"):
        quick, both = bus.read(1, name), bus.sync_read(name, (1, 2))
        bus._machine.gave_up((1, 2), quick.register.size, b"something else", bus.now(), bus.now())
        careful, slow = bus.read(1, name), bus.sync_read(name, (1, 2))
        assert careful == quick
        assert careful.register is series.register(name)
        assert careful.value == quick.value
        assert list(slow) == list(both)
        assert slow.values == both.values
        bus._machine.late_replies.clear()
    assert bus.counters.settled


def test_ids_come_in_any_collection() -> None:
    bus, _ = make_bus((1, 2, 3))
    raws = bus.sync_read("present_position", (2, 1)).raw
    for ids in ([2, 1], iter((2, 1)), {2: 0, 1: 0}):
        readings = bus.sync_read("present_position", ids)
        assert (readings.ids, readings.raw) == ((2, 1), raws)
    assert [block.servo_id for block in bus.sync_read_blocks(56, 2, iter((3, 1)))] == [3, 1]


def test_what_cannot_be_written_is_named_with_its_servo() -> None:
    bus, _ = make_bus((1, 7))
    for call in (
        lambda: bus.write(7, "present_position", 1.0),
        lambda: bus.write_raw(7, "present_position", 1),
        lambda: bus.reg_write(7, "present_position", 1.0),
        lambda: bus.sync_write("present_position", {7: 1.0}),
        lambda: bus.sync_write_raw("present_position", {7: 1}),
    ):
        with pytest.raises(UsageError, match=r"^register present_position of servo 7 "):
            call()
    for call in (
        lambda: bus.write_raw(7, "max_temperature", 101),
        lambda: bus.reg_write(7, "max_temperature", 101.0),
        lambda: bus.sync_write_raw("max_temperature", {1: 50, 7: 101}),
    ):
        with pytest.raises(UsageError, match=r"^max_temperature of servo 7 takes"):
            call()


def test_each_servo_is_written_in_its_own_series() -> None:
    bus, device = make_bus((1, 2), (Series.STS_SMS, Series.SCS), paced=False)
    for servo_id in (1, 2):
        series = bus.series_of(servo_id)
        goal = series.register("goal_position")
        assert bus.write(servo_id, "goal_position", 1.0).ok
        assert device.wire[servo_id].registers.get("goal_position") == goal.from_si(1.0)
        assert bus.write_raw(servo_id, "goal_position", 300).ok
        assert bus.read(servo_id, "goal_position").raw == 300
        assert bus.write_bytes(servo_id, goal.address, goal.encode(301)).ok
        assert bus.read(servo_id, "goal_position").raw == 301
    bus.sync_write("goal_position", {1: 1.0, 2: 1.0})
    bus.pause(0.01)
    raws = [bus.series_of(i).register("goal_position").from_si(1.0) for i in (1, 2)]
    assert [device.wire[i].registers.get("goal_position") for i in (1, 2)] == raws
    bus.sync_write_bytes(42, {1: b"\x05\x00"})
    bus.pause(0.01)
    assert device.wire[1].registers.get("goal_position") == 5
