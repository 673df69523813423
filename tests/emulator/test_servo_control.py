from __future__ import annotations

import math

import pytest

from hexwire.emulator import servo_control as control
from hexwire.emulator.servo_motion import MotorDrive
from hexwire.emulator.servo_protection import NO_LIMITS
from hexwire.emulator.servo_registers import RegisterFile
from hexwire.wire.registers import Series


def order(registers: RegisterFile, distance: float = 1000.0, volts: float | None = None) -> control.MotionOrder:
    series = registers.series
    return control.order_for(
        registers, control.MECHANICS[series], control.SUPPLY[series] if volts is None else volts, distance, 1234.0
    )


def made(series: Series, **values: int) -> RegisterFile:
    registers = RegisterFile(series, 1)
    for name, value in values.items():
        registers.put(name, value)
    return registers


def test_hls_units() -> None:
    given = order(made(Series.HLS, goal_speed=60, acceleration=50, goal_torque=100))
    assert given.drive is MotorDrive.POSITION
    assert (given.speed, given.acceleration, given.target) == (3000.0, 5000.0, 1234.0)
    assert given.ceiling == pytest.approx(0.65 / 1.3)


def test_hls_zero_torque_and_zero_speed() -> None:
    assert order(made(Series.HLS, goal_torque=0)).ceiling == 0.0
    assert order(made(Series.HLS, goal_speed=0)).speed == 0.0


def test_torque_limit_holds_for_torque_and_speed() -> None:
    given = order(made(Series.HLS, torque_limit=500, goal_torque=2047, goal_speed=1000))
    assert given.ceiling == 0.5
    assert given.speed == pytest.approx(7578 / 2)


def test_sts_goal_speed_zero_depends_on_the_phase_register() -> None:
    fastest = control.MECHANICS[Series.STS_SMS].max_speed
    assert order(made(Series.STS_SMS, goal_speed=0)).speed == fastest
    assert order(made(Series.STS_SMS, goal_speed=0, phase=0)).speed == 0.0
    assert order(made(Series.STS_SMS, goal_speed=20)).speed == 1000.0
    assert order(made(Series.STS_SMS, goal_speed=1000, phase=12)).speed == 1000.0


def test_legacy_and_scs_run_time() -> None:
    for series, name in ((Series.SEVEN_BOT, "run_time"), (Series.SCS, "goal_time")):
        mechanics = control.MECHANICS[series]
        speed = order(made(series, **{name: 2000})).speed
        assert 1000 / speed + speed / mechanics.max_acceleration == pytest.approx(2.0)
        assert order(made(series, **{name: 0})).speed == mechanics.max_speed
    assert order(made(Series.SCS, goal_speed=300)).speed == 300


def test_top_speed_goes_with_the_supply() -> None:
    assert order(made(Series.SEVEN_BOT), volts=3.75).speed == pytest.approx(4200 / 2)


@pytest.mark.parametrize(
    ("series", "values", "mode", "drive", "speed"),
    [
        (Series.HLS, {"mode": 1, "goal_speed": -20}, "speed", MotorDrive.SPEED, -1000.0),
        (Series.HLS, {"mode": 3, "goal_torque": -500, "torque_limit": 1000}, "pwm", MotorDrive.SPEED, -7578 / 2),
        (Series.STS_SMS, {"mode": 1, "goal_speed": 0}, "speed", MotorDrive.SPEED, 0.0),
        (Series.STS_SMS, {"mode": 2, "goal_pwm_or_time": 250}, "pwm", MotorDrive.SPEED, 3400 / 4),
        (Series.STS_SMS, {"mode": 3}, "step", MotorDrive.POSITION, 3400.0),
        (Series.SCS, {"max_position_limit": 0, "goal_time": 0x400 | 500}, "pwm", MotorDrive.SPEED, -2050 / 2),
    ],
)
def test_modes(series: Series, values: dict[str, int], mode: str, drive: MotorDrive, speed: float) -> None:
    registers = made(series, **values)
    assert control.drive_mode(registers) == mode
    given = order(registers)
    assert given.drive is drive
    assert given.speed == pytest.approx(speed)


def test_hls_current_mode_pushes_with_the_goal_torque() -> None:
    given = order(made(Series.HLS, mode=2, goal_torque=-100))
    assert given.drive is MotorDrive.TORQUE
    assert given.target == pytest.approx(-0.5)


def test_goals_are_clamped_to_the_position_limits() -> None:
    registers = made(Series.HLS, min_position_limit=1000, max_position_limit=3000)
    assert [control.clamp_goal(registers, goal) for goal in (-5, 2000, 4000)] == [1000, 2000, 3000]
    assert control.clamp_goal(made(Series.SEVEN_BOT, min_angle_limit=100), 5) == 100
    endless = made(Series.HLS, min_position_limit=0, max_position_limit=0)
    assert control.is_multi_turn(endless)
    assert control.clamp_goal(endless, -9000) == -9000
    assert not control.is_multi_turn(made(Series.SCS, max_position_limit=0))


def test_limits() -> None:
    assert control.limits_of(made(Series.SEVEN_BOT)) is NO_LIMITS
    sts = control.limits_of(made(Series.STS_SMS, overload_torque=60, overload_time=50, holding_torque=10))
    assert (sts.overload_torque, sts.overload_ticks, sts.held_torque) == (0.6, 500, 0.1)
    assert sts.voltage == (4.0, 8.0)
    assert sts.current == pytest.approx(511 * 0.0065)
    scs = control.limits_of(made(Series.SCS))
    assert (scs.overload_torque, scs.overload_ticks, scs.held_torque) == (0.8, 800, 0.4)
    hls = control.limits_of(made(Series.HLS, overcurrent_time=10))
    assert (hls.overload_ticks, hls.current_ticks, hls.temperature) == (100, 100, 70)
    assert math.isclose(hls.current, 3.25)
