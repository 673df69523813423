from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexwire.errors import RemoteProtocolError, UsageError
from hexwire.wire import registers as registers_module
from hexwire.wire.registers import Register, Series
from hexwire.wire.tables import REGISTER_BITS, REGISTER_NOTES, REGISTERS, SERIES

EVERY = [(series, register) for series in Series for register in series.registers.values()]
registers = st.sampled_from([register for _, register in EVERY])


@given(registers, st.data())
def test_raw_values_there_and_back(register: Register, data: st.DataObject) -> None:
    value = data.draw(st.integers(register.fits[0], register.fits[-1]))
    coded = register.encode(value)
    assert len(coded) == register.size
    assert register.decode(coded) == value


@given(registers, st.binary(min_size=1, max_size=2))
def test_any_bytes_decode_within_the_coding(register: Register, data: bytes) -> None:
    if len(data) != register.size:
        with pytest.raises(RemoteProtocolError, match=register.name):
            register.decode(data)
    else:
        assert register.decode(data) in register.fits


@given(registers, st.data())
def test_si_there_and_back(register: Register, data: st.DataObject) -> None:
    value = data.draw(st.integers(register.fits[0], register.fits[-1]))
    assert register.from_si(register.to_si(value)) == value


def test_rows_are_sound() -> None:
    for series, register in EVERY:
        row = f"{series.name} {register.name}"
        assert register.byte_order == series.byte_order, row
        assert series.at(register.address) is register, row
        assert (register.unit is None) == (register.scale is None), row
        assert (register.si_unit == "") == (register.unit is None), row
        for limit in (register.minimum, register.maximum, register.default):
            assert limit is None or limit in register.fits, row


STEPS = {
    None: ("", 1.0),
    "ms": ("s", 1e-3),
    "us": ("s", 1e-6),
    "mA": ("A", 1e-3),
    "V": ("V", 1.0),
    "degC": ("degC", 1.0),
    "count": ("rad", math.pi / 180),
    "percent": ("fraction", 0.01),
}
"""SI unit, and how many of it a unit of the table is."""


def test_a_register_is_its_row_of_the_table() -> None:
    for series in Series:
        turn = math.radians(series.range_deg) / series.counts_per_rev
        for row in REGISTERS[series.value]:
            made = registers_module._make(series.value, row)
            assert made == series.register(row.name), "as it is kept"
            for name in [
                "name",
                "address",
                "size",
                "sign_bit",
                "unit",
                "scale",
                "access",
                "area",
                "minimum",
                "maximum",
                "default",
            ]:
                assert getattr(made, name) == getattr(row, name), f"{series.name} {row.name}: {name}"
            assert made.byte_order == SERIES[series.value].byte_order
            assert made.bits == REGISTER_BITS[series.value].get(row.name, {})
            assert made.note == REGISTER_NOTES[series.value].get(row.name, "")
            of_counts = {"count/s": ("rad/s", turn), "count/s^2": ("rad/s^2", turn)}
            unit = "percent" if (row.unit or "").startswith("percent") else row.unit
            si_unit, step = (STEPS | of_counts)[unit]
            assert made.si_unit == si_unit
            assert made.si_factor == pytest.approx(step * (1.0 if row.scale is None else row.scale), rel=1e-12)


def test_no_bits_or_notes_without_a_register() -> None:
    for table in (REGISTER_BITS, REGISTER_NOTES):
        for series, rows in table.items():
            assert set(rows) <= set(Series(series).registers)


def test_byte_orders() -> None:
    assert Series.SEVEN_BOT.register("present_position").encode(2053) == b"\x08\x05"
    assert Series.HLS.register("present_position").encode(2053) == b"\x05\x08"


def test_sign_magnitude() -> None:
    goal = Series.HLS.register("goal_position")
    assert goal.encode(-100) == b"\x64\x80"
    assert goal.decode(b"\x64\x80") == -100
    load = Series.HLS.register("present_load")
    assert load.decode(b"\x34\x04") == -52
    assert load.decode(b"\x00\x04") == 0


