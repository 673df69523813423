from __future__ import annotations

import itertools

import pytest
from tests.bus.bus_bench import exchange_by, make_bus

from hexwire.bus import setup as setup
from hexwire.bus.values import Answer
from hexwire.emulator.faults import FaultPlan
from hexwire.errors import NotSupportedError, ServoError, UsageError
from hexwire.wire.registers import Series
from hexwire.wire.servo_packet import ServoPacket, make_status, make_write

STS = Series.STS_SMS

ALL = (Series.SEVEN_BOT, Series.SCS, Series.STS_SMS, Series.HLS)


def test_servos_say_who_they_are() -> None:
    bus, _ = make_bus((1, 2, 3, 4), ALL, paced=False)
    for servo_id, series in zip((1, 2, 3, 4), ALL, strict=True):
        bus.set_series(servo_id, Series.STS_SMS)
        info = setup.identify(bus, servo_id)
        assert info is not None
        assert info.series is series is bus.series_of(servo_id)
        assert bus.read(servo_id, "present_position").ok
    info = setup.identify(bus, 3)
    assert info is not None
    assert info.model_name == "sts3215"
    assert info.baud == 1_000_000
    assert setup.identify(bus, 9) is None


def test_scan_finds_every_servo_at_every_rate() -> None:
    bus, device = make_bus((3, 7, 100))
    code = {rate: code for code, rate in Series.STS_SMS.baud_codes.items()}[115200]
    device.wire[7].registers.put_stored("baud_code", code)
    device.wire[7].registers.put("baud_code", code)
    seen = []
    found = setup.scan(
        bus, bauds=(1_000_000, 115_200), ids=range(101), progress=lambda baud, servo_id, n: seen.append((baud, n))
    )
    assert [(row.servo_id, row.baud, row.shared) for row in found] == [
        (3, 1_000_000, False),
        (100, 1_000_000, False),
        (7, 115_200, False),
    ]
    assert len(seen) == 202
    assert bus.timing.baud == 1_000_000
    assert bus.retries == 2


@pytest.mark.parametrize("kinds", [(Series.STS_SMS, Series.STS_SMS), (Series.STS_SMS, Series.HLS)])
def test_two_servos_with_one_id_are_seen(kinds: tuple[Series, ...]) -> None:
    bus, _ = make_bus((4, 9, 9), (Series.STS_SMS, *kinds))
    assert [(row.servo_id, row.shared) for row in setup.scan(bus, ids=range(12))] == [(4, False), (9, True)]
    with pytest.raises(ServoError, match="9"):
        setup.set_id(bus, 9, 10)


def test_scan_behind_an_echo_finds_only_servos() -> None:
    bus, _ = make_bus((2, 5), echo=True)
    assert [row.servo_id for row in setup.scan(bus, ids=range(8))] == [2, 5]


@pytest.mark.parametrize("series", ALL)
def test_set_id(series: Series) -> None:
    bus, device = make_bus((1, 2), (series,))
    with pytest.raises(ServoError, match="id 2 is taken: nothing was changed"):
        setup.set_id(bus, 1, 2)
    assert setup.set_id(bus, 1, 20).servo_id == 20
    assert bus.ping(20).ok
    assert bus.ping(1).error
    assert device.wire[20].registers.stored("id") == 20
    if "lock" in series.registers:
        assert bus.read(20, "lock").raw == 1
    with pytest.raises(UsageError, match="outside"):
        setup.set_id(bus, 2, 254)
    with pytest.raises(ServoError, match="does not answer"):
        setup.set_id(bus, 77, 78)


def test_set_id_that_does_not_take_leaves_the_old_one() -> None:
    bus, device = make_bus((1,))
    servo = device.wire[1]
    receive = servo.receive
    servo.receive = lambda packet, now: None if packet.params[:1] == b"\x05" else receive(packet, now)
    with pytest.raises(ServoError, match="it still has 1"):
        setup.set_id(bus, 1, 3)
    assert bus.read(1, "lock").raw == 1


def test_set_baud_follows_and_verifies() -> None:
    bus, device = make_bus((1,))
    setup.set_baud(bus, 1, 115200)
    assert bus.timing.baud == 115200
    assert bus.read(1, "baud_code").raw == 4
    assert device.wire[1].registers.stored("baud_code") == 4
    assert bus.read(1, "lock").raw == 1
    with pytest.raises(UsageError, match=r"support 38400, 57600, .*, 1000000 baud, not 9600"):
        setup.set_baud(bus, 1, 9600)


