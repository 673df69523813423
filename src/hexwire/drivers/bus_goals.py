"""Goals of servos on a bus: the bytes that send a servo of each series to a position in a given time.

Owns the stored settings that a goal depends on: each servo's unit of speed and its current ceiling. Must not know
stops, torque or callers.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from hexwire.wire.registers import Series
from hexwire.wire.tables import DEFAULT_CEILING

if TYPE_CHECKING:
    from hexwire.bus.servo_bus import ServoBus
    from hexwire.model.arm import JointModel

__all__ = ["SPEED_UNIT", "BusGoals"]

SPEED_UNIT = 50.0
"""Counts per second of one unit of speed, unless a servo's register `phase` sets another."""
_PHASE_SPEED_UNIT = 0x04
"""Bit of STS register phase: a unit of speed is one count per second instead of 50."""
_SHORTEST, _LONGEST = 9, 0x7FFE
"""Milliseconds of a motion that a servo accepts; the shortest applies to the legacy series."""
_FASTEST = 0x7FFF


class BusGoals:
    """Builder of the goals of one arm.

    Args:
        bus: The bus of its servos.
    """

    def __init__(self, bus: ServoBus) -> None:
        self._bus = bus
        self._speed_units: dict[int, float] = {}
        self._ceilings: dict[int, int] = {}

    def learn(self, joint: JointModel) -> None:
        """Read the settings that the goals of a servo depend on."""
        servo_id, series = joint.servo_id, Series(joint.series)
        if series is Series.STS_SMS:
            phase = self._bus.read(servo_id, "phase").raw
            single = phase is not None and phase & _PHASE_SPEED_UNIT
            self._speed_units[servo_id] = 1.0 if single else SPEED_UNIT
        elif series is Series.HLS:
            self._ceilings[servo_id] = self._bus.read(servo_id, "protection_current").raw or DEFAULT_CEILING

    def speed_unit(self, joint: JointModel) -> float:
        """Counts per second of one unit of a servo's speed."""
        return self._speed_units.get(joint.servo_id, SPEED_UNIT)

    def make(self, joint: JointModel, counts: int, duration: float, start: float | None) -> tuple[int, bytes]:
        """Make the address and bytes that send a servo to a position in a given time.

        Args:
            joint: The joint of the servo.
            counts: The goal position, encoder counts.
            duration: Seconds.
            start: Angle at the start, radians; None if it is unknown.
        """
        series = Series(joint.series)
        milliseconds = min(round(duration * 1000), _LONGEST)
        if series is Series.SEVEN_BOT:
            position, time = series.register("target_position"), series.register("run_time")
            return position.address, position.encode(max(counts, 0)) + time.encode(max(milliseconds, _SHORTEST))
        position = series.register("goal_position")
        if series is Series.SCS:
            # Position, time and speed are adjacent registers; the servo ignores the speed if there is a time.
            goal = position.encode(max(counts, 0)) + series.register("goal_time").encode(milliseconds)
            return position.address, goal + b"\0\0"
        distance = abs(counts - joint.angle_to_counts(start)) if start is not None else 0
        speed = min(max(1, math.ceil(distance / duration / self.speed_unit(joint))), _FASTEST)
        ceiling = self._ceilings.get(joint.servo_id, DEFAULT_CEILING) if series is Series.HLS else 0
        data = b"\0" + position.encode(counts) + ceiling.to_bytes(2, "little")
        return series.register("acceleration").address, data + series.register("goal_speed").encode(speed)
