from __future__ import annotations

import math

import pytest

from hexwire.bus.values import Answer, Reading, Readings, ServoBlock, fault_text, fault_words, why
from hexwire.errors import ServoError, UsageError
from hexwire.wire.registers import Series

STS = Series.STS_SMS
POSITION = STS.register("present_position")


def test_faults_have_names_and_advice() -> None:
    assert fault_words(0x2F) == ("voltage", "encoder", "temperature", "current", "overload")
    assert fault_words(0x41) == ("voltage", "bits 0x40")
    assert fault_words(0) == ()
    assert "servo 3 reports overload at present_load" in fault_text(3, 32, "present_load")
    assert "recover" in fault_text(3, 32, "present_load")
    assert "supply" in fault_text(3, 1, "ping")


def test_an_answer_raises_only_when_asked() -> None:
    assert Answer(1, "ping").check().ok
    silent = Answer(1, "ping", 0, "no answer", False)
    assert not silent.ok
    with pytest.raises(ServoError, match="servo 1: no answer to ping") as caught:
        silent.check()
    assert caught.value.servo_id == 1
    with pytest.raises(ServoError, match="overload"):
        Answer(2, "a write of acceleration", 32).check()


def test_readings_make_values_on_demand() -> None:
    readings = Readings(POSITION, (4, 5), (2048, None), 10.0, {4: 1}, {5: (1000, 7.5)})
    assert readings.values[0] == pytest.approx(math.pi)
    assert math.isnan(readings.values[1])
    assert readings.missing == (5,)
    assert not readings.ok
    assert len(readings) == 2
    assert readings[4].faults == ("voltage",)
    late = readings[5]
    assert (late.raw, late.last, late.age, late.error) == (None, 1000, 2.5, "no answer")
    with pytest.raises(UsageError, match="no reading of servo 6"):
        readings[6]
    with pytest.raises(ServoError, match="voltage"):
        readings.check()
    assert "2048" in repr(readings)
    assert Readings(POSITION, (4,), (1,), 0.0).check().ok


def test_reading() -> None:
    assert Reading(1, POSITION, 1024).check().value == pytest.approx(math.pi / 2)
    assert Reading(1, POSITION, 1024, 8).faults == ("current",)


def test_blocks_decode_what_they_hold() -> None:
    block = ServoBlock(1, 56, bytes((0, 8, 50, 128)))
    assert block.raw(POSITION) == 2048
    assert block.raw(STS.register("present_speed")) == -50
    assert block.raw(STS.register("present_load")) is None
    assert block.raw(STS.register("goal_position")) is None
    assert math.isnan(block.value(STS.register("goal_position")))
    with pytest.raises(ServoError, match="registers from 56"):
        ServoBlock(1, 56, b"", 0, "no answer").check()


def test_reasons() -> None:
    assert why("") == "no answer"
    assert why("only the echo") == "no answer, but only the echo"


def test_single_readings_are_joined_with_their_ages_and_errors() -> None:
    rows = [
        Reading(4, POSITION, 5, 0, 0.0, "", 5),
        Reading(2, POSITION, None, 0, 1.5, "no answer", 7),
        Reading(9, POSITION, None, 0, math.inf, "no answer, but noise"),
    ]
    joined = Readings.joined(rows, 100.0)
    assert joined.ids == (4, 2, 9)
    assert list(joined) == rows
    assert joined.missing == (2, 9)
    assert joined.stamp == 100.0


def test_a_reading_is_well_only_with_a_value_and_without_a_fault() -> None:
    assert Reading(1, POSITION, 5).ok
    assert not Reading(1, POSITION, 5, 1).ok
    assert not Reading(1, POSITION, None, 0, 0.0, "no answer").ok
    with pytest.raises(ServoError, match="servo 1: no answer to present_position") as caught:
        Reading(1, POSITION, None, 4, 0.0, "no answer").check()
    assert (caught.value.servo_id, caught.value.status) == (1, 4)
    with pytest.raises(ServoError, match="servo 1 reports current at present_position") as caught:
        Reading(1, POSITION, 5, 8).check()
    assert (caught.value.servo_id, caught.value.status) == (1, 8)
    assert math.isnan(Reading(1, POSITION, None).value)


def test_readings_of_a_servo_that_never_answered() -> None:
    readings = Readings(POSITION, (4, 5), (None, 7), 10.0)
    assert list(readings) == [
        Reading(4, POSITION, None, 0, math.inf, "no answer", None),
        Reading(5, POSITION, 7, 0, 0.0, "", 7),
    ]
    assert not readings.ok
    assert not Readings(POSITION, (4,), (7,), 10.0, {4: 1}).ok
    assert Readings(POSITION, (4,), (7,), 10.0, {}).ok
    troubled = Readings(POSITION, (4,), (None,), 10.0, {4: 32}, {}, {4: "no answer, but noise"})
    assert troubled[4] == Reading(4, POSITION, None, 32, math.inf, "no answer, but noise", None)


def test_joined_readings_keep_status_and_register_of_each() -> None:
    other = Series.SCS.register("present_position")
    rows = [Reading(4, POSITION, 5, 32, 0.0, "", 5), Reading(2, other, 6, 0, 0.0, "", 6)]
    joined = Readings.joined(rows, 100.0)
    assert list(joined) == rows
    assert joined[2].register is other
    assert not joined.ok


def test_a_block_holds_only_whole_registers() -> None:
    load, speed = STS.register("present_load"), STS.register("present_speed")
    assert ServoBlock(1, 56, bytes(4)).raw(speed) == 0
    assert ServoBlock(1, 56, bytes(3)).raw(speed) is None
    assert ServoBlock(1, 57, bytes(9)).raw(POSITION) is None
    assert ServoBlock(1, 56, bytes((0, 8))).value(POSITION) == pytest.approx(math.pi)
    assert ServoBlock(1, 58, bytes(2)).raw(load) is None
    with pytest.raises(ServoError, match="overload"):
        ServoBlock(1, 56, b"ab", 32).check()
    block = ServoBlock(1, 56, b"ab")
    assert block.check() is block


def test_advice_is_that_of_the_gravest_fault() -> None:
    assert fault_text(1, 0x21, "x").endswith("(free the joint, then `hexwire bus recover`)")
    assert fault_text(1, 0x05, "x").endswith("(too hot: let it cool down)")
    assert fault_text(1, 0x40, "x") == "servo 1 reports bits 0x40 at x (read its register status)"