def test_set_baud_comes_back_where_the_servo_answers_but_has_not_stored_the_rate() -> None:
    bus, device = make_bus((1,))
    plain = bus.read
    bus.read = lambda servo_id, name: (  # type: ignore[assignment,method-assign]
        plain(servo_id, name)._replace(raw=0) if name == "baud_code" else plain(servo_id, name)
    )
    with pytest.raises(ServoError, match="it still uses 1000000"):
        setup.set_baud(bus, 1, 115200)
    assert bus.timing.baud == 1_000_000
    assert device.wire[1].registers.stored("baud_code") == 0


@pytest.mark.parametrize("spoiled", [0, 3, 4, 6])
def test_an_id_is_shared_if_most_answers_collide(spoiled: int) -> None:
    bus, _ = make_bus((1,))
    plain, asked = bus.ask, itertools.count()

    def ask(request: bytes, servo_id: int, params: int) -> object:
        return (None, "a bad check sum") if next(asked) < spoiled else plain(request, servo_id, params)

    bus.ask = ask  # type: ignore[assignment,method-assign]
    assert setup.shares_id(bus, 1) is (spoiled > 3)


def test_set_baud_comes_back_where_the_line_does_not_carry_it() -> None:
    bus, device = make_bus((1,))
    plain = bus._line.exchange
    exchange_by(
        bus, lambda data, window, rest=None: b"" if bus.timing.baud == 500_000 else plain(data, window, rest)
    )
    with pytest.raises(ServoError, match="does not answer at 500000 baud; it still uses 1000000"):
        setup.set_baud(bus, 1, 500_000)
    assert bus.timing.baud == 1_000_000
    assert bus.ping(1).ok
    assert device.wire[1].registers.stored("baud_code") == 0


def test_settings_are_stored_and_verified() -> None:
    bus, device = make_bus((1,))
    setup.write_setting(bus, 1, "max_temperature", 60)
    assert device.wire[1].registers.stored("max_temperature") == 60
    assert bus.read(1, "lock").raw == 1
    for name in ("id", "baud_code"):
        with pytest.raises(UsageError, match="set-"):
            setup.write_setting(bus, 1, name, 3)


def test_the_middle_is_set_only_without_torque_and_nothing_moves() -> None:
    bus, device = make_bus((1, 2), (Series.STS_SMS, Series.HLS), paced=False)
    for servo_id in (1, 2):
        before = device.wire[servo_id].motion.position
        bus.write_raw(servo_id, "torque_enable", 1)
        with pytest.raises(ServoError, match="has torque"):
            setup.center(bus, servo_id)
        bus.write_raw(servo_id, "torque_enable", 0)
        assert abs(setup.center(bus, servo_id) - 2048) <= 1
        bus.pause(1.0)
        assert device.wire[servo_id].motion.position == pytest.approx(before, abs=0.5)
        assert bus.read(servo_id, "torque_enable").raw == 0
    legacy, _ = make_bus((1,), (Series.SEVEN_BOT,))
    with pytest.raises(NotSupportedError):
        setup.center(legacy, 1)


def test_torque_off_tries_every_servo() -> None:
    bus, device = make_bus((1, 2, 3))
    bus.sync_write_raw("torque_enable", dict.fromkeys((1, 2, 3), 1))
    assert setup.torque_off(bus, (1, 9, 2, 3)) == (9,)
    assert [device.wire[i].registers.get("torque_enable") for i in (1, 2, 3)] == [0, 0, 0]


def test_torque_off_asks_a_second_time_only_where_the_first_had_no_effect() -> None:
    bus, device = make_bus((1, 2, 3))
    bus.sync_write_raw("torque_enable", dict.fromkeys((1, 2, 3), 1))
    before = len(bus.link.written)
    assert setup.torque_off(bus, (1, 2, 3)) == ()
    assert [packet[4] for packet in bus.link.written[before:]] == [0x83, 0x82]
    bus.sync_write_raw("torque_enable", dict.fromkeys((1, 2, 3), 1))
    plain = bus.sync_write_raw
    bus.sync_write_raw = lambda name, values: plain(name, {i: v for i, v in values.items() if i != 2})  # type: ignore[method-assign]  # servo 2 misses it
    before = len(bus.link.written)
    assert setup.torque_off(bus, (1, 2, 3)) == ()
    assert device.wire[2].registers.get("torque_enable") == 0
    assert [packet[2] for packet in bus.link.written[before:] if packet[4] == 0x03] == [2]


