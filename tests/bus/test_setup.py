from __future__ import annotations

import pytest
from tests.bus.bus_bench import make_bus

from hexwire.bus import setup as setup
from hexwire.emulator.faults import FaultPlan
from hexwire.errors import NotSupportedError, ServoError, UsageError
from hexwire.wire.registers import Series

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
    with pytest.raises(UsageError, match="not 9600"):
        setup.set_baud(bus, 1, 9600)


def test_set_baud_comes_back_where_the_line_does_not_carry_it() -> None:
    bus, device = make_bus((1,))
    plain = bus._line.exchange
    bus._line.exchange = lambda data, window, rest=None: (
        b"" if bus.timing.baud == 500_000 else plain(data, window, rest)
    )
    with pytest.raises(ServoError, match="does not work at 500000 baud; it is at 1000000 as before"):
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
