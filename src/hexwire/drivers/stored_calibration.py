"""The calibration that the servos of an arm have stored: read, and judged.

Owns the registers, and from which range on a joint does not count as calibrated. Must not write.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from hexwire.errors import ServoError
from hexwire.model.arms import assembly_of
from hexwire.model.calibration import Calibration, JointCalibration

if TYPE_CHECKING:
    from hexwire.bus.servo_bus import ServoBus
    from hexwire.model.arm import ArmModel, JointModel

__all__ = ["TOO_FAR", "not_calibrated", "stored_calibration", "stored_ranges"]

_STORED = ("position_offset", "min_position_limit", "max_position_limit")
"""Registers of a calibration."""
TOO_FAR = 1.3
"""Share of the usual range beyond which a joint cannot go."""
_TURN = 4096


def stored_ranges(bus: ServoBus, joints: Sequence[JointModel]) -> dict[str, JointCalibration | None]:
    """The offset and position limits that each servo has stored. Nothing is written.

    Args:
        bus: Their bus, open.
        joints: The joints whose servos are asked.

    Returns:
        By joint name, with None for a servo whose limits are no range within one turn; one that does not answer is
        not among them.
    """
    silent: set[int] = set()
    read: dict[str, dict[int, int]] = {}
    for name in _STORED:
        able = [joint.servo_id for joint in joints if name in bus.series_of(joint.servo_id).registers]
        for reading in bus.sync_read(name, able) if able else ():
            if reading.raw is None:
                silent.add(reading.servo_id)
            else:
                read.setdefault(name, {})[reading.servo_id] = reading.raw
    offsets, lows, highs = (read.get(name, {}) for name in _STORED)
    found: dict[str, JointCalibration | None] = {}
    for joint in joints:
        servo_id = joint.servo_id
        if servo_id in silent:
            continue
        low, high = lows.get(servo_id), highs.get(servo_id)
        if low is None or high is None or not 0 <= low < high < _TURN:
            found[joint.name] = None
            continue
        offset, middle = offsets.get(servo_id), (low + high) / 2
        found[joint.name] = JointCalibration(joint.name, servo_id, middle, low, high, servo_offset=offset)
    return found


def stored_calibration(bus: ServoBus, model: ArmModel) -> Calibration:
    """What the servos of a whole arm have stored. Nothing is written.

    Returns:
        A row for each servo whose limits are a range within one turn, with the date left empty.

    Raises:
        ServoError: A servo does not answer.
    """
    found = stored_ranges(bus, model.joints)
    for joint in model.joints:
        if joint.name not in found:
            name, servo_id = joint.name, joint.servo_id
            raise ServoError(f"{name} (servo {servo_id}) does not answer: check cable and power", servo_id=servo_id)
    return Calibration(model.name, "", tuple(row for row in found.values() if row is not None))


def not_calibrated(stored: Calibration, model: ArmModel) -> dict[str, str]:
    """Why joints of an arm do not count as calibrated, in words by name; empty if all do.

    A new servo has its whole turn as its range, or none. Joints without stops have no range, so nothing tells.

    Args:
        stored: As from `stored_calibration`.
        model: The arm as it usually is.
    """
    rows, found = {row.name: row for row in stored.joints}, {}
    for joint in model.joints:
        if joint.name in assembly_of(model).endless:
            continue
        row = rows.get(joint.name)
        if row is None:
            found[joint.name] = "no range stored"
        elif (travel := (row.high - row.low) * joint.scale) > TOO_FAR * (joint.maximum - joint.minimum):
            usual = math.degrees(joint.maximum - joint.minimum)
            found[joint.name] = f"{math.degrees(travel):.0f} deg stored, but it goes {usual:.0f} deg"
    return found
