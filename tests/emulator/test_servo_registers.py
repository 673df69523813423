from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexwire.emulator.servo_registers import RegisterFile
from hexwire.wire.registers import Series


@pytest.mark.parametrize("series", list(Series))
def test_factory_settings(series: Series) -> None:
    registers = RegisterFile(series, 7)
    assert registers.get("id") == registers.stored("id") == 7
    for row in series.registers.values():
        if row.default is not None and row.name not in ("id", "firmware_major"):
            assert registers.get(row.name) == row.default
        if row.access == "rw" and row.minimum is not None and row.maximum is not None:
            assert row.minimum <= registers.get(row.name) <= row.maximum


def test_versions_and_models() -> None:
    words = {}
    for series in (Series.SCS, Series.STS_SMS, Series.HLS):
        registers = RegisterFile(series, 1)
        version = (registers.get("firmware_major"), registers.get("firmware_minor"))
        assert Series.from_firmware(*version, series.byte_order) is series
        words[series] = int.from_bytes(registers.read(3, 2), "little")
    assert words == {Series.SCS: 1284, Series.STS_SMS: 777, Series.HLS: 2570}
    assert RegisterFile(Series.HLS, 1, firmware=(3, 42)).get("firmware_minor") == 42


def test_power_up_copies_of_hls() -> None:
    registers = RegisterFile(
        Series.HLS, 1, settings={"max_torque": 700, "protection_current": 123, "position_p": 9}
    )
    copies = {name: registers.get(name) for name in ("torque_limit", "goal_torque", "kp", "kd", "ki")}
    assert copies == {"torque_limit": 700, "goal_torque": 123, "kp": 9, "kd": 32, "ki": 0}


def test_locked_writes_take_effect_but_do_not_survive() -> None:
    registers = RegisterFile(Series.STS_SMS, 1)
    assert registers.write(13, b"\x32") == {"max_temperature"}
    assert (registers.get("max_temperature"), registers.stored("max_temperature")) == (50, 70)
    registers.power_up()
    assert registers.get("max_temperature") == 70
    registers.write(55, b"\x00")
    registers.write(13, b"\x32")
    registers.power_up()
    assert registers.get("max_temperature") == 50
    assert registers.get("lock") == 1


def test_backup_stores_what_the_lock_kept_out() -> None:
    registers = RegisterFile(Series.STS_SMS, 1)
    registers.write(13, b"\x32")
    registers.backup()
    registers.power_up()
    assert registers.get("max_temperature") == 50


def test_legacy_servos_have_no_lock() -> None:
    registers = RegisterFile(Series.SEVEN_BOT, 1)
    registers.write(5, b"\x09")
    registers.power_up()
    assert registers.get("id") == 9


def test_read_only_and_empty_addresses_swallow_writes() -> None:
    registers = RegisterFile(Series.HLS, 1)
    before = registers.read(0, 256)
    assert registers.write(56, b"\x11\x22") == set()
    assert registers.write(0, b"\x11\x22\x33\x44\x55") == set()
    assert registers.write(70, b"\x11" * 300) == set()
    assert registers.read(0, 256) == before
    assert registers.read(200, 2) == b"\x00\x00"


def test_values_out_of_range() -> None:
    registers = RegisterFile(Series.HLS, 1)
    assert registers.write(16, (5000).to_bytes(2, "little")) == {"max_torque"}  # has a unit: clamped
    assert registers.get("max_torque") == 1000
    assert registers.write(33, b"\x09") == set()  # a bare number: ignored
    assert registers.get("mode") == 0
    assert registers.write(5, b"\xfe") == set()
    assert registers.get("id") == 1


def test_half_a_register_keeps_the_other_half() -> None:
    registers = RegisterFile(Series.HLS, 1)
    registers.write(42, b"\x34\x02")
    registers.write(43, b"\x01")
    assert registers.get("goal_position") == 0x0134


def test_put_clips_to_the_coding() -> None:
    registers = RegisterFile(Series.HLS, 1)
    registers.put("present_position", 99_999)
    assert registers.get("present_position") == 32767
    registers.put("present_temperature", -3)
    assert registers.get("present_temperature") == 0


@given(st.sampled_from(list(Series)), st.integers(0, 255), st.binary(max_size=300))
def test_any_write_leaves_every_register_in_range(series: Series, address: int, data: bytes) -> None:
    registers = RegisterFile(series, 1)
    touched = registers.write(address, data)
    for row in series.registers.values():
        value = registers.get(row.name)
        if row.access == "rw":
            assert row.minimum is None or value >= row.minimum or value == 0
            assert row.maximum is None or value <= row.maximum
        else:
            assert row.name not in touched
    assert len(registers.read(0, 256)) == 256
