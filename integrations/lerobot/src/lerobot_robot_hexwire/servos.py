"""What the servos of an SO arm have stored, and the settings among it that LeRobot writes at each connection.

Owns the values, which are LeRobot's (`SOFollower.configure`, 0.4.4 and 0.6): datasets and policies fit the same
gains. A value is written only where it differs, since it is stored in memory that wears. Must not know connections.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hexwire.bus.setup import write_setting
from hexwire.drivers.base import JointProbe
from hexwire.drivers.bus_arm import ratings
from hexwire.drivers.checkup import explain_missing
from hexwire.errors import ServoError
from hexwire.wire.registers import Series

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

    from hexwire.bus.servo_bus import ServoBus
    from hexwire.bus.values import ServoBlock
    from hexwire.link.diagnose import Finding
    from hexwire.model.arm import ArmModel

__all__ = ["FOLLOWER", "GRIPPER", "LEADER", "configure", "probes", "stored", "unreadable"]

_TRIES = 3

LEADER = {"return_delay": 0, "mode": 0}
FOLLOWER = {**LEADER, "position_p": 16, "position_i": 0, "position_d": 32}
GRIPPER = {"max_torque": 500, "protection_current": 250, "overload_torque": 25}
"""A gripper that presses for long does not burn out."""

_REGISTERS = Series.STS_SMS.registers
_RATINGS = ("min_voltage", "max_voltage", "max_temperature")
_FIRST, _LAST = _REGISTERS["return_delay"], _REGISTERS["overload_torque"]


def stored(bus: ServoBus, model: ArmModel) -> dict[str, ServoBlock]:
    """What each servo has stored, by joint; one request for all."""
    count = _LAST.address + _LAST.size - _FIRST.address
    blocks = bus.sync_read_blocks(_FIRST.address, count, [joint.servo_id for joint in model.joints])
    return dict(zip(model.names, blocks, strict=True))


def unreadable(bus: ServoBus, model: ArmModel, silent: Collection[str]) -> list[Finding]:
    """Why servos of some joints could not be read, such as two with one id."""
    return explain_missing(bus, model, [joint for joint in model.joints if joint.name in silent])


def probes(model: ArmModel, blocks: Mapping[str, ServoBlock]) -> tuple[JointProbe, ...]:
    """The limits of supply and temperature that each servo has stored."""
    found = []
    for joint in model.joints:
        block = blocks[joint.name]
        supply, hottest = ratings(*(block.value(_REGISTERS[name]) for name in _RATINGS))
        found.append(
            JointProbe(joint.name, joint.servo_id, joint.series, True, supply=supply, max_temperature=hottest)
        )
    return tuple(found)


def configure(bus: ServoBus, model: ArmModel, blocks: Mapping[str, ServoBlock], *, leader: bool) -> tuple[str, ...]:
    """Write the settings that differ from what was stored; torque should be off.

    Returns:
        What was written, as in ``gripper max_torque``.

    Raises:
        ServoError: A servo does not answer, or has another value afterwards.
    """
    written = []
    for joint in model.joints:
        wanted = LEADER if leader else {**FOLLOWER, **(GRIPPER if joint.name == "gripper" else {})}
        for name, raw in wanted.items():
            if blocks[joint.name].raw(_REGISTERS[name]) != raw:
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
