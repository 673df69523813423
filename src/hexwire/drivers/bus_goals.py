"""Goals of servos on a bus: the bytes that send a servo of each series to a position in a given time.

Owns the stored settings that a goal depends on: each servo's unit of speed and its current ceiling. Must not know
stops, torque or callers.

Loops send goals of all joints hundreds of times a second, so what depends on the joint alone is prepared once.
"""

from __future__ import annotations

import math
from functools import lru_cache, partial
from struct import unpack
from typing import TYPE_CHECKING

from hexwire.wire.registers import Series
from hexwire.wire.servo_packet import make_sync_write, sync_write_packer
from hexwire.wire.tables import DEFAULT_CEILING

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from hexwire.bus.servo_bus import ServoBus
    from hexwire.bus.values import Reading
    from hexwire.model.arm import JointModel

__all__ = ["SPEED_UNIT", "BusGoals"]

SPEED_UNIT = 50.0
"""Counts per second of one unit of speed, unless a servo's register `phase` sets another."""
_PHASE_SPEED_UNIT = 0x04
"""Bit of STS register phase: a unit of speed is one count per second instead of 50."""
_SHORTEST, _LONGEST = 9, 0x7FFE
"""Milliseconds of a motion that a servo accepts; the shortest applies to the legacy series."""
_FASTEST = 0x7FFF
_STS_ROW = "<BHHH"
"""Acceleration, position, time (the current ceiling of HLS) and speed, which are adjacent registers."""
_sts_packer = lru_cache(partial(sync_write_packer, Series.STS_SMS.register("acceleration").address, _STS_ROW))
_STS_SERIES = frozenset((Series.STS_SMS.value, Series.HLS.value))
_MOST_COUNTS = 0x7FFF
"""Goals of STS and HLS servos up to this count have no sign bit."""

_Row = tuple[bool, int, int, float, float, int, float, int]
"""What the goals of a joint depend on: whether its servo is STS or HLS, id, sign, offset, scale, neutral, unit of
speed, ceiling."""


class BusGoals:
    """Builder of the goals of one arm.

    Args:
        bus: The bus of its servos.
        joints: Its joints by name.
    """

    def __init__(self, bus: ServoBus, joints: Mapping[str, JointModel]) -> None:
        self._bus, self._joints = bus, joints
        self._speed_units: dict[int, float] = {}
        self._ceilings: dict[int, int] = {}
        self._rows: dict[str, _Row] = {}

    def learn(self, joints: Iterable[JointModel]) -> None:
        """Read the settings that the goals of servos depend on."""
        self._rows.clear()
        ids: dict[Series, list[int]] = {}
        for joint in joints:
            ids.setdefault(Series(joint.series), []).append(joint.servo_id)
        for reading in self._read("phase", ids.get(Series.STS_SMS)):
            single = reading.raw is not None and reading.raw & _PHASE_SPEED_UNIT
            self._speed_units[reading.servo_id] = 1.0 if single else SPEED_UNIT
        for reading in self._read("protection_current", ids.get(Series.HLS)):
            self._ceilings[reading.servo_id] = reading.raw or DEFAULT_CEILING

    def unbind(self, joints: Iterable[JointModel]) -> None:
        """Take the last goal's speed from STS servos that do not move, as if they had just been switched on.

        Programs that give a goal without a speed, as LeRobot's own arms do, would crawl at it.
        """
        if ids := [joint.servo_id for joint in joints if joint.series == Series.STS_SMS.value]:
            self._bus.sync_write_raw("goal_speed", dict.fromkeys(ids, 0))
            # Nobody acknowledges such a packet, and the port may be closed next.
            for reading in self._bus.sync_read("goal_speed", ids):
                if reading.raw:
                    self._bus.write_raw(reading.servo_id, "goal_speed", 0)

    def _read(self, name: str, servo_ids: list[int] | None) -> Iterable[Reading]:
        return self._bus.sync_read(name, servo_ids) if servo_ids else ()

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
        data = b"\0" + position.encode(counts) + self._ceiling(joint).to_bytes(2, "little")
        return series.register("acceleration").address, data + series.register("goal_speed").encode(speed)

    def make_packets(
        self, moves: Iterable[tuple[str, float]], duration: float, starts: Mapping[str, float]
    ) -> tuple[list[bytes], tuple[tuple[str, float], ...]]:
        """Make the goals of several joints; each as by `make`.

        Args:
            moves: Names of joints with the angles to which they go, radians.
            duration: Seconds.
            starts: Angles at the start by joint name, radians, where they are known.

        Returns:
            One packet for each address and length; and the angles as the servos round them.
        """
        others: dict[tuple[int, int], dict[int, bytes]] = {}
        sent, rows = [], self._rows
        fields: list[int] = []
        for name, angle in moves:
            row = rows.get(name)
            if row is None:
                rows[name] = row = self._make_row(self._joints[name])
            like_sts, servo_id, sign, offset, scale, neutral, unit, ceiling = row
            start = starts.get(name)
            if like_sts and start is not None:
                steps = round(sign * (angle - offset) / scale)
                counts = steps + neutral
                if 0 <= counts <= _MOST_COUNTS:
                    distance = abs(steps - round(sign * (start - offset) / scale))
                    speed = math.ceil(distance / duration / unit) or 1
                    fields += servo_id, 0, counts, ceiling, speed if speed < _FASTEST else _FASTEST
                    sent.append((name, sign * steps * scale + offset))
                    continue
            joint = self._joints[name]
            counts = joint.angle_to_counts(angle)
            address, data = self.make(joint, counts, duration, start)
            if like_sts:
                fields += servo_id, *unpack(_STS_ROW, data)
            else:
                others.setdefault((address, len(data)), {})[servo_id] = data
            sent.append((name, joint.counts_to_angle(counts)))
        packets = [make_sync_write(address, data_of) for (address, _), data_of in others.items()]
        if fields:
            packets.append(_sts_packer(len(fields) // 5)(*fields))
        return packets, tuple(sent)

    def _make_row(self, joint: JointModel) -> _Row:
        return (
            joint.series in _STS_SERIES,
            joint.servo_id,
            joint.sign,
            joint.offset,
            joint.scale,
            joint.neutral,
            self.speed_unit(joint),
            self._ceiling(joint),
        )

    def _ceiling(self, joint: JointModel) -> int:
        """Most current of an HLS servo; other servos have none, and 0 in its place."""
        if Series(joint.series) is not Series.HLS:
            return 0
        return self._ceilings.get(joint.servo_id, DEFAULT_CEILING)