def test_recovery_says_what_remains() -> None:
    bus, _ = make_bus((1,))
    assert setup.recover(bus, 1) == ()
    hot, _ = make_bus((1,), faults=FaultPlan(["hot:1"]))
    hot.pause(0.5)
    assert setup.recover(hot, 1, patience=0.5) == ("temperature",)
    gone, device = make_bus((1,))
    device.wire.servos = []
    with pytest.raises(ServoError, match="does not confirm"):
        setup.recover(gone, 1)


@pytest.mark.parametrize("late", [0.012, 0.02, 0.04])
def test_a_late_answer_makes_no_servo_of_the_next_id(late: float) -> None:
    for seed in range(20):
        bus, _ = make_bus((2,), faults=FaultPlan([f"late:2:{late}:0.5"], seed=seed))
        assert {row.servo_id for row in setup.scan(bus, ids=range(8))} <= {2}


@pytest.mark.parametrize("retries", [0, 1, 3])
def test_a_scan_pings_once_and_asks_who_answers_at_least_once_again(retries: int) -> None:
    bus, device = make_bus((4,), retries=retries)
    plain = device.wire[4].receive
    device.wire[4].receive = lambda packet, now: plain(packet, now) if packet.instruction == 1 else None
    assert setup.scan(bus, ids=(3, 4)) == [setup.Found(None, 4, 1_000_000, False)]
    sent = [packet for packet in bus.link.written if packet[2] == 3]
    assert len(sent) == 1
    # Nine bytes of who it is, and then a position as of a legacy servo.
    asked = [packet for packet in bus.link.written if packet[4:7] == bytes((2, 0, 9))]
    assert len(asked) == 1 + max(1, retries)
    assert bus.retries == retries


@pytest.mark.parametrize("series", ALL)
def test_one_servo_does_not_share_its_id(series: Series) -> None:
    bus, _ = make_bus((4,), (series,))
    (row,) = setup.scan(bus, ids=(4,))
    assert row.info is not None
    assert (row.info.series, row.shared) == (series, False)


