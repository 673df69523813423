"""Identification of one servo on a bus, compared with the arm's file and calibration.

Owns the requests to that servo. Reads only. Must not know the arm as a whole.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hexwire.bus import setup as servo_setup

from .values import JointProbe

if TYPE_CHECKING:
    from hexwire.bus.servo_bus import ServoBus
    from hexwire.model.arm import JointModel
    from hexwire.model.calibration import Calibration

__all__ = ["probe_joint", "ratings"]


def probe_joint(bus: ServoBus, joint: JointModel, calibration: Calibration | None = None) -> JointProbe:
    """Identify the servo of a joint.

    Args:
        bus: An open bus.
        joint: The joint in the arm's file.
        calibration: The calibration of the arm, if it has one.
    """
    info = servo_setup.identify(bus, joint.servo_id)
    if info is None:
        return JointProbe(joint.name, joint.servo_id, "unknown", False)
    series = "unknown" if info.series is None else info.series.value
    notes = [] if series == joint.series else [f"answers as {series}, the arm's file says {joint.series}"]
    notes += _at_odds(bus, joint, calibration)
    model = f"{info.model_name} {info.firmware}" if info.firmware else ""
    supply, hottest = _ratings(bus, joint.servo_id)
    return JointProbe(joint.name, joint.servo_id, series, True, ", ".join(notes), model, supply, hottest)


def _ratings(bus: ServoBus, servo_id: int) -> tuple[tuple[float, float] | None, float | None]:
    """Read the limits of voltage (V) and temperature (deg C) that a servo has stored."""
    if "max_voltage" not in bus.series_of(servo_id).registers:
        return None, None
    low, high, hottest = (bus.read(servo_id, name) for name in ("min_voltage", "max_voltage", "max_temperature"))
    return ratings(low.value, high.value, hottest.value)


def ratings(low: float, high: float, hottest: float) -> tuple[tuple[float, float] | None, float | None]:
    """What the stored limits of voltage (V) and temperature (deg C) say; None for one that says nothing.

    Args:
        low: Of the voltage; like the others NaN where it was not read.
        high: Of the voltage.
        hottest: Of the temperature.
    """
    return (low, high) if low < high else None, hottest if hottest > 0.0 else None


def _at_odds(bus: ServoBus, joint: JointModel, calibration: Calibration | None) -> list[str]:
    """Compare a servo's stored offset with the calibration: with another offset every position is wrong."""
    for row in () if calibration is None else calibration.joints:
        if row.name == joint.name and row.servo_offset is not None:
            now = bus.read(joint.servo_id, "position_offset").raw
            if now != row.servo_offset:
                return [f"its offset is {now} but was {row.servo_offset} at calibration: calibrate again"]
    return []
