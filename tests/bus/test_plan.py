from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexwire.bus.plan import ReadPlan, SyncReadPlan, SyncWritePlan, WritePlan
from hexwire.errors import UsageError
from hexwire.wire.registers import Series
from hexwire.wire.servo_packet import make_status, make_sync_write, parse_packet

STS = Series.STS_SMS
POSITION = STS.register("present_position")
GOAL = STS.register("goal_position")
words = st.integers(0, 0x7FFF)


@given(st.lists(st.tuples(st.integers(0, 253), words), min_size=1, max_size=30, unique_by=lambda row: row[0]))
def test_sound_answers_are_known_at_a_glance(rows: list[tuple[int, int]]) -> None:
    plan = SyncReadPlan(STS, [i for i, _ in rows], 56, 2, POSITION)
    data = b"".join(make_status(i, 0, value.to_bytes(2, "little")) for i, value in rows)
    assert plan.glance(data) == tuple(value for _, value in rows)
    assert plan.blocks(data) == [value.to_bytes(2, "little") for _, value in rows]
    assert plan.rest(data) == 0.0
    assert plan.length == len(data)


@given(st.lists(words, min_size=7, max_size=7), st.data())
def test_no_change_of_a_byte_goes_unnoticed(values: list[int], data: st.DataObject) -> None:
    plan = SyncReadPlan(STS, range(1, 8), 56, 2, POSITION)
    stream = bytearray(b"".join(make_status(i, 0, v.to_bytes(2, "little")) for i, v in enumerate(values, 1)))
    at = data.draw(st.integers(0, len(stream) - 1))
    stream[at] ^= data.draw(st.integers(1, 255))
    assert plan.glance(bytes(stream)) is None
    assert plan.blocks(bytes(stream)) is None


@given(st.lists(words, min_size=7, max_size=7), st.data())
def test_two_damaged_packets_cannot_make_up_for_each_other(values: list[int], data: st.DataObject) -> None:
    plan = SyncReadPlan(STS, range(1, 8), 56, 2, POSITION)
    stream = bytearray(b"".join(make_status(i, 0, v.to_bytes(2, "little")) for i, v in enumerate(values, 1)))
    one, other = data.draw(st.lists(st.integers(0, 6), min_size=2, max_size=2, unique=True))
    stream[8 * one + 5] = (stream[8 * one + 5] + 1) & 0xFF
    stream[8 * other + 5] = (stream[8 * other + 5] - 1) & 0xFF
    assert plan.glance(bytes(stream)) is None


@given(st.binary(min_size=8, max_size=8))
def test_a_glance_never_takes_what_the_parser_would_not(noise: bytes) -> None:
    plan = SyncReadPlan(STS, (1,), 56, 2, POSITION)
    raw = plan.glance(noise)
    assert raw is None or noise == make_status(1, 0, raw[0].to_bytes(2, "little"))
    one = ReadPlan(1, STS, 56, 2, POSITION)
    value = one.value(noise)
    assert value is None or noise == make_status(1, 0, POSITION.encode(value))


@given(st.integers(-32767, 32767), st.sampled_from([STS, Series.SCS]))
def test_values_are_those_of_the_register(raw: int, series: Series) -> None:
    register = series.register("goal_position")
    plan = ReadPlan(1, series, register.address, 2, register)
    if raw in register.fits:
        assert plan.value(make_status(1, 0, register.encode(raw))) == raw
    assert plan.value(make_status(1, 1, b"\0\0")) is None
    assert plan.value(plan.request) is None


def test_errors_and_negative_values_take_the_careful_path() -> None:
    plan = SyncReadPlan(STS, (1,), 56, 2, POSITION)
    assert plan.glance(make_status(1, 32, b"\x01\x02")) is None
    assert plan.blocks(make_status(1, 32, b"\x01\x02")) is None
    assert plan.glance(make_status(1, 0, b"\x01\x80")) is None
    assert plan.blocks(make_status(1, 0, b"\x01\x80")) == [b"\x01\x80"]
    load = SyncReadPlan(STS, (1,), 60, 2, STS.register("present_load"))
    assert load.glance(make_status(1, 0, b"\x01\x04")) is None


def test_big_endian_values() -> None:
    plan = SyncReadPlan(Series.SCS, (1, 2), 56, 2, Series.SCS.register("present_position"))
    assert plan.glance(make_status(1, 0, b"\x02\x01") + make_status(2, 0, b"\x00\x05")) == (513, 5)


def test_blocks_of_any_length() -> None:
    plan = SyncReadPlan(STS, (1, 2), 56, 15)
    rows = [bytes(range(15)), bytes(range(15, 30))]
    data = make_status(1, 0, rows[0]) + make_status(2, 0, rows[1])
    assert plan.glance(data) is None
    assert plan.blocks(data) == rows


def test_what_is_missing_is_waited_for_until_the_last_servo_has_answered() -> None:
    plan = SyncReadPlan(STS, (1, 2, 3), 56, 2, POSITION)
    plan.base, plan.allowance = 0.0024, 0.001
    one, two, three = (make_status(i, 0, b"\x01\x02") for i in (1, 2, 3))
    assert plan.rest(one) == pytest.approx(0.0026)
    assert plan.rest(one + two[:4]) == pytest.approx(0.0022)
    assert plan.rest(one + three[:-1]) == pytest.approx(0.0019)
    assert plan.rest(one + three) == 0.0
    assert plan.rest(one + two + three) == 0.0
    assert ReadPlan(1, STS, 56, 2, POSITION).rest is None