def test_a_scan_reports_its_progress_and_restores_the_rate_after_an_error() -> None:
    bus, _ = make_bus((1, 3))
    seen: list[tuple[int, int, int]] = []
    setup.scan(bus, ids=(1, 2, 3), progress=lambda *row: seen.append(row))
    assert seen == [(1_000_000, 1, 0), (1_000_000, 2, 1), (1_000_000, 3, 1)]

    def fail(baud: int, servo_id: int, found: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        setup.scan(bus, bauds=(115_200,), progress=fail)
    assert bus.timing.baud == 1_000_000
    assert bus.retries == 2


def test_what_a_servo_says_of_itself() -> None:
    bus, device = make_bus((1, 2), (Series.SCS, Series.STS_SMS), paced=False)
    for name, raw in (("return_delay", 100), ("status_return_level", 0), ("model_minor", 1)):
        for servo_id in (1, 2):
            device.wire[servo_id].registers.put(name, raw)
    one, two = setup.identify(bus, 1), setup.identify(bus, 2)
    assert one is not None
    assert two is not None
    assert (one.servo_id, one.firmware, one.status) == (1, "0.20", 0)
    assert one.return_delay == pytest.approx(200e-6)
    assert two.return_delay == pytest.approx(500e-6), "no effect on this series"
    assert not one.acknowledges
    assert not bus.acknowledges(1)
    assert two.model is not None
    assert two.model_name == str(two.model) == str(device.wire[2].registers.get("model_major") + 256)
    assert bus._machine.servos.return_delays((1,)) == pytest.approx(200e-6)


@pytest.mark.parametrize(("firmware", "instruction"), [((3, 9), 3), ((3, 10), 11), ((4, 0), 11)])
def test_the_middle_is_set_as_the_firmware_knows_it(firmware: tuple[int, int], instruction: int) -> None:
    bus, device = make_bus((1,))
    device.wire[1].registers.put("firmware_minor", firmware[1])
    device.wire[1].registers.put("firmware_major", firmware[0])
    assert abs(setup.center(bus, 1) - 2048) <= 1
    packet = next(p for p in bus.link.written if p[4] in (3, 11))
    assert packet[4] == instruction
    if instruction == 3:
        assert packet[5:7] == bytes((40, 128))


@pytest.mark.parametrize(("off", "good"), [(8, True), (-8, True), (9, False), (-9, False)])
def test_a_middle_may_be_eight_counts_off(off: int, good: bool) -> None:
    bus, _ = make_bus((1,))
    plain = bus.read

    def read(servo_id: int, name: str) -> object:
        reading = plain(servo_id, name)
        return reading._replace(raw=2048 + off) if name == "present_position" else reading

    bus.read = read  # type: ignore[assignment,method-assign]
    if good:
        assert setup.center(bus, 1) == 2048 + off
    else:
        with pytest.raises(ServoError, match=f"reports position {2048 + off} after"):
            setup.center(bus, 1)


@pytest.mark.parametrize(("series", "high"), [(Series.SEVEN_BOT, 250), (Series.STS_SMS, 253)])
def test_ids_have_bounds(series: Series, high: int) -> None:
    bus, _ = make_bus((1,), (series,))
    for bad in (-1, high + 1):
        with pytest.raises(UsageError, match=f"id {bad} is outside 0..{high}"):
            setup.set_id(bus, 1, bad)
    with pytest.raises(UsageError, match="has that id already"):
        setup.set_id(bus, 1, 1)
    assert setup.set_id(bus, 1, high).servo_id == high
    assert setup.set_id(bus, high, 0).servo_id == 0


def test_a_setting_that_is_not_kept_is_reported_and_locked_again() -> None:
    bus, device = make_bus((1,))
    plain = device.wire[1].receive
    # It acknowledges and forgets.
    device.wire[1].receive = lambda packet, now: (
        make_status(1) if packet.instruction == 3 and packet.params[:1] == b"\x0d" else plain(packet, now)
    )
    before = device.wire[1].registers.get("max_temperature")
    assert STS.register("max_temperature").address == 13
    with pytest.raises(ServoError, match=f"servo 1 has {before} after max_temperature was set to 61"):
        setup.write_setting(bus, 1, "max_temperature", 61)
    assert bus.read(1, "lock").raw == 1
    device.wire.servos = []
    with pytest.raises(ServoError):
        setup.write_setting(bus, 1, "max_temperature", 61)


def test_a_rate_that_a_series_or_a_link_does_not_have() -> None:
    legacy, _ = make_bus((1,), (Series.SEVEN_BOT,))
    with pytest.raises(NotSupportedError, match="whose rate is fixed"):
        setup.set_baud(legacy, 1, 1_000_000)
    gone, device = make_bus((1,))
    plain = device.wire[1].receive
    # It is deaf from the moment its rate is written.
    deaf: list[bool] = []

    def receive(packet: ServoPacket, now: float) -> bytes | None:
        if packet.instruction == 3 and packet.params[:1] == b"\x06":
            deaf.append(True)
        return None if deaf else plain(packet, now)

    device.wire[1].receive = receive
    with pytest.raises(ServoError, match="answers neither at 1000000 nor at 115200 baud: switch its supply"):
        setup.set_baud(gone, 1, 115_200)
    written = [packet for packet in gone.link.written if packet[4:6] == b"\x03\x06"]
    assert written == [make_write(1, 6, b"\x04"), make_write(1, 6, b"\0")], "it is sent back blindly"
    assert gone.timing.baud == 1_000_000


def test_recovery_waits_as_long_as_it_may_and_stops_when_the_fault_is_gone() -> None:
    bus, device = make_bus((1,), faults=FaultPlan(["hot:1"]))
    bus.pause(0.5)
    for patience, pings in ((0.5, 5), (0.04, 1), (1.0, 10)):
        before, start = len(bus.link.written), bus.now()
        assert setup.recover(bus, 1, patience=patience) == ("temperature",)
        sent = bus.link.written[before:]
        assert sum(packet[4] == 1 for packet in sent) == pings
        assert bus.now() - start == pytest.approx(0.1 * pings, abs=0.05)
    device.wire.faults = FaultPlan([])
    before = len(bus.link.written)
    plain = bus.ping
    left = [Answer(1, "ping", 4), Answer(1, "ping", 4)]
    bus.ping = lambda servo_id: left.pop() if left else plain(servo_id)._replace(status=0)  # type: ignore[method-assign]
    assert setup.recover(bus, 1) == ()
    assert left == []
