"""From registers to motion and back: the meaning of the same addresses in the four series.

Owns the units and meanings that differ (goal speed, run time, torque ceiling, offset, modes) as functions of a
register file. Knows nothing of packets or time.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import copysign, inf

from hexwire.wire.registers import Series

from .servo_motion import Mechanics, MotorDrive, speed_for_duration
from .servo_protection import NO_LIMITS, ProtectionLimits
from .servo_registers import RegisterFile

__all__ = [
    "AMPERES",
    "MECHANICS",
    "SUPPLY",
    "MotionOrder",
    "clamp_goal",
    "drive_mode",
    "goal_name",
    "is_multi_turn",
    "limits_of",
    "order_for",
    "speed_unit",
]

AMPERES = 0.0065
"""Amperes per unit of the current registers (vendor memory table)."""

SUPPLY = {Series.SEVEN_BOT: 7.5, Series.SCS: 8.4, Series.STS_SMS: 7.4, Series.HLS: 6.0}
"""Default supply of an emulated servo, volts; within the factory limits of its series."""

# No-load speeds: HLS3606 111 rpm at 6 V (data sheet); STS3215 about 50 rpm, SCS009 0.1 s/60 deg; legacy assumed.
MECHANICS = {
    Series.SEVEN_BOT: Mechanics(4200.0, stall_current=1.5, nominal_voltage=7.5, stops=(0.0, 4095.0)),
    Series.SCS: Mechanics(2050.0, 20_000.0, 30_000.0, stall_current=1.0, nominal_voltage=8.4, stops=(0.0, 1023.0)),
    Series.STS_SMS: Mechanics(3400.0, stall_current=2.4, nominal_voltage=7.4),
    Series.HLS: Mechanics(7578.0, stall_current=1.3, nominal_voltage=6.0),
}

_ACCELERATION_UNIT = 100.0  # counts/s^2
_SPEED_UNIT = 50.0  # counts/s
_TICKS_A_UNIT = 10  # protection times count 10 ms
# HLS has no registers for these; the values are the STS factory settings.
_HLS_OVERLOAD = 0.8
_HLS_HELD = 0.2


@dataclass(frozen=True, slots=True)
class MotionOrder:
    """Arguments of `Motion.command`, before protection reduces them."""

    drive: MotorDrive
    target: float
    speed: float
    acceleration: float
    ceiling: float


def goal_name(series: Series) -> str:
    """Name of the register at 0x2A."""
    return "target_position" if series is Series.SEVEN_BOT else "goal_position"


def is_multi_turn(registers: RegisterFile) -> bool:
    """Whether positions continue past one turn: both limits 0, on the magnetic-encoder series."""
    if registers.series not in (Series.STS_SMS, Series.HLS):
        return False
    return registers.get("min_position_limit") == registers.get("max_position_limit") == 0


def clamp_goal(registers: RegisterFile, goal: int) -> int:
    """A goal inside the position limits of the EEPROM."""
    kind = "angle" if registers.series is Series.SEVEN_BOT else "position"
    low, high = registers.get(f"min_{kind}_limit"), registers.get(f"max_{kind}_limit")
    if low == high == 0:
        return goal
    return max(low, min(high, goal))


def speed_unit(registers: RegisterFile) -> float:
    """Counts/s of one unit of goal_speed and present_speed."""
    if registers.series is Series.STS_SMS:
        return 1.0 if registers.get("phase") & 4 else _SPEED_UNIT
    return _SPEED_UNIT if registers.series is Series.HLS else 1.0


def drive_mode(registers: RegisterFile) -> str:
    """Operating mode by name: position, step, speed, pwm or current."""
    series = registers.series
    if series is Series.SCS:
        wheel = registers.get("min_position_limit") == registers.get("max_position_limit") == 0
        return "pwm" if wheel else "position"
    if series is Series.SEVEN_BOT:
        return "position"
    names = (
        ("position", "speed", "current", "pwm") if series is Series.HLS else ("position", "speed", "pwm", "step")
    )
    return names[registers.get("mode") & 3]


def order_for(
    registers: RegisterFile, mechanics: Mechanics, volts: float, distance: float, target: float
) -> MotionOrder:
    """What the motor should do when the torque is on.

    Args:
        registers: Live registers.
        mechanics: The servo's motor and gears.
        volts: Supply; the top speed is proportional to it.
        distance: Distance to the last goal when it was written, counts; converts a run time into a speed.
        target: The goal in counts of the shaft.
    """
    series = registers.series
    fastest = mechanics.max_speed * volts / mechanics.nominal_voltage
    acceleration = 0.0
    ceiling = 1.0
    if series in (Series.STS_SMS, Series.HLS):
        acceleration = registers.get("acceleration") * _ACCELERATION_UNIT
        ceiling = registers.get("torque_limit") / 1000
        fastest *= ceiling
    elif series is Series.SCS:
        ceiling = registers.get("max_torque") / 1000
    mode = drive_mode(registers)
    if series is Series.HLS and mode != "pwm":
        ceiling = min(ceiling, abs(registers.get("goal_torque")) * AMPERES / mechanics.stall_current)
    if mode == "pwm":
        return MotionOrder(MotorDrive.SPEED, target, fastest * _pwm(registers), acceleration, ceiling)
    if mode == "current":
        push = copysign(ceiling, registers.get("goal_torque"))
        return MotionOrder(MotorDrive.TORQUE, push, fastest, acceleration, ceiling)
    if mode == "speed":
        speed = registers.get("goal_speed") * speed_unit(registers)
        return MotionOrder(MotorDrive.SPEED, target, max(-fastest, min(fastest, speed)), acceleration, ceiling)
    speed = min(fastest, _travel_speed(registers, mechanics, distance))
    return MotionOrder(MotorDrive.POSITION, target, speed, acceleration, ceiling)


def _pwm(registers: RegisterFile) -> float:
    """Signed duty, -1..1, from the register in which the series keeps it."""
    if registers.series is Series.HLS:
        return max(-1.0, min(1.0, registers.get("goal_torque") / 1000))
    if registers.series is Series.STS_SMS:
        return max(-1.0, min(1.0, registers.get("goal_pwm_or_time") / 1000))
    value = registers.get("goal_time")
    duty = min(value & 0x3FF, 1000) / 1000
    return -duty if value & 0x400 else duty


def _travel_speed(registers: RegisterFile, mechanics: Mechanics, distance: float) -> float:
    """Speed limit of a move to a position, counts/s; inf if only the motor limits it."""
    series = registers.series
    if series is Series.SEVEN_BOT or series is Series.SCS:
        time = registers.get("run_time" if series is Series.SEVEN_BOT else "goal_time")
        if time:
            return speed_for_duration(distance, time / 1000, mechanics.max_acceleration)
        return inf if series is Series.SEVEN_BOT else registers.get("goal_speed") or inf
    speed = abs(registers.get("goal_speed")) * speed_unit(registers)
    if series is Series.STS_SMS and not speed and registers.get("phase") & 8:
        return inf
    return speed


def limits_of(registers: RegisterFile) -> ProtectionLimits:
    """Protection limits as the registers set them now."""
    series = registers.series
    if series is Series.SEVEN_BOT:
        return NO_LIMITS
    get = registers.get
    current, current_ticks = 1e9, NO_LIMITS.current_ticks
    if series is Series.SCS:
        overload, ticks, held = get("overload_torque") / 100, get("protect_time"), get("protect_torque") / 100
    else:
        current = get("protection_current") * AMPERES
        current_ticks = get("overcurrent_time") * _TICKS_A_UNIT
        if series is Series.STS_SMS:
            overload, ticks, held = get("overload_torque") / 100, get("overload_time"), get("holding_torque") / 100
        else:
            overload, ticks, held = _HLS_OVERLOAD, get("overcurrent_time"), _HLS_HELD
    return ProtectionLimits(
        overload_torque=overload,
        overload_ticks=max(1, ticks * _TICKS_A_UNIT),
        current=current,
        current_ticks=max(1, current_ticks),
        held_torque=held,
        temperature=get("max_temperature"),
        voltage=(get("min_voltage") / 10, get("max_voltage") / 10),
        switch=get("protection_switch"),
    )
