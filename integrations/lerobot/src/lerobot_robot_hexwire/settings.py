"""The settings of the servos of an SO arm that LeRobot writes at each connection.

Owns the values, which are LeRobot's (`SOFollower.configure`, 0.4.4 and 0.6): datasets and policies fit the same
gains. A value is written only where it differs, since it is stored in memory that wears.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hexwire.bus.setup import write_setting
from hexwire.errors import ServoError

if TYPE_CHECKING:
    from hexwire.bus.servo_bus import ServoBus
    from hexwire.model.arm import ArmModel

__all__ = ["FOLLOWER", "GRIPPER", "LEADER", "configure"]

_TRIES = 3

LEADER = {"return_delay": 0, "mode": 0}
FOLLOWER = {**LEADER, "position_p": 16, "position_i": 0, "position_d": 32}
GRIPPER = {"max_torque": 500, "protection_current": 250, "overload_torque": 25}
"""A gripper that presses for long does not burn out."""


def configure(bus: ServoBus, model: ArmModel, *, leader: bool) -> tuple[str, ...]:
    """Write the settings that differ; torque should be off.

    Returns:
        What was written, as in ``gripper max_torque``.

    Raises:
        ServoError: A servo does not answer, or has another value afterwards.
    """
    written = []
    for joint in model.joints:
        wanted = LEADER if leader else {**FOLLOWER, **(GRIPPER if joint.name == "gripper" else {})}
        for name, raw in wanted.items():
            reading = bus.read(joint.servo_id, name)
            if reading.raw is None:
                reading.check()
            if reading.raw != raw:
                _write(bus, joint.servo_id, name, raw)
                written.append(f"{joint.name} {name}")
                if name == "return_delay":
                    bus.set_return_delay(joint.servo_id, 0.0)
    return tuple(written)


def _write(bus: ServoBus, servo_id: int, name: str, raw: int) -> None:
    for _ in range(_TRIES - 1):
        try:
            return write_setting(bus, servo_id, name, raw)
        except ServoError:
            # Silent for a moment, such as a stall of the computer: the same value may be written again.
            continue
    return write_setting(bus, servo_id, name, raw)