@pytest.mark.parametrize(
    ("series", "name", "raw", "value", "unit"),
    [
        (Series.HLS, "present_load", 52, 0.052, "fraction"),
        (Series.HLS, "present_position", 1024, math.pi / 2, "rad"),
        (Series.SCS, "present_position", 1024, math.radians(300), "rad"),
        (Series.HLS, "present_speed", 1, math.radians(50 * 360 / 4096), "rad/s"),
        (Series.HLS, "acceleration", 1, math.radians(100 * 360 / 4096), "rad/s^2"),
        (Series.HLS, "goal_torque", 300, 1.95, "A"),
        (Series.HLS, "present_voltage", 60, 6.0, "V"),
        (Series.HLS, "present_temperature", 31, 31.0, "degC"),
        (Series.HLS, "overcurrent_time", 200, 2.0, "s"),
        (Series.SEVEN_BOT, "run_time", 1720, 1.72, "s"),
        (Series.SCS, "return_delay", 250, 0.0005, "s"),
        (Series.STS_SMS, "mode", 3, 3.0, ""),
    ],
)
def test_si_values(series: Series, name: str, raw: int, value: float, unit: str) -> None:
    register = series.register(name)
    assert register.si_unit == unit
    assert register.to_si(raw) == pytest.approx(value, rel=1e-12)
    assert register.from_si(value) == raw


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e9])
def test_values_that_do_not_fit_a_register_are_refused(value: float) -> None:
    with pytest.raises(UsageError, match="cannot hold"):
        Series.HLS.register("goal_position").from_si(value)


def test_a_value_that_does_not_fit_is_refused() -> None:
    for register, value in (("goal_position", 32768), ("goal_position", -32768), ("id", 256), ("id", -1)):
        with pytest.raises(UsageError, match=register):
            Series.HLS.register(register).encode(value)


def test_unknown_names_get_a_hint() -> None:
    with pytest.raises(UsageError, match="did you mean goal_position"):
        Series.HLS.register("goal_positon")
    with pytest.raises(UsageError, match=r"no register 'xyzzy'$"):
        Series.HLS.register("xyzzy")
    assert Series.HLS.at(43) is None


def test_the_run_time_of_one_series_is_the_current_ceiling_of_the_other() -> None:
    names = {series: series.at(44).name for series in Series if series.at(44)}  # type: ignore[union-attr]
    assert names == {
        Series.SEVEN_BOT: "run_time",
        Series.SCS: "goal_time",
        Series.STS_SMS: "goal_pwm_or_time",
        Series.HLS: "goal_torque",
    }


def test_series_facts() -> None:
    assert [series.code for series in Series] == [1, 2, 3, 4]
    assert [series.reply_header for series in Series] == [b"\xff\xf5", b"\xff\xff", b"\xff\xff", b"\xff\xff"]
    assert [series.neutral for series in Series] == [2047, 511, 2048, 2048]
    assert [series.sync_read for series in Series] == [False, False, True, True]
    assert Series.SEVEN_BOT.max_read == 2
    assert Series.HLS.baud_codes[4] == 115200
    assert [Series.HLS.baud_codes[code] for code in (5, 6, 7)] == [76800, 57600, 38400]
    assert not Series.SEVEN_BOT.baud_codes
    assert Series.SEVEN_BOT.baud == 115200
    assert "REBOOT" in Series.HLS.instructions
    assert "REBOOT" not in Series.SEVEN_BOT.instructions
    assert all(series.title and series.range_deg for series in Series)


@pytest.mark.parametrize(
    ("version", "series"),
    [
        ((0, 20), Series.SCS),
        ((1, 5), None),
        ((2, 50), Series.STS_SMS),
        ((3, 10), Series.STS_SMS),
        ((3, 30), Series.STS_SMS),
        ((3, 30, "big"), None),
        ((3, 45), Series.HLS),
        ((3, 60), None),
        ((9, 9), None),
    ],
)
def test_series_from_firmware(version: tuple[int, int] | tuple[int, int, str], series: Series | None) -> None:
    assert Series.from_firmware(*version) is series


@pytest.mark.parametrize(
    ("name", "series"),
    [
        ("sts", Series.STS_SMS),
        ("SMS", Series.STS_SMS),
        ("sts-sms", Series.STS_SMS),
        ("SMS_STS", Series.STS_SMS),
        ("SCSCL", Series.SCS),
        ("HLS", Series.HLS),
        ("7bot", Series.SEVEN_BOT),
        (" seven_bot ", Series.SEVEN_BOT),
    ],
)
def test_a_series_is_found_by_the_names_that_people_know(name: str, series: Series) -> None:
    assert Series(name) is series


@pytest.mark.parametrize("name", ["", "st", "servo", "sts_sms2", None, 3])
def test_other_names_are_no_series(name: object) -> None:
    with pytest.raises(ValueError, match="is not a valid Series"):
        Series(name)
