"""Goals of servos on a bus: the bytes that send each series to a position in a time.

Owns what a goal depends on besides the position: the unit of speeds and the current ceiling that each servo has
stored. Must not know stops, torque or who asks.
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
"""Counts per second of one unit of speed, unless a servo's register `phase` says otherwise."""
_PHASE_SPEED_UNIT = 0x04
"""Bit of STS register phase: speeds count single steps instead of 50."""
_SHORTEST, _LONGEST = 9, 0x7FFE
"""Milliseconds of a motion that a servo takes; the shortest is of the legacy series."""
_FASTEST = 0x7FFF


class BusGoals:
    """The goals of one arm.

    Args:
        bus: Where its servos hang.
    """

    def __init__(self, bus: ServoBus) -> None:
        self._bus = bus
        self._speed_units: dict[int, float] = {}
        self._ceilings: dict[int, int] = {}

    def learn(self, joint: JointModel) -> None:
        """Read what the goals of a servo depend on."""
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
        """Address and bytes that send a servo to a position in a time.

        Args:
            joint: Whose servo.
            counts: The position.
            duration: Seconds.
            start: Angle from which it begins, radians; None if that is not known.
        """
        series = Series(joint.series)
        milliseconds = min(round(duration * 1000), _LONGEST)
        if series is Series.SEVEN_BOT:
            position, time = series.register("target_position"), series.register("run_time")
            return position.address, position.encode(max(counts, 0)) + time.encode(max(milliseconds, _SHORTEST))
        position = series.register("goal_position")
        if series is Series.SCS:
            # Position, time, speed: neighbours, and the speed is not used where there is a time.
            goal = position.encode(max(counts, 0)) + series.register("goal_time").encode(milliseconds)
            return position.address, goal + b"\0\0"
        distance = abs(counts - joint.angle_to_counts(start)) if start is not None else 0
        speed = min(max(1, math.ceil(distance / duration / self.speed_unit(joint))), _FASTEST)
        ceiling = self._ceilings.get(joint.servo_id, DEFAULT_CEILING) if series is Series.HLS else 0
        data = b"\0" + position.encode(counts) + ceiling.to_bytes(2, "little")
        return series.register("acceleration").address, data + series.register("goal_speed").encode(speed)