def test_the_echo_of_a_read_is_no_answer() -> None:
    plan = ReadPlan(1, STS, 56, 2, POSITION)
    assert plan.value(plan.request) is None
    assert plan.value(make_status(1, 0, b"\x07\x08")) == 0x0807
    legacy = ReadPlan(1, Series.SEVEN_BOT, 40, 2, Series.SEVEN_BOT.register("torque_enable"))
    assert legacy.value(make_status(1, 0, b"\x07\x08", legacy=True)) == 7
    assert legacy.value(make_status(1, 0, b"\x07\x08")) is None


def test_acknowledgement() -> None:
    plan = WritePlan(5, STS, 40, b"\x01")
    assert plan.acknowledgement == make_status(5)
    assert WritePlan(5, Series.SEVEN_BOT, 40, b"\x01").acknowledgement == make_status(5, legacy=True)


@given(st.dictionaries(st.integers(0, 253), st.integers(-32767, 32767), min_size=1, max_size=40))
def test_sync_writes_are_those_of_the_codec(values: dict[int, int]) -> None:
    plan = SyncWritePlan(GOAL, tuple(values))
    packet = plan.serialize(tuple(values.values()))
    assert packet == make_sync_write(42, {i: GOAL.encode(value) for i, value in values.items()})
    assert parse_packet(packet).servo_id == 0xFE
    big = SyncWritePlan(Series.SCS.register("goal_position"), (1, 2))
    assert big.serialize((1, 1023)) == make_sync_write(42, {1: b"\0\x01", 2: b"\x03\xff"})


def test_a_value_that_does_not_fit_is_refused() -> None:
    with pytest.raises(UsageError, match=r"goal_position of servo 2 takes -32767..32767, not 40000"):
        SyncWritePlan(GOAL, (1, 2)).serialize((0, 40000))
    with pytest.raises(UsageError, match="has 1 byte"):
        SyncWritePlan(STS.register("torque_enable"), (1,))


@given(st.lists(words, min_size=3, max_size=3))
def test_the_last_servos_answer_ends_the_wait_if_it_is_sound(values: list[int]) -> None:
    plan = SyncReadPlan(STS, (1, 2, 3), 56, 2, POSITION)
    plan.base, plan.allowance = 0.0024, 0.001
    one, two, three = (make_status(i, 0, v.to_bytes(2, "little")) for i, v in enumerate(values, 1))
    assert plan.rest(one + three) == 0.0
    assert plan.rest(three) == 0.0
    damaged = three[:-1] + bytes((three[-1] ^ 1,))
    assert plan.rest(one + damaged) == pytest.approx(0.0024 * 8 / 24 + 0.001)
    assert plan.rest(one + two) == pytest.approx(0.0018)
    assert plan.rest(b"") == pytest.approx(0.0034)
    assert plan.rest(one + two + three + b"x") == 0.0


def test_lengths_and_totals() -> None:
    sync = SyncReadPlan(STS, (1, 2, 3), 56, 4)
    assert (sync.size, sync.length, sync.total) == (10, 30, 30 + len(sync.request))
    assert (sync.base, sync.allowance) == (0.0, 0.0)
    one = ReadPlan(1, STS, 56, 2, POSITION)
    assert (one.ids, one.length, one.total) == ((1,), 8, 16)
    assert (one.base, one.allowance, one.latest, one.stamp) == (0.0, 0.0, None, 0.0)
    write = WritePlan(1, STS, 41, b"\x05")
    assert (write.data, write.length, write.total, write.base) == (b"\x05", 6, len(write.request) + 6, 0.0)
    order = WritePlan(1, STS, 41, b"\x05", make_status(1))
    assert (order.data, order.request, order.total) == (b"", make_status(1), 12)


@given(st.binary(max_size=20))
def test_blocks_are_taken_only_in_their_exact_length(noise: bytes) -> None:
    plan = SyncReadPlan(STS, (1, 2), 56, 3)
    data = make_status(1, 0, b"abc") + make_status(2, 0, b"def")
    assert plan.blocks(data) == [b"abc", b"def"]
    for other in (data[:-1], data + noise + b"x", noise):
        assert plan.blocks(other) is None
        assert SyncReadPlan(STS, (1, 2), 56, 2, POSITION).glance(other) is None


@pytest.mark.parametrize("series", [STS, Series.SCS])
def test_a_sync_write_takes_its_registers_whole_range_and_no_more(series: Series) -> None:
    register = series.register("goal_position")
    plan = SyncWritePlan(register, (4, 9))
    assert (plan.least, plan.most) == (
        register.fits[0] if register.minimum is None else register.minimum,
        register.fits[-1] if register.maximum is None else register.maximum,
    )
    pair = (plan.least, plan.most)
    assert plan.serialize(pair) == make_sync_write(
        register.address, {i: register.encode(v) for i, v in zip((4, 9), pair, strict=True)}
    )
    for bad, servo_id in (((plan.least - 1, 0), 4), ((0, plan.most + 1), 9)):
        with pytest.raises(UsageError, match=f"of servo {servo_id} takes {plan.least}..{plan.most}, not"):
            plan.serialize(bad)


def test_a_register_of_one_byte_has_no_fast_path() -> None:
    plan = SyncReadPlan(STS, (1, 2), 63, 1, STS.register("present_temperature"))
    data = make_status(1, 0, b"\x20") + make_status(2, 0, b"\x21")
    assert plan.glance(data) is None
    assert plan.blocks(data) == [b"\x20", b"\x21"]
    one = ReadPlan(1, STS, 63, 1, STS.register("present_temperature"))
    assert one.value(make_status(1, 0, b"\xff")) == 255
    assert one.value(make_status(1, 0, b"\xff\0")) is None
