from __future__ import annotations

import pytest

from hexwire.emulator.board_state import BoardSettings, BoardState, JointSlot
from hexwire.wire import tables
from hexwire.wire.commands import AGE_NEVER, LimitRow, OffsetRow
from hexwire.wire.registers import Series


def test_flags_of_a_joint_keep_only_the_servos_own_error_bits() -> None:
    joint = JointSlot(4, Series.HLS, error=0xFF)
    assert joint.flags == 0x2F | tables.SERVO_FLAGS_SILENT
    joint.present = joint.torque_on = joint.clamped = True
    assert joint.flags == 0x2F | tables.SERVO_FLAGS_TORQUE_ON | tables.SERVO_FLAGS_CLAMPED


def test_age_is_whole_milliseconds_and_never_reaches_never() -> None:
    joint = JointSlot(4, Series.HLS)
    assert joint.age(5.0) == AGE_NEVER
    joint.sampled_at = 1.0
    assert joint.age(1.5) == 500
    assert joint.age(1e6) == AGE_NEVER - 1


def test_defaults_until_both_tables_are_stored() -> None:
    settings = BoardSettings()
    state = BoardState(1, 0.0, settings)
    assert state.board_flags == tables.BOARD_FLAGS_SETTINGS_DEFAULT
    settings.limits = [LimitRow(1, 2, 3)] * 7
    assert state.board_flags == tables.BOARD_FLAGS_SETTINGS_DEFAULT
    settings.offsets = [OffsetRow(1, 1)] * 7
    assert state.board_flags == 0
    assert BoardState(2, 0.0, settings).limits == settings.limits


@pytest.mark.parametrize(
    ("name", "bit"),
    [
        ("stopped", tables.BOARD_FLAGS_STOPPED),
        ("watchdog_tripped", tables.BOARD_FLAGS_WATCHDOG_TRIPPED),
        ("torque_off_stop", tables.BOARD_FLAGS_TORQUE_OFF_STOP),
        ("under_voltage_reset", tables.BOARD_FLAGS_UNDER_VOLTAGE_RESET),
    ],
)
def test_board_flags(name: str, bit: int) -> None:
    state = BoardState(1, 0.0, BoardSettings([], []))
    setattr(state, name, True)
    assert state.board_flags == bit


def test_the_clock_counts_microseconds_since_the_start_and_wraps() -> None:
    state = BoardState(1, 100.0, BoardSettings())
    assert state.clock_us(101.5) == 1_500_000
    assert state.clock_us(100.0 + 4294.967296 + 0.25) == pytest.approx(250_000, abs=1)


def test_a_watchdog_that_tripped_is_not_fed() -> None:
    state = BoardState(1, 0.0, BoardSettings())
    state.feed_watchdog(1.0)
    assert state.watchdog_due is None
    state.watchdog_timeout = 0.5
    state.feed_watchdog(1.0)
    assert state.watchdog_due == 1.5
    state.watchdog_due, state.watchdog_tripped = None, True
    state.feed_watchdog(2.0)
    assert state.watchdog_due is None


def test_stores_are_limited_and_come_back_one_a_minute() -> None:
    state = BoardState(1, 0.0, BoardSettings())
    every = tables.SETTINGS_STORE_EVERY
    assert [state.may_store(1000.0) for _ in range(tables.SETTINGS_STORES + 1)] == [
        True
    ] * tables.SETTINGS_STORES + [False]
    assert not state.may_store(1000.0 + every - 0.1)
    assert [state.may_store(1000.0 + every) for _ in range(2)] == [True, False]
    assert [state.may_store(1000.0 + 3.5 * every) for _ in range(3)] == [True, True, False]
    assert state.may_store(1000.0 + 4.0 * every), "no time is lost in between"
    assert sum(state.may_store(1e6) for _ in range(100)) == tables.SETTINGS_STORES
